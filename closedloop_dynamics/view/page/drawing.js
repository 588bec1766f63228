// A drawing of a mechanism in the plane, and the scene that it is, as YAML. Knows no page and no server.

// Metres and radians of units.
const LENGTH_UNITS = {mm: 1e-3, cm: 1e-2, m: 1, inch: 0.0254}, DEGREE = Math.PI / 180;
// Masses of bars [kg/m], of gears, cams and other discs [kg/m^2], of blocks that slide [kg].
const BAR_DENSITY = 1, DISC_DENSITY = 40, BLOCK_MASS = 0.1;
// Coefficients of new springs and dampers [N/m, N s/m].
const SPRING_STIFFNESS = 100, DAMPER_DAMPING = 1;
// The pin of a Geneva drive, and what is beside it in a slot, against the distance of both axes.
const GENEVA_PIN = 0.05, GENEVA_CLEARANCE = 2e-4;
// Deceleration of its wheel between two turns [rad/s^2].
const GENEVA_HOLD = 100;
const CONTACT = 'stiffness: 2.0e+6, restitution: 0.2, impact_velocity: 0.02';
const GROUND_BODY = 'ground';

const difference = ([a, b], [c, d]) => [a - c, b - d];
const rotate = ([x, y], angle) => [x * Math.cos(angle) - y * Math.sin(angle),
                                   x * Math.sin(angle) + y * Math.cos(angle)];
const angleOf = ([x, y]) => Math.atan2(y, x);

// What is drawn: `nodes` by name {x, y, ground, trace}, `elements` by name {kind, ...}:
//   link      nodes [name, ...]                 a bar, or a polygon of three and more
//   slider    node, on, angle, block            a block on a line of the ground or a link; or a pin in a slot
//   gear      node, teeth, module, ring, fixed  fixed: to the ground or a link, else it turns by itself
//   mesh, belt  a, b                            two gears
//   rack      gear, angle                       slides along the angle, to the left of the gear's centre
//   cylinder  a, b                              a rod of variable length between two nodes
//   spring    a, b, stiffness, damping
//   cam       node, roller, radius, radii       radii at even angles, the roller about a node
//   geneva    wheel, driver, slots              between two nodes, with a driver of its own
//   motor     node or on, law, value            law: speed or torque (force)
//   force     node, x, y
class Drawing {
  constructor(data = null) {
    Object.assign(this, {name: 'drawing', unit: 'mm', gravity: true, nodes: {}, elements: {}}, data);
  }

  copy() { return new Drawing(JSON.parse(JSON.stringify(this))); }

  place(node) { return [this.nodes[node].x, this.nodes[node].y]; }

  of(...kinds) { return Object.entries(this.elements).filter(([, {kind}]) => kinds.includes(kind)); }

  newNode(place) {
    const taken = new Set([...Object.keys(this.nodes), ...Object.keys(this.elements)]);
    let name;
    for (let k = 0; !name || taken.has(name); k++) {
      name = String.fromCharCode(65 + k % 26) + (k < 26 ? '' : Math.floor(k / 26));
    }
    this.nodes[name] = {x: place[0], y: place[1]};
    return name;
  }

  add(kind, values) {
    let number = 1;
    while (`${kind}_${number}` in this.elements) number++;
    this.elements[`${kind}_${number}`] = {kind, ...values};
    return `${kind}_${number}`;
  }

  // Names of nodes and elements that an element hangs on.
  static needs({nodes = [], node, a, b, gear, roller, wheel, driver, on, fixed}) {
    return [...nodes, node, a, b, gear, roller, wheel, driver, on, fixed].filter(
      (one) => one !== undefined && one !== null && one !== GROUND_BODY);
  }

  // With it goes what hangs on it; nodes of nothing go, too.
  remove(name) {
    delete this.elements[name];
    delete this.nodes[name];
    for (const [other, one] of Object.entries(this.elements)) {
      if (Drawing.needs(one).includes(name)) {
        if (one.kind === 'link' && one.nodes.length > 2) one.nodes = one.nodes.filter((node) => node !== name);
        else if (one.fixed === name) one.fixed = null;
        else this.remove(other);
      }
    }
    const used = new Set(Object.values(this.elements).flatMap(Drawing.needs));
    for (const node of Object.keys(this.nodes)) {
      if (!used.has(node) && !this.nodes[node].ground) delete this.nodes[node];
    }
  }

  rename(before, after) {
    const swap = (value) => (value === before ? after : value);
    const keys = (map) => Object.fromEntries(Object.entries(map).map(([key, one]) => [swap(key), one]));
    [this.nodes, this.elements] = [keys(this.nodes), keys(this.elements)];
    for (const one of Object.values(this.elements)) {
      for (const [key, value] of Object.entries(one)) {
        if (key !== 'kind' && key !== 'law') one[key] = Array.isArray(value) ? value.map(swap) : swap(value);
      }
    }
  }

  radius(gear) {
    const {teeth, module} = this.elements[gear];
    return 0.5 * teeth * module;
  }

  // Bodies by name, the barrel of a cylinder nearer to the ground than its rod.
  bodies() {
    const bodies = this.#bodies(new Set()), depth = this.#depths(bodies);
    const turned = this.of('cylinder').map(([name]) => name).filter(
      (name) => depth[`${name}_rod`] < depth[`${name}_barrel`]);
    return turned.length ? this.#bodies(new Set(turned)) : bodies;
  }

  // How many joints lead from the ground to each body; Infinity where none do.
  #depths(bodies) {
    const depth = Object.fromEntries(Object.keys(bodies).map((body) => [body, Infinity]));
    const pairs = this.of('slider', 'rack').filter(([, {kind, block}]) => kind === 'rack' || block).map(
      ([name, {on}]) => [on ?? GROUND_BODY, name]);
    const waiting = [GROUND_BODY];
    depth[GROUND_BODY] = 0;
    while (waiting.length) {
      const here = waiting.shift();
      for (const body of Object.keys(bodies)) {
        if (depth[body] === Infinity && (bodies[body].nodes.some((node) => bodies[here].nodes.includes(node))
          || pairs.some((pair) => pair.includes(here) && pair.includes(body)))) {
          depth[body] = depth[here] + 1;
          waiting.push(body);
        }
      }
    }
    return depth;
  }

  // Where their frames are, which nodes they have, and their mass.
  #bodies(turned) {
    const found = {[GROUND_BODY]: {at: [0, 0], angle: 0, nodes: Object.keys(this.nodes).filter(
      (node) => this.nodes[node].ground)}};
    const disc = (at, radius, nodes, given) => {
      const mass = given ?? DISC_DENSITY * Math.PI * radius * radius;
      return {at, angle: 0, nodes, mass, center: [0, 0], inertia: 0.5 * mass * radius * radius};
    };
    for (const [name, one] of Object.entries(this.elements)) {
      if (one.kind === 'link') found[name] = this.#link(one);
      else if (one.kind === 'slider' && one.block) {
        const mass = one.mass ?? BLOCK_MASS;
        found[name] = {at: this.place(one.node), angle: one.angle, nodes: [one.node], mass,
                       center: [0, 0], inertia: 1e-4 * mass};
      } else if (one.kind === 'gear' && !one.fixed) {
        found[name] = disc(this.place(one.node), this.radius(name), [one.node], one.mass);
      } else if (one.kind === 'rack') {
        const radius = this.radius(one.gear), gear = this.elements[one.gear];
        const [x, y] = this.place(gear.node), [u, v] = rotate([0, -radius], one.angle);
        found[name] = {...this.#bar(4 * radius, one.mass), at: [x + u, y + v], angle: one.angle,
                       center: [0, 0], nodes: []};
      } else if (one.kind === 'cylinder') {
        const ends = turned.has(name) ? [one.b, one.a] : [one.a, one.b];
        const [a, b] = ends.map((node) => this.place(node)), angle = angleOf(difference(b, a));
        // Half of the mass each, as long as half of what is drawn.
        const half = 0.5 * Math.hypot(...difference(b, a)), mass = 0.5 * (one.mass ?? 2 * BAR_DENSITY * half);
        found[`${name}_barrel`] = {...this.#bar(half, mass), at: a, angle, nodes: [ends[0]], end: `${name}_foot`};
        found[`${name}_rod`] = {...this.#bar(half, mass), at: b, angle, nodes: [ends[1]], end: `${name}_head`,
                                center: [-0.5 * half, 0]};
      } else if (one.kind === 'cam') {
        found[name] = disc(this.place(one.node), Math.max(...one.radii), [one.node], one.mass);
      } else if (one.kind === 'geneva') {
        const {apart, crank, line} = this.geneva(name);
        found[name] = disc(this.place(one.wheel), apart * Math.cos(Math.PI / one.slots), [one.wheel], one.mass);
        found[name].angle = line + Math.PI / one.slots;
        found[`${name}_driver`] = {...this.#bar(crank, one.mass), at: this.place(one.driver), angle: line,
                                   nodes: [one.driver]};
      }
    }
    return found;
  }

  // Distance of both axes, length of the driver, and the direction from the wheel to the driver.
  geneva(name) {
    const {wheel, driver, slots} = this.elements[name], away = difference(this.place(driver), this.place(wheel));
    const apart = Math.hypot(...away);
    return {apart, crank: apart * Math.sin(Math.PI / slots), line: angleOf(away)};
  }

  #bar(length, given) {
    const mass = given ?? BAR_DENSITY * length;
    return {mass, center: [0.5 * length, 0], inertia: mass * length * length / 12};
  }

  // Uniform bars along the edges; the frame is at the first node, its x axis towards the second.
  #link({nodes, mass: given}) {
    const places = nodes.map((node) => this.place(node)), angle = angleOf(difference(places[1], places[0]));
    const local = places.map((place) => rotate(difference(place, places[0]), -angle));
    const edges = nodes.length > 2 ? local.map((a, k) => [a, local[(k + 1) % local.length]]) : [local];
    const lengths = edges.map(([a, b]) => Math.hypot(...difference(b, a)));
    const whole = lengths.reduce((sum, one) => sum + one, 0), mass = given ?? BAR_DENSITY * whole;
    const share = lengths.map((length) => mass * length / whole);
    const middle = edges.map(([a, b]) => [0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1])]);
    const center = [0, 1].map((k) => middle.reduce((sum, one, e) => sum + share[e] * one[k], 0) / mass);
    const inertia = share.reduce((sum, one, e) => sum + one * (
      lengths[e] ** 2 / 12 + Math.hypot(...difference(middle[e], center)) ** 2), 0);
    return {at: places[0], angle, nodes, mass, center, inertia};
  }

  // Joints between bodies, from the one nearer to the ground: of each node that with each of the
  // others; what slides.
  joints(bodies = this.bodies()) {
    const found = [], depth = this.#depths(bodies);
    for (const node of Object.keys(this.nodes)) {
      const here = Object.keys(bodies).filter((body) => bodies[body].nodes.includes(node)).sort(
        (one, other) => depth[one] - depth[other] || 0);
      const whole = here.filter((body) => !bodies[body].end), [first, ...others] = whole;
      others.forEach((other, k) => found.push({
        name: k ? `${node}_${k + 1}` : node, type: 'revolute', node, between: [first, other], at: this.place(node)}));
      for (const body of here.filter((one) => bodies[one].end)) {
        found.push({name: bodies[body].end, type: 'revolute', node, between: [first ?? 'nothing', body],
                    at: this.place(node), ofCylinder: true});
      }
    }
    for (const [name, one] of this.of('slider', 'rack', 'cylinder')) {
      const [barrel, rod] = [`${name}_barrel`, `${name}_rod`];
      if (one.kind === 'slider' && !one.block) continue;
      const pair = one.kind === 'cylinder' ? [barrel, rod] : [one.on ?? GROUND_BODY, name];
      found.push({
        name: one.kind === 'cylinder' ? name : `${name}_guide`, type: 'prismatic',
        between: depth[pair[1]] < depth[pair[0]] ? pair.reverse() : pair,
        at: one.kind === 'cylinder' ? bodies[barrel].at : bodies[name].at, ofCylinder: one.kind === 'cylinder'});
    }
    return found;
  }

  // The turn of a body against another one, as factors of joints; null where none leads there.
  static turn(joints, from, to) {
    const known = {[from]: {}};
    const waiting = [from];
    while (waiting.length) {
      const here = waiting.shift();
      for (const {name, type, between: [a, b]} of joints) {
        for (const [one, other, sign] of [[a, b, 1], [b, a, -1]]) {
          if (one === here && !(other in known)) {
            known[other] = type === 'revolute' ? {...known[here], [name]: sign} : known[here];
            waiting.push(other);
          }
        }
      }
    }
    return known[to] ?? null;
  }

  // The body that carries both gears.
  carrier(a, b, bodies) {
    const [one, other] = [this.elements[a].node, this.elements[b].node];
    const found = Object.keys(bodies).filter((body) => (
      bodies[body].nodes.includes(one) && bodies[body].nodes.includes(other)));
    return found.find((body) => body !== GROUND_BODY) ?? found[0] ?? GROUND_BODY;
  }

  #gearBody(gear) { return this.elements[gear].fixed ?? gear; }

  // The motor's joint.
  driven({node, on, body}, joints) {
    if (on) return this.elements[on].kind === 'cylinder' ? on : `${on}_guide`;
    const here = joints.filter((joint) => joint.node === node);
    return (here.find(({between}) => between[1] === body) ?? here[0])?.name;
  }

  // The scene.

  text() {
    const bodies = this.bodies(), joints = this.joints(bodies), {length, pair, angle} = this.#writers();
    const local = (body, place) => pair(rotate(difference(place, bodies[body].at), -bodies[body].angle));
    const motors = this.of('motor').map(([name, one]) => [name, one, this.driven(one, joints)]);
    const actuated = new Set(motors.filter(([, {law}]) => law === 'torque').map(([, , joint]) => joint));
    const lines = ['mechanism:', `  name: ${this.name}`, '  bodies:'];
    for (const [name, {mass, center, inertia}] of Object.entries(bodies)) {
      if (name !== GROUND_BODY && !bodies[name].end) {
        lines.push(`    ${name}: {mass: ${brief(mass)}, center_of_mass: ${pair(center)}, inertia: ${brief(inertia)}}`);
      }
    }
    lines.push('  joints:');
    for (const {name, type, between: [a, b], at} of joints.filter((joint) => !joint.ofCylinder)) {
      const turned = type === 'prismatic' && a !== b ? bodies[b].angle - bodies[a].angle : 0;
      lines.push(`    ${name}: {type: ${type}, between: [${a}, ${b}], points: [${local(a, at)}, ${local(b, at)}]${
        Math.abs(turned) > 1e-12 ? `, angle: ${angle(turned)}` : ''}${actuated.has(name) ? ', actuated: true' : ''}}`);
    }
    const slots = this.of('slider').filter(([, {block}]) => !block);
    if (slots.length) lines.push('  cut_joints:');
    for (const [name, {node, on, angle: along}] of slots) {
      const body = this.bodyAt(node, bodies, on), at = this.place(node);
      lines.push(`    ${name}: {type: point_on_line, body_a: ${body}, point_a: ${local(body, at)}, body_b: ${on}, point_b: ${
        local(on, at)}, angle: ${angle(along - bodies[on].angle)}}`);
    }
    const cylinders = this.of('cylinder');
    if (cylinders.length) lines.push('  cylinders:');
    for (const [name] of cylinders) {
      const ends = ['foot', 'head'].map((end) => joints.find((joint) => joint.name === `${name}_${end}`));
      const {mass, center: [half]} = bodies[`${name}_barrel`];
      lines.push(`    ${name}: {between: [${ends.map(({between}) => between[0]).join(', ')}], points: [${
        ends.map(({between: [body], at}) => (body in bodies ? local(body, at) : pair(at))).join(', ')}], mass: ${
        brief(2 * mass)}, length: ${length(2 * half)}${actuated.has(name) ? ', actuated: true' : ''}}`);
    }
    const couplings = this.couplings(bodies, joints);
    if (couplings.length) lines.push('  couplings:');
    for (const {name, joints: factors, offset, radius} of couplings) {
      const written = Object.entries(factors).map(([joint, factor]) => `${joint}: ${brief(factor, 12)}`);
      lines.push(`    ${name}: {joints: {${written.join(', ')}}${
        Math.abs(offset) > 1e-9 ? `, offset: ${brief(offset, 12)}` : ''}${radius ? `, radius: ${length(radius)}` : ''}}`);
    }
    const [effects, points] = this.#effects(bodies, joints, motors);
    for (const [node, {trace}] of Object.entries(this.nodes)) {
      const here = Object.keys(bodies).filter((body) => bodies[body].nodes.includes(node));
      if (trace || here.length === 1 && here[0] !== GROUND_BODY && !slots.some(([, one]) => one.node === node)) {
        points.set(node, [this.bodyAt(node, bodies), this.place(node)]);
      }
    }
    const traced = [...points].sort(([a], [b]) => Boolean(this.nodes[b]?.trace) - Boolean(this.nodes[a]?.trace));
    if (points.size) lines.push('  points:');
    for (const [name, [body, at]] of traced) lines.push(`    ${name}: {body: ${body}, position: ${local(body, at)}}`);
    const places = joints.filter(({name, node}) => name === node).map(({node}) => node);
    const ends = joints.filter(({name, node, ofCylinder}) => ofCylinder && node && !places.includes(node));
    places.push(...slots.map(([name]) => name), ...[...points.keys()].filter((name) => (
      name in this.nodes && !places.includes(name) && !slots.some(([, {node}]) => node === name))));
    const starts = places.map((name) => [name, this.place(name in this.nodes ? name : this.elements[name].node)]);
    starts.push(...ends.map(({name, at}) => [name, at]));
    lines.push('initial:', `  at: {${starts.map(([name, place]) => `${name}: ${pair(place)}`).join(', ')}}`);
    const turns = this.of('geneva').flatMap(([name]) => [name, `${name}_driver`]).map((body) => [
      joints.find(({between}) => between[1] === body)?.name, bodies[body].angle]).filter(([name]) => name);
    if (turns.length) {
      lines.push(`  position: {${turns.map(([name, value]) => `${name}: ${angle(value)}`).join(', ')}}`);
    }
    if (this.gravity) effects.unshift('gravity: {type: gravity, acceleration: [0, -9.81]}');
    if (effects.length) lines.push('effects:', ...effects.map((effect) => `  ${effect}`));
    return `${lines.join('\n')}\n`;
  }

  // The first body at a node that is not the ground, nor another one.
  bodyAt(node, bodies, but = null) {
    const here = Object.keys(bodies).filter((body) => bodies[body].nodes.includes(node) && body !== but);
    return here.find((body) => body !== GROUND_BODY) ?? here[0] ?? GROUND_BODY;
  }

  #writers() {
    const size = LENGTH_UNITS[this.unit];
    const length = (value) => {
      const number = Number((value / size).toPrecision(12));
      return Math.abs(number) < 1e-9 ? '0' : `${number} ${this.unit}`;
    };
    return {length, pair: (place) => `[${place.map(length).join(', ')}]`,
            angle: (value) => `${Number((value / DEGREE).toPrecision(13))} deg`};
  }

  // Couplings of gears, belts and racks: factors by joint.
  couplings(bodies, joints) {
    const found = [];
    const put = (name, terms, offset, radius) => {
      const sum = {};
      for (const [factor, turn] of terms) {
        // The gear's own joint first, which has the radius.
        for (const [joint, sign] of Object.entries(turn ?? {}).reverse()) sum[joint] = (sum[joint] ?? 0) + factor * sign;
      }
      found.push({name, offset, radius, joints: Object.fromEntries(
        Object.entries(sum).filter(([, factor]) => factor))});
    };
    for (const [name, {kind, a, b}] of this.of('mesh', 'belt')) {
      const carrier = this.carrier(a, b, bodies), [one, other] = [a, b].map((gear) => this.#gearBody(gear));
      const inside = this.elements[a].ring || this.elements[b].ring;
      const [first, second] = [this.elements[a].teeth, (inside || kind === 'belt' ? -1 : 1) * this.elements[b].teeth];
      const turns = [one, other].map((body) => Drawing.turn(joints, carrier, body));
      // A gear that turns by itself begins where it meshes.
      const offset = one === a || other === b ? 0 : [[first, one], [second, other]].reduce((sum, [factor, body]) => (
        sum + factor * (bodies[body].angle - bodies[carrier].angle)), 0);
      put(name, [[first, turns[0]], [second, turns[1]]], offset, one === a ? this.radius(a) : 0);
    }
    for (const [name, {gear}] of this.of('rack')) {
      const turn = Drawing.turn(joints, GROUND_BODY, this.#gearBody(gear)), radius = this.radius(gear);
      put(`${name}_mesh`, [[1, {[`${name}_guide`]: 1}], [-radius, turn]], 0);
    }
    return found;
  }

  #effects(bodies, joints, motors) {
    const found = [], points = new Map(), {length, pair} = this.#writers();
    const point = (node) => {
      points.set(node, [this.bodyAt(node, bodies), this.place(node)]);
      return node;
    };
    for (const [name, {law, value}, joint] of motors) {
      found.push(`${name}: {type: ${law === 'speed' ? 'prescribed_motion' : 'prescribed_force'}, joint: ${
        joint ?? 'none'}, shape: ${law === 'speed' ? 'constant_speed, speed' : 'constant, amplitude'}: ${brief(value)}}`);
    }
    for (const [name, {node, x, y}] of this.of('force')) {
      found.push(`${name}: {type: external_force, point: ${point(node)}, force: [${brief(x)}, ${brief(y)}]}`);
    }
    for (const [name, {a, b, stiffness, damping, free}] of this.of('spring')) {
      const [from, to] = this.nodes[a].ground && !this.nodes[b].ground ? [b, a] : [a, b];
      const rest = free ?? Math.hypot(...difference(this.place(b), this.place(a)));
      found.push(`${name}: {type: point_spring, point_a: ${point(from)}, ${
        this.nodes[to].ground ? `anchor: ${pair(this.place(to))}` : `point_b: ${point(to)}`}${
        stiffness ? `, stiffness: ${brief(stiffness)}, free_length: ${length(rest)}` : ''}${
        damping ? `, damping: ${brief(damping)}` : ''}}`);
    }
    for (const [name, {node, roller, radius, radii}] of this.of('cam')) {
      points.set(`${name}_axle`, [name, this.place(node)]);
      found.push(`${name}_outline: {type: body_contact, point: ${point(roller)}, radius: ${length(radius)}, other: ${
        name}_axle, shape: curve, ${CONTACT}, radii: [${radii.map(length).join(', ')}]}`);
    }
    for (const [name, {slots}] of this.of('geneva')) {
      const {apart, crank, line} = this.geneva(name), [x, y] = bodies[`${name}_driver`].at;
      points.set(`${name}_pin`, [`${name}_driver`, [x + crank * Math.cos(line), y + crank * Math.sin(line)]]);
      points.set(`${name}_axle`, [name, bodies[name].at]);
      const pin = GENEVA_PIN * apart;
      found.push(`${name}_slots: {type: body_contact, point: ${name}_pin, radius: ${length(pin)}, other: ${
        name}_axle, shape: curve, ${CONTACT}, outline: {geneva: {slots: ${slots}, distance: ${
        length(apart)}, clearance: ${length(GENEVA_CLEARANCE * apart)}}}}`);
      // What its disc locks, friction holds here.
      found.push(`${name}_bearing: {type: joint_friction, joint: ${
        joints.find(({between}) => between[1] === name)?.name}, coulomb: ${
        brief(GENEVA_HOLD * bodies[name].inertia)}}`);
    }
    return [found, points];
  }
}

// A number with the digits that a mass or a factor needs.
const brief = (value, digits = 6) => String(Number(value.toPrecision(digits)));
