// What bodies and the ground are drawn as: shapes, joints, feet; each a mesh with a place on a body.

const GROUND_COLOR = [0.55, 0.57, 0.6];
// Driven joints, in the colour that the theme has for them.
const INK = [0.16, 0.18, 0.2], WHITE = [0.95, 0.95, 0.95];
// Radius of a pin, in sizes of links, which are a little wider; half the width of a foot.
const PIN = 0.019, FOOT = 0.05;
// Neighbours of one colour differ a little: by so much of white, or of black.
const SHADES = [0, 0.16, -0.12];

class Parts {
  constructor(described, meshes) {
    this.described = described;
    this.meshes = meshes;
    this.size = described.thick;
    // By body, -1: the ground, what it is drawn as; by all that distinguishes it.
    this.items = new Map();
    // Places on each body that the picture has to show; -1: the ground.
    this.reach = [];
    this.compose();
  }

  // The same again is not put.
  put(body, mesh, local, color) {
    if (!this.items.has(body)) this.items.set(body, new Map());
    this.items.get(body).set(`${numbered(mesh)},${color},${local}`, {mesh, local, color});
  }

  shows(body, places) { this.reach.push(...places.map((place) => [body, place])); }

  compose() {
    const {bodies, ground, joints, cuts, guides, surfaces, wires, colors} = this.described;
    bodies.forEach((body, number) => {
      const shade = SHADES[number % SHADES.length];
      const color = '#' + rgb(body.color).map((c) => Math.round(255 * (
        shade > 0 ? c + shade * (1 - c) : c * (1 + shade))).toString(16).padStart(2, '0')).join('');
      for (const shape of body.shapes) this.shape(number, shape, shape.color ?? color);
      this.shows(number, body.grabs);
    });
    for (const shape of ground) this.shape(-1, shape, shape.color ?? '#9aa0a8');
    for (const joint of joints) {
      const color = joint.actuated ? INK : WHITE, radius = PIN * this.size;
      if (joint.type !== 'prismatic') this.pin(joint.parent, joint.place, joint, radius, color);
      else if (!this.described.planar) this.sleeve(joint, radius, color);
    }
    for (const cut of cuts) {
      const [body, place] = cut.body_a >= 0 ? [cut.body_a, cut.point_a] : [cut.body_b, cut.point_b];
      this.pin(body, place, cut, 1.2 * PIN * this.size, rgb(colors.cut));
      this.pin(body, place, {...cut, more: 0.004 * this.size}, 0.7 * PIN * this.size, WHITE);
    }
    // A ground that has shapes of its own needs no feet.
    if (!ground.some((shape) => shape.kind !== 'profile')) {
      const pivots = this.pivots();
      for (const place of pivots) this.foot(place);
      if (!this.described.planar && pivots.length > 2) this.base(pivots);
    }
    for (const guide of guides) this.shows(guide.mover, [guide.at]);
    for (const surface of surfaces) this.surface(surface);
    for (const wire of wires) this.wire(wire);
  }

  // Where the ground has joints that turn, and holds cables and springs.
  pivots() {
    const {joints, cuts, lines} = this.described;
    return [...joints.filter(({parent, type}) => parent < 0 && type !== 'prismatic')
      .map(({place}) => place),
            ...cuts.filter(({type}) => !['prismatic', 'point_on_line'].includes(type))
              .flatMap((cut) => [[cut.body_a, cut.point_a], [cut.body_b, cut.point_b]])
              .filter(([body]) => body < 0).map(([, place]) => place),
            ...lines.filter(({kind, anchor}) => kind !== 'rod' && !anchor)
              .flatMap(({ends}) => ends.filter(([body]) => body < 0).map(([, place]) => place))];
  }

  shape(body, shape, color) {
    const {meshes} = this, paint = rgb(color), {kind} = shape;
    const pale = paint.map((c) => 0.45 + 0.55 * c);
    if (kind === 'plate') {
      this.put(body, this.meshes.made.get(plateMesh, shape.corners, 0.7 * shape.thickness),
               IDENTITY, pale);
      this.shows(body, shape.corners);
    } else if (kind === 'bar') {
      this.bar(body, shape.from, shape.to, shape.radius, paint, shape.flat);
      this.shows(body, [shape.from, shape.to]);
    } else if (kind === 'box') {
      const axes = shape.axes ?? [[1, 0, 0], [0, 1, 0], [0, 0, 1]];
      const sides = axes.map((axis, k) => times(shape.size[k], axis));
      this.put(body, meshes.box, frame(...sides, shape.center), paint);
      this.shows(body, corners(shape.center, sides));
    } else if (kind === 'ball') {
      this.ball(body, shape.center, shape.radius, paint);
      this.shows(body, corners(shape.center, [0, 1, 2].map((axis) => (
        [0, 1, 2].map((k) => (k === axis ? 1.2 * shape.radius : 0))))));
    } else if (kind === 'cylinder') {
      const local = between(shape.from, shape.to, shape.radius);
      this.put(body, meshes.cylinder, local, paint);
      this.shows(body, round(local));
    } else if (kind === 'mesh') {
      this.put(body, meshes.made.get(faceMesh, shape.triangles.map((face) => (
        face.map((k) => shape.points[k])))), IDENTITY, paint);
      this.shows(body, box(shape.points));
    } else if (kind === 'faces') {
      this.put(body, meshes.made.get(faceMesh, shape.triangles), IDENTITY, pale);
    } else this.wheel(body, shape, paint);
  }

  // Outlines, rims and spokes about an axis.
  wheel(body, {kind, x, z, origin, depth, radius = 1, ...shape}, paint) {
    const local = frame(times(radius, x), times(radius, cross(z, x)), times(depth, z), origin);
    if (kind === 'profile') {
      this.put(body, this.meshes.made.get(profileMesh, shape.outline, shape.hole, shape.taper),
               local, paint);
      this.shows(body, few(shape.outline).map(([u, v]) => moved(local, [u, v, 0])));
    } else if (kind === 'spokes') this.put(body, this.meshes.spokes, local, paint);
    else {
      this.put(body, this.meshes.pulley, local, paint);
      this.put(body, this.meshes.spokes, product(local, frame(
        [0.8, 0, 0], [0, 0.8, 0], [0, 0, 0.6], [0, 0, 0])), paint);
      this.shows(body, round(local));
    }
  }

  bar(body, start, end, radius, color, flat) {
    this.put(body, this.meshes.cylinder, between(start, end, radius, flat ? flat / 2 : radius),
             color);
    for (const place of [start, end]) {
      if (flat) this.disk(body, place, radius, flat, color);
      else this.ball(body, place, radius, color, this.meshes.knob);
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

  // Joints.

  pin(body, place, {heights, type, axis, more = 0}, radius, color) {
    if (!this.described.planar) {
      if (axis && type === 'revolute') {
        const half = times(2.2 * radius, unit(axis));
        this.put(body, this.meshes.cylinder, between(minus(place, half), add(place, half), radius),
                 color);
      } else this.ball(body, place, 1.25 * radius + more, color);
      return;
    }
    const low = heights[0] - 0.012 * this.size, high = heights[1] + 0.016 * this.size + more;
    this.put(body, this.meshes.cylinder, frame(
      [radius, 0, 0], [0, radius, 0], [0, 0, high - low], [place[0], place[1], low]), color);
  }

  sleeve({parent, place, axis}, radius, color) {
    const half = times(2.5 * radius, unit(axis));
    this.put(parent, this.meshes.cylinder, between(
      minus(place, half), add(place, half), 1.2 * radius), color);
  }

  // The ground.

  foot(place) {
    const {size, meshes} = this, half = FOOT * size;
    if (!this.described.planar) {
      this.put(-1, meshes.cone, frame([half, 0, 0], [0, half, 0], [0, 0, 1.4 * half],
                                      add(place, [0, 0, -1.4 * half])), GROUND_COLOR);
      this.put(-1, meshes.cylinder, frame([1.4 * half, 0, 0], [0, 1.4 * half, 0], [0, 0, 0.2 * half],
                                          add(place, [0, 0, -1.6 * half])), GROUND_COLOR);
      return;
    }
    const [x, y] = place, down = 0.07 * size, thick = 0.014 * size;
    this.put(-1, meshes.made.get(plateMesh, [[0, 0, 0], [-half, -down, 0], [half, -down, 0]],
                                 0.012 * size), frame([1, 0, 0], [0, 1, 0], [0, 0, 1], [x, y, 0]),
             GROUND_COLOR);
    this.put(-1, meshes.box, frame([3 * half, 0, 0], [0, thick, 0], [0, 0, 0.03 * size],
                                   [x, y - down, 0]), GROUND_COLOR);
    for (const {mesh, local, color} of hatch(meshes, [x, y - down - thick / 2, 0], [1, 0, 0],
                                             [0, -1, 0], 3 * half, size)) {
      this.put(-1, mesh, local, color);
    }
    this.shows(-1, [[x - 1.5 * half, y - 1.6 * down, 0], [x + 1.5 * half, y, 0]]);
  }

  // The plate that feet in space stand on.
  base(places) {
    const half = FOOT * this.size, middle = times(1 / places.length, places.reduce(add));
    const floor = Math.min(...places.map(([, , z]) => z)) - 1.6 * half;
    const radius = 1.6 * half + Math.max(...places.map(
      ([x, y]) => Math.hypot(x - middle[0], y - middle[1])));
    this.put(-1, this.meshes.cylinder, frame([radius, 0, 0], [0, radius, 0], [0, 0, -0.3 * half],
                                             [middle[0], middle[1], floor]), GROUND_COLOR);
  }

  // The line or plane of a contact; its free side is where the normal points.
  surface({place, normal}) {
    const {size, planar} = this.described, z = unit(normal), gray = [0.62, 0.64, 0.66];
    const aside = planar ? [z[1], -z[0], 0]
      : unit(cross(Math.abs(z[2]) < 0.9 ? [0, 0, 1] : [0, 1, 0], z));
    const wide = (planar ? 6 : 3) * size, thick = 0.02 * size;
    this.put(-1, this.meshes.box, frame(
      times(wide, aside), times(planar ? 0.06 * size : wide, cross(z, aside)),
      times(thick, z), minus(place, times(thick / 2, z))), gray);
  }

  wire({body, places, color = this.described.colors.load, width = 0.004 * this.size}) {
    places.slice(1).forEach((place, k) => this.put(body, this.meshes.cylinder, between(
      places[k], place, width), rgb(color)));
    this.shows(body, few(places));
  }
}

// Some of the places along an outline, about evenly.
function few(places) {
  const every = Math.ceil(places.length / 24);
  return places.filter((_, k) => k % every === 0);
}

// Corners of a box, by its middle and its sides.
const corners = (middle, sides) => [0, 1, 2, 3, 4, 5, 6, 7].map((k) => sides.reduce(
  (place, side, axis) => add(place, times((k >> axis) & 1 ? 0.5 : -0.5, side)), middle));

// Corners of the box about places.
function box(places) {
  const [low, high] = [Math.min, Math.max].map((least) => [0, 1, 2].map((axis) => (
    places.reduce((found, place) => least(found, place[axis]), places[0][axis]))));
  const wide = minus(high, low);
  return corners(times(0.5, add(low, high)), [[wide[0], 0, 0], [0, wide[1], 0], [0, 0, wide[2]]]);
}

// Places about the two ends of what is round about the z axis of a frame.
const round = (local) => [0, 1, 2, 3, 4, 5, 6, 7].flatMap((k) => [0, 1].map((end) => moved(local, [
  Math.cos(0.25 * Math.PI * k), Math.sin(0.25 * Math.PI * k), end])));
