// The editor page: machines that are drawn, simulated in the page, and kept in its address.

// Bodies that a drawing may have here; what is drawn before anything is; elements that search for what
// touches, which no equations here do.
const MOST_LINKS = 12, UNKNOWN_HERE = {cam: 'outlines that touch', geneva: 'outlines that touch'};
const EXAMPLE = {
  name: 'four_bar', nodes: {A: {x: 0, y: 0, ground: true}, B: {x: 0.02, y: 0.03}, C: {x: 0.1, y: 0.07},
    D: {x: 0.1, y: 0, ground: true}, E: {x: 0.05, y: 0.09, trace: true}},
  elements: {link_1: {kind: 'link', nodes: ['A', 'B']}, link_2: {kind: 'link', nodes: ['B', 'C', 'E']},
    link_3: {kind: 'link', nodes: ['C', 'D']}, motor_1: {kind: 'motor', node: 'A', law: 'speed', value: 6.28319}}};
// Of links, as in `view/description.py`: radius of bars, thickness and layers, in sizes of the machine;
// that of gears, below the links.
const BAR_RADIUS = 0.022, PLATE = 0.016, LAYER_ABOVE = 0.03, GEAR_LAYER = 0.015, BELT_WIDTH = 0.005;
const EARTH_GRAVITY = 9.81, BELT_COLOR = '#6f7681', LINK_COLORS = ['#0072B2', '#E69F00', '#009E73', '#CC79A7', '#56B4E9', '#D55E00'];

// What `Machine` and the page need of a drawing. Throws an Error where it cannot be simulated here.
class DrawnMachine {
  constructor(drawing, method) {
    for (const [name, {kind}] of Object.entries(drawing.elements)) {
      if (kind in UNKNOWN_HERE) {
        throw new Error(`${name}: ${UNKNOWN_HERE[kind]} are not simulated on this page; closedloop view has them`);
      }
    }
    this.drawing = drawing;
    this.bodies = drawing.bodies();
    this.joints = drawing.joints(this.bodies);
    this.names = Object.keys(this.bodies).filter((name) => name !== GROUND_BODY);
    if (this.names.length > MOST_LINKS) {
      throw new Error(`expected ${MOST_LINKS} links at most on this page, got ${this.names.length}; closedloop view has no limit`);
    }
    this.motors = drawing.of('motor').map(([, one]) => ({...one, joint: drawing.driven(one, this.joints)}));
    this.span();
    this.toothAngles = toothAngles(drawing);
    this.size = Math.max(1e-3, ...Object.keys(drawing.nodes).flatMap((one) => Object.keys(drawing.nodes).map(
      (other) => Math.hypot(...difference(drawing.place(one), drawing.place(other))))));
    this.equations = new PlanarEquations(this.model());
    this.method = method;
  }

  local(body, place) {
    const {at, angle} = this.bodies[body];
    return rotate(difference(place, at), -angle);
  }

  // Direction of a joint that slides: that of its block.
  direction({name, between}) {
    const block = name.replace(/_guide$/, '');
    return rotate([1, 0], this.bodies[block in this.bodies ? block : between[1]].angle);
  }

  // A spanning tree from the ground, of driven joints first; rows by body, joints that are cut.
  span() {
    const driven = new Set(this.motors.map(({joint}) => joint)), group = {};
    const root = (body) => (group[body] === undefined ? body : root(group[body]));
    const kept = [...this.joints].sort((one, other) => driven.has(other.name) - driven.has(one.name)).filter(
      ({between: [a, b]}) => {
        const [one, other] = [root(a), root(b)];
        if (one !== other) group[one] = other;
        return one !== other;
      });
    [this.row, this.tree] = [{[GROUND_BODY]: 0}, []];
    for (const queue = [GROUND_BODY]; queue.length;) {
      const parent = queue.shift();
      for (const joint of kept) {
        const [a, b] = joint.between, child = a === parent ? b : a;
        if ((a === parent || b === parent) && !(child in this.row)) {
          this.tree.push({...joint, parent, child, sign: a === parent ? 1 : -1});
          this.row[child] = this.tree.length;
          queue.push(child);
        }
      }
    }
    const loose = this.names.find((name) => !(name in this.row));
    if (loose) throw new Error(`${loose}: expected joints that lead to the ground, got none`);
    this.cut = this.joints.filter((joint) => !kept.includes(joint));
    const stuck = this.motors.find(({joint}) => !this.tree.some(({name}) => name === joint));
    if (stuck) throw new Error(`${stuck.joint ?? 'motor'}: expected motors that do not drive one loop twice`);
  }

  model() {
    const {drawing, bodies, row} = this, bodyAt = (node) => drawing.bodyAt(node, bodies), gravity = drawing.gravity ? [0, -EARTH_GRAVITY] : [0, 0];
    const rows = this.tree.map((joint) => {
      const {type, parent, child, at, sign} = joint, {mass, center, inertia, angle, end} = bodies[child];
      return {parent: row[parent], turns: type === 'revolute', sign, place: this.local(parent, at),
              at: this.local(child, at), angle: angle - bodies[parent].angle, center,
              // As the scene has them: of a cylinder it has both masses together.
              ...end ? {mass: 0.5 * brief(2 * mass), inertia: 0.5 * brief(2 * mass) * (2 * center[0]) ** 2 / 12}
                : {mass: Number(brief(mass)), inertia: Number(brief(inertia))},
              slide: type === 'revolute' ? null : scaled(sign, rotate(this.direction(joint), -bodies[parent].angle))};
    });
    const ends = ([a, b], at) => ({a: row[a], at_a: this.local(a, at), b: row[b], at_b: this.local(b, at)});
    const cuts = this.cut.map((joint) => {
      const [b, a] = joint.between, {type, at} = joint;
      return {...ends([a, b], at), kind: type === 'revolute' ? 'pin' : 'guide', name: joint.name,
              angle: bodies[a].angle - bodies[b].angle,
              along: type === 'revolute' ? null : rotate(this.direction(joint), -bodies[b].angle)};
    });
    for (const [name, {node, on, block, angle}] of drawing.of('slider')) {
      if (!block) {
        cuts.push({...ends([drawing.bodyAt(node, bodies, on), on ?? GROUND_BODY], drawing.place(node)), kind: 'line', name,
                   along: rotate([1, 0], angle - bodies[on ?? GROUND_BODY].angle)});
      }
    }
    this.cuts = cuts;
    // All coordinates are zero as it is drawn.
    const couplings = drawing.couplings(bodies, this.joints).map(({joints}) => Object.entries(joints).map(
      ([name, factor]) => {
        const joint = this.joints.find((one) => one.name === name), [a, b] = joint.between;
        const {at_a, at_b} = ends([a, b], joint.at);
        return [factor, {turns: joint.type === 'revolute', a: row[a], at_a, b: row[b], at_b,
                         angle: bodies[b].angle - bodies[a].angle,
                         along: joint.type === 'revolute' ? null : rotate(this.direction(joint), -bodies[a].angle)}];
      }));
    this.springs = drawing.of('spring').map(([name, {a, b, stiffness, damping, free}]) => {
      const [from, to] = [a, b].map((node) => drawing.place(node)), [one, other] = [a, b].map((node) => bodyAt(node));
      return {name, a: row[one], at_a: this.local(one, from), b: row[other], at_b: this.local(other, to), stiffness,
              damping, free: free ?? Math.hypot(...difference(to, from))};
    });
    const forces = drawing.of('force').map(([, {node, x, y}]) => ({
      row: row[bodyAt(node)], at: this.local(bodyAt(node), drawing.place(node)), force: [x, y]}));
    this.points = Object.entries(drawing.nodes).filter(([node, {trace}]) => trace
      || Object.values(bodies).filter(({nodes}) => nodes.includes(node)).length === 1 && bodyAt(node) !== GROUND_BODY)
      .sort(([, one], [, other]) => Boolean(other.trace) - Boolean(one.trace))
      .map(([name]) => ({name, body: bodyAt(name), at: this.local(bodyAt(name), drawing.place(name))}));
    return {rows, cuts, couplings, springs: this.springs, forces, gravity};
  }

  // Findings while it is drawn, from `view/checking.py`.
  reported() {
    const {equations} = this, {nv} = equations;
    if (!equations.correction()) throw new Error('expected masses that resist every motion');
    const speeds = this.motors.filter(({law}) => law === 'speed').length, rank = equations.count - equations.dependent;
    const names = [...this.cuts.flatMap(({name, kind}) => Array(CUT_EQUATIONS[kind]).fill(name)),
                   ...this.drawing.couplings(this.bodies, this.joints).map(({name}) => name)];
    const repeated = [...new Set(equations.repeated.map((number) => names[number]))];
    return {error: null, freedoms: nv - rank - speeds, driven: speeds, repeated,
            words: [`${nv} joints of the tree less ${rank} independent equations of the loops`,
                    ...repeated.map((name) => `${name} repeats others`)]};
  }

  // For `Machine`.
  described() {
    const {equations, tree} = this, motor = (name) => this.motors.find(({joint}) => joint === name);
    const mass = this.names.reduce((sum, name) => sum + this.bodies[name].mass, 0);
    const stiffness = mass * EARTH_GRAVITY / (0.05 * this.size), axes = [1, 0, 0, 0, 1, 0, 0, 0, 1];
    return {
      ...this.method, arrays: equations.arrays, planar: true, balls: [], place: [...tree.keys()], closure_tolerance: 1e-13,
      closure_limit: 1e-5 * this.size, step_size: 1e-3, unique: !equations.dependent,
      bodies: this.names.map((name) => [this.row[name], 0, 0, 0, ...axes]),
      points: this.points.map(({body, at}) => [this.row[body], ...at]), position: [...tree.keys()],
      actuated: [...tree.keys()].filter((k) => motor(tree[k].name)), turns: [],
      drives: Object.fromEntries(tree.flatMap(({name}, k) => (motor(name)
        ? [[name, [k, motor(name).law, motor(name).value]]] : []))),
      own: null, clocks: [], choices: [[]], hand: [stiffness, 0.5 * Math.sqrt(stiffness * mass)],
      effects: {gravity: {type: 'gravity', enabled: this.drawing.gravity, columns: {},
                          values: {acceleration: [0, -EARTH_GRAVITY]}}}, numbers: {}};
  }

  // For the page.
  description() {
    const {size, tree, row} = this, height = (name) => size * (!row[name] ? 0 : this.geared(name) ? GEAR_LAYER : LAYER_ABOVE * (1 + row[name] % 3));
    const named = (number) => [GROUND_BODY, ...tree.map(({child}) => child)][number];
    const raised = (name, [x, y]) => [x, y, height(name)], color = (name) => LINK_COLORS[(row[name] - 1) % LINK_COLORS.length];
    const heights = (...names) => names.map(height).sort((a, b) => a - b);
    const plot = (group, name, unit, column, more = {}) => ({
      group, name, unit, column, shown: true, log: false, method: false, deviation: null, ...more});
    const units = ({type}, each) => each[Number(type === 'prismatic')];
    const driven = tree.filter(({name}) => this.motors.some(({joint}) => joint === name));
    const plots = [
      ...tree.map((joint) => plot('joint position', joint.name, units(joint, ['rad', 'm']), `position.${joint.name}`,
                                  {shown: driven.includes(joint)})),
      ...driven.map((joint) => plot('drive torque or force', joint.name, units(joint, ['N m', 'N']), `effort.${joint.name}`)),
      ...driven.map(({name}) => plot('drive power', name, 'W', `power.${name}`)),
      ...this.cuts.map(({name}) => plot('force where loops close', name, 'N', `cut_force.${name}`)),
      ...this.points.flatMap(({name}) => ['x', 'y'].map((axis) => plot('points', `${name} ${axis}`, 'm', `point.${name}.${axis}`))),
      ...tree.map((joint) => plot('joint velocity', joint.name, units(joint, ['rad/s', 'm/s']), `velocity.${joint.name}`,
                                  {shown: driven.includes(joint)})),
      ...['kinetic', 'stored', 'work less losses'].map((name) => plot('energy', name, 'J', `energy.${name}`)),
      plot('closure error', 'largest', 'm or rad', 'closure', {log: true, method: true}),
      plot('error of the energy balance', 'balance', 'J', 'energy.error', {log: true, method: true}),
      plot('cost', 'computing', '% of real time', 'cost', {method: true}),
      plot('evaluations', 'in a simulated second', '1/s', 'evaluations', {method: true, log: true})];
    const forces = 7 * this.names.length, first = forces + 3 * this.cuts.length, width = first + plots.length;
    const files = [...this.names.flatMap((name) => ['x [m]', 'y [m]', 'z [m]', 'qx', 'qy', 'qz', 'qw'].map(
      (part) => `pose.${name}.${part}`)), ...this.cuts.flatMap(({name}) => [`force.${name}.x [N]`, `force.${name}.y [N]`, '']),
      ...plots.map(({column, unit}) => `${column} [${unit}]`)];
    return {
      name: this.drawing.name, title: this.drawing.name, mode: 'live', planar: true, hand: true, size, thick: size,
      weight: EARTH_GRAVITY * this.names.reduce((sum, name) => sum + this.bodies[name].mass, 0),
      colors: {cut: '#D55E00', load: '#8C6D31'}, subsystems: this.names.map(color),
      bodies: this.names.map((name, k) => ({
        name, color: color(name), subsystem: k, shapes: this.shapes(name).map((shape) => this.lifted(shape, height(name))),
        grabs: [...this.bodies[name].nodes.map((node) => this.local(name, this.drawing.place(node))),
                this.bodies[name].center].map(([x, y]) => [x, y, 0])})),
      ground: this.discs(GROUND_BODY), guides: [], surfaces: [], wires: this.belts(), missing: [], meanings: {}, loads: [], plots, files, sliders: [],
      joints: tree.map((joint) => ({
        name: joint.name, type: joint.type, parent: row[joint.parent] - 1, child: row[joint.child] - 1,
        actuated: driven.includes(joint), place: [...this.local(joint.parent, joint.at), 0],
        axis: joint.type === 'revolute' ? [0, 0, 1] : [...rotate(this.direction(joint), -this.bodies[joint.parent].angle), 0],
        heights: heights(joint.parent, joint.child)})),
      cuts: this.cuts.map(({name, kind, a, at_a, b, at_b}) => ({
        name, type: {pin: 'revolute', guide: 'prismatic', line: 'point_on_line'}[kind], body_a: a - 1, body_b: b - 1,
        a: named(a), b: named(b), point_a: [...at_a, 0], point_b: [...at_b, 0], heights: heights(named(a), named(b))})),
      lines: this.springs.map(({name, a, at_a, b, at_b}) => ({
        kind: 'spring', name, ends: [[a - 1, raised(named(a), at_a)], [b - 1, raised(named(b), at_b)]]})),
      points: this.points.map(({name, body, at}) => ({name, body: row[body] - 1, place: [...at, 0]})),
      columns: {poses: 0, forces, loads: first, estimate: first, direction: first, plots: first, others: width,
                deviations: width, width},
      drives: driven.map(({name, type}) => {
        const slides = type === 'prismatic', reach = slides ? size : Math.PI;
        return {joint: name, slides, turns: false, torque: 10 * size, speed: 4 * reach, position: [-reach, reach],
                modes: ['torque', 'position', 'speed', 'expression']};
      }), gravity: 'gravity', own: driven.length > 0};
  }

  shapes(name) {
    const {size, drawing} = this, flat = PLATE * size, element = drawing.elements[name];
    const corners = this.bodies[name].nodes.map((node) => this.local(name, drawing.place(node)));
    const discs = this.discs(name);
    if (element?.kind === 'gear') return discs;
    const bar = (from, to) => ({kind: 'bar', from: [...from, 0], to: [...to, 0], radius: BAR_RADIUS * size, flat});
    if (element?.kind === 'rack') {
      return [this.profile(rackOutline(drawing, element, this.toothAngles[element.gear]), null, [0, 0], 0)];
    }
    if (!element || corners.length < 2) {
      const {center} = this.bodies[name];
      return element ? [{kind: 'box', center: [0, 0, 0], size: [0.1 * size, 0.06 * size, flat]}] : [bar([0, 0], scaled(2, center))];
    }
    const ends = corners.length > 2 ? corners.map((corner, k) => [corner, corners[(k + 1) % corners.length]]) : [corners];
    return [...discs, ...corners.length > 2 ? [{kind: 'plate', corners: corners.map((corner) => [...corner, 0]), thickness: flat}] : [],
            ...ends.map(([from, to]) => bar(from, to))];
  }

  // The gears that are a body, or fixed to it, in one layer below the links.
  discs(name) {
    return this.drawing.of('gear').filter(([gear, {fixed}]) => (fixed ?? gear) === name).flatMap(([gear, one]) => {
      const outline = toothed(one), rim = rimmed(one, outline), turned = this.toothAngles[gear] - this.bodies[name].angle;
      const disc = this.profile(...one.ring ? [rim, outline] : [outline, rim], this.local(name, this.drawing.place(one.node)), turned);
      return one.ring ? [disc] : [disc, {...disc, kind: 'spokes', depth: 0.7 * disc.depth, radius: 1.02 * Math.hypot(...rim[0])}];
    });
  }

  geared(name) { return ['gear', 'rack'].includes(this.drawing.elements[name]?.kind); }

  belts() {
    return this.drawing.of('belt').map(([name, one]) => {
      const carrier = this.drawing.carrier(one.a, one.b, this.bodies), path = beltPath(this.drawing, one);
      return {name, body: this.row[carrier] - 1, color: BELT_COLOR, width: BELT_WIDTH * this.size,
              places: [...path, path[0]].map((place) => [...this.local(carrier, place), GEAR_LAYER * this.size])};
    });
  }

  profile(outline, hole, [x, y], turned) {
    return {kind: 'profile', outline, hole, origin: [x, y, GEAR_LAYER * this.size], x: [...rotate([1, 0], turned), 0], z: [0, 0, 1],
            depth: PLATE * this.size, taper: 1};
  }

  lifted(shape, above) {
    const up = ([x, y, z]) => [x, y, z + above];
    return Object.fromEntries(Object.entries(shape).map(([key, value]) => [
      key, key === 'corners' ? value.map(up) : ['from', 'to', 'center'].includes(key) ? up(value) : value]));
  }
}

// The page's part: the board, and the drawing in the address.
class EditorPage {
  constructor(page, method) {
    [this.page, this.method] = [page, method];
    const open = byId('new');
    open.hidden = false;
    open.textContent = 'draw …';
    open.onclick = () => {
      this.board.open();
      this.board.fit();
    };
    this.board = new Board({
      check: async () => {
        try {
          return this.made().reported();
        } catch (error) {
          return {error: error.message};
        }
      },
      simulate: () => {
        history.replaceState(null, '', `#${this.written()}`);
        this.show();
      }});
    addEventListener('hashchange', () => this.read());
    this.read();
  }

  made() { return new DrawnMachine(this.board.drawing, this.method); }

  // The drawing in an address, and out of it.
  written() { return encodeURIComponent(JSON.stringify(this.board.drawing)); }

  read() {
    let data = EXAMPLE;
    try {
      if (location.hash.length > 1) data = JSON.parse(decodeURIComponent(location.hash.slice(1)));
      this.board.drawing = new Drawing(data);
      this.show();
    } catch (error) {
      this.page.complain(`The address of this page has no drawing that can be simulated: ${error.message}`);
    }
  }

  show() {
    const {page} = this;
    let made;
    try {
      made = this.made();
      made.reported();
    } catch (error) {
      page.complain(error.message);
      return;
    }
    this.board.element.close();
    byId('message').hidden = true;
    page.socket = new Standalone(page, made.description(), new Machine(made.equations.exported, made.described()));
    page.socket.begin();
  }
}
