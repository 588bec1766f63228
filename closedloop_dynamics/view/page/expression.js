// Expressions in the time t, as drives have them: value, rate and acceleration at once. Functions
// with corners are left out: a motion has no jumps of its speed.

const expressionOf = (() => {
  // A number with its first and second derivative by the time.
  const jet = (value, rate = 0, bend = 0) => [value, rate, bend];
  // f of a jet, by f, f' and f'' there.
  const chained = ([, rate, bend], f, slope, curve) => jet(
    f, slope * rate, slope * bend + curve * rate * rate);
  const product = (a, b) => jet(a[0] * b[0], a[1] * b[0] + a[0] * b[1],
                                a[2] * b[0] + 2 * a[1] * b[1] + a[0] * b[2]);
  const inverse = (a) => chained(a, 1 / a[0], -1 / a[0] ** 2, 2 / a[0] ** 3);
  const sum = (a, b, sign = 1) => a.map((x, k) => x + sign * b[k]);
  const logarithm = (a) => chained(a, Math.log(a[0]), 1 / a[0], -1 / a[0] ** 2);
  const exponential = (a) => chained(a, Math.exp(a[0]), Math.exp(a[0]), Math.exp(a[0]));
  const root = (a) => chained(a, Math.sqrt(a[0]), 0.5 / Math.sqrt(a[0]), -0.25 / a[0] ** 1.5);
  const arctangent = (a) => chained(a, Math.atan(a[0]), 1 / (1 + a[0] ** 2),
                                    -2 * a[0] / (1 + a[0] ** 2) ** 2);
  // A constant exponent has no logarithm of its base, which may be negative.
  const power = (a, b) => (b[1] || b[2] ? exponential(product(logarithm(a), b))
    : b[0] === 0 ? jet(1)
      : chained(a, a[0] ** b[0], b[0] * a[0] ** (b[0] - 1),
                b[0] === 1 ? 0 : b[0] * (b[0] - 1) * a[0] ** (b[0] - 2)));
  const sineOf = (a) => chained(a, Math.sin(a[0]), Math.cos(a[0]), -Math.sin(a[0]));
  const cosineOf = (a) => chained(a, Math.cos(a[0]), -Math.sin(a[0]), -Math.cos(a[0]));
  const arcsine = (a) => arctangent(product(a, inverse(root(sum(jet(1), product(a, a), -1)))));
  const JET_FUNCTIONS = {
    sin: sineOf, cos: cosineOf, tan: (a) => product(sineOf(a), inverse(cosineOf(a))),
    asin: arcsine, acos: (a) => sum(jet(Math.PI / 2), arcsine(a), -1), atan: arctangent,
    sqrt: root, exp: exponential, log: logarithm,
    radians: (a) => a.map((x) => x * Math.PI / 180), degrees: (a) => a.map((x) => x * 180 / Math.PI),
    hypot: (a, b) => root(sum(product(a, a), product(b, b))),
    atan2: (a, b) => sum(arctangent(product(a, inverse(b))), jet(
      Math.atan2(a[0], b[0]) - Math.atan(a[0] / b[0])))};

  // Return a function of the time that gives [value, rate, acceleration]. Throws an Error where the
  // text is no expression.
  const read = (text) => {
    const tokens = text.match(/\d+\.?\d*(?:e[+-]?\d+)?|\.\d+(?:e[+-]?\d+)?|[a-z_]\w*|\*\*|[-+*/(),]|\S/gi) ?? [];
    let at = 0;
    const wrong = () => new Error(`expected an expression in the time t, such as 1.05+2*pi*t, got ${text}`);
    const taken = (...which) => (which.includes(tokens[at]) ? tokens[at++] : null);
    const need = (what) => { if (!taken(what)) throw wrong(); };
    const chain = (operand, operators) => {
      let left = operand();
      for (let sign = taken(...Object.keys(operators)); sign; sign = taken(...Object.keys(operators))) {
        const [before, right, join] = [left, operand(), operators[sign]];
        left = (t) => join(before(t), right(t));
      }
      return left;
    };
    const total = () => chain(term, {'+': sum, '-': (a, b) => sum(a, b, -1)});
    const term = () => chain(signed, {'*': product, '/': (a, b) => product(a, inverse(b))});
    const signed = () => {
      const sign = taken('+', '-');
      if (!sign) return raised();
      const inner = signed();
      return sign === '+' ? inner : (t) => inner(t).map((x) => -x);
    };
    const raised = () => {
      const base = single();
      if (!taken('**')) return base;
      const exponent = signed();
      return (t) => power(base(t), exponent(t));
    };
    const single = () => {
      const token = tokens[at++];
      if (token === '(') {
        const inner = total();
        need(')');
        return inner;
      }
      if (token === 't') return (t) => jet(t, 1);
      if (token === 'pi') return () => jet(Math.PI);
      if (/^[\d.]/.test(token ?? '')) return () => jet(Number(token));
      const call = Object.hasOwn(JET_FUNCTIONS, token ?? '') ? JET_FUNCTIONS[token] : null;
      if (!call) throw wrong();
      need('(');
      const operands = [total()];
      while (taken(',')) operands.push(total());
      need(')');
      if (operands.length !== call.length) throw wrong();
      return (t) => call(...operands.map((operand) => operand(t)));
    };
    const found = total();
    if (at < tokens.length) throw wrong();
    return found;
  };
  return read;
})();

// What follows the time in a scene: pieces, each with its start, c0 to c5, a, w and p, of which the
// present one gives c0 + u (c1 + ... u c5) + a sin(w u + p), u since its start; or programs on a
// stack, of a value, its rate and its acceleration, as effects/expression.py has them; or the time.
const OF_ONE = [
  (x) => -x, Math.abs, Math.sin, Math.cos, Math.tan, Math.asin, Math.acos, Math.atan, Math.sqrt,
  Math.exp, Math.log, (x) => x * Math.PI / 180, (x) => x * 180 / Math.PI];
const OF_TWO = [
  (x, y) => x + y, (x, y) => x - y, (x, y) => x * y, (x, y) => x / y, Math.pow, Math.atan2,
  Math.hypot, Math.min, Math.max];
// Operations before those of one number; times closer than this, relative to their size, are the same.
const NO_OPERANDS = 2, SAME_TIME = 1e-12;

const programValue = ([count, ...steps], time) => {
  const stack = [];
  for (let k = 0; k < count; k++) {
    const operation = steps[2 * k] - NO_OPERANDS;
    if (operation < 0) {
      stack.push(operation === -1 ? time : steps[2 * k + 1]);
    } else if (operation < OF_ONE.length) {
      stack.push(OF_ONE[operation](stack.pop()));
    } else {
      const last = stack.pop();
      stack.push(OF_TWO[operation - OF_ONE.length](stack.pop(), last));
    }
  }
  return stack[0];
};

const pieceValues = ([c0, c1, c2, c3, c4, c5, a, w, p], u) => [
  c0 + u * (c1 + u * (c2 + u * (c3 + u * (c4 + u * c5)))) + a * Math.sin(w * u + p),
  c1 + u * (2 * c2 + u * (3 * c3 + u * (4 * c4 + u * 5 * c5))) + a * w * Math.cos(w * u + p),
  2 * c2 + u * (6 * c3 + u * (12 * c4 + u * 20 * c5)) - a * w * w * Math.sin(w * u + p)];

class Clock {
  // `clock`: of `wasm_source.clocks_of`; it writes into an array.
  constructor(clock, array) {
    Object.assign(this, clock, {array});
    this.begin(0);
  }

  // Have the piece that is present from a time on; return when it ends.
  begin(time) {
    const {pieces, period} = this;
    if (!pieces) return Infinity;
    const now = time + SAME_TIME * Math.max(1, Math.abs(time));
    const cycle = period ? Math.floor(now / period) * period : 0;
    const next = pieces.findIndex(([start], k) => k > 0 && start > now - cycle);
    const [start, ...numbers] = pieces[next < 0 ? pieces.length - 1 : next - 1];
    this.present = [cycle + start, numbers];
    return next < 0 ? (period ? cycle + period : Infinity) : cycle + pieces[next][0];
  }

  put(time) {
    const {array, index, count, offset, programs, present} = this;
    const found = programs ? programs.map((each) => programValue(each, time))
      : present ? pieceValues(present[1], time - present[0]) : [time];
    for (let k = 0; k < count; k++) array[index + k] = found[k] + (k ? 0 : offset);
  }
}
