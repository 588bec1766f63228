// A machine that is simulated in the page: it answers what the page asks for as a server does.

// Share of the time between frames that may go into computing [ms]; longest time that one frame
// catches up with [s].
const COMPUTING = 11, LATE = 0.1;
// Samples between frames come so often [s].
const SAMPLED = 0.004;
// Motion of a joint after which drives find the inertia that they feel again [rad, m].
const FELT_AFTER = 0.02;
// Simulated time over which the speed that is reached is measured [ms].
const MEASURED = 500;

class Standalone {
  constructor(page, description, machine) {
    Object.assign(this, {page, description, machine});
    this.scene = {type: 'scene', ...description};
    [this.playing, this.speed, this.failure, this.achieved] = [false, 1, null, null];
    [this.notes, this.refused, this.number] = [[], 0, 0];
    this.readyState = WebSocket.OPEN;
    const {described} = machine;
    this.effects = described.effects;
    this.own = described.own && {...described.own, rows: unpacked(described.own.rows, Float64Array)};
    this.drives = {};
    this.row = new Float32Array(description.columns.width);
    this.numbers = Object.fromEntries((description.sliders ?? []).map(({key, value}) => [key, value]));
    this.initial = {...this.numbers};
    machine.torques = (time, state) => this.exert(time, state);
    this.follow();
    this.startDrives();
    machine.account();
    [this.cost, this.made] = [{spent: 0, share: NaN, rate: NaN, since: 0, evaluations: 0}, 0];
  }

  begin() {
    this.tell(this.scene);
    this.sliders = new Numbers((what, more) => this.page.ask(what, more));
    this.sliders.describe(this.scene.sliders);
    byId('handle').hidden = false;
    byId('handle').firstElementChild.hidden = true;
    this.show();
    this.controls();
    this.last = performance.now();
    this.do({do: 'play'});
    const tick = () => {
      // Another machine has taken its place.
      if (this.page.socket !== this) return;
      requestAnimationFrame(tick);
      this.tick(performance.now());
    };
    requestAnimationFrame(tick);
  }

  tell(message) { this.page.hear(JSON.stringify(message)); }

  // Time.

  tick(now) {
    const elapsed = Math.min((now - this.last) / 1000, LATE);
    this.last = now;
    if (!this.playing) return;
    this.goal += elapsed * this.speed;
    const begin = this.machine.time;
    this.until(this.goal, now + COMPUTING);
    // What cannot be reached is given up.
    if (this.machine.time < this.goal) this.goal = this.machine.time;
    const {cost} = this, spent = performance.now() - now;
    cost.spent += spent;
    cost.asked = (cost.asked ?? 0) + elapsed;
    cost.done = (cost.done ?? 0) + this.machine.time - begin;
    if (now - cost.since > MEASURED) {
      const {evaluations} = this.machine;
      this.achieved = cost.asked > 0 ? cost.done / cost.asked : null;
      cost.share = cost.done > 0 ? 0.1 * cost.spent / cost.done : NaN;
      cost.rate = cost.done > 0 ? (evaluations - cost.evaluations) / cost.done : NaN;
      Object.assign(cost, {spent: 0, asked: 0, done: 0, since: now, evaluations});
      this.controls();
    }
    this.show();
  }

  // Advance to a time, or as far as it takes no longer than to a moment of the clock.
  until(end, latest = Infinity) {
    const {machine} = this;
    this.samples = [];
    try {
      while (machine.time < end - 1e-12 && performance.now() < latest) {
        this.feel();
        const next = Math.min(end, machine.time + SAMPLED);
        while (machine.time < next) machine.advance(next);
        if (machine.time < end - 1e-12) this.samples.push([machine.time, this.written().slice()]);
      }
    } catch (error) {
      this.stop(error.message);
    }
  }

  stop(failure = null) {
    [this.playing, this.failure] = [false, failure];
    this.controls();
  }

  // The present state, and those since the last frame, as a server sends them.
  show() {
    const {machine, samples = []} = this, width = this.row.length;
    const buffer = new ArrayBuffer(16 + 4 * (width + samples.length * (width + 1)));
    const view = new DataView(buffer), numbers = new Float32Array(buffer, 16);
    this.number += 1;
    view.setUint32(0, this.number, true);
    view.setUint32(4, samples.length, true);
    view.setFloat64(8, machine.time, true);
    numbers.set(this.written());
    samples.forEach(([time, row], k) => {
      numbers[width + k * (width + 1)] = time - machine.time;
      numbers.set(row, width + k * (width + 1) + 1);
    });
    this.samples = [];
    this.page.hear(buffer);
  }

  // The row of the present state.
  written() {
    const {machine, row, description: {columns}} = this, {described, arrays} = machine;
    machine.evaluate();
    const {nq, state} = machine, {position, actuated, bodies, points, planar} = described;
    bodies.forEach((body, k) => row.set(poseOf(machine, body), columns.poses + 7 * k));
    row.set(described.unique ? arrays.force : arrays.force.map(() => NaN), columns.forces);
    const positions = position.filter((place) => place >= 0).map((place) => state[place]);
    const velocity = [...state.subarray(nq, nq + machine.nv)];
    const {tau, force, energies, closure} = arrays;
    const sizes = Array.from({length: force.length / 3}, (_, k) => (
      described.unique ? Math.hypot(...force.subarray(3 * k, 3 * k + 3)) : NaN));
    const places = points.flatMap(([first, ...place]) => (
      [...machine.pointOf(first, [...place, 0].slice(0, 3))[0]].slice(0, planar ? 2 : 3)));
    const [kinetic, weight, stored] = energies;
    row.set([
      ...positions, ...actuated.map((k) => tau[k]), ...actuated.map((k) => tau[k] * velocity[k]),
      ...sizes, ...places, ...velocity, kinetic, weight + stored, state[nq + machine.nv],
      largestOf(closure), Math.abs(machine.residual ?? 0), this.cost?.share ?? NaN,
      this.cost?.rate ?? NaN, ...described.turns.map((place) => state[place])], columns.plots);
    return row;
  }

  // Drives.

  startDrives() {
    const {described} = this.machine;
    for (const [joint, [freedom, mode, value]] of Object.entries(described.drives)) {
      this.set(joint, mode, value, freedom);
    }
    this.feel(true);
  }

  set(joint, mode, value, freedom = this.drives[joint].freedom) {
    const {machine} = this, law = mode === 'expression' ? expressionOf(value) : null;
    const position = this.position(freedom);
    // An angle is followed from where it is, whole turns aside.
    const begin = law?.(machine.time)[0], {slides} = this.description.drives.find(
      (drive) => drive.joint === joint);
    const shift = law && !slides && Number.isFinite(begin)
      ? 2 * Math.PI * Math.round((position - begin) / (2 * Math.PI)) : 0;
    const inertia = this.drives[joint]?.inertia ?? 1;
    this.drives[joint] = {freedom, mode, value, law, shift, inertia, from: [machine.time, position]};
  }

  position(freedom, state = this.machine.state) {
    return state[this.machine.described.position[freedom]] ?? 0;
  }

  // Position, rate and acceleration that a drive tracks.
  reference(joint, {mode, value, law, shift, from}, time) {
    if (mode === 'position') return [value, 0, 0];
    if (mode === 'speed') return [from[1] + value * (time - from[0]), value, 0];
    if (mode === 'own') return this.recorded(joint, time);
    const [position, rate, acceleration] = law(time);
    if (!Number.isFinite(position + rate + acceleration)) {
      throw new Error(`The expression ${value} of the drive of ${joint} has no finite value at t = ${
        time.toPrecision(6)} s.`);
    }
    return [position + shift, rate, acceleration];
  }

  // The motion that a controller has made, between two of its places by a polynomial that agrees in
  // places, rates and accelerations.
  recorded(joint, time) {
    const {joints, period, rows, again, turns} = this.own, width = 3 * joints.length;
    const most = rows.length / width - 1, column = joints.indexOf(joint);
    let [at, cycles] = [time / period, 0];
    if (at > most && again !== null) {
      cycles = Math.floor((at - again) / (most - again));
      at -= cycles * (most - again);
    }
    const k = Math.min(Math.floor(at), most - 1), s = at - k;
    const [[a, b], [u, v], [e, f]] = [0, 1, 2].map((order) => [k, k + 1].map((n) => (
      period ** order * rows[n * width + order * joints.length + column])));
    if (at > most) return [b, 0, 0];
    const way = b - a, c3 = 10 * way - 6 * u - 4 * v - 1.5 * e + 0.5 * f;
    const c4 = -15 * way + 8 * u + 7 * v + 1.5 * e - f, c5 = 6 * way - 3 * (u + v) - 0.5 * (e - f);
    return [cycles * turns[column] + a + s * (u + s * (e / 2 + s * (c3 + s * (c4 + s * c5)))),
            (u + s * (e + s * (3 * c3 + s * (4 * c4 + s * 5 * c5)))) / period,
            (e + s * (6 * c3 + s * (12 * c4 + s * 20 * c5))) / period ** 2];
  }

  // Torques of a state.
  exert(time, state) {
    const {arrays: {tau}, nq, described: {rate}} = this.machine;
    tau.fill(0);
    for (const [joint, drive] of Object.entries(this.drives)) {
      const {freedom, mode, value, inertia} = drive;
      if (mode === 'torque') tau[freedom] = value;
      else {
        const [wanted, speed, acceleration] = this.reference(joint, drive, time);
        tau[freedom] = inertia * (acceleration + rate * (
          rate * (wanted - this.position(freedom, state)) + 2 * (speed - state[nq + freedom])));
      }
    }
  }

  // Find the inertia that drives feel, where the machine has moved on.
  feel(now = false) {
    const {machine} = this, drives = Object.values(this.drives).filter(({mode}) => mode !== 'torque');
    if (!drives.length) return;
    const positions = drives.map(({freedom}) => this.position(freedom));
    if (!now && this.felt?.length === positions.length
        && positions.every((x, k) => Math.abs(x - this.felt[k]) < FELT_AFTER)) return;
    this.felt = positions;
    machine.feltInertia(drives.map(({freedom}) => freedom)).forEach((inertia, k) => {
      drives[k].inertia = inertia;
    });
  }

  get motion() {
    const drives = Object.entries(this.drives), {described} = this.machine;
    if (drives.length && drives.every(([, {mode}]) => mode === 'position')) return 'held';
    if (drives.every(([, {mode, value}]) => mode === 'torque' && value === 0)) return 'free';
    return drives.every(([joint, {mode, value}]) => (
      described.drives[joint][1] === mode && described.drives[joint][2] === value)) ? 'own' : null;
  }

  // What the page asks for.

  send(text) {
    const asked = JSON.parse(text);
    if (asked.do === 'seen') return;
    try {
      this.do(asked);
    } catch (error) {
      this.refused += 1;
      this.note(error.message);
    }
    this.controls();
    if (!this.playing) this.show();
  }

  do({do: what, ...more}) {
    const {machine} = this;
    const actions = {
      play: () => {
        [this.playing, this.failure, this.goal] = [true, null, machine.time];
        this.last = performance.now();
      },
      pause: () => this.stop(),
      reset: () => {
        machine.reset();
        this.startDrives();
        machine.account();
        this.stop();
      },
      step: ({count}) => {
        this.stop();
        this.until(machine.time + count * machine.described.step_size);
      },
      speed: ({factor}) => { this.speed = factor; },
      drive: ({joint, mode}) => this.set(joint, mode, {
        torque: 0, speed: 0, own: machine.described.drives[joint][2],
        expression: String(Number(this.position(this.drives[joint].freedom).toPrecision(9)))}[mode]
          ?? this.position(this.drives[joint].freedom)),
      command: ({joint, value}) => this.set(joint, this.drives[joint].mode, value),
      motion: ({which}) => {
        if (which === 'own') this.startDrives();
        else for (const [joint, {freedom}] of Object.entries(this.drives)) {
          const held = which === 'held' && machine.described.position[freedom] >= 0;
          this.set(joint, held ? 'position' : 'torque', held ? this.position(freedom) : 0);
        }
      },
      effect: (asked) => this.effect(asked),
      set: (asked) => this.change(asked),
      grab: ({body, place, at}) => {
        const [stiffness, damping] = machine.described.hand;
        const [row, ...placed] = machine.described.bodies[body];
        machine.hand = {row, goal: at, stiffness, damping,
                        place: inRow(placed, this.scene.bodies[body].grabs[place])};
      },
      pull: ({at}) => { if (machine.hand) machine.hand.goal = at; },
      release: () => { machine.hand = null; }};
    if (!actions[what]) throw new Error(`${what} takes closedloop view itself, not a page of it`);
    actions[what](more);
    this.feel(true);
  }

  effect({name, enabled, values = {}}) {
    const effect = this.effects[name], {arrays} = this.machine;
    for (const [key, value] of Object.entries(values)) {
      const numbers = [value].flat(), wanted = [effect.values[key]].flat().length;
      if (numbers.length !== wanted || !numbers.every(Number.isFinite)) {
        throw new Error(`${name}, ${key}: expected ${wanted === 1 ? 'a number' : `${wanted} numbers`}, got ${value}`);
      }
      if (!Array.isArray(value) && value < 0 && effect.values[key] >= 0 && /stiffness|damping|coefficient/.test(key)) {
        throw new Error(`${name}, ${key}: expected zero or more, got ${value}`);
      }
      effect.values[key] = value;
      (effect.columns[key] ?? []).forEach((column, k) => {
        arrays.values[13 * effect.row + column] = numbers[k];
      });
    }
    effect.enabled = enabled ?? effect.enabled;
    if (effect.row !== undefined) arrays.switch[effect.row] = Number(effect.enabled);
    this.follow();
    this.machine.account();
  }

  // Gravity is a number of the machine.
  follow() {
    const gravity = this.effects[this.description.gravity];
    this.machine.arrays.gravity.set(
      gravity.enabled ? gravity.values.acceleration : gravity.values.acceleration.map(() => 0));
  }

  // Give a length, mass or parameter another value, and close the loops again.
  change({key, value}) {
    const before = {...this.numbers}, {machine} = this;
    if (!(value > 0) && this.initial[key] > 0) throw new Error(`${key}: expected a number above zero, got ${value}`);
    const put = (numbers) => {
      for (const name of ['body', 'cut_point']) {
        machine.arrays[name].set(machine.given[name]);
        for (const [other, change] of Object.entries(machine.described.numbers)) {
          for (const [index, slope] of change[name]) {
            machine.arrays[name][index] += slope * (numbers[other] - this.initial[other]);
          }
        }
      }
    };
    put({...before, [key]: value});
    const [start, state] = [machine.start.slice(), machine.state.slice()];
    // Where the machine starts, and where it is.
    if (![start, state].every((one) => machine.close(one, 10 * CORRECTIONS))) {
      put(before);
      throw new Error(`${key}: with ${short(value, 4)} the loops cannot be closed near where it is`);
    }
    this.numbers[key] = value;
    [machine.start, machine.state] = [start, state];
    machine.account();
    this.describe();
  }

  // The machine as it is drawn: what is at joints goes with them.
  describe() {
    const scene = structuredClone({type: 'scene', ...this.description});
    for (const [key, {marks}] of Object.entries(this.machine.described.numbers)) {
      const change = this.numbers[key] - this.initial[key];
      for (const [body, place, slope] of change ? marks : []) {
        const holders = body < 0 ? scene.ground : [...scene.bodies[body].shapes, scene.bodies[body].grabs];
        const ends = [holders, scene.joints.filter(({parent}) => parent === body).map((one) => one.place),
                      scene.cuts.filter((cut) => cut.body_a === body).map((cut) => cut.point_a),
                      scene.cuts.filter((cut) => cut.body_b === body).map((cut) => cut.point_b)];
        shiftAll(ends, place, slope.map((x) => x * change), this.machine.described.planar);
      }
    }
    for (const slider of scene.sliders) slider.value = this.numbers[slider.key];
    this.scene = scene;
    this.tell(scene);
    this.sliders.describe(scene.sliders);
  }

  note(text) {
    this.notes = [...this.notes.slice(-4), {number: (this.notes.at(-1)?.number ?? 0) + 1, text}];
  }

  controls() {
    const effects = Object.fromEntries(Object.entries(this.effects).map(
      ([name, {type, enabled, values}]) => [name, {type, enabled, values}]));
    this.tell({
      type: 'controls', playing: this.playing, achieved: this.achieved, speed: this.speed, every: 1,
      failure: this.failure, kinematic: false, editing: false, undoable: [false, false],
      findings: this.machine.finding ? [this.machine.finding] : [], busy: null, motion: this.motion,
      drives: Object.fromEntries(Object.entries(this.drives).map(
        ([joint, {mode, value}]) => [joint, {mode, value}])),
      effects, notes: this.notes, refused: this.refused});
  }
}

// Return a place of a body in its row.
function inRow([x, y, z, ...axes], place) {
  return [x, y, z].map((origin, i) => (
    origin + axes[i] * place[0] + axes[3 + i] * place[1] + axes[6 + i] * place[2]));
}

// Return place and quaternion of a body.
function poseOf(machine, [row, ...placed]) {
  const [origin, ...tips] = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]].map(
    (place) => machine.pointOf(row, inRow(placed, place))[0]);
  const [x, y, z] = tips.map((tip) => tip.map((value, i) => value - origin[i]));
  // The largest component first, so that none is lost.
  const squares = [x[0] - y[1] - z[2], y[1] - x[0] - z[2], z[2] - x[0] - y[1], x[0] + y[1] + z[2]];
  const k = squares.indexOf(Math.max(...squares)), size = 2 * Math.sqrt(1 + squares[k]);
  const [a, b, c] = [y[2] - z[1], z[0] - x[2], x[1] - y[0]];
  const [d, e, f] = [x[1] + y[0], z[0] + x[2], y[2] + z[1]], own = size * size / 4;
  const turn = [[own, d, e, a], [d, own, f, b], [e, f, own, c], [a, b, c, own]][k];
  return [...origin, ...turn.map((value) => value / size)];
}

// Shift all places among some data that are at one, in the plane at any height.
function shiftAll(data, place, change, planar) {
  if (!Array.isArray(data)) {
    if (data && typeof data === 'object') for (const one of Object.values(data)) shiftAll(one, place, change, planar);
    return;
  }
  if (data.length === 3 && data.every(Number.isFinite)) {
    if (data.every((x, k) => (planar && k === 2) || Math.abs(x - place[k]) < 1e-9)) {
      data.forEach((x, k) => { data[k] = x + (planar && k === 2 ? 0 : change[k]); });
    }
    return;
  }
  for (const one of data) shiftAll(one, place, change, planar);
}
