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
// Whether WebGL has no graphics card here.
function drawnByProcessor() {
  const gl = document.createElement('canvas').getContext('webgl2');
  const about = gl?.getExtension('WEBGL_debug_renderer_info');
  const name = about ? gl.getParameter(about.UNMASKED_RENDERER_WEBGL) : '';
  gl?.getExtension('WEBGL_lose_context')?.loseContext();
  return /swiftshader|llvmpipe|softpipe|software/i.test(name);
}

// Colours of the meshes that are stretched again in each frame.
const STRETCHED = {cylinder: ['force', 'load', 'loose', 'rod'], cone: ['force', 'load', 'loose'],
                   spring: ['load'], pulley: ['wheel'], spokes: ['wheel']};

class Scene extends Camera {
  constructor(solid, lines, described) {
    super();
    this.canvas = solid;
    this.lines = lines;
    this.pen = lines.getContext('2d');
    this.row = null;
    this.frames = [];
    this.hover = this.held = this.handAt = null;
    // Places that are measured, each a body and the number of a place of it; null: none is.
    this.measured = null;
    this.followed = -1;
    // What is drawn above everything else; a machine that is compared.
    this.above = this.ghost = null;
    this.shown = {forces: true, names: false, path: true, paths: false};
    // Where the processor draws, smooth edges would cost half of the frames; pictures may ask.
    const smooth = location.search.includes('smooth') || !drawnByProcessor();
    this.gl = solid.getContext('webgl2', {antialias: smooth, alpha: false});
    if (!this.gl) throw new Error('This browser has no WebGL 2, which the picture needs.');
    this.solid = this.build(VERTEX, FRAGMENT, ['place', 'normal', 'paint']);
    this.meshes = {
      cylinder: cylinderMesh(), cone: cylinderMesh(0), ball: ballMesh(),
      // Ends of bars are small.
      knob: ballMesh(16), box: boxMesh(), spring: springMesh(), pulley: pulleyMesh(),
      spokes: spokesMesh(), made: new Made()};
    // The effects, as they were received: which are off, and where their anchors are.
    this.effects = {};
    [this.described, this.size] = [described, described.size];
    this.parts = new Parts(described, this.meshes);
    this.paths = new Trails(this);
    this.guides = new Guides(this);
    this.ropes = new Ropes(this);
    this.forces = new Arrows(this);
    this.overlay = new Overlay(this);
    this.extent = null;
    this.view('first');
    solid.addEventListener('webglcontextlost', (event) => event.preventDefault());
    solid.addEventListener('webglcontextrestored', () => location.reload());
  }

  // Another description, from the next frame on; the camera stays where it is.
  reshape(described) {
    [this.described, this.size, this.baked] = [described, described.size, null];
    this.parts = new Parts(described, this.meshes);
    this.hover = this.held = null;
    if (this.measured) this.measured = [];
    // Another number of bodies: nothing is drawn before the next frame.
    if (described.bodies.length !== this.frames.length) [this.row, this.followed] = [null, -1];
    this.paths.begin();
    this.guides.begin();
  }

  // Another machine, seen as one is seen at first.
  first() {
    [this.row, this.extent] = [null, null];
    this.followBody(-1);
    this.forces.forceScale = 0;
    this.view('first');
  }

  get trails() { return this.paths.all; }

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
    const count = (of) => parts.reduce((sum, {mesh}) => sum + of(mesh), 0);
    const corners = count(({places}) => places.length / 3);
    const shut = count((mesh) => (mesh.open ? 0 : mesh.corners.length));
    const [places, normals, paints] = [0, 1, 2].map(() => new Float32Array(3 * corners));
    const elements = new Uint32Array(count((mesh) => mesh.corners.length));
    let first = 0, closed = 0, open = shut;
    for (const {mesh, local, color} of parts) {
      const paint = color === INK ? theme.driven : color, n = mesh.places.length;
      place(mesh, local, places, normals, 3 * first);
      for (let k = 0; k < n; k++) paints[3 * first + k] = paint[k % 3];
      // Seen from its normal's side a triangle turns left, in a mirror right.
      const mirrored = dot(cross(local.subarray(0, 3), local.subarray(4, 7)),
                           local.subarray(8, 11)) < 0;
      const around = leftHanded(mesh), size = around.length, at = mesh.open ? open : closed;
      for (let k = 0; k < size; k += 3) {
        elements[at + k] = first + around[k];
        elements[at + k + 1] = first + around[k + (mirrored ? 2 : 1)];
        elements[at + k + 2] = first + around[k + (mirrored ? 1 : 2)];
      }
      if (mesh.open) open += size; else closed += size;
      first += n / 3;
    }
    return this.stored(places, normals, paints, elements, closed);
  }

  stored(places, normals, paints, elements, closed) {
    const gl = this.gl, array = gl.createVertexArray();
    gl.bindVertexArray(array);
    const buffers = [0, 1, 2, 3].map(() => gl.createBuffer());
    [places, normals, paints].forEach((values, number) => {
      gl.bindBuffer(gl.ARRAY_BUFFER, buffers[number]);
      gl.bufferData(gl.ARRAY_BUFFER, values, gl.STATIC_DRAW);
      gl.enableVertexAttribArray(number);
      gl.vertexAttribPointer(number, 3, gl.FLOAT, false, 0, 0);
    });
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, buffers[3]);
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, elements, gl.STATIC_DRAW);
    return {array, buffers, closed, count: elements.length};
  }

  drop(mesh) {
    if (!mesh) return;
    this.gl.deleteVertexArray(mesh.array);
    for (const buffer of mesh.buffers) this.gl.deleteBuffer(buffer);
  }

  // Everything in the colours of a theme.
  bake(theme) {
    const before = this.bakedTheme === theme ? this.solids : new Map();
    [this.baked, this.bakedTheme] = [theme, theme];
    this.solids = new Map([-1, ...this.described.bodies.keys()].map((body) => {
      const parts = this.parts.items.get(body) ?? new Map(), key = [...parts.keys()].join(';');
      const known = before.get(body);
      if (known?.key === key) return [body, known];
      return [body, {key, mesh: this.load([...parts.values()], theme)}];
    }));
    const kept = new Set(this.solids.values());
    for (const one of this.everBaked ?? []) if (!kept.has(one)) this.drop(one.mesh);
    this.everBaked = kept;
    if (this.stretchedTheme === theme) return;
    this.stretchedTheme = theme;
    const colors = {force: theme.force, load: this.described.colors.load, loose: '#bf4dbf',
                    rod: ROD, wheel: '#7d848f'};
    this.stretching = Object.fromEntries(Object.entries(STRETCHED).flatMap(([name, kinds]) => (
      kinds.map((kind) => [name + kind, this.load(
        [{mesh: this.meshes[name], local: IDENTITY, color: rgb(colors[kind])}], theme)]))));
  }

  // Draw one of the meshes that are stretched.
  stretched(name, kind, local) { this.mesh(this.stretching[name + kind], local); }

  // Where things are.

  // A state; of paths what was up to its time.
  show(row, time) {
    this.row = row;
    const first = this.described.columns.poses;
    this.frames = this.described.bodies.map((_, k) => ofPose(row, first + 7 * k));
    this.guides.follow();
    const places = [...this.parts.reach.map(([body, place]) => moved(this.frameOf(body), place)),
                    ...this.guides.reach(), ...this.ropes.reach()];
    this.widen(places.filter((place) => place.every(Number.isFinite)));
    if (this.followed >= 0) {
      const place = this.grabbed([this.followed, 0]);
      if (this.followedAt) this.target = add(this.target, minus(place, this.followedAt));
      this.followedAt = place;
    } else if (!this.touched) this.fit();
    this.paths.follow(time);
  }

  // The box about what is seen and was lately.
  widen(places) {
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
  }

  // Keep a body where it is on the screen, by its number; -1: none.
  followBody(number) {
    this.followed = number;
    this.followedAt = null;
    this.touched = true;
  }

  frameOf(body) { return body < 0 ? IDENTITY : this.frames[body]; }

  // Lengthen the paths to a state that has come.
  extend(row, time) { this.paths.extend(row, time); }

  // The paths of a recording.
  record(history) { this.paths.record(history); }

  forget() {
    this.paths.forget();
    this.guides.begin();
    this.forgetPeaks();
  }

  forgetPeaks() { this.forces.forcePeak = 0; }

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
    this.ghost?.draw(theme, ratio);
    for (const [body, {mesh}] of this.solids) this.mesh(mesh, this.frameOf(body));
    this.guides.draw(theme);
    this.ropes.draw();
    if (this.shown.forces) this.forces.draw();
    this.forces.drawDirection();
    this.paths.draw(theme, ratio);
    this.forces.tell();
    this.overlay.draw(theme);
  }

  mesh(mesh, model, kind = this.gl.TRIANGLES) {
    const gl = this.gl;
    gl.uniformMatrix4fv(this.solid.uniforms.model, false, model);
    gl.bindVertexArray(mesh.array);
    // The inside of a closed mesh is never seen.
    gl.enable(gl.CULL_FACE);
    if (mesh.closed) gl.drawElements(kind, mesh.closed, gl.UNSIGNED_INT, 0);
    gl.disable(gl.CULL_FACE);
    const open = mesh.count - mesh.closed;
    if (open) gl.drawElements(kind, open, gl.UNSIGNED_INT, 4 * mesh.closed);
  }

  // Lines behind everything, which fade with the distance; made again where the camera has moved far.
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
    return this.stored(new Float32Array(places), new Float32Array(places.length),
                       new Float32Array(paints), new Uint32Array(places.length / 3).map((_, k) => k),
                       0);
  }
}
