// Guides and slots of what slides: as long as the way that it has been seen to go.

// Of a guide, in sizes of links: half the width of its edges, how far it reaches beyond what slides,
// and by how much it grows; between the lines of a hatch, and their length.
const EDGE = 0.011, BEYOND = 0.11, GROWTH = 0.15, HATCH = 0.055, DASH = 0.05;

class Guides {
  constructor(scene) {
    this.scene = scene;
    this.all = [];
    this.begin();
  }

  // Guides that nothing has slid in yet.
  begin() {
    for (const {mesh} of this.all) this.scene.drop(mesh);
    this.all = this.scene.described.guides.map((guide) => ({
      ...guide, low: Infinity, high: -Infinity, mesh: null}));
  }

  // Where what slides is along its line.
  along(guide) {
    const {scene} = this, frameOf = scene.frameOf(guide.body);
    const away = minus(moved(scene.frameOf(guide.mover), guide.at), moved(frameOf, guide.place));
    return dot(away, unit(turned(frameOf, guide.axis)));
  }

  follow() {
    const {thick, size} = this.scene.described, grow = GROWTH * size;
    for (const guide of this.all) {
      const now = this.along(guide), reach = BEYOND * thick;
      if (!Number.isFinite(now) || (now - reach >= guide.low && now + reach <= guide.high)) continue;
      // What ran away leaves its old guide.
      const far = now - reach > guide.high + 20 * size || now + reach < guide.low - 20 * size;
      guide.low = Math.min(far ? Infinity : guide.low, now - reach - grow);
      guide.high = Math.max(far ? -Infinity : guide.high, now + reach + grow);
      guide.theme = null;
    }
  }

  // The ends of all guides, which the picture has to show.
  reach() {
    return this.all.filter((guide) => guide.high > guide.low).flatMap((guide) => (
      [guide.low, guide.high].map((share) => moved(this.scene.frameOf(guide.body), add(
        guide.place, times(share, unit(guide.axis)))))));
  }

  draw(theme) {
    for (const guide of this.all) {
      if (!(guide.high > guide.low)) continue;
      if (guide.theme !== theme) {
        this.scene.drop(guide.mesh);
        [guide.mesh, guide.theme] = [this.scene.load(this.items(guide), theme), theme];
      }
      this.scene.mesh(guide.mesh, this.scene.frameOf(guide.body));
    }
  }

  items(guide) {
    const {meshes, described} = this.scene, {thick, planar} = described;
    const z = unit(guide.axis), edge = EDGE * thick, body = described.bodies[guide.body];
    const color = guide.body < 0 ? GROUND_COLOR : rgb(body.color).map((c) => 0.75 * c);
    const middle = add(guide.place, times(0.5 * (guide.low + guide.high), z));
    const length = guide.high - guide.low;
    if (!planar) {
      return [{mesh: meshes.cylinder, color, local: between(
        add(guide.place, times(guide.low, z)), add(guide.place, times(guide.high, z)),
        1.1 * edge)}];
    }
    const left = [-z[1], z[0], 0], up = [0, 0, guide.height], deep = [0, 0, 0.02 * thick];
    const found = guide.sides.map((side) => ({
      mesh: meshes.box, color, local: frame(times(length, z), times(edge, left), deep, add(
        add(middle, up), times(side + Math.sign(side) * 0.5 * edge, left)))}));
    if (guide.body < 0 && guide.kind === 'slide') {
      const below = Math.min(...guide.sides) - edge;
      found.push(...hatch(meshes, add(add(middle, up), times(below, left)), z, times(-1, left),
                          length, thick));
    }
    return found;
  }
}

// Short lines on the side of the ground of an edge, whose middle, direction and length are given.
function hatch(meshes, middle, along, down, length, thick) {
  const count = Math.max(1, Math.round(length / (HATCH * thick))), step = length / count;
  const dash = times(DASH * thick, unit(add(times(-0.7, along), down)));
  return Array.from({length: count}, (_, k) => {
    const start = add(middle, times(((k + 0.85) / count - 0.5) * length, along));
    return {mesh: meshes.box, color: GROUND_COLOR, local: frame(
      dash, times(0.12 * Math.min(step, HATCH * thick), unit([-dash[1], dash[0], 0])),
      [0, 0, 0.008 * thick], add(start, times(0.5, dash)))};
  });
}
