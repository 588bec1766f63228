// A machine that simulates itself: its equations in WebAssembly, steps with error control, closed
// loops, an account of its energy. It knows neither page nor clock.

// Hairer's choices, as the engine's: safety, largest growth and cut of a step.
const STEP_SAFETY = 0.9, LARGEST_GROWTH = 6, LARGEST_CUT = 0.2;
// Smallest step, which is made whatever its error, as where a force jumps, so often in a row at most;
// first step [s]; corrections of coordinates at most.
const SMALLEST_STEP = 1e-8, MOST_SMALLEST = 100, FIRST_STEP = 1e-4, CORRECTIONS = 8;
// Numbers of a body's motion: its origin, its axes row by row, velocity, angular velocity.
const MOTION_COLUMNS = 18;
// Energy that the balance misses, relative to the energy exchanged, at which the page warns and
// stops; exchanges below this one are rounding [J].
const ENERGY_WARN = 1e-3, ENERGY_ERROR = 0.1, NO_ENERGY = 1e-9;

// How many times as distinct other equations must be to take over.
const MORE_DISTINCT = 2;

const largestOf = (values) => values.reduce((most, one) => Math.max(most, Math.abs(one)), 0);

class Machine {
  // `exported`: of the module; `described`: as `view/local.py` writes it.
  constructor(exported, described) {
    Object.assign(this, {exported, described, tableau: described.tableau});
    this.arrays = {};
    for (const [name, [first, content]] of Object.entries(described.arrays)) {
      const numbers = typeof content === 'string' ? unpacked(content, Float64Array) : null;
      this.arrays[name] = new Float64Array(
        exported.memory.buffer, 8 * first, numbers ? numbers.length : content);
      if (numbers) this.arrays[name].set(numbers);
    }
    const {q, qd, tau, lam} = this.arrays;
    [this.nq, this.nv, this.nc] = [q.length, qd.length, lam.length];
    this.given = Object.fromEntries(['body', 'cut_point', 'gravity', 'values'].map(
      (name) => [name, this.arrays[name].slice()]));
    this.start = Float64Array.from([...q, ...qd, 0]);
    this.torques = () => tau.fill(0);
    // Where a hand pulls: row, place in it, goal [m]; its spring [N/m] and damper [N s/m].
    this.hand = null;
    this.clocks = described.clocks.map((clock) => new Clock(clock, this.arrays[clock.array]));
    const count = this.start.length, make = () => new Float64Array(count);
    this.slopes = this.tableau.a.map(make);
    [this.stage, this.after] = [make(), make()];
    this.reset();
  }

  static async of(described) {
    const bytes = Uint8Array.from(atob(described.module), (c) => c.charCodeAt(0));
    const {instance} = await WebAssembly.instantiate(bytes, {math: Math});
    return new Machine(instance.exports, described);
  }

  reset() {
    this.state = this.start.slice();
    [this.time, this.step, this.smallest] = [0, FIRST_STEP, 0];
    [this.evaluations, this.finding, this.choice] = [0, '', 0];
    this.account();
  }

  // Count energy from the present state on, as after a change by hand.
  account() {
    this.state[this.nq + this.nv] = this.exchanged = 0;
    this.reference = this.energy();
    this.before = this.reference;
  }

  // Call a function of the module that depends on the choice of equations.
  call(name) { return this.exported[this.choice ? `${name}_${this.choice}` : name](); }

  // Work on other equations where these are much more distinct at the present state: by the volume
  // that their rows span, in units of the mechanism.
  choose() {
    this.read();
    this.exported.jacobian();
    const {nv, arrays: {jacobian}, described: {choices, units: [rows, columns]}} = this;
    const row = (number) => columns.map((unit, k) => jacobian[number * nv + k] * unit / rows[number]);
    const volumes = choices.map((choice) => {
      const across = [];
      return choice.reduce((volume, number) => {
        const left = row(number);
        for (const one of across) {
          const along = left.reduce((sum, x, k) => sum + x * one[k], 0);
          one.forEach((x, k) => { left[k] -= along * x; });
        }
        const size = Math.hypot(...left);
        across.push(left.map((x) => x / (size || 1)));
        return volume * size;
      }, 1);
    });
    const best = Math.max(...volumes);
    if (best > MORE_DISTINCT * volumes[this.choice]) this.choice = volumes.indexOf(best);
  }

  // What the state changes by: rates of coordinates, accelerations, power from outside.
  slope(time, state, out) {
    const {q, qd, tau, qdd, push, power} = this.arrays, {nq, nv} = this;
    q.set(state.subarray(0, nq));
    qd.set(state.subarray(nq, nq + nv));
    this.torques(time, state);
    for (const clock of this.clocks) clock.put(time);
    let input = this.hand ? this.pull() : 0;
    this.evaluations += 1;
    if (!this.call('evaluation')) return false;
    this.rates(state, out);
    out.set(qdd, nq);
    for (let i = 0; i < nv; i++) input += tau[i] * qd[i];
    out[nq + nv] = input - power[0] + power[1];
    push.fill(0);
    return true;
  }

  // Derivatives of the coordinates: of quaternions half of them times the rates.
  rates(state, out) {
    const {nq, described: {balls, place}} = this;
    for (let i = 0; i < this.nv; i++) if (place[i] >= 0) out[place[i]] = state[nq + i];
    for (const [ball, turn] of balls) {
      const [x, y, z, w] = state.subarray(ball, ball + 4);
      const [i, j, k] = state.subarray(nq + turn, nq + turn + 3).map((rate) => rate / 2);
      out.set([w * i + y * k - z * j, w * j + z * i - x * k, w * k + x * j - y * i,
               -(x * i + y * j + z * k)], ball);
    }
  }

  // Move coordinates by finite changes along the rates: orientations by their exponential.
  move(state, change) {
    const {described: {balls, place}} = this;
    for (let i = 0; i < this.nv; i++) if (place[i] >= 0) state[place[i]] += change[i];
    for (const [ball, turn] of balls) {
      const [x, y, z, w] = state.subarray(ball, ball + 4);
      let [i, j, k] = change.subarray(turn, turn + 3).map((angle) => angle / 2);
      const angle = Math.hypot(i, j, k), s = Math.cos(angle);
      const sine = angle > 1e-9 ? Math.sin(angle) / angle : 1;
      [i, j, k] = [i * sine, j * sine, k * sine];
      state.set([w * i + x * s + y * k - z * j, w * j + y * s + z * i - x * k,
                 w * k + z * s + x * j - y * i, w * s - x * i - y * j - z * k], ball);
    }
    this.normalise(state);
  }

  normalise(state) {
    for (const [ball] of this.described.balls) {
      const turn = state.subarray(ball, ball + 4), norm = Math.hypot(...turn);
      for (let k = 0; k < 4; k++) turn[k] /= norm;
    }
  }

  // Close the loops of a state by the least change, as the exported C does; return whether they
  // are closed at a time.
  close(state, most = CORRECTIONS, time = this.time) {
    const {q, qd, change, closure} = this.arrays, {nq, nv} = this;
    const {closure_tolerance: tolerance, closure_limit: limit} = this.described;
    const correct = () => {
      q.set(state.subarray(0, nq));
      qd.set(state.subarray(nq, nq + nv));
      return this.call('correction');
    };
    for (const clock of this.clocks) clock.put(time);
    this.normalise(state);
    let good = correct(), error = largestOf(closure);
    for (let n = 0; good && n < most && error > tolerance; n++) {
      this.move(state, change);
      good = correct();
      const before = error;
      error = largestOf(closure);
      if (!(error < 0.5 * before)) break;
    }
    if (!good || !(error <= limit)) return false;
    for (let i = 0; i < nv; i++) state[nq + i] += change[nv + i];
    return true;
  }

  // Make one step that ends at a time at the latest. Throws an Error with what went wrong; the
  // state before is kept.
  advance(end) {
    const {state, stage, after, slopes, tableau: {a, b, order}} = this, count = state.length;
    // Within a step one formula holds.
    end = this.clocks.reduce((first, clock) => Math.min(first, clock.begin(this.time)), end);
    if (!this.slope(this.time, state, slopes[0])) throw new Error(this.singular());
    for (;;) {
      const left = end - this.time, last = this.step > 0.9 * left, size = last ? left : this.step;
      let error = Infinity;
      let good = true;
      for (let k = 1; good && k < a.length; k++) {
        for (let i = 0; i < count; i++) {
          let sum = 0;
          for (let n = 0; n < k; n++) sum += a[k][n] * slopes[n][i];
          stage[i] = state[i] + size * sum;
        }
        good = this.slope(this.time + size * this.tableau.c[k], stage, slopes[k]);
      }
      if (good) {
        for (let i = 0; i < count; i++) {
          let sum = 0;
          for (let n = 0; n < b.length; n++) sum += b[n] * slopes[n][i];
          after[i] = state[i] + size * sum;
        }
        error = this.error(size);
      }
      const factor = Number.isFinite(error)
        ? Math.min(LARGEST_GROWTH, Math.max(LARGEST_CUT, STEP_SAFETY * error ** (-1 / order))) : LARGEST_CUT;
      const least = size <= SMALLEST_STEP && Number.isFinite(error) && this.smallest < MOST_SMALLEST;
      const time = last ? end : this.time + size;
      if ((error <= 1 || least) && this.close(after, CORRECTIONS, time)) {
        state.set(after);
        this.smallest = error <= 1 ? 0 : this.smallest + 1;
        this.time = time;
        this.step = last ? Math.max(this.step, factor * size) : factor * size;
        this.check();
        if (this.described.choices.length > 1) this.choose();
        return;
      }
      if (size <= SMALLEST_STEP) throw new Error(this.singular());
      this.step = Math.max(SMALLEST_STEP, Math.min(factor, 0.5) * size);
    }
  }

  singular() {
    return `No step from t = ${this.time.toPrecision(6)} s: closure equations depend on one another `
      + 'there, or nearly, or the motion is too fast.';
  }

  // Error of a step relative to the tolerance, as the engine estimates it (Hairer, Norsett and
  // Wanner 1993, section II.10).
  error(size) {
    const {state, after, slopes, tableau: {error, tolerance}} = this;
    const count = this.nq + this.nv;
    let fine = 0, coarse = 0;
    for (let i = 0; i < count; i++) {
      let first = 0, second = 0;
      for (let n = 0; n < slopes.length; n++) {
        first += error[0][n] * slopes[n][i];
        second += error[1][n] * slopes[n][i];
      }
      const weight = 1 / (tolerance * (1 + Math.max(Math.abs(state[i]), Math.abs(after[i]))));
      fine += (first * weight) ** 2;
      coarse += (second * weight) ** 2;
    }
    return coarse > 0 ? size * fine / Math.sqrt((fine + 0.01 * coarse) * count)
      : size * Math.sqrt(fine / count);
  }

  // The balance of energy. Throws an Error where it is far off.
  check() {
    const energy = this.energy(), work = this.state[this.nq + this.nv];
    this.exchanged = Math.max(this.exchanged, Math.abs(energy - this.reference),
                              Math.abs(this.arrays.energies[0]), Math.abs(work));
    this.residual = energy - this.reference - work;
    const share = Math.abs(this.residual) / (this.exchanged + NO_ENERGY);
    const text = `The energy balance misses ${Math.abs(this.residual).toPrecision(3)} J of the ${
      this.exchanged.toPrecision(3)} J exchanged until t = ${this.time.toPrecision(6)} s.`;
    if (!(share < ENERGY_ERROR)) throw new Error(text);
    if (share > ENERGY_WARN) this.finding = text;
  }

  // The present state.

  read() {
    const {q, qd} = this.arrays, {nq, nv} = this;
    q.set(this.state.subarray(0, nq));
    qd.set(this.state.subarray(nq, nq + nv));
  }

  // Kinetic, gravitational and stored energy together [J].
  energy() {
    this.read();
    this.exported.energies();
    const [kinetic, weight, stored] = this.arrays.energies;
    return kinetic + weight + stored;
  }

  // Evaluate the present state: accelerations, multipliers, motion of bodies, forces, energies.
  evaluate() {
    for (const clock of this.clocks) clock.begin(this.time);
    this.slope(this.time, this.state, this.slopes[0]);
    this.exported.bodies();
    this.call('forces');
    this.exported.energies();
    this.call('correction');
  }

  // Inertia that the drive of each of some freedoms feels, the others free [kg m^2; kg]: of the
  // present state, which is changed by a torque of 1.
  feltInertia(freedoms) {
    const {tau, qdd} = this.arrays;
    this.read();
    tau.fill(0);
    if (!this.call('evaluation')) return freedoms.map(() => 1);
    const before = qdd.slice();
    return freedoms.map((freedom) => {
      tau[freedom] = 1;
      this.call('evaluation');
      tau[freedom] = 0;
      const inertia = 1 / (qdd[freedom] - before[freedom]);
      return inertia > 0 && Number.isFinite(inertia) ? inertia : 1;
    });
  }

  // Place and velocity of a place in a row, of the state that `bodies` was called for.
  pointOf(row, place) {
    const motion = this.arrays.motion.subarray(MOTION_COLUMNS * row, MOTION_COLUMNS * (row + 1));
    if (!row) return [place, [0, 0, 0]];
    const offset = [0, 1, 2].map((i) => motion[3 + 3 * i] * place[0]
      + motion[4 + 3 * i] * place[1] + motion[5 + 3 * i] * place[2]);
    const turning = cross(motion.subarray(15, 18), offset);
    return [offset.map((x, i) => motion[i] + x), turning.map((x, i) => motion[12 + i] + x), offset];
  }

  // Put the force of the hand on its body; return its power [W].
  pull() {
    const {row, place, goal, stiffness, damping} = this.hand, {push} = this.arrays;
    this.exported.bodies();
    const [at, velocity, offset] = this.pointOf(row, place);
    const force = at.map((x, i) => stiffness * (goal[i] - x) - damping * velocity[i]);
    if (this.described.planar) force[2] = 0;
    push.set([...cross(offset, force), ...force], 6 * row);
    return force.reduce((sum, x, i) => sum + x * velocity[i], 0);
  }
}
