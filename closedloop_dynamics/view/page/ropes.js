// Springs, cables with their pulleys, and massless rods: between places that move.

const ROD = '#8b929c';
// Half widths of what is drawn, and half the depth of a pulley, in sizes of links.
const LINE_WIDTHS = {spring: 0.026, cable: 0.006, rod: 0.013}, PULLEY_DEPTH = 0.02;

// The way of a cable: straight pieces between pulleys, and what lies on these; along z, which is the
// axis of all pulleys, it goes straight. Beside its places the pulleys, each with the angle by which
// the cable has turned it.
function cableWay(centers, radii) {
  const pieces = [], turns = [];
  for (let k = 0; k + 1 < centers.length; k++) {
    const [dx, dy] = minus(centers[k + 1], centers[k]), between = dx * dx + dy * dy;
    const across = radii[k + 1] - radii[k], length = Math.sqrt(Math.max(0, between - across * across));
    pieces.push(between > 0 ? [(length * dx + across * dy) / between,
                               (length * dy - across * dx) / between] : [1, 0]);
  }
  const on = (k, [x, y]) => add(centers[k], [radii[k] * y, -radii[k] * x, 0]);
  const way = [centers[0]];
  let length = 0;
  for (let k = 1; k + 1 < centers.length; k++) {
    const [a, b] = [pieces[k - 1], pieces[k]], sense = Math.sign(radii[k]);
    const begin = sense ? on(k, a) : centers[k];
    length += norm(minus(begin, way[way.length - 1]));
    if (!sense) { way.push(begin); continue; }
    // The cable does not slip: what comes on turns the rim.
    turns.push([k, Math.atan2(a[1], a[0]) - length / radii[k]]);
    let turn = sense * Math.atan2(a[0] * b[1] - a[1] * b[0], a[0] * b[0] + a[1] * b[1]);
    if (turn < -0.5 * Math.PI) turn += 2 * Math.PI;
    const steps = Math.max(1, Math.ceil(Math.abs(turn) / 0.2));
    for (let n = 0; n <= steps; n++) {
      const angle = sense * turn * n / steps, [c, s] = [Math.cos(angle), Math.sin(angle)];
      way.push(on(k, [c * a[0] - s * a[1], s * a[0] + c * a[1]]));
    }
    length += Math.abs(turn * radii[k]);
  }
  way.push(centers[centers.length - 1]);
  return {way, turns};
}

class Ropes {
  constructor(scene) { this.scene = scene; }

  // The ends of all, and the rims of pulleys, which the picture has to show.
  reach() {
    return this.scene.described.lines.flatMap(({ends, radii = []}) => ends.flatMap(
      ([body, place], k) => {
        const at = moved(this.scene.frameOf(body), place), radius = 1.1 * Math.abs(radii[k] ?? 0);
        return radius ? corners(at, [[2 * radius, 0, 0], [0, 2 * radius, 0], [0, 0, 0]]) : [at];
      }));
  }

  draw() {
    const {scene} = this, {thick} = scene.described;
    for (const line of scene.described.lines) {
      const effect = scene.effects[line.name];
      if (effect && !effect.enabled) continue;
      const places = line.ends.map(([body, place]) => moved(scene.frameOf(body), place));
      if (line.anchor && effect?.values[line.anchor]) {
        const last = places.length - 1;
        places[last] = [...effect.values[line.anchor], places[last][2]].slice(0, 3);
      }
      const way = line.kind === 'cable' && line.radii.some(Boolean)
        ? this.rounded(line, places) : places;
      const [name, kind] = {spring: ['spring', 'load'], cable: ['cylinder', 'load'],
                            rod: ['cylinder', 'rod']}[line.kind];
      for (let k = 0; k + 1 < way.length; k++) {
        if (norm(minus(way[k + 1], way[k])) > 0) {
          scene.stretched(name, kind, between(way[k], way[k + 1], LINE_WIDTHS[line.kind] * thick));
        }
      }
    }
  }

  // Draw the pulleys of a cable; return its way.
  rounded(line, places) {
    const {scene} = this, depth = PULLEY_DEPTH * scene.described.thick;
    const z = line.axis ? unit(turned(scene.frameOf(line.axis[0]), line.axis[1])) : [0, 0, 1];
    const x = line.axis ? unit(cross(Math.abs(z[1]) < 0.9 ? [0, 1, 0] : [1, 0, 0], z)) : [1, 0, 0];
    const y = cross(z, x);
    const {way, turns} = cableWay(places.map((place) => [x, y, z].map((axis) => dot(axis, place))),
                                  line.radii);
    for (const [k, turn] of turns) {
      const radius = Math.abs(line.radii[k]), [c, s] = [Math.cos(turn), Math.sin(turn)];
      const along = add(times(c, x), times(s, y)), side = add(times(-s, x), times(c, y));
      const local = frame(times(radius, along), times(radius, side), times(2 * depth, z), places[k]);
      scene.stretched('pulley', 'wheel', local);
      scene.stretched('spokes', 'wheel', product(local, frame([0.8, 0, 0], [0, 0.8, 0], [0, 0, 0.6],
                                                              [0, 0, 0])));
    }
    return way.map((place) => add(add(times(place[0], x), times(place[1], y)), times(place[2], z)));
  }
}
