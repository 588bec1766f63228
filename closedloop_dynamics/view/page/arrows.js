// Forces as arrows, and the motion that loops or drives hardly prevent.

// An arrow of the largest force seen lately, as a share of the size; a share of the machine's weight,
// or of what its drives can exert, below which forces have no long arrows.
const ARROW = 0.18, SMALL_FORCE = 0.02;
// A peak of the forces counts half after so long [ms].
const HALF_LIFE = 1500;
// Shortest arrow, head and half width, as shares of the size.
const SHORTEST = 0.012, HEAD = 0.055, WIDTH = 0.0085;

class Arrows {
  constructor(scene) {
    this.scene = scene;
    this.forcePeak = this.peakAt = this.forceScale = 0;
  }

  // A force that is large for this machine: its weight, or what its drives can exert [N].
  usual() {
    const {weight, drives = [], size} = this.scene.described;
    return Math.max(weight, ...drives.map(({torque, slides}) => (slides ? torque : torque / size)));
  }

  // Foot, vector to the head [m], and kind of each.
  found() {
    const {described, row} = this.scene, {cuts, columns, loads} = described, some = [];
    const vector = (first) => [row[first], row[first + 1], row[first + 2]];
    cuts.forEach((cut, k) => {
      some.push({foot: moved(this.scene.frameOf(cut.body_a), cut.point_a),
                 force: vector(columns.forces + 3 * k), kind: 'force'});
    });
    loads.forEach((load, k) => {
      const first = columns.loads + 6 * k;
      some.push({foot: vector(first), force: vector(first + 3), kind: 'load'});
    });
    const known = some.filter(({foot, force}) => (
      Number.isFinite(norm(force)) && Number.isFinite(norm(foot))));
    const largest = Math.max(0, ...known.map(({force}) => norm(force)));
    // The scale forgets a peak slowly.
    const now = performance.now();
    this.forcePeak = Math.max(largest, this.forcePeak * 0.5 ** ((now - this.peakAt) / HALF_LIFE));
    this.peakAt = now;
    // In steps, so that arrows do not breathe.
    const peak = Math.max(this.forcePeak, SMALL_FORCE * this.usual());
    if (!(this.forceScale >= peak && this.forceScale < 4 * peak)) {
      this.forceScale = peak > 0 ? 2 * roundDown(peak) : 0;
      if (this.forceScale < peak) this.forceScale *= 1.5;
    }
    const scale = this.forceScale > 0 ? ARROW * this.scene.size / this.forceScale : 0;
    return known.map((one) => ({...one, along: times(scale, one.force)}));
  }

  arrow(foot, along, kind, width) {
    const {scene} = this, length = norm(along);
    if (!(length > SHORTEST * scene.size)) return;
    const head = Math.min(HEAD * scene.size, 0.6 * length), z = unit(along);
    const neck = add(foot, times(length - head, z));
    scene.stretched('cylinder', kind, between(foot, neck, width));
    scene.stretched('cone', kind, between(neck, add(foot, along), 2.6 * width));
  }

  draw() {
    const {scene} = this;
    // Seen before everything else.
    scene.gl.clear(scene.gl.DEPTH_BUFFER_BIT);
    for (const {foot, along, kind} of this.found()) this.arrow(foot, along, kind, WIDTH * scene.size);
  }

  drawDirection() {
    const {scene} = this, {described, row} = scene, {columns, joints, cuts, points} = described;
    const first = columns.direction;
    if (first === columns.plots || !Number.isFinite(row[first])) return;
    const places = [...joints.map((joint) => [joint.child, [0, 0, 0]]),
                    ...cuts.map((cut) => [cut.body_a, cut.point_a]),
                    ...points.map((point) => [point.body, point.place])];
    for (const [body, place] of places) {
      if (body < 0) continue;
      const foot = moved(scene.frames[body], place);
      this.arrow(foot, minus(moved(ofPose(row, first + 7 * body), place), foot),
                 'loose', 0.7 * WIDTH * scene.size);
    }
  }

  // How long an arrow is for a round force, and the grid's step, are written beside the picture.
  tell() {
    const {scene} = this;
    const [a, b] = [scene.target, add(scene.target, times(ARROW * scene.size, scene.seen.right))]
      .map((place) => scene.project(place)[0]);
    let force = roundDown(0.75 * this.forceScale);
    const length = () => (b - a) * force / this.forceScale;
    while (length() > 150) force = roundDown(0.6 * force);
    const scale = scene.shown.forces && this.forceScale > 0
      ? `${short(force)} N` : '', wide = `${Math.round(length())}px`;
    const grid = `grid ${short(scene.gridStep)} m`, key = [scale, wide, grid].join();
    if (key === this.written) return;
    this.written = key;
    byId('unit').hidden = !scale;
    byId('unit').firstElementChild.style.width = wide;
    byId('unit').lastElementChild.textContent = scale;
    byId('grid').textContent = grid;
  }
}
