// Vectors, 4 x 4 matrices (columns one after the other, as WebGL takes them) and poses.
'use strict';

const add = (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
const minus = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
const times = (s, a) => [s * a[0], s * a[1], s * a[2]];
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [
  a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const norm = (a) => Math.hypot(a[0], a[1], a[2]);
const unit = (a) => times(1 / (norm(a) || 1), a);

function product(a, b) {
  const out = new Float32Array(16);
  for (let column = 0; column < 4; column++) {
    for (let row = 0; row < 4; row++) {
      let sum = 0;
      for (let k = 0; k < 4; k++) sum += a[4 * k + row] * b[4 * column + k];
      out[4 * column + row] = sum;
    }
  }
  return out;
}

// A frame's axes and origin as a matrix.
const frame = (x, y, z, origin) => new Float32Array([
  x[0], x[1], x[2], 0, y[0], y[1], y[2], 0, z[0], z[1], z[2], 0,
  origin[0], origin[1], origin[2], 1]);

const IDENTITY = frame([1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, 0]);

// The matrix of a pose: seven numbers of a row, x, y, z and the quaternion x, y, z, w.
function ofPose(row, first) {
  let x = row[first + 3], y = row[first + 4], z = row[first + 5], w = row[first + 6];
  const length = Math.hypot(x, y, z, w) || 1;
  x /= length; y /= length; z /= length; w /= length;
  return frame(
    [1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)],
    [2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)],
    [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)],
    [row[first], row[first + 1], row[first + 2]]);
}

const moved = (m, p) => [
  m[0] * p[0] + m[4] * p[1] + m[8] * p[2] + m[12],
  m[1] * p[0] + m[5] * p[1] + m[9] * p[2] + m[13],
  m[2] * p[0] + m[6] * p[1] + m[10] * p[2] + m[14]];
const turned = (m, p) => [
  m[0] * p[0] + m[4] * p[1] + m[8] * p[2],
  m[1] * p[0] + m[5] * p[1] + m[9] * p[2],
  m[2] * p[0] + m[6] * p[1] + m[10] * p[2]];

// The frame that stretches the unit z axis from one place to another, with a width.
function between(start, end, width, depth = width) {
  const along = minus(end, start), z = unit(along);
  // Flat things stay flat in the plane.
  const aside = Math.abs(z[2]) < 0.9 ? [0, 0, 1] : [1, 0, 0];
  const x = unit(cross(aside, z)), y = cross(z, x);
  return frame(times(width, x), times(depth, y), along, start);
}

function perspective(angle, aspect, near, far) {
  const f = 1 / Math.tan(angle / 2), m = new Float32Array(16);
  m[0] = f / aspect; m[5] = f; m[10] = (far + near) / (near - far); m[11] = -1;
  m[14] = 2 * far * near / (near - far);
  return m;
}

// What is `height` above or below the middle is at the edge.
function parallel(height, aspect, near, far) {
  const m = new Float32Array(16);
  m[0] = 1 / (height * aspect); m[5] = 1 / height; m[10] = 2 / (near - far); m[15] = 1;
  m[14] = (far + near) / (near - far);
  return m;
}

// A number from 1, 2 and 5 times a power of ten, not above the one given.
function roundDown(value) {
  if (!(value > 0)) return 0;
  const power = 10 ** Math.floor(Math.log10(value) + 1e-9);
  return (value / power >= 5 ? 5 : value / power >= 2 ? 2 : 1) * power;
}

// A number in a few characters.
function short(value, digits = 3) {
  if (!Number.isFinite(value)) return '–';
  if (value === 0) return '0';
  const size = Math.abs(value);
  if (size >= 1e5 || size < 1e-3) {
    const [mantissa, power] = value.toExponential(Math.max(digits - 2, 0)).split('e');
    return `${mantissa.replace(/\.?0+$/, '').replace('-', '−')}e${power.replace('+', '').replace('-', '−')}`;
  }
  const places = Math.max(0, digits - 1 - Math.floor(Math.log10(size)));
  const text = value.toFixed(places);
  return (places ? text.replace(/\.?0+$/, '') : text).replace('-', '−');
}

const escaped = (text) => String(text).replace(/[&<>"]/g, (c) => (
  {'&': '&amp;', '<': '&lt;', '>': '&gt;', '"': '&quot;'}[c]));
