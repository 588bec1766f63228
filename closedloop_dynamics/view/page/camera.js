// The camera turns about a target; in the plane it looks at the front, y up, else z is up.

const FIELD_OF_VIEW = 0.5;

// What is seen: of a scene, whose canvas, size and places it knows.
class Camera {
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

  // Which share of the picture lies behind the buttons at its upper end.
  covered() {
    const [bar, picture] = [byId('bar'), this.canvas].map((one) => one.getBoundingClientRect());
    return Math.max(0, Math.min(0.3, (bar.bottom - picture.top) / (picture.height || 1)));
  }

  // As near as all of the box about what has been seen allows, with room for arrows.
  fit() {
    const {low, high} = this.extent, {right, top, out} = this.axes();
    const margin = (this.described.planar ? ARROW : 0.16) * this.size, wide = minus(high, low);
    const middle = times(0.5, add(low, high)), covered = this.covered();
    const aspect = this.canvas.clientWidth / Math.max(this.canvas.clientHeight, 1) || 1;
    const slope = Math.tan(FIELD_OF_VIEW / 2);
    this.distance = Math.max(...[0, 1, 2, 3, 4, 5, 6, 7].map((k) => {
      const corner = wide.map((side, axis) => ((k >> axis) & 1 ? 0.5 : -0.5) * side);
      return dot(corner, out) + Math.max(
        (Math.abs(dot(corner, right)) + margin) / (slope * aspect),
        (Math.abs(dot(corner, top)) + margin) / (slope * (1 - covered)));
    }));
    this.target = add(middle, times(covered * slope * this.distance, top));
  }

  // Directions to the right, upwards and to the eye, of length one.
  axes() {
    const {planar} = this.described;
    const up = planar ? [0, 1, 0] : [0, 0, 1], right0 = [1, 0, 0];
    const out0 = planar ? [0, 0, 1] : [0, -1, 0];
    const [c, s] = [Math.cos(this.yaw), Math.sin(this.yaw)];
    const level = add(times(c, out0), times(s, right0));
    const right = add(times(c, right0), times(-s, out0));
    const out = add(times(Math.cos(this.pitch), level), times(Math.sin(this.pitch), up));
    return {right, out, top: cross(out, right)};
  }

  camera() {
    const {right, top, out} = this.axes(), eye = add(this.target, times(this.distance, out));
    const seen = new Float32Array([
      right[0], top[0], out[0], 0, right[1], top[1], out[1], 0, right[2], top[2], out[2], 0,
      -dot(right, eye), -dot(top, eye), -dot(out, eye), 1]);
    const aspect = this.canvas.width / Math.max(this.canvas.height, 1);
    const [near, far] = [0.02 * this.distance, 20 * this.distance];
    const lens = this.flat
      ? parallel(this.distance * Math.tan(FIELD_OF_VIEW / 2), aspect, near, far)
      : perspective(FIELD_OF_VIEW, aspect, near, far);
    return {matrix: product(lens, seen), eye, right, top, out};
  }

  // Whether a machine in the plane is seen from its front: by parallel rays, in which the two ends of
  // a pin are one.
  get flat() { return this.described.planar && this.yaw === 0 && this.pitch === 0; }

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
    const aside = add(times(u, right), times(v, top)), ahead = times(-1, out);
    if (this.flat) {
      return add(add(eye, times(this.distance, aside)), times(dot(minus(through, eye), out), out));
    }
    const ray = add(aside, ahead);
    const normal = this.described.planar ? [0, 0, 1] : out;
    const along = dot(ray, normal);
    if (Math.abs(along) < 1e-6) return through;
    return add(eye, times(dot(minus(through, eye), normal) / along, ray));
  }
}
