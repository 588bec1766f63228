// Outlines of drawn gears, racks and belts: involute teeth, turned so that they mesh. Knows no page.

// Pressure angle; of teeth, in modules: above and below the pitch circle, what is left between
// flanks, the rim outside a ring, and what is below the teeth of a rack.
const PRESSURE = 20 * DEGREE, ADDENDUM = 1, DEDENDUM = 1.25, BACKLASH = 0.05, RIM = 2.2, BACK = 2.5;
// Places along a flank, and along half a turn of a belt; how far a rack reaches, in radii of its gear.
const FLANK = 6, HALF_TURN = 24, RACK_REACH = 2;

const involute = (angle) => Math.tan(angle) - angle;

// A closed outline about the centre of a gear, with the middle of a tooth on the x axis.
function toothed({teeth, module, ring}) {
  const radius = 0.5 * teeth * module, base = radius * Math.cos(PRESSURE), outward = ring ? -1 : 1;
  const [root, tip] = [-DEDENDUM, ADDENDUM].map((height) => radius + outward * height * module);
  // Half of a tooth's angle; the teeth of a ring are the gaps of a gear. Radial below the base circle.
  const half = (r) => {
    const inside = 0.5 * Math.PI / teeth + involute(PRESSURE) - involute(Math.acos(Math.min(1, base / r)));
    return Math.max(0, (ring ? Math.PI / teeth - inside : inside) - BACKLASH / teeth);
  };
  const flank = Array.from({length: FLANK}, (_, k) => root + (tip - root) * k / (FLANK - 1)).map((r) => [r, half(r)]);
  const tooth = [...flank.map(([r, angle]) => [r, -angle]), ...flank.reverse()];
  return Array.from({length: teeth}, (_, k) => tooth.map(([r, angle]) => (
    rotate([r, 0], angle + 2 * Math.PI * k / teeth)))).flat();
}

// The rim of a ring or the hole of a gear, of as many places as its teeth have.
function rimmed({teeth, module, ring}, outline) {
  const radius = 0.5 * teeth * module + (ring ? DEDENDUM + RIM : -DEDENDUM) * module;
  return outline.map((place) => place.map((x) => (ring ? 1 : 0.8) * radius * x / Math.hypot(...place)));
}

// Where gears as drawn have the middle of a tooth, as an angle of the paper, by name.
function toothAngles(drawing) {
  const found = {}, meshes = drawing.of('mesh').map(([, one]) => one);
  for (const [start] of drawing.of('gear')) {
    if (start in found) continue;
    found[start] = 0;
    for (const queue = [start]; queue.length;) {
      const here = queue.shift(), one = drawing.elements[here];
      for (const {a, b} of meshes.filter((mesh) => mesh.a === here || mesh.b === here)) {
        const there = a === here ? b : a, other = drawing.elements[there], inside = one.ring || other.ring;
        if (there in found) continue;
        // The directions of both to where they touch.
        const away = angleOf(difference(drawing.place(other.node), drawing.place(one.node)));
        const [own, its] = inside ? Array(2).fill(one.ring ? away : away + Math.PI) : [away, away + Math.PI];
        const pitches = (found[here] - own) * one.teeth / (2 * Math.PI) - 0.5;
        found[there] = its + (inside ? 1 : -1) * pitches * 2 * Math.PI / other.teeth;
        queue.push(there);
      }
    }
  }
  return found;
}

// A closed outline in the frame of a rack, whose x axis is the pitch line, below its gear.
function rackOutline(drawing, {gear, angle}, turned) {
  const {module} = drawing.elements[gear], radius = drawing.radius(gear), pitch = Math.PI * module;
  // A gap is where the gear has a tooth.
  const first = (turned - angle + 0.5 * Math.PI) * radius + 0.5 * pitch, reach = RACK_REACH * radius;
  const half = (height) => 0.25 * pitch - (height * Math.tan(PRESSURE) + 0.5 * BACKLASH) * module;
  const tooth = [[-half(-DEDENDUM), -DEDENDUM], [-half(ADDENDUM), ADDENDUM]];
  tooth.push(...tooth.map(([x, height]) => [-x, height]).reverse());
  const found = [];
  for (let k = Math.ceil((-reach - first) / pitch); first + k * pitch <= reach; k++) {
    found.push(...tooth.map(([x, height]) => [first + k * pitch + x, height * module]));
  }
  const back = -(DEDENDUM + BACK) * module;
  return [...found, [found.at(-1)[0], back], [found[0][0], back]];
}

// The closed path of a belt about two gears, on the paper.
function beltPath(drawing, {a, b}) {
  const [one, other] = [a, b].map((gear) => drawing.place(drawing.elements[gear].node));
  const [first, second] = [drawing.radius(a), drawing.radius(b)], away = difference(other, one);
  const lean = Math.acos(Math.max(-1, Math.min(1, (first - second) / Math.hypot(...away))));
  const arc = (middle, radius, from, to) => Array.from({length: HALF_TURN + 1}, (_, k) => {
    const [x, y] = rotate([radius, 0], angleOf(away) + from + (to - from) * k / HALF_TURN);
    return [middle[0] + x, middle[1] + y];
  });
  return [...arc(one, first, lean, 2 * Math.PI - lean), ...arc(other, second, -lean, lean)];
}
