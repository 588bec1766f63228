// Meshes: places and normals of corners, and triangles as three numbers of corners each.

const ROUND = 24;
// Each corner once, with the triangles as numbers of corners: drivers without a graphics card take
// longest for corners.
function indexed({places, normals}) {
  const known = new Map(), mesh = {places: [], normals: [], corners: []};
  for (let k = 0; k < places.length; k += 3) {
    const corner = [...places.slice(k, k + 3), ...normals.slice(k, k + 3)];
    const key = corner.map((value) => value.toFixed(6)).join();
    if (!known.has(key)) {
      known.set(key, known.size);
      mesh.places.push(...corner.slice(0, 3));
      mesh.normals.push(...corner.slice(3));
    }
    mesh.corners.push(known.get(key));
  }
  return mesh;
}

function cylinderMesh(top = 1) {
  const places = [], normals = [];
  const slope = 1 - top;
  for (let k = 0; k < ROUND; k++) {
    const [a, b] = [k, k + 1].map((n) => 2 * Math.PI * n / ROUND);
    const p = (angle, z) => {
      const radius = z ? top : 1;
      return [radius * Math.cos(angle), radius * Math.sin(angle), z];
    };
    const n = (angle) => unit([Math.cos(angle), Math.sin(angle), slope]);
    for (const [angle, z] of [[a, 0], [b, 0], [b, 1], [a, 0], [b, 1], [a, 1]]) {
      places.push(...p(angle, z));
      normals.push(...n(angle));
    }
    for (const z of top ? [0, 1] : [0]) {
      places.push(0, 0, z, ...p(a, z), ...p(b, z));
      for (let i = 0; i < 3; i++) normals.push(0, 0, z ? 1 : -1);
    }
  }
  return indexed({places, normals});
}

function ballMesh(round = ROUND) {
  const places = [], normals = [], rings = round / 2;
  const p = (i, k) => {
    const a = Math.PI * i / rings, b = 2 * Math.PI * k / round;
    return [Math.sin(a) * Math.cos(b), Math.sin(a) * Math.sin(b), Math.cos(a)];
  };
  for (let i = 0; i < rings; i++) {
    for (let k = 0; k < round; k++) {
      for (const [u, v] of [[0, 0], [1, 0], [1, 1], [0, 0], [1, 1], [0, 1]]) {
        places.push(...p(i + u, k + v));
        normals.push(...p(i + u, k + v));
      }
    }
  }
  return indexed({places, normals});
}

function boxMesh() {
  const places = [], normals = [];
  for (let axis = 0; axis < 3; axis++) {
    for (const side of [-0.5, 0.5]) {
      for (const [u, v] of [[0, 0], [1, 0], [1, 1], [0, 0], [1, 1], [0, 1]]) {
        const place = [0, 0, 0], normal = [0, 0, 0];
        place[axis] = side;
        place[(axis + 1) % 3] = u - 0.5;
        place[(axis + 2) % 3] = v - 0.5;
        normal[axis] = Math.sign(side);
        places.push(...place);
        normals.push(...normal);
      }
    }
  }
  return indexed({places, normals});
}

// A flat convex polygon with a thickness along z.
function plateMesh(corners, thickness) {
  const places = [], normals = [], half = thickness / 2;
  const at = (corner, side) => [corner[0], corner[1], corner[2] + side * half];
  for (let k = 1; k + 1 < corners.length; k++) {
    for (const side of [1, -1]) {
      for (const corner of [corners[0], corners[k], corners[k + 1]]) {
        places.push(...at(corner, side));
        normals.push(0, 0, side);
      }
    }
  }
  for (let k = 0; k < corners.length; k++) {
    const a = corners[k], b = corners[(k + 1) % corners.length];
    const normal = unit([b[1] - a[1], a[0] - b[0], 0]);
    for (const [corner, side] of [[a, -1], [b, -1], [b, 1], [a, -1], [b, 1], [a, 1]]) {
      places.push(...at(corner, side));
      normals.push(...normal);
    }
  }
  return {places, normals, corners: [...places.keys()].slice(0, places.length / 3)};
}

// A coil about the z axis from 0 to 1 with straight ends: a spring, to be stretched.
const TURNS = 9, WIRE = 6, STEPS = 20;
function springMesh() {
  const places = [], normals = [], count = TURNS * STEPS;
  const middle = (k) => {
    const share = k / count, angle = 2 * Math.PI * TURNS * share;
    const radius = Math.min(1, 12 * share, 12 * (1 - share));
    return [radius * Math.cos(angle), radius * Math.sin(angle), share];
  };
  const at = (k, n) => {
    // Round the wire: out of the axis, and along it, where it is thin as it will be stretched.
    const angle = 2 * Math.PI * TURNS * k / count, turn = 2 * Math.PI * n / WIRE;
    const [c, s] = [Math.cos(turn), Math.sin(turn)];
    const out = [c * Math.cos(angle), c * Math.sin(angle), s];
    const [x, y, z] = middle(k);
    return [[x + 0.22 * out[0], y + 0.22 * out[1], z + 0.018 * s], out];
  };
  for (let k = 0; k < count; k++) {
    for (let n = 0; n < WIRE; n++) {
      for (const [i, j] of [[k, n], [k + 1, n], [k + 1, n + 1], [k, n], [k + 1, n + 1], [k, n + 1]]) {
        const [place, normal] = at(i, j);
        places.push(...place);
        normals.push(...normal);
      }
    }
  }
  return indexed({places, normals});
}

// Triangles in space with flat faces, which may be seen from both sides.
function faceMesh(triangles) {
  const places = [], normals = [];
  for (const [a, b, c] of triangles) {
    const normal = unit(cross(minus(b, a), minus(c, a)));
    places.push(...a, ...b, ...c);
    for (let k = 0; k < 3; k++) normals.push(...normal);
  }
  return {places, normals, open: true,
          corners: [...places.keys()].slice(0, places.length / 3)};
}

// A mesh whose corners are those of its triangles, each with the normal of its own.
function flatMesh(places, normals) {
  return {places, normals, corners: [...Array(places.length / 3).keys()]};
}

// An outline about the z axis, as deep as the unit and as wide at its upper end as ``taper`` says;
// with a hole of as many places a band.
function profileMesh(outline, hole, taper = 1) {
  const places = [], normals = [], count = outline.length;
  const at = ([x, y], side) => {
    const scale = side > 0 ? taper : 1;
    return [scale * x, scale * y, 0.5 * side];
  };
  const walls = (path, inward) => {
    for (let k = 0; k < count; k++) {
      const a = path[k], b = path[(k + 1) % count];
      const normal = times(inward ? -1 : 1, unit([b[1] - a[1], a[0] - b[0], 0]));
      for (const [corner, side] of [[a, -1], [b, -1], [b, 1], [a, -1], [b, 1], [a, 1]]) {
        places.push(...at(corner, side));
        normals.push(...normal);
      }
    }
  };
  const faces = hole
    ? outline.flatMap((a, k) => {
      const n = (k + 1) % count;
      return [[a, outline[n], hole[n]], [a, hole[n], hole[k]]];
    }) : triangles(outline);
  for (const side of [-1, 1]) {
    for (const corner of faces.flat()) {
      places.push(...at(corner, side));
      normals.push(0, 0, side);
    }
  }
  const turn = outline.reduce((sum, [x, y], k) => {
    const [u, v] = outline[(k + 1) % count];
    return sum + x * v - y * u;
  }, 0);
  walls(outline, turn < 0);
  if (hole) walls(hole, turn > 0);
  return flatMesh(places, normals);
}

// Triangles of a polygon that does not cross itself: ears are cut off until it is gone.
function triangles(polygon) {
  const turn = ([ax, ay], [bx, by], [cx, cy]) => (bx - ax) * (cy - ay) - (by - ay) * (cx - ax);
  const area = polygon.reduce((sum, [x, y], k) => {
    const [u, v] = polygon[(k + 1) % polygon.length];
    return sum + x * v - y * u;
  }, 0);
  const left = area < 0 ? [...polygon].reverse() : [...polygon], found = [];
  const inside = (p, a, b, c) => turn(a, b, p) >= 0 && turn(b, c, p) >= 0 && turn(c, a, p) >= 0;
  for (let k = 0, idle = 0; left.length > 3 && idle <= left.length; k = k % left.length) {
    const last = (k + left.length - 1) % left.length, next = (k + 1) % left.length;
    const [a, b, c] = [left[last], left[k], left[next]];
    const ear = turn(a, b, c) > 0 && !left.some((p, n) => (
      n !== last && n !== k && n !== next && inside(p, a, b, c)));
    // Corners on a straight line are left out without a triangle.
    if (ear || turn(a, b, c) === 0) {
      if (ear) found.push([a, b, c]);
      left.splice(k, 1);
      idle = 0;
    } else {
      k += 1;
      idle += 1;
    }
  }
  if (left.length === 3) found.push(left);
  return found;
}

// A section, places [radius, z] one after the other, turned about the z axis.
function latheMesh(section, round = 40) {
  const places = [], normals = [];
  const at = ([radius, z], k) => {
    const angle = 2 * Math.PI * k / round;
    return [radius * Math.cos(angle), radius * Math.sin(angle), z];
  };
  section.forEach((from, n) => {
    const to = section[(n + 1) % section.length];
    const out = [to[1] - from[1], from[0] - to[0]];
    for (let k = 0; k < round; k++) {
      for (const [corner, turn] of [[from, k], [from, k + 1], [to, k + 1], [from, k], [to, k + 1], [to, k]]) {
        const angle = 2 * Math.PI * turn / round;
        places.push(...at(corner, turn));
        normals.push(...unit([out[0] * Math.cos(angle), out[0] * Math.sin(angle), out[1]]));
      }
    }
  });
  return flatMesh(places, normals);
}

// A hub with four spokes about the z axis, of radius one and as deep as the unit; one is wider, so
// that turns are seen.
function spokesMesh() {
  const places = [], normals = [], box = boxMesh();
  const hub = latheMesh([[0, -0.6], [0.24, -0.6], [0.24, 0.6], [0, 0.6]], 20);
  places.push(...hub.places);
  normals.push(...hub.normals);
  for (let k = 0; k < 4; k++) {
    const angle = 0.5 * Math.PI * k, x = [Math.cos(angle), Math.sin(angle), 0];
    const local = frame(x, times(k ? 0.12 : 0.26, [-x[1], x[0], 0]), [0, 0, 0.7], times(0.5, x));
    for (const corner of box.corners) {
      places.push(...moved(local, box.places.slice(3 * corner, 3 * corner + 3)));
      normals.push(...unit(turned(local, box.normals.slice(3 * corner, 3 * corner + 3))));
    }
  }
  return flatMesh(places, normals);
}

// The rim of a pulley whose rope lies at radius one, with a groove.
const pulleyMesh = () => latheMesh([
  [0.76, -0.4], [1.06, -0.5], [1.06, -0.36], [0.93, 0], [1.06, 0.36], [1.06, 0.5], [0.76, 0.4]]);

const rgb = (color) => [1, 3, 5].map((k) => parseInt(color.slice(k, k + 2), 16) / 255);

// The corners of a mesh, so that triangles turn left where they are seen from their normals' side.
function leftHanded(mesh) {
  if (mesh.around) return mesh.around;
  const {places, normals, corners} = mesh, at = (values, k) => values.slice(3 * k, 3 * k + 3);
  mesh.around = Uint32Array.from(corners);
  for (let k = 0; k < corners.length; k += 3) {
    const [a, b, c] = [0, 1, 2].map((n) => at(places, corners[k + n]));
    if (dot(cross(minus(b, a), minus(c, a)), at(normals, corners[k])) < 0) {
      [mesh.around[k + 1], mesh.around[k + 2]] = [corners[k + 2], corners[k + 1]];
    }
  }
  return mesh.around;
}

// Put the places and normals of a mesh in a frame into arrays, from a number on.
function place(mesh, m, places, normals, first) {
  const {places: p, normals: n} = mesh;
  // Normals of what is stretched: each axis by the square of its length.
  const [sx, sy, sz] = [0, 4, 8].map((k) => 1 / (m[k] ** 2 + m[k + 1] ** 2 + m[k + 2] ** 2));
  for (let k = 0; k < p.length; k += 3) {
    const x = p[k], y = p[k + 1], z = p[k + 2], u = sx * n[k], v = sy * n[k + 1], w = sz * n[k + 2];
    const a = m[0] * u + m[4] * v + m[8] * w, b = m[1] * u + m[5] * v + m[9] * w;
    const c = m[2] * u + m[6] * v + m[10] * w, length = Math.sqrt(a * a + b * b + c * c) || 1;
    const at = first + k;
    places[at] = m[0] * x + m[4] * y + m[8] * z + m[12];
    places[at + 1] = m[1] * x + m[5] * y + m[9] * z + m[13];
    places[at + 2] = m[2] * x + m[6] * y + m[10] * z + m[14];
    normals[at] = a / length;
    normals[at + 1] = b / length;
    normals[at + 2] = c / length;
  }
}

// Meshes that are made of numbers, each once: those that were made before are the same again.
class Made {
  constructor() { this.known = new Map(); }

  get(make, ...given) {
    const key = make.name + JSON.stringify(given);
    if (!this.known.has(key)) {
      // What is edited leaves many that nobody needs any more.
      if (this.known.size > 500) this.known.clear();
      this.known.set(key, make(...given));
    }
    return this.known.get(key);
  }
}

let meshCount = 0;
const numbered = (mesh) => (mesh.number ??= ++meshCount);
