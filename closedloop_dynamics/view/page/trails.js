// Paths of points: places in buffers that grow, drawn as wide as they are seen.

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

// Half the width of a path, and the radius of the dot at its end [CSS pixels]; how many places of
// a live one are kept, and forgotten at once; how far they are apart at least, in sizes.
const PATH = 0.9, DOT = 3.2, PATH_LENGTH = 8000, FORGOTTEN = 1000, SPACING = 0.001;

// The places of a point and their times, in a buffer that grows by what is new; of a recording those of
// all rows.
class Trail {
  constructor(gl, capacity = PATH_LENGTH) {
    this.gl = gl;
    this.buffer = gl.createBuffer();
    this.places = new Float32Array(3 * capacity);
    this.times = new Float64Array(capacity);
    // How many there are, are drawn, and are in the buffer; -1: none, and it has no size yet.
    this.count = this.shown = 0;
    this.sent = -1;
    this.now = null;
  }

  push(place, time) {
    if (this.count === this.times.length) {
      this.places.copyWithin(0, 3 * FORGOTTEN);
      this.times.copyWithin(0, FORGOTTEN);
      this.count -= FORGOTTEN;
      this.resend();
    }
    this.places.set(place, 3 * this.count);
    this.times[this.count] = time;
    this.count += 1;
  }

  // A place of a live path, if it is far enough from the one before.
  lengthen(place, time, spacing) {
    const before = this.places.subarray(3 * this.count - 3, 3 * this.count);
    if (!this.count || norm(minus(place, before)) > spacing) this.push(place, time);
  }

  // Draw what was up to a time, and where the point is then.
  showTo(time, now) {
    let low = 0, high = this.count;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.times[middle] <= time) low = middle + 1; else high = middle;
    }
    [this.shown, this.now] = [low, now];
  }

  forget() {
    this.count = this.shown = 0;
    this.resend();
  }

  // From the first place on, into a buffer that has its size or not yet.
  resend() { this.sent = Math.min(this.sent, 0); }

  last() { return this.places.subarray(3 * this.shown - 3, 3 * this.shown); }

  drop() { this.gl.deleteBuffer(this.buffer); }

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

// The paths of all points of a machine.
class Trails {
  constructor(scene) {
    this.scene = scene;
    this.program = scene.build(PATH_VERTEX, PATH_FRAGMENT, ['from', 'to']);
    this.buffer = scene.gl.createBuffer();
    this.all = [];
    this.begin();
  }

  // Paths of the points that there are now.
  begin() {
    for (const trail of this.all) trail.drop();
    this.all = this.scene.described.points.map(() => new Trail(this.scene.gl));
  }

  // Where the points are in the state that is shown, of a time.
  follow(time) {
    const {scene} = this;
    scene.described.points.forEach((point, k) => {
      this.all[k].showTo(time, moved(scene.frameOf(point.body), point.place));
    });
  }

  // Where they are in a row.
  places(row) {
    const {points, columns} = this.scene.described;
    return points.map(({body, place}) => moved(
      body < 0 ? IDENTITY : ofPose(row, columns.poses + 7 * body), place));
  }

  // Lengthen the paths to a state that has come.
  extend(row, time) {
    this.places(row).forEach((place, k) => (
      this.all[k].lengthen(place, time, SPACING * this.scene.size)));
  }

  // The paths of a recording are those of all its rows, whichever of them are shown.
  record(history) {
    this.recorded = true;
    this.all = this.scene.described.points.map(() => new Trail(this.scene.gl, history.count));
    for (let k = 0; k < history.count; k++) {
      this.places(history.row(k)).forEach((place, n) => this.all[n].push(place, history.time(k)));
    }
  }

  forget() {
    if (!this.recorded) for (const trail of this.all) trail.forget();
  }

  // Above everything, with a dot where each is now; and what is edited.
  draw(theme, ratio) {
    const {gl, canvas, seen, shown, above} = this.scene, {program, uniforms} = this.program;
    this.ratio = ratio;
    gl.useProgram(program);
    gl.disable(gl.DEPTH_TEST);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
    gl.uniformMatrix4fv(uniforms.view, false, seen.matrix);
    gl.uniform2f(uniforms.window, canvas.width, canvas.height);
    gl.bindVertexArray(this.array ??= gl.createVertexArray());
    const color = rgb(theme.path);
    this.all.forEach((trail, k) => {
      if (!trail.shown || !shown[k ? 'paths' : 'path']) return;
      gl.uniform3fv(uniforms.paint, color);
      trail.bind();
      if (trail.shown > 1) this.pieces(0, 12, trail.shown - 1, PATH);
      this.line([...trail.last(), ...trail.now], PATH, color);
      this.dots(trail.now, DOT, color);
    });
    if (above?.on) above.paint(theme, this);
    gl.disable(gl.BLEND);
  }

  // Pieces of the buffer that is bound, each from a place to one so many bytes on.
  pieces(first, step, count, radius) {
    const {gl} = this.scene;
    [first, first + step].forEach((offset, number) => {
      gl.enableVertexAttribArray(number);
      gl.vertexAttribPointer(number, 3, gl.FLOAT, false, 12, offset);
      gl.vertexAttribDivisor(number, 1);
    });
    gl.uniform1f(this.program.uniforms.radius, this.ratio * radius);
    gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, count);
  }

  // Bind a buffer with places, one number after the other, and a colour for them.
  give(places, color) {
    const {gl} = this.scene;
    gl.bindBuffer(gl.ARRAY_BUFFER, this.buffer);
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(places), gl.STREAM_DRAW);
    gl.uniform3fv(this.program.uniforms.paint, color);
  }

  // A line through places, half as wide as so many CSS pixels.
  line(places, radius, color) {
    this.give(places, color);
    if (places.length > 3) this.pieces(0, 12, places.length / 3 - 1, radius);
  }

  // Round dots, from places to themselves.
  dots(places, radius, color) {
    this.give(places, color);
    if (places.length) this.pieces(0, 0, places.length / 3, radius);
  }
}
