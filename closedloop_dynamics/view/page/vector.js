// Pictures of lines and areas: what is drawn on a canvas, or by WebGL, as SVG.

const rounded = (value) => String(Math.round(100 * value) / 100);

// A pen as that of a canvas, as far as the page uses one, which writes SVG.
class SvgPen {
  constructor(width, height) {
    [this.width, this.height, this.parts, this.path, this.kept] = [width, height, [], '', []];
    this.measuring = document.createElement('canvas').getContext('2d');
    Object.assign(this, {fillStyle: '#000', strokeStyle: '#000', lineWidth: 1, globalAlpha: 1,
                         font: '12px sans-serif', textAlign: 'left', textBaseline: 'alphabetic',
                         lineJoin: 'round', lineCap: 'butt', dash: [], origin: [0, 0], clips: ''});
  }

  save() {
    const {fillStyle, strokeStyle, lineWidth, globalAlpha, dash, origin, clips} = this;
    this.kept.push({fillStyle, strokeStyle, lineWidth, globalAlpha, dash, origin, clips});
  }

  restore() { Object.assign(this, this.kept.pop()); }

  translate(x, y) { this.origin = [this.origin[0] + x, this.origin[1] + y]; }

  setTransform() {}

  clearRect() {}

  setLineDash(dash) { this.dash = dash; }

  measureText(text) {
    this.measuring.font = this.font;
    return this.measuring.measureText(text);
  }

  at(x, y) { return `${rounded(x + this.origin[0])} ${rounded(y + this.origin[1])}`; }

  beginPath() { this.path = ''; }

  moveTo(x, y) { this.path += `M${this.at(x, y)}`; }

  lineTo(x, y) { this.path += `L${this.at(x, y)}`; }

  rect(x, y, width, height) {
    this.path += `M${this.at(x, y)}h${rounded(width)}v${rounded(height)}h${rounded(-width)}z`;
  }

  // Whole circles are all that is drawn of arcs.
  arc(x, y, radius) {
    const r = rounded(radius), arc = (end) => `A${r} ${r} 0 1 1 ${this.at(x + end * radius, y)}`;
    this.path += `M${this.at(x + radius, y)}${arc(-1)}${arc(1)}z`;
  }

  clip() {
    const id = `clip${this.parts.length}`;
    this.parts.push(`<clipPath id="${id}"><path d="${this.path}"/></clipPath>`);
    this.clips = ` clip-path="url(#${id})"`;
  }

  stroke() {
    if (!this.path) return;
    this.parts.push(`<path d="${this.path}" fill="none" stroke="${this.strokeStyle}" stroke-width="${
      rounded(this.lineWidth)}" stroke-linejoin="round"${this.dash.length ? ` stroke-dasharray="${
      this.dash.join(' ')}"` : ''}${this.more('stroke')}/>`);
  }

  fill() { this.parts.push(`<path d="${this.path}" fill="${this.fillStyle}"${this.more('fill')}/>`); }

  fillRect(x, y, width, height) {
    this.beginPath();
    this.rect(x, y, width, height);
    this.fill();
  }

  more(what) {
    return (this.globalAlpha < 1 ? ` ${what}-opacity="${this.globalAlpha}"` : '') + this.clips;
  }

  fillText(text, x, y) { this.text(text, x, y, `fill="${this.fillStyle}"`); }

  strokeText(text, x, y) {
    this.text(text, x, y, `fill="none" stroke="${this.strokeStyle}" stroke-width="${
      this.lineWidth}" stroke-linejoin="round"`);
  }

  text(text, x, y, more) {
    const [, weight = 'normal', size, family] = this.font.match(/^(\d+ )?([\d.]+)px (.*)$/);
    const shift = {middle: 0.35, top: 0.9}[this.textBaseline] ?? 0;
    const [left, top] = [x + this.origin[0], y + shift * size + this.origin[1]].map(rounded);
    this.parts.push(`<text x="${left}" y="${top}" font-family="${escaped(family)}" font-size="${
      size}" font-weight="${weight.trim()}" text-anchor="${
      {center: 'middle', right: 'end'}[this.textAlign] ?? 'start'}" ${more}>${escaped(text)}</text>`);
  }

  svg() {
    const size = `width="${this.width}" height="${this.height}"`;
    return `<svg xmlns="http://www.w3.org/2000/svg" ${size} viewBox="0 0 ${this.width} ${
      this.height}">${this.parts.join('\n')}</svg>\n`;
  }
}

// The picture of a machine: what WebGL draws, as areas, the farthest first.
class VectorPicture {
  constructor(picture, theme) {
    [this.picture, this.theme, this.faces] = [picture, theme, []];
    // What is drawn later lies above, where depths are forgotten between.
    this.layer = 0;
    this.known = new Map();
  }

  // Write what a picture draws with a pen.
  write(pen) {
    const {picture, theme} = this, {gl, overlay, pen: own} = picture, paths = [];
    const {draw} = Trails.prototype;
    picture.mesh = (mesh, model, kind = gl.TRIANGLES) => this.take(mesh, model, kind);
    gl.clear = () => { this.layer += 1; };
    // Trails of the machine that is compared, too.
    Trails.prototype.draw = function drawn({path}) {
      this.all.forEach((trail, k) => {
        if (trail.shown && picture.shown[k ? 'paths' : 'path']) paths.push({trail, path});
      });
    };
    [picture.pen, overlay.pen] = [pen, pen];
    overlay.draw = () => {
      this.paint(pen);
      for (const {trail, path} of paths) this.trace(pen, trail, path);
      Overlay.prototype.draw.call(overlay, theme);
    };
    try {
      picture.draw(theme);
    } finally {
      delete gl.clear;
      delete picture.mesh;
      delete overlay.draw;
      Trails.prototype.draw = draw;
      [picture.pen, overlay.pen] = [own, own];
    }
  }

  // Triangles or lines of a mesh, read back from where they are drawn of.
  read(mesh) {
    if (this.known.has(mesh)) return this.known.get(mesh);
    const {gl} = this.picture, arrays = mesh.buffers.slice(0, 3).map((buffer) => {
      gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
      const values = new Float32Array(gl.getBufferParameter(gl.ARRAY_BUFFER, gl.BUFFER_SIZE) / 4);
      gl.getBufferSubData(gl.ARRAY_BUFFER, 0, values);
      return values;
    });
    gl.bindVertexArray(mesh.array);
    const corners = new Uint32Array(mesh.count);
    gl.getBufferSubData(gl.ELEMENT_ARRAY_BUFFER, 0, corners);
    gl.bindVertexArray(null);
    this.known.set(mesh, [...arrays, corners]);
    return this.known.get(mesh);
  }

  take(mesh, model, kind) {
    const {gl} = this.picture, [places, normals, paints, corners] = this.read(mesh);
    const each = kind === gl.LINES ? 2 : 3;
    const at = (values, corner) => [values[3 * corner], values[3 * corner + 1], values[3 * corner + 2]];
    const squares = [0, 4, 8].map((k) => model[k] ** 2 + model[k + 1] ** 2 + model[k + 2] ** 2);
    for (let k = 0; k < corners.length; k += each) {
      const seen = [...corners.subarray(k, k + each)].map((corner) => (
        this.picture.project(moved(model, at(places, corner)))));
      if (seen.some(([, , depth]) => !(depth > 0))) continue;
      const [[ax, ay], [bx, by]] = seen, [cx, cy] = seen[each - 1];
      const area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax);
      // The inside of a closed mesh is never seen.
      if (each === 3 && (Math.abs(area) < 0.02 || (k < mesh.closed && area > 0))) continue;
      const paint = at(paints, corners[k]);
      const normal = unit(turned(model, [0, 1, 2].map((axis) => [...corners.subarray(k, k + each)]
        .reduce((sum, corner) => sum + normals[3 * corner + axis], 0) / squares[axis])));
      this.faces.push({
        layer: this.layer, depth: seen.reduce((sum, [, , depth]) => sum + depth, 0) / each, seen,
        color: hex(each === 2 ? paint : this.lit(paint, normal).map((c) => Math.min(1, c)))});
    }
  }

  // As the shader has it, without the glint.
  lit(color, normal) {
    const {right, top, out} = this.picture.seen;
    const light = unit(add(add(times(-0.45, right), times(0.6, top)), times(0.75, out)));
    const n = dot(normal, out) < 0 ? times(-1, normal) : normal, along = dot(n, light);
    const share = this.theme.ambient + 0.22 * (0.5 + 0.5 * n[1]) + 0.62 * Math.max(along, -0.4 * along);
    return color.map((c) => c * share);
  }

  paint(pen) {
    this.faces.sort((a, b) => a.layer - b.layer || b.depth - a.depth);
    // Edges of one colour with their area leave no gaps between neighbours.
    pen.lineWidth = 0.6;
    for (const {seen, color} of this.faces) {
      pen.fillStyle = pen.strokeStyle = color;
      pen.beginPath();
      seen.forEach(([x, y], k) => pen[k ? 'lineTo' : 'moveTo'](x, y));
      if (seen.length > 2) pen.fill();
      pen.stroke();
    }
  }

  trace(pen, trail, color) {
    pen.strokeStyle = pen.fillStyle = color;
    pen.lineWidth = 2 * PATH;
    pen.beginPath();
    for (let k = 0; k < trail.shown; k++) {
      const [x, y] = this.picture.project(trail.places.subarray(3 * k, 3 * k + 3));
      pen[k ? 'lineTo' : 'moveTo'](x, y);
    }
    const [x, y] = this.picture.project(trail.now);
    pen.lineTo(x, y);
    pen.stroke();
    pen.beginPath();
    pen.arc(x, y, DOT);
    pen.fill();
  }
}
