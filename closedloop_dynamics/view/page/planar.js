// Equations of a mechanism in the plane, for any: what WebAssembly is to one machine, by loops over its
// bodies. Joint coordinates of a spanning tree; the equations of cut joints and couplings by multipliers.

// Squared length of an equation, against that before others were taken from it, below which it
// repeats them.
const REPEATS = 1e-10;
// How many equations cut joints have.
const CUT_EQUATIONS = {pin: 2, line: 1, guide: 2, distance: 1};

const sum2 = ([a, b], [c, d]) => [a + c, b + d];
const scaled = (s, [a, b]) => [s * a, s * b];
// A vector turned by a right angle; scalar product.
const normalTo = ([a, b]) => [-b, a];
const inner = ([a, b], [c, d]) => a * c + b * d;

class PlanarEquations {
  // `rows`: from row 1 on, {parent, turns, sign (-1: the coordinate is that of the parent in the
  // body), place (on the parent), at (on the body), angle, slide
  // (direction on the parent), mass, center, inertia}; `cuts`: {kind, a, at_a, b, at_b, along, angle,
  // length}, of kinds pin, line, guide (a line and an angle) and distance; `couplings`: lists of
  // [factor, coordinate], a coordinate {turns, a, at_a, b, at_b, along}, of b in a; `springs`:
  // {a, at_a, b, at_b, stiffness, damping, free}; `forces`: {row, at, force}.
  constructor({rows, cuts, couplings, springs, forces, gravity}) {
    Object.assign(this, {rows: [null, ...rows], cuts, couplings, springs, forces});
    [this.nv, this.dependent, this.repeated] = [rows.length, 0, []];
    this.chains = this.rows.map((row, i) => this.chain(i));
    this.turning = this.rows.map((row, i) => this.turns(i));
    this.frames = this.rows.map(() => ({angle: 0, origin: [0, 0], spin: 0, velocity: [0, 0], bias: [0, 0]}));
    const sizes = {q: this.nv, qd: this.nv, tau: this.nv, push: 6 * this.rows.length, switch: 0, body: 0,
      gravity: 2, cut_point: 0, values: 0, qdd: this.nv, lam: this.count, power: 2, change: 2 * this.nv,
      closure: this.count, energies: 3, motion: MOTION_COLUMNS * this.rows.length, force: 3 * cuts.length};
    let end = 0;
    this.arrays = {};
    for (const [name, size] of Object.entries(sizes)) {
      this.arrays[name] = [end, size];
      end += size;
    }
    this.memory = {buffer: new ArrayBuffer(8 * end)};
    for (const [name, [first, size]] of Object.entries(this.arrays)) {
      this[name] = new Float64Array(this.memory.buffer, 8 * first, size);
    }
    this.gravity.set(gravity);
  }

  get count() {
    return this.cuts.reduce((total, {kind}) => total + CUT_EQUATIONS[kind], this.couplings.length);
  }

  // Joints that move a body, by their rows.
  chain(row) {
    const found = [];
    for (let i = row; i > 0; i = this.rows[i].parent) found.push(i);
    return found.reverse();
  }

  // Poses, velocities, and accelerations where those of the joints are zero.
  outward() {
    for (let i = 1; i < this.rows.length; i++) {
      const row = this.rows[i], parent = this.frames[row.parent], q = this.q[i - 1], rate = this.qd[i - 1];
      const frame = this.frames[i], place = this.turned(row.parent, row.place);
      frame.angle = parent.angle + row.angle + (row.turns ? row.sign * q : 0);
      frame.spin = parent.spin + (row.turns ? row.sign * rate : 0);
      [frame.cos, frame.sin] = [Math.cos(frame.angle), Math.sin(frame.angle)];
      frame.direction = row.turns ? null : this.turned(row.parent, row.slide);
      const arm = row.turns ? place : sum2(place, scaled(q, frame.direction));
      const back = scaled(-1, this.turned(i, row.at));
      frame.joint = sum2(parent.origin, arm);
      frame.origin = sum2(frame.joint, back);
      frame.velocity = sum2(sum2(parent.velocity, scaled(parent.spin, normalTo(arm))),
                            scaled(frame.spin, normalTo(back)));
      frame.bias = sum2(sum2(parent.bias, scaled(-(parent.spin ** 2), arm)), scaled(-(frame.spin ** 2), back));
      if (!row.turns) {
        frame.velocity = sum2(frame.velocity, scaled(rate, frame.direction));
        frame.bias = sum2(frame.bias, scaled(2 * parent.spin * rate, normalTo(frame.direction)));
      }
    }
  }

  turned(row, [x, y]) {
    if (!row) return [x, y];
    const {cos, sin} = this.frames[row];
    return [cos * x - sin * y, sin * x + cos * y];
  }

  // Place of a point, its velocity, acceleration and Jacobian: x and y for each joint.
  point(row, at) {
    const {origin, velocity, spin, bias} = this.frames[row], arm = this.turned(row, at);
    const place = sum2(origin, arm), x = new Float64Array(this.nv), y = new Float64Array(this.nv);
    for (const k of this.chains[row]) {
      const {joint, direction} = this.frames[k], {sign} = this.rows[k];
      x[k - 1] = direction ? direction[0] : sign * (joint[1] - place[1]);
      y[k - 1] = direction ? direction[1] : sign * (place[0] - joint[0]);
    }
    return {place, x, y, velocity: sum2(velocity, scaled(spin, normalTo(arm))),
            bias: sum2(bias, scaled(-(spin ** 2), arm))};
  }

  // Which joints turn a body, and which way.
  turns(row) {
    const found = new Float64Array(this.nv);
    for (const k of this.chains[row]) if (this.rows[k].turns) found[k - 1] = this.rows[k].sign;
    return found;
  }

  // The distance of point a from point b; only the signs of the multipliers depend on the order.
  between(a, atA, b, atB) {
    const [one, other] = [this.point(a, atA), this.point(b, atB)];
    const less = (key) => sum2(one[key], scaled(-1, other[key]));
    return {place: less('place'), velocity: less('velocity'), bias: less('bias'),
            x: one.x.map((value, k) => value - other.x[k]), y: one.y.map((value, k) => value - other.y[k])};
  }

  // A distance along a direction fixed in body b: value, Jacobian, bias.
  along({a, at_a: atA, b, at_b: atB}, direction) {
    const {place, velocity, bias, x, y} = this.between(a, atA, b, atB), spin = this.frames[b].spin;
    const axis = this.turned(b, direction), across = normalTo(axis), lever = inner(across, place);
    return {value: inner(axis, place), jac: x.map((_, k) => (
      axis[0] * x[k] + axis[1] * y[k] + this.turning[b][k] * lever)),
            bias: inner(axis, bias) + 2 * spin * inner(across, velocity) - spin ** 2 * inner(axis, place), axis};
  }

  angles(a, b, angle) {
    return {value: this.frames[a].angle - this.frames[b].angle - angle, bias: 0,
            jac: this.turning[a].map((x, k) => x - this.turning[b][k])};
  }

  // All closure equations.
  equations() {
    const found = [];
    for (const cut of this.cuts) {
      if (cut.kind === 'pin' || cut.kind === 'distance') {
        const {place, velocity, bias, x, y} = this.between(cut.a, cut.at_a, cut.b, cut.at_b);
        if (cut.kind === 'pin') {
          found.push({value: place[0], jac: x, bias: bias[0]}, {value: place[1], jac: y, bias: bias[1]});
        } else {
          const length = Math.hypot(...place), axis = scaled(1 / length, place), rate = inner(axis, velocity);
          found.push({value: length - cut.length, jac: x.map((_, k) => axis[0] * x[k] + axis[1] * y[k]), axis,
                      bias: inner(axis, bias) + (inner(velocity, velocity) - rate ** 2) / length});
        }
      } else {
        found.push(this.along(cut, normalTo(cut.along)));
        if (cut.kind === 'guide') found.push(this.angles(cut.a, cut.b, cut.angle));
      }
    }
    for (const terms of this.couplings) {
      const total = {value: 0, jac: new Float64Array(this.nv), bias: 0};
      for (const [factor, one] of terms) {
        const {value, jac, bias} = one.turns ? this.angles(one.b, one.a, one.angle)
          : this.along({a: one.b, at_a: one.at_b, b: one.a, at_b: one.at_a}, one.along);
        total.value += factor * value;
        total.bias += factor * bias;
        jac.forEach((x, k) => { total.jac[k] += factor * x; });
      }
      found.push(total);
    }
    return found;
  }

  // The factor of the joints' inertia, and what acts on them beside torques.
  masses() {
    const {nv} = this, matrix = Array.from({length: nv}, () => new Float64Array(nv)), force = new Float64Array(nv);
    const load = (row, at, [x, y], moment) => {
      const moves = this.point(row, at), turns = this.turning[row];
      for (let k = 0; k < nv; k++) force[k] += moves.x[k] * x + moves.y[k] * y + turns[k] * moment;
    };
    for (let i = 1; i < this.rows.length; i++) {
      const {mass, center, inertia} = this.rows[i], {x, y, bias} = this.point(i, center), turns = this.turning[i];
      const [gx, gy] = [this.gravity[0] - bias[0], this.gravity[1] - bias[1]];
      for (const row of this.chains[i]) {
        const a = row - 1;
        for (const other of this.chains[i]) {
          const b = other - 1;
          if (b <= a) matrix[a][b] += mass * (x[a] * x[b] + y[a] * y[b]) + inertia * turns[a] * turns[b];
        }
        force[a] += mass * (x[a] * gx + y[a] * gy);
      }
      const [moment, fx, fy] = this.push.subarray(6 * i + 2, 6 * i + 5);
      if (moment || fx || fy) load(i, [0, 0], [fx, fy], moment);
    }
    this.power.fill(0);
    for (const {row, at, force: given} of this.forces) {
      load(row, at, given, 0);
      this.power[1] += inner(given, this.point(row, at).velocity);
    }
    for (const {a, at_a: atA, b, at_b: atB, stiffness, damping, free} of this.springs) {
      const {place, velocity} = this.between(a, atA, b, atB), length = Math.hypot(...place);
      if (!(length > 0)) continue;
      const axis = scaled(1 / length, place), rate = inner(axis, velocity);
      const pull = scaled(-(stiffness * (length - free) + damping * rate), axis);
      load(a, atA, pull, 0);
      load(b, atB, scaled(-1, pull), 0);
      this.power[0] += damping * rate * rate;
    }
    return {factor: this.factored(matrix), force};
  }

  // Cholesky's factor of a positive matrix, given below its diagonal; null where it is none.
  factored(matrix) {
    const lower = matrix.map((row) => row.slice());
    for (let i = 0; i < lower.length; i++) {
      for (let j = 0; j <= i; j++) {
        let rest = lower[i][j];
        for (let k = 0; k < j; k++) rest -= lower[i][k] * lower[j][k];
        if (i === j && !(rest > 0)) return null;
        lower[i][j] = i === j ? Math.sqrt(rest) : rest / lower[j][j];
      }
    }
    return lower;
  }

  // L^-1 of a vector, and L^-T.
  forward(lower, values) {
    const x = Float64Array.from(values);
    for (let i = 0; i < x.length; i++) {
      for (let k = 0; k < i; k++) x[i] -= lower[i][k] * x[k];
      x[i] /= lower[i][i];
    }
    return x;
  }

  backward(lower, values) {
    const x = Float64Array.from(values);
    for (let i = x.length - 1; i >= 0; i--) {
      for (let k = i + 1; k < x.length; k++) x[i] -= lower[k][i] * x[k];
      x[i] /= lower[i][i];
    }
    return x;
  }

  // Directions of the equations in the metric of the masses, each without those before it (Gram and
  // Schmidt, twice), and which repeat them.
  directions(lower, equations) {
    const found = [], product = (a, b) => {
      let total = 0;
      for (let i = 0; i < a.length; i++) total += a[i] * b[i];
      return total;
    };
    equations.forEach(({jac}, number) => {
      const rest = this.forward(lower, jac), shares = new Float64Array(found.length);
      const size = product(rest, rest);
      for (let pass = 0; pass < 2; pass++) {
        for (let k = 0; k < found.length; k++) {
          const {axis} = found[k], share = product(axis, rest);
          shares[k] += share;
          for (let i = 0; i < rest.length; i++) rest[i] -= share * axis[i];
        }
      }
      const left = product(rest, rest), length = Math.sqrt(left);
      if (left > REPEATS * size) found.push({number, shares, length, axis: rest.map((x) => x / length)});
    });
    const kept = new Set(found.map(({number}) => number));
    this.repeated = [...equations.keys()].filter((number) => !kept.has(number));
    this.dependent = this.repeated.length;
    return found;
  }

  // The least change, in the metric of the masses, by which equations change by given numbers, and
  // the multipliers that make it.
  least(lower, directions, wanted) {
    const parts = [], change = new Float64Array(this.nv);
    for (const {number, shares, length, axis} of directions) {
      let rest = wanted[number];
      shares.forEach((share, k) => { rest -= share * parts[k]; });
      const part = rest / length;
      parts.push(part);
      axis.forEach((x, i) => { change[i] += part * x; });
    }
    const multipliers = new Float64Array(this.count);
    for (let k = directions.length - 1; k >= 0; k--) {
      let rest = parts[k];
      for (let n = k + 1; n < directions.length; n++) rest -= directions[n].shares[k] * multipliers[directions[n].number];
      multipliers[directions[k].number] = rest / directions[k].length;
    }
    return [this.backward(lower, change), multipliers];
  }

  // What `Machine` calls, as of WebAssembly.

  evaluation() {
    this.outward();
    const {factor, force} = this.masses();
    if (!factor) return 0;
    const equations = this.equations(), directions = this.directions(factor, equations);
    const free = this.backward(factor, this.forward(factor, force.map((x, k) => x + this.tau[k])));
    const [change, multipliers] = this.least(factor, directions, equations.map(({jac, bias}) => (
      -bias - jac.reduce((total, x, k) => total + x * free[k], 0))));
    for (let k = 0; k < this.nv; k++) this.qdd[k] = free[k] + change[k];
    this.lam.set(multipliers);
    return Number(this.qdd.every(Number.isFinite));
  }

  correction() {
    this.outward();
    const {factor} = this.masses();
    if (!factor) return 0;
    const equations = this.equations(), directions = this.directions(factor, equations);
    const [places] = this.least(factor, directions, equations.map(({value}) => -value));
    const [rates] = this.least(factor, directions, equations.map(({jac}) => (
      -jac.reduce((total, x, k) => total + x * this.qd[k], 0))));
    this.change.set(places);
    this.change.set(rates, this.nv);
    this.closure.set(equations.map(({value}) => value));
    return Number(this.change.every(Number.isFinite));
  }

  heldEnergies() {
    this.outward();
    let [kinetic, weight, stored] = [0, 0, 0];
    for (let i = 1; i < this.rows.length; i++) {
      const {mass, center, inertia} = this.rows[i], {place, velocity} = this.point(i, center);
      kinetic += 0.5 * (mass * inner(velocity, velocity) + inertia * this.frames[i].spin ** 2);
      weight -= mass * inner(this.gravity, place);
    }
    for (const {a, at_a: atA, b, at_b: atB, stiffness, free} of this.springs) {
      stored += 0.5 * stiffness * (Math.hypot(...this.between(a, atA, b, atB).place) - free) ** 2;
    }
    return [kinetic, weight, stored];
  }

  bodies() {
    this.outward();
    for (let i = 1; i < this.rows.length; i++) {
      const {origin, cos, sin, velocity, spin} = this.frames[i];
      this.motion.set([...origin, 0, cos, -sin, 0, sin, cos, 0, 0, 0, 1, ...velocity, 0, 0, 0, spin], MOTION_COLUMNS * i);
    }
    return 1;
  }

  // Forces on bodies A of the cut joints.
  reactions() {
    this.outward();
    const equations = this.equations();
    let number = 0;
    this.cuts.forEach(({kind}, k) => {
      const first = this.lam[number];
      this.force.set(kind === 'pin' ? [first, this.lam[number + 1], 0]
        : [...scaled(first, equations[number].axis), 0], 3 * k);
      number += kind === 'pin' || kind === 'guide' ? 2 : 1;
    });
    return 1;
  }

  // By the names of a module's functions.
  get exported() {
    return {memory: this.memory, evaluation: () => this.evaluation(), correction: () => this.correction(),
            bodies: () => this.bodies(), forces: () => this.reactions(), energies: () => {
              this.energies.set(this.heldEnergies());
              return 1;
            }};
  }
}
