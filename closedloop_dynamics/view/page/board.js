// A board to draw a mechanism on from nothing, by mouse, finger and keys.

// How near the pointer must be [CSS pixels], also with a finger; how far a drag is at least.
const SNAP = 13, FINGER_SNAP = 26, DRAG = 9;
// The least spacing of grid lines [CSS pixels], and what a step may be [units].
const GRID_PIXELS = 18, GRID_STEPS = [1, 2, 5];
// Gears that are new [m]; teeth of those that are clicked, not dragged, and the least number.
const MODULE = 0.003, NEW_TEETH = 20, LEAST_TEETH = 6;
// Motors and forces that are new [rad/s, N m, N a metre of the arrow], a cam's lift against its circle.
const NEW_SPEED = 6.28319, NEW_TORQUE = 1, FORCE_PER_METRE = 100, CAM_LIFT = 0.2, CAM_RADII = 36;
// A roller against the distance to its cam, a slot's line and a rack against the view [CSS pixels].
const CAM_ROLLER = 0.2, SLOT_PIXELS = 46;
// The least module that teeth are drawn of [CSS pixels].
const LEAST_TOOTH = 2.5;
// Steps of undoing; how long a drawing rests before it is checked [ms].
const MOST_UNDO = 200, CHECK_AFTER = 150;
// Tools: word, and what is to be done.
const TOOLS = {
  select: ['select', 'Click to see numbers, drag to move; drag the paper to shift it, wheel or two fingers to zoom.'],
  ground: ['ground pivot', 'Click a place or a pin: it is fixed to the ground, or not any more. On the rim of a gear: that stands still.'],
  bar: ['bar', 'Drag from end to end, or click both. Where a pin is already, it is joined.'],
  link: ['link', 'Click the corners of a ternary or larger link; click the first again to end.'],
  slider: ['slider', 'Click a pin, then a bar that its block slides along, or where the line on the ground leads.'],
  slot: ['pin in slot', 'Click a pin, then the bar with the slot, or where the slot in the ground leads.'],
  cylinder: ['cylinder', 'Drag from end to end: a rod of variable length. A motor gives it speed or force.'],
  gear: ['gear', 'Drag from its centre to its pitch circle. Gears that touch mesh.'],
  belt: ['belt', 'Click the rims of two gears.'],
  rack: ['rack', 'Click the rim of a gear where it touches the rack.'],
  cam: ['cam', 'Drag from its axle to the pin that is the roller\u2019s centre.'],
  geneva: ['Geneva drive', 'Drag from the axle of the wheel to that of the driver.'],
  spring: ['spring', 'Drag from pin to pin.'],
  damper: ['damper', 'Drag from pin to pin.'],
  motor: ['motor', 'Click a pivot, or the block of a slider or a cylinder: it turns or moves at a speed, or by a torque or force.'],
  force: ['force', 'Drag from a pin: the arrow is the force.'],
  trace: ['trace', 'Click a pin: its path is drawn.'],
  erase: ['erase', 'Click what is to go.']};
// Those that lead from one node to another, and what they add.
const BETWEEN_NODES = {
  bar: (a, b) => ['link', {nodes: [a, b]}], cylinder: (a, b) => ['cylinder', {a, b}],
  spring: (a, b) => ['spring', {a, b, stiffness: SPRING_STIFFNESS, damping: 0}],
  damper: (a, b) => ['spring', {a, b, stiffness: 0, damping: DAMPER_DAMPING}],
  geneva: (wheel, driver) => ['geneva', {wheel, driver, slots: 5}]};

class Board {
  // `host` checks and simulates: check(name, text) returns a promise of the findings, simulate(name, text);
  // `reads`: whether it takes text that the board cannot draw.
  constructor(host) {
    this.host = host;
    this.drawing = new Drawing();
    [this.done, this.undone] = [[], []];
    [this.tool, this.selected, this.first, this.corners, this.pointers] = ['bar', null, null, [], new Map()];
    // The middle of the view [m], CSS pixels a metre, whether places snap to the grid, labels.
    [this.middle, this.scale, this.snaps, this.labels] = [[0.05, 0.03], 4000, true, true];
    this.reported = {};
    this.build();
  }

  build() {
    const button = (tool) => `<button data-tool="${tool}" title="${TOOLS[tool][1]}">${TOOLS[tool][0]}</button>`;
    this.element = make(`<dialog id="board"><header><h2>New mechanism</h2>
      <input type="text" class="name" aria-label="name" value="drawing">
      <button data-do="undo" title="Ctrl+Z">undo</button><button data-do="redo" title="Ctrl+Y">redo</button>
      <button data-do="fit" title="all of it (F)">fit</button><button data-do="clear">clear</button>
      <button data-do="simulate" class="go">simulate</button><button data-do="close">close</button></header>
      <div class="body"><nav>${Object.keys(TOOLS).map(button).join('')}</nav>
      <div class="paper"><canvas tabindex="0" aria-label="the drawing"></canvas><p class="hint"></p>
      <p class="reported" role="status"></p></div>
      <aside><div class="row"><label>unit <select data-set="unit">${Object.keys(LENGTH_UNITS).map(
        (unit) => `<option>${unit}</option>`).join('')}</select></label>
      <label><input type="checkbox" data-set="snaps" checked> snap to grid</label>
      <label><input type="checkbox" data-set="labels" checked> lengths and angles</label>
      <label><input type="checkbox" data-set="gravity" checked> gravity</label></div>
      <div class="fields"></div>
      <details><summary>the scene as text</summary><div class="row"><a class="button" download>download</a>
      <label class="button">open a file …<input type="file" accept=".yaml,.yml" hidden></label></div>
      <textarea class="scene" spellcheck="false" wrap="off" aria-label="the scene as text"></textarea></details>
      </aside></div></dialog>`);
    document.body.append(this.element);
    const find = (selector) => this.element.querySelector(selector);
    [this.canvas, this.fields, this.area, this.link, this.status] = [
      find('canvas'), find('.fields'), find('.scene'), find('a'), find('.reported')];
    this.area.oninput = () => {
      clearTimeout(this.waiting);
      this.waiting = setTimeout(() => this.read(this.area.value), CHECK_AFTER);
    };
    find('[type=file]').onchange = async ({target}) => {
      const [file] = target.files;
      if (file) this.read(this.area.value = await file.text());
      target.value = '';
    };
    this.status.onclick = () => this.goToLine(Number(/line (\d+)/.exec(this.status.textContent)?.[1]));
    this.pen = this.canvas.getContext('2d');
    find('.name').oninput = ({target}) => {
      const good = /^[A-Za-z]\w*$/.test(target.value);
      target.classList.toggle('bad', !good);
      if (good) {
        this.drawing.name = target.value;
        this.changed();
      }
    };
    const act = {undo: () => this.step(this.done, this.undone), redo: () => this.step(this.undone, this.done),
                 clear: () => this.edit(() => { this.drawing = new Drawing({unit: this.drawing.unit}); }),
                 fit: () => this.fit(), simulate: () => this.simulate(), close: () => this.element.close()};
    for (const one of this.element.querySelectorAll('[data-do]')) one.onclick = act[one.dataset.do];
    for (const one of this.element.querySelectorAll('[data-tool]')) one.onclick = () => this.choose(one.dataset.tool);
    for (const one of this.element.querySelectorAll('[data-set]')) {
      const key = one.dataset.set;
      one.onchange = () => {
        const value = one.type === 'checkbox' ? one.checked : one.value;
        if (key in this.drawing) this.edit(() => { this.drawing[key] = value; });
        else this[key] = value;
        this.show();
      };
    }
    this.element.oncancel = (event) => { event.preventDefault(); this.cancel(); };
    this.element.onkeydown = (event) => this.key(event);
    this.canvas.onpointerdown = (event) => this.down(event);
    this.canvas.onpointermove = (event) => this.move(event);
    this.canvas.onpointerup = (event) => this.up(event);
    this.canvas.onpointercancel = (event) => { this.pointers.delete(event.pointerId); this.cancel(); };
    this.canvas.onwheel = (event) => {
      event.preventDefault();
      this.zoom(Math.exp(-event.deltaY / 500), this.at(event));
    };
    new ResizeObserver(() => this.draw()).observe(this.canvas);
    this.choose('bar');
  }

  open() {
    this.element.showModal();
    this.canvas.focus();
    this.changed();
  }

  // Changes.

  // What is drawn, and its text where that was typed.
  get state() { return {drawing: this.drawing.copy(), typed: this.typed, unread: this.unread}; }

  edit(change, typed = null, unread = null) {
    this.keep(this.state);
    change();
    this.changed(typed, unread);
  }

  keep(before) {
    this.done.push(before);
    this.done.splice(0, this.done.length - MOST_UNDO);
    this.undone = [];
  }

  step(back, forth) {
    if (!back.length) return;
    forth.push(this.state);
    const {drawing, typed, unread} = back.pop();
    this.drawing = drawing;
    this.cancel();
    this.changed(typed, unread);
  }

  // Text that is typed is drawn, where it is of the board.
  read(text) {
    try {
      const {drawing} = new SceneReader(text);
      this.edit(() => { this.drawing = drawing; }, text);
    } catch (error) {
      this.edit(() => {}, text, error.message);
    }
  }

  goToLine(line) {
    if (!line) return;
    const lines = this.text.split('\n'), start = lines.slice(0, line - 1).join('\n').length + Number(line > 1);
    this.area.closest('details').open = true;
    this.area.focus();
    this.area.setSelectionRange(start, start + lines[line - 1].length);
  }

  changed(typed = null, unread = null) {
    const {drawing} = this;
    [this.typed, this.unread] = [typed, unread];
    if (!(this.selected in drawing.nodes || this.selected in drawing.elements)) this.selected = null;
    this.element.querySelector('.name').value = drawing.name;
    this.element.querySelector('[data-set=unit]').value = drawing.unit;
    this.text = typed ?? (Object.keys(drawing.elements).length ? drawing.text() : '');
    if (this.area.value !== this.text) this.area.value = this.text;
    this.link.href = URL.createObjectURL(new Blob([this.text], {type: 'application/yaml'}));
    this.link.download = `${drawing.name}.yaml`;
    clearTimeout(this.waiting);
    this.waiting = setTimeout(() => this.check(), CHECK_AFTER);
    this.showFields();
    this.show();
  }

  async check() {
    const {text, unread} = this;
    const reported = !text ? {} : unread && !this.host.reads ? {error: unread} : await this.host.check(this.drawing.name, text);
    if (text !== this.text) return;
    // The text that this is about.
    this.reported = {...reported, text};
    const {error, freedoms, driven, words} = reported;
    this.status.textContent = !text ? 'nothing drawn yet' : error ?? `${freedoms} degree${
      freedoms === 1 ? '' : 's'} of freedom${driven ? ` left, ${driven} driven` : ''}: ${[...words, ...unread ? [`not drawn, ${unread}`] : []].join('; ')}`;
    this.status.classList.toggle('bad', Boolean(error));
    this.show();
  }

  // Names of what a message or a repeated equation is about.
  get marked() {
    const words = `${this.reported.error ?? ''} ${(this.reported.repeated ?? []).join(' ')}`;
    return [...Object.keys(this.drawing.nodes), ...Object.keys(this.drawing.elements)].filter((name) => (
      new RegExp(`(^|[^A-Za-z0-9_])${name}(_\\d+|_guide|_barrel|_rod|_foot|_head)?([^A-Za-z0-9_]|$)`).test(words)));
  }

  simulate() {
    if (!this.unread || this.host.reads) this.host.simulate(this.drawing.name, this.text);
  }

  choose(tool) {
    this.cancel();
    this.tool = tool;
    for (const one of this.element.querySelectorAll('[data-tool]')) {
      one.setAttribute('aria-pressed', one.dataset.tool === tool);
    }
    this.element.querySelector('.hint').textContent = TOOLS[tool][1];
    this.show();
  }

  cancel() {
    [this.first, this.corners, this.held] = [null, [], null];
    this.show();
  }

  key(event) {
    event.stopPropagation();
    if (event.target.tagName === 'INPUT' || event.target.tagName === 'TEXTAREA') return;
    const key = event.key.toLowerCase(), control = event.ctrlKey || event.metaKey;
    const arrow = {arrowleft: [-1, 0], arrowright: [1, 0], arrowup: [0, 1], arrowdown: [0, -1]}[key];
    if (control && (key === 'y' || key === 'z' && event.shiftKey)) this.step(this.undone, this.done);
    else if (control && key === 'z') this.step(this.done, this.undone);
    else if ((key === 'delete' || key === 'backspace') && this.selected) this.erase(this.selected);
    else if (key === 'enter') this.endLink();
    else if (key === 'f') this.fit();
    else if (arrow && this.selected in this.drawing.nodes) {
      const node = this.drawing.nodes[this.selected];
      this.edit(() => { node.x += arrow[0] * this.grid; node.y += arrow[1] * this.grid; });
    } else return;
    event.preventDefault();
  }

  // Places.

  at({clientX, clientY}) {
    const box = this.canvas.getBoundingClientRect();
    return [clientX - box.x, clientY - box.y];
  }

  seen([x, y]) {
    return [0.5 * this.canvas.clientWidth + (x - this.middle[0]) * this.scale,
            0.5 * this.canvas.clientHeight - (y - this.middle[1]) * this.scale];
  }

  meant([u, v]) {
    return [this.middle[0] + (u - 0.5 * this.canvas.clientWidth) / this.scale,
            this.middle[1] - (v - 0.5 * this.canvas.clientHeight) / this.scale];
  }

  zoom(factor, about) {
    const before = this.meant(about);
    this.scale = Math.max(5, Math.min(2e5, this.scale * factor));
    this.shift(difference(before, this.meant(about)));
  }

  // All of the drawing with a margin.
  fit() {
    const {drawing, canvas} = this, places = Object.keys(drawing.nodes).map((node) => drawing.place(node));
    for (const [name, {node}] of drawing.of('gear')) {
      const [x, y] = drawing.place(node), radius = drawing.radius(name);
      places.push([x - radius, y - radius], [x + radius, y + radius]);
    }
    if (!places.length) return;
    const low = [0, 1].map((k) => Math.min(...places.map((place) => place[k])));
    const high = [0, 1].map((k) => Math.max(...places.map((place) => place[k])));
    this.middle = low.map((one, k) => 0.5 * (one + high[k]));
    this.scale = Math.min(2e5, 0.7 * Math.min(canvas.clientWidth / (high[0] - low[0] || 0.1),
                                              canvas.clientHeight / (high[1] - low[1] || 0.1)));
    this.show();
  }

  shift([x, y]) {
    this.middle = [this.middle[0] + x, this.middle[1] + y];
    this.show();
  }

  // Spacing of the grid [m].
  get grid() {
    const unit = LENGTH_UNITS[this.drawing.unit], least = GRID_PIXELS / this.scale / unit;
    const power = 10 ** Math.floor(Math.log10(least));
    return unit * power * (GRID_STEPS.find((step) => step * power >= least) ?? 10);
  }

  near(place, reach, but = null) {
    let best = null, least = reach;
    for (const name of Object.keys(this.drawing.nodes)) {
      const away = Math.hypot(...difference(this.seen(this.drawing.place(name)), place));
      if (name !== but && away < least) [best, least] = [name, away];
    }
    return best;
  }

  // A place on the grid, or where the pointer is.
  onGrid(place) {
    const [x, y] = this.meant(place), step = this.snaps ? this.grid : LENGTH_UNITS[this.drawing.unit] * 1e-3;
    return [x, y].map((one) => Number((Math.round(one / step) * step).toPrecision(12)));
  }

  node(place, reach) { return this.near(place, reach) ?? this.drawing.newNode(this.onGrid(place)); }

  // The gear whose rim is there, and the element whose line is.
  gearAt(place, reach) {
    return this.drawing.of('gear').map(([name, {node}]) => [name, Math.abs(Math.hypot(...difference(
      this.seen(this.drawing.place(node)), place)) - this.drawing.radius(name) * this.scale)])
      .filter(([, away]) => away < reach).sort(([, a], [, b]) => a - b)[0]?.[0] ?? null;
  }

  elementAt(place, reach) {
    const found = Object.keys(this.drawing.elements).map((name) => [name, Math.min(Infinity, ...this.lines(name).map(
      ([a, b]) => toLine(place, this.seen(a), this.seen(b))))]).filter(([, away]) => away < reach);
    return found.sort(([, a], [, b]) => a - b)[0]?.[0] ?? this.gearAt(place, reach);
  }

  linkAt(place, reach, node) {
    return this.drawing.of('link').filter(([, {nodes}]) => !nodes.includes(node)).find(([name]) => this.lines(name).some(
      ([a, b]) => toLine(place, this.seen(a), this.seen(b)) < reach))?.[0] ?? null;
  }

  // The lines of an element, of pairs of places.
  lines(name) {
    const {drawing} = this, one = drawing.elements[name], at = (node) => drawing.place(node);
    const ray = ([x, y], angle, pixels) => [[x, y], [x + pixels * Math.cos(angle) / this.scale,
                                                     y + pixels * Math.sin(angle) / this.scale]];
    switch (one.kind) {
      case 'link': return one.nodes.map((node, k) => [at(node), at(one.nodes[(k + 1) % one.nodes.length])])
        .slice(0, one.nodes.length > 2 ? undefined : 1);
      case 'cylinder': case 'spring': return [[at(one.a), at(one.b)]];
      case 'belt': return beltPath(drawing, one).map((place, k, path) => [place, path[(k + 1) % path.length]]);
      case 'slider': return [SLOT_PIXELS, -SLOT_PIXELS].map((pixels) => ray(at(one.node), one.angle, pixels));
      case 'rack': {
        const {at: middle, angle} = drawing.bodies()[name], pixels = 2 * drawing.radius(one.gear) * this.scale;
        return [pixels, -pixels].map((size) => ray(middle, angle, size));
      }
      case 'force': return [[at(one.node), [at(one.node)[0] + one.x / FORCE_PER_METRE, at(one.node)[1] + one.y / FORCE_PER_METRE]]];
      case 'geneva': return [[at(one.wheel), at(one.driver)]];
      default: return [];
    }
  }

  // The pointer.

  down(event) {
    const place = this.at(event), reach = event.pointerType === 'touch' ? FINGER_SNAP : SNAP;
    this.canvas.setPointerCapture(event.pointerId);
    this.pointers.set(event.pointerId, place);
    if (this.pointers.size > 1) {
      this.cancel();
      return;
    }
    [this.start, this.last, this.reach] = [place, place, reach];
    const act = {select: () => this.hold(place, reach), ground: () => this.ground(place, reach),
                 trace: () => this.trace(place, reach), motor: () => this.motor(place, reach),
                 belt: () => this.belt(place, reach), rack: () => this.rack(place, reach),
                 erase: () => this.erase(this.near(place, reach) ?? this.elementAt(place, reach)),
                 link: () => this.corner(place, reach)}[this.tool];
    if (act) act();
    else if (!this.first) this.first = {place, fresh: true};
    this.show();
  }

  move(event) {
    const place = this.at(event), before = this.pointers.get(event.pointerId);
    if (before && this.pointers.size === 2) {
      const [other] = [...this.pointers].filter(([id]) => id !== event.pointerId).map(([, one]) => one);
      this.zoom(Math.hypot(...difference(place, other)) / (Math.hypot(...difference(before, other)) || 1), other);
      this.shift(difference(this.meant(before), this.meant(place)).map((one) => 0.5 * one));
    } else if (before && this.held) this.drag(place);
    if (before) this.pointers.set(event.pointerId, place);
    this.last = place;
    this.show();
  }

  up(event) {
    const place = this.at(event), one = this.pointers.size === 1;
    this.pointers.delete(event.pointerId);
    if (!one) return;
    if (this.held) {
      if (this.held.before) {
        this.keep(this.held.before);
        this.changed();
      }
      this.held = null;
    } else if (this.first) {
      // A drag ends here; after a click the second one ends it.
      const dragged = Math.hypot(...difference(place, this.first.place)) > DRAG;
      if (this.first.fresh && !dragged) this.first.fresh = false;
      else this.finish(place);
    }
    this.show();
  }

  // What is drawn from a first place to another.
  finish(place) {
    const from = this.first.place, {tool, reach, drawing} = this;
    this.first = null;
    if (tool === 'slider' || tool === 'slot') {
      this.slide(from, place, tool === 'slider');
      return;
    }
    this.edit(() => {
      const a = this.node(from, reach), middle = this.seen(drawing.place(a));
      if (tool === 'gear') {
        this.gear(a, Math.hypot(...difference(this.meant(place), drawing.place(a))));
      } else if (tool === 'force') {
        const [x, y] = difference(this.onGrid(place), drawing.place(a)).map((one) => one * FORCE_PER_METRE);
        this.selected = drawing.add('force', {node: a, x, y});
      } else if (Math.hypot(...difference(place, middle)) > DRAG) {
        const b = this.near(place, reach, a) ?? drawing.newNode(this.onGrid(place));
        if (tool === 'cam') this.cam(a, b);
        else {
          if (tool === 'geneva') drawing.nodes[a].ground = drawing.nodes[b].ground = true;
          this.selected = drawing.add(...BETWEEN_NODES[tool](a, b));
        }
      }
    });
  }

  corner(place, reach) {
    const {drawing, corners} = this;
    if (corners.length > 2 && Math.hypot(...difference(this.seen(corners[0].at), place)) < reach) {
      this.endLink();
      return;
    }
    const node = this.near(place, reach);
    corners.push({node, at: node ? drawing.place(node) : this.onGrid(place)});
  }

  endLink() {
    const {corners, drawing} = this;
    if (corners.length > 1) {
      this.edit(() => {
        this.selected = drawing.add('link', {nodes: corners.map(({node, at}) => node ?? drawing.newNode(at))});
      });
    }
    this.cancel();
  }

  ground(place, reach) {
    const node = this.near(place, reach), gear = node ? null : this.gearAt(place, reach);
    this.edit(() => {
      if (gear) {
        const one = this.drawing.elements[gear];
        one.fixed = one.fixed ? null : GROUND_BODY;
      } else {
        const name = this.node(place, reach);
        this.drawing.nodes[name].ground = !this.drawing.nodes[name].ground;
        this.selected = name;
      }
    });
  }

  trace(place, reach) {
    const name = this.near(place, reach);
    if (name) this.edit(() => { this.drawing.nodes[name].trace = !this.drawing.nodes[name].trace; });
  }

  erase(name) {
    if (name) this.edit(() => this.drawing.remove(name));
  }

  slide(from, place, block) {
    const {drawing, reach} = this, node = this.near(from, reach);
    const on = this.linkAt(place, reach, node);
    this.edit(() => {
      const name = node ?? drawing.newNode(this.onGrid(from)), line = on && this.lines(on)[0];
      const angle = line ? angleOf(difference(line[1], line[0])) : angleOf(difference(this.onGrid(place), drawing.place(name)));
      this.selected = drawing.add('slider', {node: name, on: on ?? GROUND_BODY, angle, block});
    });
  }

  gear(node, radius) {
    const {drawing} = this, teeth = Math.max(LEAST_TEETH, Math.round(2 * radius / MODULE) || NEW_TEETH);
    const name = drawing.add('gear', {node, teeth, module: MODULE, ring: false, fixed: null});
    this.selected = name;
    for (const [other, one] of drawing.of('gear')) {
      const apart = Math.hypot(...difference(drawing.place(one.node), drawing.place(node)));
      const [own, its] = [drawing.radius(name), drawing.radius(other)], slack = 0.25 * MODULE;
      if (other === name || apart < slack) continue;
      if (Math.abs(own + its - apart) < slack) drawing.add('mesh', {a: name, b: other});
      else if (Math.abs(Math.abs(own - its) - apart) < slack) {
        drawing.elements[own > its ? name : other].ring = true;
        drawing.add('mesh', {a: own > its ? name : other, b: own > its ? other : name});
      }
    }
  }

  belt(place, reach) {
    const gear = this.gearAt(place, reach);
    if (gear && this.held2 && this.held2 !== gear) {
      this.edit(() => { this.selected = this.drawing.add('belt', {a: this.held2, b: gear}); });
      this.held2 = null;
    } else this.held2 = gear;
  }

  rack(place, reach) {
    const gear = this.gearAt(place, reach);
    if (!gear) return;
    const away = difference(this.meant(place), this.drawing.place(this.drawing.elements[gear].node));
    // To whole degrees.
    const angle = DEGREE * Math.round((angleOf(away) + 0.5 * Math.PI) / DEGREE);
    this.edit(() => { this.selected = this.drawing.add('rack', {gear, angle}); });
  }

  cam(node, roller) {
    const {drawing} = this, away = difference(drawing.place(roller), drawing.place(node)), far = Math.hypot(...away);
    const radius = CAM_ROLLER * far, base = far - radius, first = angleOf(away);
    const radii = Array.from({length: CAM_RADII}, (_, k) => base * (
      1 + 0.5 * CAM_LIFT * (1 - Math.cos(2 * Math.PI * k / CAM_RADII - first))));
    this.selected = drawing.add('cam', {node, roller, radius, radii});
  }

  motor(place, reach) {
    const {drawing} = this, node = this.near(place, reach);
    const on = drawing.of('slider', 'cylinder').find(([name]) => name === this.elementAt(place, reach))?.[0];
    const joints = drawing.joints().filter((joint) => joint.node === node && !joint.ofCylinder);
    const rods = drawing.of('slider').filter(([, one]) => one.block && one.node === node);
    if (!(node && (joints.length || rods.length)) && !on) return;
    const turned = joints.length && !rods.length ? {node, body: joints.at(-1).between[1]} : {on: on ?? rods[0]?.[0]};
    this.edit(() => {
      this.selected = drawing.add('motor', {...(on ? {on} : turned), law: 'speed',
                                            value: on || turned.on ? 0.1 : NEW_SPEED});
    });
  }

  hold(place, reach) {
    const node = this.near(place, reach), found = node ?? this.elementAt(place, reach);
    this.selected = found;
    const nodes = node ? [node] : found ? Drawing.needs(this.drawing.elements[found]).filter(
      (name) => name in this.drawing.nodes) : null;
    this.held = {nodes, from: place, places: (nodes ?? []).map((name) => this.drawing.place(name))};
    this.showFields();
  }

  drag(place) {
    const {held, drawing} = this;
    if (!held.nodes) {
      this.shift(difference(this.meant(this.last), this.meant(place)));
      return;
    }
    if (!held.before && Math.hypot(...difference(place, held.from)) < 3) return;
    held.before ??= this.state;
    const way = difference(this.meant(place), this.meant(held.from));
    held.nodes.forEach((name, k) => {
      const [x, y] = held.places[k];
      const [u, v] = this.onGrid(this.seen([x + way[0], y + way[1]]));
      Object.assign(drawing.nodes[name], {x: u, y: v});
    });
    this.text = '';
  }

  // Numbers of what is selected.

  showFields() {
    const {drawing, selected} = this;
    const node = drawing.nodes[selected], one = drawing.elements[selected], rows = [];
    const row = (label, kind, value, set) => rows.push({label, kind, value, set});
    if (node || one) {
      row('name', 'text', selected, (name) => {
        if (/^[A-Za-z]\w*$/.test(name) && !(name in drawing.nodes) && !(name in drawing.elements)) {
          drawing.rename(selected, name);
          this.selected = name;
        }
      });
    }
    if (node) {
      row('x', 'length', node.x, (value) => { node.x = value; });
      row('y', 'length', node.y, (value) => { node.y = value; });
      row('on the ground', 'check', Boolean(node.ground), (value) => { node.ground = value; });
      row('traced', 'check', Boolean(node.trace), (value) => { node.trace = value; });
    }
    if (one) this.elementRows(one, row);
    this.fields.replaceChildren(...rows.map((each) => this.field(each)));
  }

  elementRows(one, row) {
    const {drawing} = this, put = (key) => (value) => { one[key] = value; };
    const bar = (a, b) => {
      const away = difference(drawing.place(b), drawing.place(a)), length = Math.hypot(...away);
      const end = (size, angle) => {
        const [x, y] = drawing.place(a);
        Object.assign(drawing.nodes[b], {x: x + size * Math.cos(angle), y: y + size * Math.sin(angle)});
      };
      row(`length ${a} ${b}`, 'length', length, (value) => end(value, angleOf(away)));
      row(`angle ${a} ${b}`, 'angle', angleOf(away), (value) => end(length, value));
    };
    if (one.kind === 'link') one.nodes.slice(1).forEach((node) => bar(one.nodes[0], node));
    if (one.kind === 'cylinder' || one.kind === 'spring') bar(one.a, one.b);
    if (one.kind === 'geneva') bar(one.wheel, one.driver);
    const bodies = drawing.bodies(), body = bodies[this.selected] ?? bodies[`${this.selected}_rod`];
    if (body) row('mass [kg]', 'number', (one.kind === 'cylinder' ? 2 : 1) * body.mass, put('mass'));
    if (one.kind === 'slider' || one.kind === 'rack') row('angle', 'angle', one.angle, put('angle'));
    if (one.kind === 'slider') row('with a block', 'check', one.block, put('block'));
    if (one.kind === 'gear') {
      row('teeth', 'whole', one.teeth, put('teeth'));
      row('module', 'length', one.module, put('module'));
      row('ring', 'check', one.ring, put('ring'));
      row('turns with', ['itself', GROUND_BODY, ...drawing.of('link').map(([name]) => name)], one.fixed ?? 'itself',
          (value) => { one.fixed = value === 'itself' ? null : value; });
    }
    if (one.kind === 'geneva') row('slots', 'whole', one.slots, put('slots'));
    if (one.kind === 'spring') {
      row('stiffness [N/m]', 'number', one.stiffness, put('stiffness'));
      row('damping [N s/m]', 'number', one.damping, put('damping'));
      row('free length', 'length', one.free ?? Math.hypot(...difference(drawing.place(one.a), drawing.place(one.b))), put('free'));
    }
    if (one.kind === 'cam') {
      row('roller radius', 'length', one.radius, put('radius'));
      row('radii', 'table', one.radii, put('radii'));
    }
    if (one.kind === 'motor') {
      const unit = one.on ? {speed: 'm/s', torque: 'N'} : {speed: 'rad/s', torque: 'N m'};
      row('law', ['speed', 'torque'], one.law, (law) => {
        Object.assign(one, {law, value: law === 'torque' ? NEW_TORQUE : one.on ? 0.1 : NEW_SPEED});
      });
      row(`${one.law} [${unit[one.law]}]`, one.law === 'torque' ? 'number' : one.on ? 'sliding' : 'turning', one.value, put('value'));
    }
    if (one.kind === 'force') ['x', 'y'].forEach((key) => row(`force ${key} [N]`, 'number', one[key], put(key)));
  }

  field({label, kind, value, set}) {
    const {unit} = this.drawing, size = {length: LENGTH_UNITS[unit], table: LENGTH_UNITS[unit], angle: DEGREE}[kind] ?? 1;
    const words = {length: ` [${unit}]`, table: ` [${unit}]`, angle: ' [deg]'}[kind] ?? '';
    const shown = (one) => String(Number((one / size).toPrecision(8)));
    const entry = kind === 'check' ? `<input type="checkbox"${value ? ' checked' : ''}>`
      : Array.isArray(kind) ? `<select>${kind.map((one) => `<option${one === value ? ' selected' : ''}>${escaped(one)}</option>`).join('')}</select>`
        : kind === 'table' ? `<textarea rows="3">${value.map(shown).join(' ')}</textarea>`
          : `<input type="text" value="${escaped(kind === 'text' ? value : shown(value))}">`;
    const element = make(`<label>${escaped(label + words)} <span>${kind === 'whole' ? '<button>−</button>' : ''}${
      entry}${kind === 'whole' ? '<button>+</button>' : ''}</span></label>`);
    const input = element.querySelector('input, select, textarea');
    // 40, 40 mm, 1.5 inch, 30 deg, 2*25; of motors also 90 rpm.
    const read = (text) => {
      try {
        return quantity(text, {table: 'length', whole: 'number', sliding: 'length'}[kind] ?? kind, size);
      } catch {
        return NaN;
      }
    };
    const apply = (next) => {
      const good = Array.isArray(next) ? next.length > 2 && next.every((one) => one > 0)
        : typeof next === 'number' ? Number.isFinite(next) : true;
      input.classList.toggle('bad', !good);
      if (good) this.edit(() => set(next));
    };
    input.onchange = () => apply(kind === 'check' ? input.checked : Array.isArray(kind) || kind === 'text' ? input.value
      : kind === 'table' ? input.value.trim().split(/[\s,;]+/).map(read)
        : kind === 'whole' ? Math.round(read(input.value)) : read(input.value));
    element.querySelectorAll('button').forEach((button, k) => {
      button.onclick = (event) => { event.preventDefault(); apply(value + (k ? 1 : -1)); };
    });
    return element;
  }

  // The picture.

  show() {
    if (this.due) return;
    this.due = requestAnimationFrame(() => {
      this.due = null;
      this.draw();
    });
  }

  draw() {
    const {canvas, pen, drawing} = this, ratio = devicePixelRatio || 1;
    const [wide, high] = [canvas.clientWidth, canvas.clientHeight];
    if (!wide || !high) return;
    if (canvas.width !== Math.round(wide * ratio) || canvas.height !== Math.round(high * ratio)) {
      [canvas.width, canvas.height] = [Math.round(wide * ratio), Math.round(high * ratio)];
    }
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, wide, high);
    const style = getComputedStyle(document.documentElement), color = (name) => style.getPropertyValue(`--${name}`).trim();
    this.colors = {ink: color('ink'), muted: color('muted'), line: color('line'), accent: color('accent'), bad: color('bad'),
                   card: color('card'), path: color('path'), force: color('force')};
    this.drawGrid(wide, high);
    const marked = new Set(this.marked);
    this.toothAngles = toothAngles(drawing);
    for (const name of Object.keys(drawing.elements)) {
      pen.strokeStyle = pen.fillStyle = marked.has(name) ? this.colors.bad : name === this.selected ? this.colors.accent : this.colors.ink;
      this.drawElement(name, drawing.elements[name]);
    }
    for (const name of Object.keys(drawing.nodes)) this.drawNode(name, marked.has(name));
    this.drawPending();
  }

  drawGrid(wide, high) {
    const {pen, grid} = this, [left, top] = this.meant([0, 0]), [right, bottom] = this.meant([wide, high]);
    for (const [low, end, across] of [[left, right, true], [bottom, top, false]]) {
      for (let k = Math.ceil(low / grid); k * grid <= end; k++) {
        const [u, v] = this.seen([k * grid, k * grid]);
        pen.strokeStyle = this.colors.line;
        pen.lineWidth = k % 10 ? 0.5 : 1.2;
        this.stroke(across ? [[u, 0], [u, high]] : [[0, v], [wide, v]]);
      }
    }
    pen.fillStyle = this.colors.muted;
    pen.font = '12px system-ui, sans-serif';
    pen.textAlign = 'right';
    pen.fillText(`grid ${Number((grid / LENGTH_UNITS[this.drawing.unit]).toPrecision(3))} ${this.drawing.unit}`, wide - 8, 18);
  }

  stroke(places, closed = false) {
    this.pen.beginPath();
    places.forEach(([u, v], k) => (k ? this.pen.lineTo(u, v) : this.pen.moveTo(u, v)));
    if (closed) this.pen.closePath();
    this.pen.stroke();
  }

  // What is closed, about a place on the paper, turned.
  outline(places, [x, y], turned) {
    this.stroke(places.map((place) => {
      const [u, v] = rotate(place, turned);
      return this.seen([x + u, y + v]);
    }), true);
  }

  circle([u, v], radius, fill = false) {
    this.pen.beginPath();
    this.pen.arc(u, v, Math.max(0, radius), 0, 2 * Math.PI);
    if (fill) this.pen.fill();
    this.pen.stroke();
  }

  drawElement(name, one) {
    const {pen, drawing} = this, at = (node) => this.seen(drawing.place(node));
    pen.lineWidth = one.kind === 'link' ? 5 : 2;
    pen.lineJoin = pen.lineCap = 'round';
    pen.setLineDash(one.kind === 'belt' || one.kind === 'slider' && !one.block ? [7, 5] : []);
    const lines = this.lines(name).map((line) => line.map((place) => this.seen(place)));
    if (one.kind === 'link' && lines.length > 1) {
      pen.globalAlpha = 0.15;
      pen.beginPath();
      lines.forEach(([[u, v]], k) => (k ? pen.lineTo(u, v) : pen.moveTo(u, v)));
      pen.fill();
      pen.globalAlpha = 1;
    }
    if (one.kind === 'spring') this.zigzag(...lines[0], one.stiffness > 0);
    else for (const line of lines) this.stroke(line);
    pen.setLineDash([]);
    if (one.kind === 'link' || one.kind === 'cylinder') this.label(lines, one);
    if (one.kind === 'cylinder') {
      pen.lineWidth = 9;
      this.stroke([lines[0][0], lines[0][0].map((u, k) => 0.5 * (u + lines[0][1][k]))]);
    } else if (one.kind === 'slider' && one.block) {
      pen.save();
      pen.translate(...at(one.node));
      pen.rotate(-one.angle);
      pen.fillStyle = this.colors.card;
      pen.fillRect(-15, -9, 30, 18);
      pen.strokeRect(-15, -9, 30, 18);
      pen.restore();
    } else if (one.kind === 'gear') {
      const teeth = one.module * this.scale > LEAST_TOOTH;
      if (teeth) {
        const [x, y] = drawing.place(one.node), outline = toothed(one), turned = this.toothAngles[name];
        this.outline(outline, [x, y], turned);
        if (one.ring) this.outline(rimmed(one, outline), [x, y], turned);
        pen.lineWidth = 1;
        pen.setLineDash([2, 4]);
      }
      this.circle(at(one.node), drawing.radius(name) * this.scale);
      pen.setLineDash([]);
      pen.textAlign = 'left';
      const [u, v] = at(one.node), radius = drawing.radius(name) * this.scale;
      pen.fillText(`${one.teeth}${one.fixed ? ' fixed' : ''}`, u + 0.72 * radius + 4, v - 0.72 * radius - 4);
    } else if (one.kind === 'rack') {
      const {at: place, angle} = drawing.bodies()[name];
      this.outline(rackOutline(drawing, one, this.toothAngles[one.gear]), place, angle);
    } else if (one.kind === 'geneva') {
      const {apart, crank, line} = drawing.geneva(name), half = Math.PI / one.slots, [wheel, driver] = [at(one.wheel), at(one.driver)];
      this.circle(wheel, apart * Math.cos(half) * this.scale);
      this.circle(driver, crank * this.scale);
      for (let k = 0; k < one.slots; k++) {
        const way = rotate([1, 0], -(line + (2 * k + 1) * half));
        this.stroke([apart - crank, apart * Math.cos(half)].map((r) => [wheel[0] + way[0] * r * this.scale, wheel[1] + way[1] * r * this.scale]));
      }
    } else if (one.kind === 'cam') {
      const step = 2 * Math.PI / one.radii.length;
      this.outline(one.radii.map((r, k) => rotate([r, 0], k * step)), drawing.place(one.node), 0);
      this.circle(at(one.roller), one.radius * this.scale);
    } else if (one.kind === 'force') {
      this.arrow(...lines[0]);
    } else if (one.kind === 'motor') {
      const [u, v] = at(one.node ?? drawing.elements[one.on].node ?? drawing.elements[one.on].a);
      pen.beginPath();
      pen.arc(u, v, 17, -2.4, 1.2);
      pen.stroke();
      this.arrow([u + 17 * Math.cos(0.9), v + 17 * Math.sin(0.9)], [u + 17 * Math.cos(1.25), v + 17 * Math.sin(1.25)]);
    }
  }

  arrow([a, b], [c, d]) {
    const way = Math.atan2(d - b, c - a);
    this.stroke([[a, b], [c, d]]);
    for (const turn of [2.6, -2.6]) this.stroke([[c, d], [c + 9 * Math.cos(way + turn), d + 9 * Math.sin(way + turn)]]);
  }

  zigzag([a, b], [c, d], spring) {
    const way = [c - a, d - b], size = Math.hypot(...way) || 1, side = [-7 * way[1] / size, 7 * way[0] / size];
    const shares = spring ? [0, 0.2, 0.28, 0.36, 0.44, 0.52, 0.6, 0.68, 0.8, 1] : [0, 0.4, 0.4, 0.6, 0.6, 1];
    const sides = spring ? [0, 0, 1, -1, 1, -1, 1, -1, 0, 0] : [0, 0, 1, 1, 0, 0];
    this.stroke(shares.map((share, k) => [a + share * way[0] + sides[k] * side[0], b + share * way[1] + sides[k] * side[1]]));
  }

  label(lines, {kind}) {
    if (!this.labels) return;
    const {pen} = this, unit = LENGTH_UNITS[this.drawing.unit];
    pen.textAlign = 'center';
    pen.fillStyle = this.colors.muted;
    pen.font = '11.5px system-ui, sans-serif';
    for (const [[a, b], [c, d]] of lines) {
      const length = Math.hypot(c - a, d - b) / this.scale / unit, angle = Math.atan2(b - d, c - a) / DEGREE;
      const way = Math.atan2(d - b, c - a), flip = Math.cos(way) < 0 ? Math.PI : 0;
      pen.save();
      pen.translate(0.5 * (a + c), 0.5 * (b + d));
      pen.rotate(way + flip);
      pen.fillText(`${Number(length.toPrecision(4))}${kind === 'link' && lines.length > 1 ? '' : `  ${Number(angle.toPrecision(3))}°`}`, 0, -7);
      pen.restore();
    }
  }

  drawNode(name, marked) {
    const {pen} = this, {ground, trace} = this.drawing.nodes[name], [u, v] = this.seen(this.drawing.place(name));
    pen.strokeStyle = marked ? this.colors.bad : name === this.selected ? this.colors.accent : this.colors.ink;
    pen.lineWidth = 2;
    if (ground) {
      this.stroke([[u, v], [u - 11, v + 15], [u + 11, v + 15]], true);
      for (const k of [-1, 0, 1]) this.stroke([[u + 8 * k, v + 15], [u + 8 * k - 5, v + 21]]);
    }
    pen.fillStyle = trace ? this.colors.path : this.colors.card;
    this.circle([u, v], 5.5, true);
    pen.fillStyle = this.colors.ink;
    pen.font = '600 12.5px system-ui, sans-serif';
    pen.textAlign = 'left';
    pen.fillText(name, u + 9, v - 8);
  }

  drawPending() {
    const {pen, last} = this;
    pen.strokeStyle = this.colors.accent;
    pen.lineWidth = 2;
    pen.setLineDash([5, 4]);
    if (this.first && last) {
      this.stroke([this.first.place, last]);
      if (this.tool === 'gear') this.circle(this.first.place, Math.hypot(...difference(last, this.first.place)));
    }
    if (this.corners.length) this.stroke([...this.corners.map(({at}) => this.seen(at)), ...(last ? [last] : [])]);
    pen.setLineDash([]);
    if (last && this.tool !== 'select' && !this.pointers.size) {
      const node = this.near(last, SNAP);
      this.circle(node ? this.seen(this.drawing.place(node)) : this.seen(this.onGrid(last)), node ? 9 : 3);
    }
  }
}
