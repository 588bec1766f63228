// A drawing from the text of a scene: the YAML that the board writes, as people change it. Knows no page.

const ANGLE_UNITS = {deg: DEGREE, rad: 1};
const UNITS_OF = {length: LENGTH_UNITS, angle: ANGLE_UNITS, number: {}, any: {...LENGTH_UNITS, ...ANGLE_UNITS},
  turning: {...ANGLE_UNITS, rpm: Math.PI / 30}};
const NUMBER_WITH_UNIT = /((?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?) ?(mm|cm|m|inch|deg|rad|rpm)\b/gi;
// How far numbers may be from those that the board writes, of their size; how far apart one place is [m].
const SAME_NUMBER = 2e-5, SAME_PLACE = 1e-9;

// The value of 40, 40 mm, 2*(1.5 inch) or 30 deg; `bare` is the unit of numbers without one. Throws an Error.
function quantity(text, kind, bare = 1) {
  let units = false;
  const plain = text.replace(NUMBER_WITH_UNIT, (_, number, unit) => {
    if (!(unit in UNITS_OF[kind])) throw new Error(`expected ${kind === 'number' ? 'a number without unit' : `units of ${kind}`}, got ${text}`);
    units = true;
    return `(${number}*${UNITS_OF[kind][unit]})`;
  });
  let value = NaN;
  try {
    value = /\bt\b/.test(plain) ? NaN : expressionOf(plain)(0)[0];
  } catch {
    // Said below.
  }
  if (!Number.isFinite(value)) throw new Error(`expected a number, got ${text}`);
  return units ? value : value * bare;
}

const wrongAt = (node, words) => new Error(`line ${node.line}: ${words}`);

// Nodes of YAML, of those parts of it that scenes are written in: {line, map}, {line, list} or {line, text}.
function parsedYaml(text) {
  const lines = [];
  text.split('\n').forEach((line, k) => {
    const words = line.replace(/(^|\s)#.*$/, '').trimEnd(), last = lines.at(-1);
    if (!words.trim()) return;
    if (words.includes('\t')) throw wrongAt({line: k + 1}, 'expected spaces, got a tab');
    // What is in brackets goes on over lines.
    const open = last && (last.words.match(/[[{]/g) ?? []).length > (last.words.match(/[\]}]/g) ?? []).length;
    if (open) last.words += ` ${words.trim()}`;
    else lines.push({line: k + 1, indent: words.search(/\S/), words: words.trim()});
  });
  if (!lines.length) throw new Error('line 1: expected a mechanism, got nothing');
  let at = 0;
  // What is on one line: JSON, once its words are quoted.
  const flow = (words, line) => {
    const json = words.replace(/"[^"]*"|'[^']*'|(?:[^[\]{},:"'\s]|:(?!\s|$)| (?=[^[\]{},:\s]))+/g, (token) => (
      JSON.stringify(token.trim().replace(/^(["'])(.*)\1$/, '$2'))));
    let keys = 0;
    const node = (value) => {
      if (typeof value === 'string') return {line, text: value};
      if (Array.isArray(value)) return {line, list: value.map(node)};
      const entries = Object.entries(value);
      keys += entries.length;
      return {line, map: new Map(entries.map(([key, one]) => [key, node(one)]))};
    };
    let found;
    try {
      found = node(JSON.parse(json));
    } catch {
      throw wrongAt({line}, `expected a value, a list in [ ] or a mapping in { }, got ${words}`);
    }
    if (keys < (json.match(/"\s*:/g) ?? []).length) throw wrongAt({line}, 'expected each key once');
    return found;
  };
  const block = () => {
    const {indent, line} = lines[at], map = new Map();
    while (at < lines.length && lines[at].indent === indent) {
      const here = lines[at], [, key, rest] = /^(\w+)\s*:(?:\s+(.*))?$/.exec(here.words) ?? [];
      if (!key) throw wrongAt(here, `expected key: value, got ${here.words}`);
      if (map.has(key)) throw wrongAt(here, `expected each key once, got ${key} again`);
      at++;
      map.set(key, rest ? flow(rest, here.line) : lines[at]?.indent > indent ? block() : {line: here.line, map: new Map()});
    }
    if (lines[at]?.indent > indent) throw wrongAt(lines[at], 'expected the indentation of the lines above');
    return {line, map};
  };
  const found = block();
  if (at < lines.length) throw wrongAt(lines[at], 'expected the indentation of the first line');
  return found;
}

// A drawing of a scene. Throws an Error with the line of what is wrong, or is not of the board.
class SceneReader {
  constructor(text) {
    this.scene = parsedYaml(text);
    this.drawing = new Drawing({unit: /\d (mm|cm|inch)\b/.exec(text)?.[1] ?? 'm'});
    const mechanism = this.part(this.scene, 'mechanism');
    if (!mechanism.map) throw wrongAt(mechanism, 'expected the mechanism itself; the board opens no other files');
    this.drawing.name = mechanism.map.get('name')?.text ?? 'drawing';
    this.mechanism = mechanism;
    this.connect();
    this.pose();
    this.nodes();
    this.elements();
    this.couplings();
    this.effects();
    this.drawing.gravity = this.section(this.scene, 'effects').some(([, node]) => node.map?.get('type')?.text === 'gravity');
    compareNodes(this.scene, parsedYaml(this.drawing.text()));
  }

  part(node, key) {
    const found = node.map?.get(key);
    if (!found) throw wrongAt(node, `expected the key ${key}, got none`);
    return found;
  }

  section(node, key) { return [...node.map?.get(key)?.map ?? []]; }

  number(node, kind) {
    try {
      return quantity(node.text ?? 'a list or mapping', kind);
    } catch (error) {
      throw wrongAt(node, error.message);
    }
  }

  numbers(node, kind) {
    if (!node.list) throw wrongAt(node, `expected a list, got ${node.text ?? 'a mapping'}`);
    return node.list.map((one) => this.number(one, kind));
  }

  place(node) {
    const found = this.numbers(node, 'length');
    if (found.length !== 2) throw wrongAt(node, `expected a place [x, y], got ${found.length} numbers`);
    return found;
  }

  pair(node) {
    if (node.list?.length !== 2) throw wrongAt(node, 'expected a list of two');
    return node.list;
  }

  // Joints of all kinds as {name, type, between, ends: both places, angle}; what lies at one place.
  connect() {
    const {mechanism} = this;
    this.bodies = Object.fromEntries(this.section(mechanism, 'bodies'));
    this.joints = this.section(mechanism, 'joints').map(([name, node]) => ({
      name, node, type: this.part(node, 'type').text, between: this.pair(this.part(node, 'between')).map(({text}) => text),
      ends: this.pair(this.part(node, 'points')).map((end) => this.place(end)),
      angle: node.map.has('angle') ? this.number(node.map.get('angle'), 'angle') : 0}));
    this.slots = this.section(mechanism, 'cut_joints').map(([name, node]) => ({
      name, node, body: this.part(node, 'body_a').text, at: this.place(this.part(node, 'point_a')),
      on: this.part(node, 'body_b').text, angle: node.map.has('angle') ? this.number(node.map.get('angle'), 'angle') : 0}));
    this.cylinders = this.section(mechanism, 'cylinders').map(([name, node]) => ({
      name, node, between: this.pair(this.part(node, 'between')).map(({text}) => text),
      ends: this.pair(this.part(node, 'points')).map((end) => this.place(end))}));
    // What outlines lie on has points of its own.
    const contacts = this.section(this.scene, 'effects').filter(([, node]) => node.map?.get('type')?.text === 'body_contact');
    this.outlined = Object.fromEntries(contacts.map(([name, node]) => [name.replace(/_(outline|slots)$/, ''), node]));
    this.points = this.section(mechanism, 'points').filter(([name]) => !(name.replace(/_(axle|pin)$/, '') in this.outlined)).map(([name, node]) => ({
      name, node, body: this.part(node, 'body').text, at: this.place(this.part(node, 'position'))}));
    const turning = this.joints.filter(({type}) => type === 'revolute');
    this.spots = [
      ...turning.map(({name, node, between: [a, b], ends: [one, other]}) => ({name, node, named: true, members: [[a, one], [b, other]]})),
      ...this.points.map(({name, node, body, at}) => ({name, node, named: true, members: [[body, at]]})),
      ...this.slots.map(({name, node, body, at}) => ({name, node, members: [[body, at]]})),
      ...this.cylinders.flatMap(({name, node, between, ends}) => ['foot', 'head'].map((end, k) => ({
        name: `${name}_${end}`, node, members: [[between[k], ends[k]]]})))];
    for (const {node, members} of this.spots) {
      for (const [body] of members) {
        if (body !== GROUND_BODY && !(body in this.bodies)) throw wrongAt(node, `expected the name of a body, got ${body}`);
      }
    }
  }

  // Where all bodies are, by the places and joint coordinates of the start.
  pose() {
    const initial = this.part(this.scene, 'initial'), start = Object.fromEntries(this.section(initial, 'position'));
    const poses = this.poses = {[GROUND_BODY]: {at: [0, 0], angle: 0}};
    for (const [name, node] of this.section(initial, 'at')) {
      const spot = this.spots.find((one) => one.name === name);
      if (!spot) throw wrongAt(node, `expected the name of a joint that turns, a slot, a point or a cylinder's end, got ${name}`);
      spot.world = this.place(node);
    }
    const put = (body, angle, local, world) => { poses[body] = {at: difference(world, rotate(local, angle)), angle}; };
    // The angle of a body by that of another one, where a joint says it.
    const angleBy = (body) => {
      for (const {name, type, between: [a, b], angle} of this.joints) {
        const turned = type === 'revolute' ? start[name] && this.number(start[name], 'angle') : 0;
        if (turned === undefined) continue;
        if (b === body && a in poses) return poses[a].angle + angle + turned;
        if (a === body && b in poses) return poses[b].angle - angle - turned;
      }
      return null;
    };
    // Those that have one place only, such as gears, lie as they do on paper.
    for (const settled of [false, true]) {
      for (let more = true; more;) {
        more = false;
        for (const spot of this.spots.filter(({world}) => !world)) {
          const [body, local] = spot.members.find(([one]) => one in poses) ?? [];
          if (body) [spot.world, more] = [this.world(body, local), true];
        }
        for (const body of Object.keys(this.bodies).filter((one) => !(one in poses))) {
          const known = this.spots.flatMap(({world, members}) => members.filter(([one]) => world && one === body).map(([, local]) => [local, world]));
          if (!known.length) continue;
          const [[local, world]] = known, far = known.find(([other]) => Math.hypot(...difference(other, local)) > SAME_PLACE);
          const angle = far ? angleOf(difference(far[1], world)) - angleOf(difference(far[0], local)) : angleBy(body) ?? (settled ? 0 : null);
          if (angle !== null) {
            put(body, angle, local, world);
            more = true;
          }
        }
        // What slides on a body, and has no place of its own.
        for (const {type, between: [a, b], ends, angle} of this.joints) {
          if (settled && type === 'prismatic' && a in poses && !(b in poses)) {
            put(b, poses[a].angle + angle, ends[1], this.world(a, ends[0]));
            more = true;
          }
        }
      }
    }
    for (const [body, node] of Object.entries(this.bodies)) {
      if (!(body in poses)) throw wrongAt(node, `expected places in initial.at that say where ${body} is`);
    }
  }

  world(body, local) {
    const {at: [x, y], angle} = this.poses[body], [u, v] = rotate(local, angle);
    return [x + u, y + v];
  }

  // Nodes of the drawing: of places that are one, and have a body in common.
  nodes() {
    const {drawing} = this;
    [this.groups, this.nodeOf] = [[], {}];
    for (const {name, world, members, named} of this.spots) {
      const bodies = members.map(([body]) => body);
      let group = this.groups.find((one) => (
        Math.hypot(...difference(one.world, world)) < SAME_PLACE && bodies.some((body) => one.bodies.has(body))));
      if (!group) this.groups.push(group = {world, bodies: new Set(), name: named ? name : drawing.newNode(world)});
      bodies.forEach((body) => group.bodies.add(body));
      this.nodeOf[name] = group.name;
      const [x, y] = world.map((one) => Number(one.toPrecision(12)));
      drawing.nodes[group.name] = {...drawing.nodes[group.name], x, y, ...bodies.includes(GROUND_BODY) && {ground: true},
                                   ...this.points.some((one) => one.name === name) && {trace: true}};
    }
  }

  nodesOf(body) { return this.groups.filter(({bodies}) => bodies.has(body)).map(({name}) => name); }

  elements() {
    const {drawing, joints} = this;
    for (const [body, node] of Object.entries(this.bodies)) {
      const nodes = this.nodesOf(body), {angle} = this.poses[body], guide = joints.find(({name}) => name === `${body}_guide`);
      const put = (kind, values) => { drawing.elements[body] = {kind, ...values}; };
      if (body.replace(/_driver$/, '') !== body && body.replace(/_driver$/, '') in this.outlined) continue;
      if (guide && nodes.length === 1) put('slider', {node: nodes[0], on: guide.between.find((one) => one !== body), angle, block: true});
      else if (guide && !nodes.length) put('rack', {gear: null, angle});
      else if (body in this.outlined) put(...this.outline(body, nodes[0]));
      else if (nodes.length > 1) put('link', {nodes: this.corners(body, nodes)});
      else if (nodes.length) put('gear', {node: nodes[0], teeth: 0, module: MODULE, ring: false, fixed: null});
      else throw wrongAt(node, `expected joints or points on ${body}, got none`);
    }
    for (const {name, node, on, angle} of this.slots) {
      if (!(on in this.poses)) throw wrongAt(node, `expected the name of a body, got ${on}`);
      drawing.elements[name] = {kind: 'slider', node: this.nodeOf[name], on, angle: angle + this.poses[on].angle, block: false};
    }
    for (const {name} of this.cylinders) {
      drawing.elements[name] = {kind: 'cylinder', a: this.nodeOf[`${name}_foot`], b: this.nodeOf[`${name}_head`]};
    }
  }

  // The origin of the frame first, then what lies along its x axis, the others around.
  corners(body, nodes) {
    const local = (node) => rotate(difference(this.drawing.place(node), this.poses[body].at), -this.poses[body].angle);
    const first = nodes.find((node) => Math.hypot(...local(node)) < SAME_PLACE) ?? nodes[0];
    const middle = [0, 1].map((k) => nodes.reduce((sum, node) => sum + local(node)[k], 0) / nodes.length);
    const around = (node) => angleOf(difference(local(node), middle));
    const rest = nodes.filter((node) => node !== first).sort((one, other) => around(one) - around(other));
    const along = rest.findIndex((node) => local(node)[0] > SAME_PLACE && Math.abs(local(node)[1]) < SAME_PLACE);
    return [first, ...rest.slice(Math.max(0, along)), ...rest.slice(0, Math.max(0, along))];
  }

  outline(name, node) {
    const contact = this.outlined[name], slots = contact.map.get('outline')?.map?.get('geneva')?.map?.get('slots');
    if (slots) {
      const [driver] = this.nodesOf(`${name}_driver`);
      return ['geneva', {wheel: node, driver, slots: this.number(slots, 'number')}];
    }
    return ['cam', {node, roller: this.nodeOf[this.part(contact, 'point').text], radius: this.number(this.part(contact, 'radius'), 'length'),
                    radii: this.numbers(this.part(contact, 'radii'), 'length')}];
  }

  // Masses, where they are not those of new parts.
  masses() {
    const made = this.drawing.bodies();
    for (const [body, node] of Object.entries(this.bodies)) {
      const mass = this.number(this.part(node, 'mass'), 'number'), element = this.drawing.elements[body];
      if (element && !sameScalar(brief(made[body].mass), String(mass))) element.mass = mass;
    }
    for (const {name, node} of this.cylinders) {
      const mass = this.number(this.part(node, 'mass'), 'number');
      if (!sameScalar(brief(2 * made[`${name}_barrel`].mass), String(mass))) this.drawing.elements[name].mass = mass;
    }
  }

  couplings() {
    const all = this.section(this.mechanism, 'couplings').map(([name, node]) => ({
      name, node, factors: Object.fromEntries([...this.part(node, 'joints').map ?? []].map(([joint, one]) => [joint, this.number(one, 'number')]))}));
    const ofRack = ({factors}) => Object.keys(factors).find((joint) => this.drawing.elements[joint.replace(/_guide$/, '')]?.kind === 'rack');
    for (const one of all.filter((coupling) => !ofRack(coupling))) this.mesh(one);
    for (const {node, factors, rack = ofRack({factors})} of all.filter(ofRack)) {
      const {[rack]: slide, ...turns} = factors, [body, factor] = this.turned(GROUND_BODY, turns)[0] ?? [];
      if (!body) throw wrongAt(node, 'expected the turn of a gear');
      this.drawing.elements[rack.replace(/_guide$/, '')].gear = this.gear(body, this.nodesOf(body)[0], null, Math.abs(factor / slide));
    }
    const smooth = this.drawing.of('gear').find(([, {teeth}]) => !teeth);
    if (smooth) throw wrongAt(this.bodies[smooth[0]], `expected a coupling of ${smooth[0]}, or a second place on it`);
  }

  // Bodies, one or two, and factors of their turns against a carrier, that make up those of joints.
  turned(carrier, factors, count = 1) {
    const turns = Object.keys(this.poses).filter((body) => body !== carrier).map((body) => [body, Drawing.turn(this.joints, carrier, body)])
      .filter(([, turn]) => turn && Object.keys(turn).length);
    const left = (of, factor, turn) => Object.fromEntries(Object.entries({...Object.fromEntries(Object.keys(turn).map((joint) => [joint, 0])), ...of})
      .map(([joint, one]) => [joint, one - factor * (turn[joint] ?? 0)]).filter(([, one]) => Math.abs(one) > SAME_PLACE));
    for (const [body, turn] of turns) {
      for (const joint of Object.keys(turn).filter((one) => factors[one])) {
        const factor = factors[joint] / turn[joint], rest = left(factors, factor, turn);
        if (!Object.keys(rest).length) return [[body, factor]];
        const others = count > 1 ? this.turned(carrier, rest) : [];
        if (others.length) return [[body, factor], ...others];
      }
    }
    return [];
  }

  mesh({name, node, factors}) {
    const [first] = Object.keys(factors), joint = this.joints.find((one) => one.name === first);
    if (!joint) throw wrongAt(node, `expected joints, got ${first ?? 'none'}`);
    for (const carrier of new Set([GROUND_BODY, ...joint.between, ...Object.keys(this.poses)])) {
      const found = this.turned(carrier, factors, 2), pivots = found.map(([body]) => (
        this.groups.find(({bodies}) => bodies.has(body) && bodies.has(carrier))?.name));
      if (found.length < 2 || !pivots.every(Boolean)) continue;
      const own = found.findIndex(([body]) => body === joint.between[1]);
      if (own > 0) [found, pivots].forEach((list) => list.reverse());
      const counts = found.map(([, factor]) => Math.abs(factor)), least = Math.min(...counts);
      const teeth = counts.map((count) => (counts.every(Number.isInteger) && least >= LEAST_TEETH ? count : count * NEW_TEETH / least));
      if (!teeth.every((count) => Math.abs(count - Math.round(count)) < SAME_NUMBER * count)) throw wrongAt(node, 'expected a ratio of whole numbers of teeth');
      const same = found[0][1] * found[1][1] < 0, apart = Math.hypot(...difference(...pivots.map((one) => this.drawing.place(one))));
      const given = node.map.get('radius'), [a, b] = teeth;
      const radius = given ? this.number(given, 'length') : apart * a / (same ? Math.abs(a - b) : a + b);
      const inside = same && Math.abs(Math.abs(radius - radius * b / a) - apart) < SAME_NUMBER * apart;
      const gears = [0, 1].map((k) => this.gear(found[k][0], pivots[k], Math.round(teeth[k]), radius * teeth[k] / a));
      if (inside) this.drawing.elements[gears[a > b ? 0 : 1]].ring = true;
      this.drawing.elements[name] = {kind: same && !inside ? 'belt' : 'mesh', a: gears[0], b: gears[1]};
      return;
    }
    throw wrongAt(node, 'expected gears with pivots on one body');
  }

  // The gear of a body at a node, made where there is none of that radius; of whole teeth.
  gear(body, node, teeth, radius) {
    const {drawing} = this, count = teeth ?? Math.max(LEAST_TEETH, Math.round(2 * radius / MODULE));
    const size = {teeth: count, module: Number((2 * radius / count).toPrecision(12))};
    let name = drawing.of('gear').find(([own, one]) => (one.fixed ?? own) === body && one.node === node && (
      !one.teeth || Math.abs(drawing.radius(own) - radius) < SAME_NUMBER * radius))?.[0];
    name ??= drawing.add('gear', {node, ...size, ring: false, fixed: body});
    if (!drawing.elements[name].teeth) Object.assign(drawing.elements[name], size);
    return name;
  }

  effects() {
    const {drawing} = this, number = (node, key, kind) => (node.map.has(key) ? this.number(node.map.get(key), kind) : undefined);
    const nodeOf = (node) => {
      if (!(node.text in this.nodeOf)) throw wrongAt(node, `expected the name of a point, got ${node.text}`);
      return this.nodeOf[node.text];
    };
    for (const [name, node] of this.section(this.scene, 'effects')) {
      const type = this.part(node, 'type').text;
      if (type === 'prescribed_motion' || type === 'prescribed_force') {
        const joint = this.part(node, 'joint').text, law = type === 'prescribed_motion' ? 'speed' : 'torque';
        const found = this.joints.find((one) => one.name === joint), on = joint.replace(/_guide$/, '');
        const place = on in drawing.elements ? {on} : found && {node: this.nodeOf[joint], body: found.between[1]};
        if (!place) throw wrongAt(node, `expected the name of a joint, got ${joint}`);
        drawing.elements[name] = {kind: 'motor', ...place, law, value: this.number(this.part(node, law === 'speed' ? 'speed' : 'amplitude'), 'number')};
      } else if (type === 'external_force') {
        const [x, y] = this.numbers(this.part(node, 'force'), 'number');
        drawing.elements[name] = {kind: 'force', node: nodeOf(this.part(node, 'point')), x, y};
      } else if (type === 'point_spring') {
        const a = nodeOf(this.part(node, 'point_a')), b = node.map.has('anchor') ? this.anchor(node.map.get('anchor')) : nodeOf(this.part(node, 'point_b'));
        const free = number(node, 'free_length', 'length'), drawn = Math.hypot(...difference(drawing.place(a), drawing.place(b)));
        drawing.elements[name] = {kind: 'spring', a, b, stiffness: number(node, 'stiffness', 'number') ?? 0, damping: number(node, 'damping', 'number') ?? 0,
                                  ...free !== undefined && Math.abs(free - drawn) > SAME_PLACE && {free}};
      }
    }
    this.masses();
  }

  // A node of the ground, new where there is none.
  anchor(node) {
    const place = this.place(node), {drawing} = this;
    const found = Object.keys(drawing.nodes).find((name) => drawing.nodes[name].ground && Math.hypot(...difference(drawing.place(name), place)) < SAME_PLACE);
    const name = found ?? drawing.newNode(place);
    drawing.nodes[name].ground = true;
    return name;
  }
}

// Throw an Error where nodes of YAML have other keys, names or numbers than those of the board.
function compareNodes(given, written, path = '') {
  if (given.map && written.map) {
    for (const key of new Set([...given.map.keys(), ...written.map.keys()])) {
      const [one, other] = [given.map.get(key), written.map.get(key)], where = `${path}${key}`;
      if (where === 'initial') continue;
      if (!other) throw wrongAt(one, `the board has no ${where}`);
      if (!one) throw wrongAt(given, `expected ${where}, got none`);
      compareNodes(one, other, `${where}.`);
    }
  } else if (given.list && written.list?.length === given.list.length) {
    given.list.forEach((one, k) => compareNodes(one, written.list[k], path));
  } else if (given.text === undefined || written.text === undefined || !sameScalar(given.text, written.text)) {
    throw wrongAt(given, `${path.slice(0, -1)}: expected ${written.text ?? 'another list or mapping'}, as the places in initial.at have it, got ${given.text ?? 'something else'}`);
  }
}

function sameScalar(one, other) {
  if (one === other) return true;
  try {
    const [a, b] = [one, other].map((text) => quantity(text, 'any'));
    return Math.abs(a - b) <= SAME_NUMBER * Math.max(Math.abs(a), Math.abs(b)) + SAME_PLACE;
  } catch {
    return false;
  }
}
