// The mechanism in three dimensions: WebGL for what is solid, a canvas above it for lines, text.

const VERTEX = `#version 300 es
uniform mat4 model, view;
in vec3 place, normal, paint;
out vec3 turned, color;
void main() {
  color = paint;
  // Normals of what is stretched: each axis by the square of its length.
  vec3 square = vec3(dot(model[0], model[0]), dot(model[1], model[1]), dot(model[2], model[2]));
  turned = mat3(model) * (normal / square);
  gl_Position = view * (model * vec4(place, 1.0));
}`;
// Without branches and with few numbers from corner to corner, which a processor draws faster.
const FRAGMENT = `#version 300 es
precision highp float;
uniform vec3 toEye, light;
uniform float ambient;
in vec3 turned, color;
out vec4 result;
void main() {
  vec3 n = turned * inversesqrt(max(dot(turned, turned), 1e-30));
  n = gl_FrontFacing ? n : -n;
  float along = dot(n, light), direct = max(along, -0.4 * along), fill = 0.5 + 0.5 * n.y;
  float glint = max(2.0 * along * dot(n, toEye) - dot(light, toEye), 0.0);
  glint *= glint; glint *= glint; glint *= glint; glint *= glint; glint *= glint;
  vec3 lit = color * (ambient + 0.22 * fill + 0.62 * direct) + 0.12 * glint;
  // Lines have no normals, and no light.
  result = vec4(turned == vec3(0.0) ? color : lit, 1.0);
}`;
// Paths: each piece a rectangle about two places next to each other, as wide as it is seen.
const PATH_VERTEX = `#version 300 es
uniform mat4 view;
uniform vec2 window;
uniform float radius;
in vec3 from, to;
out vec2 a, b;
void main() {
  vec4 first = view * vec4(from, 1.0), second = view * vec4(to, 1.0);
  a = (0.5 + 0.5 * first.xy / first.w) * window;
  b = (0.5 + 0.5 * second.xy / second.w) * window;
  vec2 along = b - a;
  // Pieces end where the next ones begin: what is drawn twice would show. A dot is round.
  float cap = dot(along, along) > 0.0 ? 0.0 : 1.0;
  along = cap > 0.0 ? vec2(1.0, 0.0) : normalize(along);
  bool ahead = gl_VertexID > 1;
  vec2 side = vec2(-along.y, along.x) * (gl_VertexID % 2 == 0 ? 1.0 : -1.0);
  vec2 place = (ahead ? b : a) + (radius + 1.0) * (side + cap * (ahead ? along : -along));
  gl_Position = first.w > 0.0 && second.w > 0.0
    ? vec4(2.0 * place / window - 1.0, 0.0, 1.0) : vec4(2.0, 2.0, 2.0, 1.0);
}`;
const PATH_FRAGMENT = `#version 300 es
precision highp float;
uniform vec3 paint;
uniform float radius;
in vec2 a, b;
out vec4 result;
void main() {
  vec2 along = b - a, away = gl_FragCoord.xy - a;
  away -= clamp(dot(away, along) / max(dot(along, along), 1e-6), 0.0, 1.0) * along;
  result = vec4(paint, clamp(radius + 0.5 - length(away), 0.0, 1.0));
}`;

const ROUND = 24;
const FIELD_OF_VIEW = 0.5;
// Half the width of a path, and the radius of the dot at its end [CSS pixels]; how many places of
// a live one are kept, and forgotten at once; how far they are apart at least, in sizes.
const PATH = 0.9, DOT = 3.2, PATH_LENGTH = 8000, FORGOTTEN = 1000, SPACING = 0.001;

// The places of a point, in a buffer that grows by what is new; of a recording those of all rows.
class Trail {
  constructor(gl, capacity = PATH_LENGTH) {
    this.gl = gl;
    this.buffer = gl.createBuffer();
    this.places = new Float32Array(3 * capacity);
    // How many there are, are drawn, and are in the buffer; -1: none, and it has no size yet.
    this.count = this.shown = 0;
    this.sent = -1;
    this.now = null;
  }

  push(place) {
    if (3 * this.count === this.places.length) {
      this.places.copyWithin(0, 3 * FORGOTTEN);
      this.count -= FORGOTTEN;
      this.sent = 0;
    }
    this.places.set(place, 3 * this.count);
    this.count += 1;
  }

  forget() { this.count = this.sent = 0; }

  last() { return this.places.subarray(3 * this.shown - 3, 3 * this.shown); }

  // Bind the buffer with all places.
  bind() {
    const gl = this.gl;
    gl.bindBuffer(gl.ARRAY_BUFFER, this.buffer);
    if (this.sent < 0) {
      gl.bufferData(gl.ARRAY_BUFFER, this.places.byteLength, gl.DYNAMIC_DRAW);
      this.sent = 0;
    }
    if (this.sent < this.count) {
      gl.bufferSubData(gl.ARRAY_BUFFER, 12 * this.sent,
                       this.places.subarray(3 * this.sent, 3 * this.count));
      this.sent = this.count;
    }
  }
}
// A force arrow of the largest force seen lately, as a share of the size; a share of the machine's
// weight, below which forces have no long arrows.
const ARROW = 0.3, SMALL_FORCE = 0.02;
// A peak of the forces counts half after so long [ms].
const HALF_LIFE = 1500;
const ROD = '#8b929c';
// Driven joints, in the colour that the theme has for them.
const INK = [0.16, 0.18, 0.2];

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

// The way of a cable in the plane: straight pieces between pulleys, and what lies on these.
function cableWay(centers, radii) {
  const pieces = [];
  for (let k = 0; k + 1 < centers.length; k++) {
    const [dx, dy] = minus(centers[k + 1], centers[k]), between = dx * dx + dy * dy;
    const across = radii[k + 1] - radii[k], length = Math.sqrt(Math.max(0, between - across * across));
    pieces.push(between > 0 ? [(length * dx + across * dy) / between,
                               (length * dy - across * dx) / between] : [1, 0]);
  }
  const on = (k, [x, y]) => add(centers[k], [radii[k] * y, -radii[k] * x, 0]);
  const way = [centers[0]];
  for (let k = 1; k + 1 < centers.length; k++) {
    const [a, b] = [pieces[k - 1], pieces[k]], sense = Math.sign(radii[k]);
    if (!sense) { way.push(centers[k]); continue; }
    let turn = sense * Math.atan2(a[0] * b[1] - a[1] * b[0], a[0] * b[0] + a[1] * b[1]);
    if (turn < -0.5 * Math.PI) turn += 2 * Math.PI;
    const steps = Math.max(1, Math.ceil(Math.abs(turn) / 0.2));
    for (let n = 0; n <= steps; n++) {
      const angle = sense * turn * n / steps, [c, s] = [Math.cos(angle), Math.sin(angle)];
      way.push(on(k, [c * a[0] - s * a[1], s * a[0] + c * a[1]]));
    }
  }
  way.push(centers[centers.length - 1]);
  return way;
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

const rgb = (color) => [1, 3, 5].map((k) => parseInt(color.slice(k, k + 2), 16) / 255);

// Whether WebGL has no graphics card here.
function drawnByProcessor() {
  const gl = document.createElement('canvas').getContext('webgl2');
  const about = gl?.getExtension('WEBGL_debug_renderer_info');
  const name = about ? gl.getParameter(about.UNMASKED_RENDERER_WEBGL) : '';
  gl?.getExtension('WEBGL_lose_context')?.loseContext();
  return /swiftshader|llvmpipe|softpipe|software/i.test(name);
}

class Scene {
  constructor(solid, lines, described) {
    this.canvas = solid;
    this.lines = lines;
    this.pen = lines.getContext('2d');
    this.described = described;
    this.size = described.size;
    this.row = null;
    this.frames = [];
    this.forcePeak = this.peakAt = 0;
    this.hover = this.held = this.handAt = null;
    // Places that are measured, each a body and the number of a place of it; null: none is.
    this.measured = null;
    this.followed = -1;
    // What is drawn above everything else.
    this.above = null;
    this.shown = {forces: true, names: false, path: true, paths: false};
    // Where the processor draws, smooth edges would cost half of the frames; pictures may ask.
    const smooth = location.search.includes('smooth') || !drawnByProcessor();
    const gl = this.gl = solid.getContext('webgl2', {antialias: smooth, alpha: false});
    if (!gl) throw new Error('This browser has no WebGL 2, which the picture needs.');
    this.solid = this.build(VERTEX, FRAGMENT, ['place', 'normal', 'paint']);
    this.path = this.build(PATH_VERTEX, PATH_FRAGMENT, ['from', 'to']);
    this.pathBuffer = gl.createBuffer();
    this.trails = described.points.map(() => new Trail(gl));
    this.meshes = {
      cylinder: cylinderMesh(), cone: cylinderMesh(0), ball: ballMesh(),
      // Ends of bars are small.
      knob: ballMesh(16), box: boxMesh(),
      spring: springMesh()};
    // Of the effects, as they are told: which are off, and where their anchors are.
    this.effects = {};
    this.items = [];
    this.arrowMeshes = {};
    this.compose();
    this.extent = null;
    this.view('first');
    solid.addEventListener('webglcontextlost', (event) => event.preventDefault());
    solid.addEventListener('webglcontextrestored', () => location.reload());
  }

  // A program with its attributes, numbered in this order, and its uniforms by name.
  build(vertex, fragment, attributes) {
    const gl = this.gl, program = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    attributes.forEach((name, number) => gl.bindAttribLocation(program, number, name));
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) {
      throw new Error('WebGL: ' + gl.getProgramInfoLog(program));
    }
    const uniforms = {};
    for (let k = 0; k < gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS); k++) {
      const {name} = gl.getActiveUniform(program, k);
      uniforms[name] = gl.getUniformLocation(program, name);
    }
    return {program, uniforms};
  }

  // What a body is drawn as, in one piece: a driver's calls cost more than its triangles.
  load(parts, theme) {
    const places = [], normals = [], paints = [], closed = [], open = [];
    const place = (corner) => places.slice(3 * corner, 3 * corner + 3);
    for (const {mesh, local, color} of parts) {
      const squares = [0, 4, 8].map((k) => local[k] ** 2 + local[k + 1] ** 2 + local[k + 2] ** 2);
      const paint = color === INK ? theme.driven : color, first = places.length / 3;
      for (let k = 0; k < mesh.places.length; k += 3) {
        places.push(...moved(local, mesh.places.slice(k, k + 3)));
        normals.push(...unit(turned(local, mesh.normals.slice(k, k + 3).map(
          (value, axis) => value / squares[axis]))));
        paints.push(...paint);
      }
      for (let k = 0; k < mesh.corners.length; k += 3) {
        const [a, b, c] = mesh.corners.slice(k, k + 3).map((corner) => first + corner);
        // Seen from its normal's side a triangle turns left.
        const out = cross(minus(place(b), place(a)), minus(place(c), place(a)));
        const left = dot(out, normals.slice(3 * a, 3 * a + 3)) >= 0;
        (mesh.open ? open : closed).push(a, ...(left ? [b, c] : [c, b]));
      }
    }
    return this.stored(places, normals, paints, closed, open);
  }

  stored(places, normals, paints, closed, open) {
    const gl = this.gl, array = gl.createVertexArray();
    gl.bindVertexArray(array);
    const buffers = [0, 1, 2, 3].map(() => gl.createBuffer());
    [places, normals, paints].forEach((values, number) => {
      gl.bindBuffer(gl.ARRAY_BUFFER, buffers[number]);
      gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(values), gl.STATIC_DRAW);
      gl.enableVertexAttribArray(number);
      gl.vertexAttribPointer(number, 3, gl.FLOAT, false, 0, 0);
    });
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, buffers[3]);
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, new Uint32Array([...closed, ...open]), gl.STATIC_DRAW);
    return {array, buffers, closed: closed.length, count: closed.length + open.length};
  }

  // What is drawn: a mesh with a place on a body, -1 for the ground; the same again is not.
  put(body, mesh, local, color) {
    if (!this.items.some((item) => item.body === body && item.mesh === mesh
        && item.color.join() === color.join() && item.local.every((x, k) => x === local[k]))) {
      this.items.push({body, mesh, local, color});
    }
  }

  bake(theme) {
    this.baked = theme;
    this.solids = [-1, ...this.described.bodies.keys()].map((body) => [
      body, this.load(this.items.filter((item) => item.body === body), theme)]);
    if (this.arrowTheme === theme) return;
    this.arrowTheme = theme;
    // Of arrows; as long as the unit, to be stretched.
    for (const name of ['cylinder', 'cone', 'spring']) {
      for (const [key, color] of Object.entries({force: theme.force,
                                                 load: this.described.colors.load,
                                                 loose: '#bf4dbf', rod: ROD})) {
        this.arrowMeshes[name + key] = this.load(
          [{mesh: this.meshes[name], local: IDENTITY, color: rgb(color)}], theme);
      }
    }
  }

  // The same parts with other numbers.
  reshape(described) {
    const gl = this.gl;
    for (const [, {array, buffers}] of this.solids ?? []) {
      gl.deleteVertexArray(array);
      for (const buffer of buffers) gl.deleteBuffer(buffer);
    }
    [this.described, this.size, this.items, this.baked] = [described, described.size, [], null];
    this.compose();
    if (this.row) this.show(this.row);
    // Paths begin where the next frame has the points.
    this.forget();
  }

  bar(body, start, end, radius, color, flat) {
    this.put(body, this.meshes.cylinder, between(start, end, flat ? radius : radius,
                                                 flat ? flat / 2 : radius), rgb(color));
    for (const place of [start, end]) {
      if (flat) this.disk(body, place, radius, flat, rgb(color));
      else this.ball(body, place, radius, rgb(color), this.meshes.knob);
    }
  }

  ball(body, place, radius, color, mesh = this.meshes.ball) {
    this.put(body, mesh,
             frame([radius, 0, 0], [0, radius, 0], [0, 0, radius], place), color);
  }

  disk(body, place, radius, thickness, color) {
    this.put(body, this.meshes.cylinder, frame(
      [radius, 0, 0], [0, radius, 0], [0, 0, thickness],
      [place[0], place[1], place[2] - thickness / 2]), color);
  }

  shape(body, shape, color) {
    if (shape.kind === 'plate') {
      const mesh = plateMesh(shape.corners, 0.7 * shape.thickness);
      this.put(body, mesh, IDENTITY, rgb(color).map((c) => 0.45 + 0.55 * c));
    } else if (shape.kind === 'bar') {
      this.bar(body, shape.from, shape.to, shape.radius, color, shape.flat);
    } else if (shape.kind === 'box') {
      const [x, y, z] = shape.size;
      const axes = shape.axes ?? [[1, 0, 0], [0, 1, 0], [0, 0, 1]];
      this.put(body, this.meshes.box, frame(times(x, axes[0]), times(y, axes[1]),
                                            times(z, axes[2]), shape.center), rgb(color));
    } else if (shape.kind === 'ball') {
      this.ball(body, shape.center, shape.radius, rgb(color));
    } else if (shape.kind === 'cylinder') {
      this.put(body, this.meshes.cylinder, between(shape.from, shape.to, shape.radius), rgb(color));
    } else if (shape.kind === 'mesh') {
      const mesh = faceMesh(shape.triangles.map((face) => face.map((k) => shape.points[k])));
      this.put(body, mesh, IDENTITY, rgb(color));
    } else if (shape.kind === 'faces') {
      this.put(body, faceMesh(shape.triangles), IDENTITY,
               rgb(color).map((c) => 0.45 + 0.55 * c));
    }
  }

  compose() {
    const {bodies, joints, cuts, planar, rails, colors} = this.described, size = this.size;
    bodies.forEach((body, number) => {
      // Neighbours of one colour differ a little.
      const shade = [0, 0.16, -0.12][number % 3];
      const color = '#' + rgb(body.color).map((c) => Math.round(255 * (
        shade > 0 ? c + shade * (1 - c) : c * (1 + shade))).toString(16).padStart(2, '0')).join('');
      for (const shape of body.shapes) this.shape(number, shape, shape.color ?? color);
    });
    for (const shape of this.described.ground) this.shape(-1, shape, shape.color ?? '#9aa0a8');
    const pin = 0.026 * size, white = [0.95, 0.95, 0.95];
    for (const joint of joints) {
      const color = joint.actuated ? INK : white;
      if (joint.type === 'prismatic') {
        if (!planar) this.sleeve(joint.parent, joint.place, joint.axis, pin, color);
        continue;
      }
      this.pin(joint.parent, joint.place, joint, pin * (joint.actuated ? 1.15 : 0.9), color);
    }
    for (const cut of cuts) {
      const body = cut.body_a >= 0 ? cut.body_a : cut.body_b;
      const place = cut.body_a >= 0 ? cut.point_a : cut.point_b;
      this.pin(body, place, cut, 1.05 * pin, rgb(colors.cut));
      this.pin(body, place, {...cut, more: 0.004 * size}, 0.6 * pin, white);
    }
    const ground = [...joints.filter((joint) => joint.parent < 0 && joint.type !== 'prismatic')
      .map((joint) => joint.place),
                    ...cuts.filter((cut) => cut.type !== 'prismatic')
                      .flatMap((cut) => [[cut.body_a, cut.point_a], [cut.body_b, cut.point_b]])
                      .filter(([body]) => body < 0).map(([, place]) => place)];
    if (!this.described.ground.length) {
      for (const place of ground) this.foot(place);
      for (const rail of rails) this.rail(rail);
    }
    for (const surface of this.described.surfaces) this.surface(surface);
    for (const {body, places} of this.described.wires) {
      places.slice(1).forEach((place, k) => this.put(body, this.meshes.cylinder, between(
        places[k], place, 0.004 * size), rgb(colors.load)));
    }
  }

  // The line or plane of a contact; its free side is where the normal points.
  surface({place, normal}) {
    const size = this.size, z = unit(normal), gray = [0.62, 0.64, 0.66];
    const aside = this.described.planar ? [z[1], -z[0], 0]
      : unit(cross(Math.abs(z[2]) < 0.9 ? [0, 0, 1] : [0, 1, 0], z));
    const wide = (this.described.planar ? 6 : 3) * size, thick = 0.02 * size;
    this.put(-1, this.meshes.box, frame(
      times(wide, aside), times(this.described.planar ? 0.06 * size : wide, cross(z, aside)),
      times(thick, z), minus(place, times(thick / 2, z))), gray);
  }

  pin(body, place, {heights, type, axis, axis_a: axisA, more = 0}, radius, color) {
    if (!this.described.planar) {
      if (axis && type === 'revolute') {
        const z = unit(axis), half = 1.9 * radius;
        this.put(body, this.meshes.cylinder, between(
          add(place, times(-half, z)), add(place, times(half, z)), radius), color);
      } else this.ball(body, place, 1.25 * radius + more, color);
      return;
    }
    const low = heights[0] - 0.012 * this.size, high = heights[1] + 0.016 * this.size + more;
    this.put(body, this.meshes.cylinder, frame(
      [radius, 0, 0], [0, radius, 0], [0, 0, high - low], [place[0], place[1], low]), color);
  }

  sleeve(body, place, axis, radius, color) {
    const z = unit(axis);
    this.put(body, this.meshes.cylinder, between(
      add(place, times(-2.2 * radius, z)), add(place, times(2.2 * radius, z)), 1.25 * radius),
             color);
  }

  foot(place) {
    const size = this.size, gray = [0.55, 0.57, 0.6], half = 0.05 * size;
    if (this.described.planar) {
      const [x, y] = place, down = -0.07 * size;
      this.put(-1, plateMesh([[x, y, 0], [x - half, y + down, 0], [x + half, y + down, 0]],
                             0.012 * size), IDENTITY, gray);
      this.put(-1, this.meshes.box, frame([3 * half, 0, 0], [0, 0.014 * size, 0],
                                          [0, 0, 0.03 * size], [x, y + down, 0]), gray);
    } else {
      this.put(-1, this.meshes.cone, frame([half, 0, 0], [0, half, 0], [0, 0, 1.4 * half],
                                           add(place, [0, 0, -1.4 * half])), gray);
    }
  }

  rail({place, axis}) {
    const size = this.size, z = unit(axis), gray = [0.55, 0.57, 0.6];
    if (this.described.planar) {
      const below = 0.045 * size, aside = [z[1], -z[0], 0];
      const middle = add(place, times(below, aside));
      this.put(-1, this.meshes.box, frame(times(2.4 * size, z), times(0.014 * size, aside),
                                          [0, 0, 0.06 * size], middle), gray);
    } else {
      this.put(-1, this.meshes.cylinder, between(
        add(place, times(-size, z)), add(place, times(size, z)), 0.012 * size), gray);
    }
  }

  // Where things are.

  // ``reached``: of a recording, the number of the last row that is not after it.
  show(row, reached) {
    this.row = row;
    this.reached = reached;
    const first = this.described.columns.poses;
    this.frames = this.described.bodies.map((_, k) => ofPose(row, first + 7 * k));
    const places = [...this.described.bodies.flatMap((body, k) => (
      body.grabs.map((place) => moved(this.frames[k], place)))),
                    ...this.described.lines.flatMap((line) => line.ends.map(
                      ([body, place]) => moved(this.frameOf(body), place)))];
    const low = [0, 1, 2].map((k) => Math.min(...places.map((place) => place[k])));
    const high = [0, 1, 2].map((k) => Math.max(...places.map((place) => place[k])));
    this.extent ??= {low: [...low], high: [...high]};
    const {extent} = this;
    for (let k = 0; k < 3; k++) {
      // What runs away is followed: where nothing has been for long is left.
      const lag = high[k] - low[k] + 2 * this.size;
      extent.low[k] = Math.max(Math.min(extent.low[k], low[k]), high[k] - lag);
      extent.high[k] = Math.min(Math.max(extent.high[k], high[k]), low[k] + lag);
    }
    if (this.followed >= 0) {
      const place = this.grabbed([this.followed, 0]);
      if (this.followedAt) this.target = add(this.target, minus(place, this.followedAt));
      this.followedAt = place;
    } else if (!this.touched) this.fit();
    this.follow();
  }

  // Keep a body where it is on the screen, by its number; -1: none.
  followBody(number) {
    this.followed = number;
    this.followedAt = null;
    this.touched = true;
  }

  frameOf(body) { return body < 0 ? IDENTITY : this.frames[body]; }

  follow() {
    this.described.points.forEach((point, k) => {
      const trail = this.trails[k];
      trail.now = moved(this.frameOf(point.body), point.place);
      if (this.history) {
        trail.shown = this.reached + 1;
        return;
      }
      this.lengthen(trail, trail.now);
    });
  }

  // Places of the points at an instant between two frames.
  trace(places) {
    this.trails.forEach((trail, k) => this.lengthen(trail, places.subarray(3 * k, 3 * k + 3)));
  }

  lengthen(trail, place) {
    trail.shown = trail.count;
    if (!trail.count || norm(minus(place, trail.last())) > SPACING * this.size) {
      trail.push(place);
      trail.shown = trail.count;
    }
  }

  // The paths of a recording are those of all its rows, whichever of them are shown.
  record(history) {
    this.history = history;
    const {rows, width, count} = history, {poses} = this.described.columns;
    this.trails = this.described.points.map((point) => {
      const trail = new Trail(this.gl, count);
      for (let row = 0; row < count; row++) {
        trail.push(moved(point.body < 0 ? IDENTITY
          : ofPose(rows, row * width + poses + 7 * point.body), point.place));
      }
      return trail;
    });
  }

  forget() {
    if (!this.history) for (const trail of this.trails) trail.forget();
    this.forcePeak = 0;
  }

  // The camera: turns about a target; in the plane it looks at the front, y up, else z is up.

  view(which) {
    const {planar} = this.described;
    if (which === 'fit') this.followedAt = null;
    else if (which === 'front' || (which === 'first' && planar)) [this.yaw, this.pitch] = [0, 0];
    else if (which === 'side') [this.yaw, this.pitch] = [Math.PI / 2, 0];
    else if (which === 'top') [this.yaw, this.pitch] = [0, 1.5];
    else [this.yaw, this.pitch] = planar ? [-0.5, 0.35] : [-0.6, 0.35];
    this.touched = false;
    if (this.extent) this.fit();
  }

  fit() {
    const {low, high} = this.extent, planar = this.described.planar;
    // Feet and arrows want room.
    const margin = 0.16 * this.size;
    this.target = times(0.5, add(low, high));
    const aspect = this.canvas.clientWidth / Math.max(this.canvas.clientHeight, 1) || 1;
    const spread = minus(high, low);
    const wide = (planar ? spread[0] : Math.hypot(spread[0], spread[1])) + 2 * margin;
    const tall = (planar ? spread[1] : spread[2] + 0.3 * wide) + 2 * margin;
    const half = Math.max(tall / 2, wide / 2 / aspect);
    this.distance = half / Math.tan(FIELD_OF_VIEW / 2) * 1.08 + 0.5 * spread[2];
  }

  camera() {
    const planar = this.described.planar;
    const up = planar ? [0, 1, 0] : [0, 0, 1], right0 = [1, 0, 0];
    const out0 = planar ? [0, 0, 1] : [0, -1, 0];
    const [c, s] = [Math.cos(this.yaw), Math.sin(this.yaw)];
    const level = add(times(c, out0), times(s, right0));
    const right = add(times(c, right0), times(-s, out0));
    const out = add(times(Math.cos(this.pitch), level), times(Math.sin(this.pitch), up));
    const eye = add(this.target, times(this.distance, out)), top = cross(out, right);
    const seen = new Float32Array([
      right[0], top[0], out[0], 0, right[1], top[1], out[1], 0, right[2], top[2], out[2], 0,
      -dot(right, eye), -dot(top, eye), -dot(out, eye), 1]);
    const aspect = this.canvas.width / Math.max(this.canvas.height, 1);
    const matrix = product(perspective(FIELD_OF_VIEW, aspect, 0.02 * this.distance,
                                       20 * this.distance), seen);
    return {matrix, eye, right, top, out};
  }

  // Where a place is on the screen, in CSS pixels.
  project(place, matrix = this.seen.matrix) {
    const x = moved(matrix, place);
    const w = matrix[3] * place[0] + matrix[7] * place[1] + matrix[11] * place[2] + matrix[15];
    return [(x[0] / w + 1) / 2 * this.canvas.clientWidth,
            (1 - x[1] / w) / 2 * this.canvas.clientHeight, w];
  }

  // The place under the pointer in the plane through another place that faces the camera.
  unproject(x, y, through) {
    const {eye, right, top, out} = this.seen;
    const height = Math.tan(FIELD_OF_VIEW / 2);
    const width = height * this.canvas.clientWidth / Math.max(this.canvas.clientHeight, 1);
    const u = (2 * x / this.canvas.clientWidth - 1) * width;
    const v = (1 - 2 * y / this.canvas.clientHeight) * height;
    const ray = add(add(times(u, right), times(v, top)), times(-1, out));
    const normal = this.described.planar ? [0, 0, 1] : out;
    const along = dot(ray, normal);
    if (Math.abs(along) < 1e-6) return through;
    return add(eye, times(dot(minus(through, eye), normal) / along, ray));
  }

  // The body and the place of it next to the pointer, by their numbers; null if none is near.
  nearest(x, y, reach, withGround = false) {
    let best = null, least = reach;
    if (withGround) {
      this.groundPlaces().forEach((place, which) => {
        const [u, v] = this.project(place), away = Math.hypot(u - x, v - y);
        if (away < least) [best, least] = [[-1, which], away];
      });
    }
    this.described.bodies.forEach((body, number) => {
      if (!this.frames[number]) return;
      body.grabs.forEach((place, which) => {
        const [u, v] = this.project(moved(this.frames[number], place));
        const away = Math.hypot(u - x, v - y);
        if (away < least) [best, least] = [[number, which], away];
      });
    });
    return best;
  }

  // Joints of the ground: the places on it that can be measured from.
  groundPlaces() {
    const {joints, cuts, points} = this.described;
    return [...joints.filter((joint) => joint.parent < 0).map((joint) => joint.place),
            ...cuts.filter((cut) => cut.body_a < 0).map((cut) => cut.point_a),
            ...cuts.filter((cut) => cut.body_b < 0).map((cut) => cut.point_b),
            ...points.filter((point) => point.body < 0).map((point) => point.place)];
  }

  // Measure one place more; after three it begins again. Return whether there was one.
  pick(found) {
    if (found) this.measured = [...this.measured.length > 2 ? [] : this.measured, found];
    return Boolean(found);
  }

  grabbed([body, place]) {
    return body < 0 ? this.groundPlaces()[place] : moved(this.frames[body], this.described.bodies[body].grabs[place]);
  }

  // Arrows: foot, vector to the head [m], colour.

  arrows() {
    const {cuts, columns, loads} = this.described, row = this.row, found = [];
    const vector = (first) => [row[first], row[first + 1], row[first + 2]];
    cuts.forEach((cut, k) => {
      const foot = cut.body_a >= 0 ? moved(this.frames[cut.body_a], cut.point_a) : cut.point_a;
      found.push({foot, force: vector(columns.forces + 3 * k), kind: 'force'});
    });
    loads.forEach((load, k) => {
      const first = columns.loads + 6 * k;
      found.push({foot: vector(first), force: vector(first + 3), kind: 'load'});
    });
    const known = found.filter(({foot, force}) => (
      Number.isFinite(norm(force)) && Number.isFinite(norm(foot))));
    const largest = Math.max(0, ...known.map(({force}) => norm(force)));
    // The scale forgets a peak slowly.
    const now = performance.now();
    this.forcePeak = Math.max(largest, this.forcePeak * 0.5 ** ((now - this.peakAt) / HALF_LIFE));
    this.peakAt = now;
    // In steps, so that arrows do not breathe.
    const peak = Math.max(this.forcePeak, SMALL_FORCE * this.described.weight);
    if (!(this.forceScale >= peak && this.forceScale < 4 * peak)) {
      this.forceScale = peak > 0 ? 2 * roundDown(peak) : 0;
      if (this.forceScale < peak) this.forceScale *= 1.5;
    }
    const scale = this.forceScale > 0 ? ARROW * this.size / this.forceScale : 0;
    return known.map((one) => ({...one, along: times(scale, one.force)}));
  }

  // Drawing.

  draw(theme) {
    const canvas = this.canvas, ratio = Math.min(window.devicePixelRatio || 1, 2);
    for (const each of [canvas, this.lines]) {
      const width = Math.round(canvas.clientWidth * ratio);
      const height = Math.round(canvas.clientHeight * ratio);
      if (each.width !== width || each.height !== height) [each.width, each.height] = [width, height];
    }
    const gl = this.gl;
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clearColor(...theme.paper, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    if (!this.row || !canvas.width) return;
    gl.enable(gl.DEPTH_TEST);
    gl.useProgram(this.solid.program);
    this.seen = this.camera();
    const {matrix, right, top, out} = this.seen, u = this.solid.uniforms;
    gl.uniformMatrix4fv(u.view, false, matrix);
    gl.uniform3fv(u.toEye, out);
    gl.uniform3fv(u.light, unit(add(add(times(-0.45, right), times(0.6, top)), times(0.75, out))));
    gl.uniform1f(u.ambient, theme.ambient);
    if (this.baked !== theme) this.bake(theme);
    this.grid(theme);
    for (const [body, mesh] of this.solids) this.mesh(mesh, this.frameOf(body));
    this.drawLines();
    if (this.shown.forces) this.drawArrows();
    this.drawDirection();
    this.drawPaths(theme, ratio);
    this.overlay(theme);
  }

  mesh(mesh, model, kind = this.gl.TRIANGLES) {
    const gl = this.gl;
    gl.uniformMatrix4fv(this.solid.uniforms.model, false, model);
    gl.bindVertexArray(mesh.array);
    // Of what is closed the inside is never seen.
    gl.enable(gl.CULL_FACE);
    if (mesh.closed) gl.drawElements(kind, mesh.closed, gl.UNSIGNED_INT, 0);
    gl.disable(gl.CULL_FACE);
    const open = mesh.count - mesh.closed;
    if (open) gl.drawElements(kind, open, gl.UNSIGNED_INT, 4 * mesh.closed);
  }

  // Lines behind everything, which fade with the distance; made anew where the camera has moved far.
  grid(theme) {
    const gl = this.gl, step = this.gridStep = roundDown(0.3 * this.size);
    const [x, y] = [0, 1].map((k) => Math.round(this.target[k] / step) * step);
    const z = this.described.planar ? -0.06 * this.size
      : Math.min(this.extent.low[2], 0) - 0.07 * this.size;
    const zoom = 1.25 ** Math.round(Math.log(this.distance) / Math.log(1.25));
    const key = [x, y, z.toFixed(3), zoom, theme.grid].join();
    if (key !== this.gridKey) {
      this.gridKey = key;
      this.gridMesh = this.gridLines([x, y, z], step, Math.min(16 * step, 1.3 * zoom), theme);
    }
    this.mesh(this.gridMesh, IDENTITY, gl.LINES);
  }

  gridLines([x, y, z], step, reach, theme) {
    const places = [], paints = [], count = 16, pieces = 16, color = rgb(theme.grid);
    const put = (place) => {
      const strength = Math.max(0, 1 - Math.hypot(place[0] - x, place[1] - y) / reach);
      places.push(...place);
      paints.push(...color.map((c, k) => strength * c + (1 - strength) * theme.paper[k]));
    };
    for (let k = -count; k <= count; k++) {
      for (let n = 0; n < pieces; n++) {
        const [from, to] = [n, n + 1].map((m) => (2 * m / pieces - 1) * count * step);
        if (Math.hypot(k * step, Math.min(Math.abs(from), Math.abs(to))) > reach) continue;
        put([x + k * step, y + from, z]);
        put([x + k * step, y + to, z]);
        put([x + from, y + k * step, z]);
        put([x + to, y + k * step, z]);
      }
    }
    return this.stored(places, new Array(places.length).fill(0), paints,
                       [], [...Array(places.length / 3).keys()]);
  }

  arrow(foot, along, kind, width) {
    const length = norm(along);
    if (!(length > 0.012 * this.size)) return;
    const head = Math.min(0.055 * this.size, 0.6 * length), z = unit(along);
    const neck = add(foot, times(length - head, z));
    this.mesh(this.arrowMeshes['cylinder' + kind], between(foot, neck, width));
    this.mesh(this.arrowMeshes['cone' + kind], between(neck, add(foot, along), 2.6 * width));
  }

  // Springs, cables and massless rods between places that move.
  drawLines() {
    const {size} = this;
    for (const line of this.described.lines) {
      const effect = this.effects[line.name];
      if (effect && !effect.enabled) continue;
      const places = line.ends.map(([body, place]) => moved(this.frameOf(body), place));
      if (line.anchor && effect?.values[line.anchor]) {
        const last = places.length - 1;
        places[last] = [...effect.values[line.anchor], places[last][2]].slice(0, 3);
      }
      const cable = line.kind === 'cable';
      const way = cable && line.radii.some(Boolean) ? cableWay(places, line.radii) : places;
      const mesh = this.arrowMeshes[line.kind === 'spring' ? 'springload'
        : cable ? 'cylinderload' : 'cylinderrod'];
      const width = {spring: 0.026, cable: 0.006, rod: 0.013}[line.kind] * size;
      for (let k = 0; k + 1 < way.length; k++) {
        if (norm(minus(way[k + 1], way[k])) > 0) this.mesh(mesh, between(way[k], way[k + 1], width));
      }
    }
  }

  drawArrows() {
    // Seen before everything else.
    this.gl.clear(this.gl.DEPTH_BUFFER_BIT);
    for (const {foot, along, kind} of this.arrows()) {
      this.arrow(foot, along, kind, 0.0085 * this.size);
    }
  }

  drawDirection() {
    const {columns} = this.described, row = this.row, first = columns.direction;
    if (first === columns.plots || !Number.isFinite(row[first])) return;
    const {joints, cuts, points} = this.described;
    const places = [...joints.map((joint) => [joint.child, [0, 0, 0]]),
                    ...cuts.map((cut) => [cut.body_a, cut.point_a]),
                    ...points.map((point) => [point.body, point.place])];
    for (const [body, place] of places) {
      if (body < 0) continue;
      const foot = moved(this.frames[body], place);
      this.arrow(foot, minus(moved(ofPose(row, first + 7 * body), place), foot),
                 'loose', 0.006 * this.size);
    }
  }

  // Above everything, with a dot where each is now.
  drawPaths(theme, ratio) {
    const gl = this.gl, {program, uniforms} = this.path;
    gl.useProgram(program);
    gl.disable(gl.DEPTH_TEST);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
    gl.uniformMatrix4fv(uniforms.view, false, this.seen.matrix);
    gl.uniform2f(uniforms.window, this.canvas.width, this.canvas.height);
    gl.uniform3fv(uniforms.paint, rgb(theme.path));
    gl.bindVertexArray(this.pathArray ??= gl.createVertexArray());
    // Pieces, each from a place to the next; a dot, from a place to itself.
    const pieces = (first, step, count, radius) => {
      [first, first + step].forEach((offset, number) => {
        gl.enableVertexAttribArray(number);
        gl.vertexAttribPointer(number, 3, gl.FLOAT, false, 12, offset);
        gl.vertexAttribDivisor(number, 1);
      });
      gl.uniform1f(uniforms.radius, ratio * radius);
      gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, count);
    };
    this.trails.forEach((trail, k) => {
      if (!trail.shown || !this.shown[k ? 'paths' : 'path']) return;
      trail.bind();
      if (trail.shown > 1) pieces(0, 12, trail.shown - 1, PATH);
      gl.bindBuffer(gl.ARRAY_BUFFER, this.pathBuffer);
      gl.bufferData(gl.ARRAY_BUFFER, new Float32Array([...trail.last(), ...trail.now]),
                    gl.STREAM_DRAW);
      pieces(0, 12, 1, PATH);
      pieces(12, 0, 1, DOT);
    });
    gl.disable(gl.BLEND);
  }

  overlay(theme) {
    this.scale();
    const touched = this.held ?? this.hover;
    this.lines.hidden = !touched && !this.shown.names && !this.measured?.length && !this.above?.on;
    if (this.lines.hidden) return;
    const pen = this.pen, ratio = this.lines.width / this.canvas.clientWidth;
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, this.canvas.clientWidth, this.canvas.clientHeight);
    pen.lineJoin = pen.lineCap = 'round';
    if (this.held && this.handAt) {
      const [a, b] = [this.grabbed(this.held), this.handAt].map((place) => this.project(place));
      pen.strokeStyle = theme.accent;
      pen.lineWidth = 2;
      pen.setLineDash([5, 4]);
      pen.beginPath();
      pen.moveTo(a[0], a[1]);
      pen.lineTo(b[0], b[1]);
      pen.stroke();
      pen.setLineDash([]);
      this.ring(b, 6, theme.accent);
    }
    if (touched) this.ring(this.project(this.grabbed(touched)), 9, theme.accent);
    if (this.measured) this.drawMeasured(theme);
    if (this.shown.names) this.drawNames(theme);
    this.above?.draw(theme);
  }

  // Distances between neighbours of the measured places, and the angle at the middle one.
  drawMeasured(theme) {
    const pen = this.pen, places = this.measured.map((one) => this.grabbed(one));
    const flat = places.map((place) => this.project(place));
    pen.strokeStyle = theme.accent;
    pen.lineWidth = 2;
    pen.beginPath();
    flat.forEach(([x, y], k) => { pen[k ? 'lineTo' : 'moveTo'](x, y); });
    pen.stroke();
    for (const place of flat) this.ring(place, 6, theme.accent);
    this.measurements().forEach(({text, at, unit}) => {
      const [x, middle] = this.project(at), y = middle + (unit === 'm' ? 0 : 30);
      pen.font = '600 13px system-ui, sans-serif';
      pen.lineWidth = 4;
      pen.strokeStyle = theme.halo;
      pen.strokeText(text, x + 12, y - 10);
      pen.fillStyle = theme.accent;
      pen.fillText(text, x + 12, y - 10);
    });
  }

  // Numbers with their units, and where they are written.
  measurements() {
    const places = this.measured.map((one) => this.grabbed(one));
    const found = places.slice(1).map((place, k) => ({
      value: norm(minus(place, places[k])), unit: 'm', at: times(0.5, add(place, places[k]))}));
    if (places.length === 3) {
      const [a, b] = [minus(places[0], places[1]), minus(places[2], places[1])];
      const value = Math.atan2(norm(cross(a, b)), dot(a, b)) * 180 / Math.PI;
      found.push({value, unit: '°', at: places[1]});
    }
    return found.map((one) => ({...one, text: `${short(one.value, 5)} ${one.unit}`}));
  }

  ring([x, y], radius, color) {
    const pen = this.pen;
    pen.strokeStyle = color;
    pen.lineWidth = 2.2;
    pen.beginPath();
    pen.arc(x, y, radius, 0, 7);
    pen.stroke();
  }

  drawNames(theme) {
    const pen = this.pen, taken = [];
    pen.font = '600 12px system-ui, sans-serif';
    pen.lineWidth = 3.5;
    const write = (text, place, color) => {
      let [x, y] = this.project(place);
      x += 10;
      y -= 8;
      const width = pen.measureText(text).width;
      // One below the other where they would overlap.
      while (taken.some((box) => Math.abs(box[1] - y) < 14 && x < box[0] + box[2] && box[0] < x + width)) {
        y += 14;
      }
      taken.push([x, y, width]);
      pen.strokeStyle = theme.halo;
      pen.strokeText(text, x, y);
      pen.fillStyle = color;
      pen.fillText(text, x, y);
    };
    for (const joint of this.described.joints) {
      write(joint.name, moved(this.frameOf(joint.parent), joint.place), theme.ink);
    }
    for (const cut of this.described.cuts) {
      write(cut.name, moved(this.frameOf(cut.body_a), cut.point_a), theme.cut);
    }
  }

  // How long an arrow is for a round force, and the grid's step.
  scale() {
    const [a, b] = [this.target, add(this.target, times(ARROW * this.size, this.seen.right))]
      .map((place) => this.project(place)[0]);
    let force = roundDown(0.75 * this.forceScale);
    const length = () => (b - a) * force / this.forceScale;
    while (length() > 150) force = roundDown(0.6 * force);
    const told = this.shown.forces && this.forceScale > 0
      ? `${short(force)} N` : '', wide = `${Math.round(length())}px`;
    const grid = `grid ${short(this.gridStep)} m`, key = [told, wide, grid].join();
    if (key === this.scaled) return;
    this.scaled = key;
    byId('unit').hidden = !told;
    byId('unit').firstElementChild.style.width = wide;
    byId('unit').lastElementChild.textContent = told;
    byId('grid').textContent = grid;
  }
}
