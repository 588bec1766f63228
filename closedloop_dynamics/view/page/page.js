// The page: what it receives and shows, live from a server or out of itself, and what it asks for.

const byId = (id) => document.getElementById(id);
const COLORS = {
  light: ['#0072B2', '#D55E00', '#008F68', '#B8589A', '#2C93CC', '#8A7A00', '#333333'],
  dark: ['#56A8E0', '#F28A3C', '#3CC79A', '#E39BC6', '#8FD0F5', '#D9C84A', '#D0D4DA']};
const THEMES = {
  light: {ink: '#1d2127', muted: '#5b6470', line: '#e3e6ea', accent: '#0b62b0', path: '#6A3D9A',
          force: '#B2182B', cut: '#B34E00', halo: '#f4f5f7', grid: '#d7dbe1', paper: rgb('#f4f5f7'), card: rgb('#ffffff'), driven: [0.16, 0.18, 0.2], ambient: 0.3},
  dark: {ink: '#e8ebef', muted: '#a2abb7', line: '#333944', accent: '#6cb2f5', path: '#b48ee6',
         force: '#ff6b78', cut: '#ff9a4d', halo: '#15181d', grid: '#333944', paper: rgb('#15181d'), card: rgb('#1e2228'), driven: [0.42, 0.45, 0.5], ambient: 0.3}};
// Words of the legend, explained where the pointer rests on them.
const MEANINGS = {
  bodies: 'Bodies of one colour hang on the ground by one joint; the equations of each such group '
    + 'are solved for themselves, and joined where loops close.',
  driven: 'A joint that takes a torque or force.',
  cut: 'A cut joint: the spanning tree is cut there, and an equation keeps the loop closed.',
  force: 'The force that body B of a cut joint exerts on its body A; the other one is opposite.',
  ghost: 'Another run at the same time: pale in the picture, dotted in the plots.',
  estimate: 'The machine as it is estimated: pale in the picture; in the plots a line with a band of '
    + 'two standard deviations on both sides.',
  direction: 'The machine is next to a singular configuration: loops, or held drives, hardly '
    + 'prevent this motion.'};
// Plots and the clock are drawn so often while time runs [ms]: nobody reads faster.
const READING = 45;
// A page that hears nothing for so long is not connected any more; one that gets no states for so
// long while time runs says so [ms].
const PATIENCE = 1000, STILL = 1500;
// Width of the picture from which on it has room for the legend beside the machine [CSS pixels].
const LEGEND_ROOM = 800;
// Bodies of one colour that the legend names.
const NAMED = 3;
// Share of the speed asked for below which the page says how fast it is.
const LAGS = 0.8;

class Page {
  constructor(data) {
    this.data = data;
    this.speed = 1;
    this.playing = false;
    this.now = 0;
    this.lastNote = -1;
    // Samples that have come since the last frame was shown.
    this.arrived = [];
    this.dark = matchMedia('(prefers-color-scheme: dark)').matches;
    this.setTheme();
    byId('theme').onclick = () => { this.dark = !this.dark; this.setTheme(); };
    this.others();
    if (data.scene) this.startRecorded();
    else if (data.machine) this.startStandalone();
    else if (data.editor) this.startEditor();
    else this.connect();
    requestAnimationFrame(() => this.tick());
  }

  setTheme() {
    document.documentElement.classList.toggle('dark', this.dark);
    this.theme = THEMES[this.dark ? 'dark' : 'light'];
    if (this.plots) this.recolor();
    this.gravity?.draw();
  }

  // Links to the other pages of this server.
  others() {
    const here = Number(location.pathname.replaceAll('/', '') || 0);
    byId('pages').replaceChildren(...(this.data.pages ?? []).map((title, k) => make(
      `<a href="${k || '/'}${escaped(location.search)}"${k === here ? ' aria-current="page"' : ''}>${
        escaped(title)}</a>`)));
  }

  // Both kinds.

  describe(scene) {
    this.scene = scene;
    byId('title').textContent = scene.title;
    document.title = scene.title;
    if (this.picture) this.picture.reshape(scene);
    else {
      try {
        this.picture = new Scene(byId('solid'), byId('lines'), scene);
      } catch (error) {
        this.complain(error.message);
        throw error;
      }
      this.handle();
      byId('legend').open = byId('stage').clientWidth > LEGEND_ROOM;
    }
    this.width = scene.columns.width;
    byId('plots').replaceChildren();
    byId('choices').replaceChildren();
    this.plots?.watch.disconnect();
    this.plots = new Plots(scene, byId('plots'), byId('choices'), byId('over'));
    this.recolor();
    this.comparison ??= new Comparison(this);
    this.files ??= new Files(this);
    this.comparison.renew();
    this.legend();
    this.transport();
    byId('follow').replaceChildren(...['still', ...scene.bodies.map(
      ({name}) => `follow ${escaped(name)}`)].map((text, k) => (
      make(`<option value="${k - 1}">${text}</option>`))));
    byId('follow').value = this.picture.followed;
    for (const text of scene.missing) this.tell(`${text}; drawn as lines`);
  }

  recolor() { this.plots.recolor(COLORS[this.dark ? 'dark' : 'light']); }

  legend() {
    const {bodies, subsystems, colors, cuts, points, loads, columns, joints, lines: drawn,
           surfaces} = this.scene;
    // Those that have no colours of their own.
    const lines = subsystems.map((color, k) => [color, bodies.filter(
      (body) => body.subsystem === k && !body.shapes.every((shape) => shape.color))])
      .filter(([, some]) => some.length)
      .map(([color, some]) => [`<i style="background:${color}"></i>${
        some.slice(0, NAMED).map(({name}) => escaped(name)).join(', ')}${
        some.length > NAMED ? ` and ${some.length - NAMED} more` : ''}`, null, null, MEANINGS.bodies]);
    if (joints.some((joint) => joint.actuated)) {
      lines.push(['<i class="dot" style="background:#2a2e33;outline:1px solid #9aa1ab"></i>driven joint', null, null, MEANINGS.driven]);
    }
    if (cuts.length) {
      lines.push([`<i class="dot hollow" style="border-color:${colors.cut}"></i>joint that closes a loop`, null, null, MEANINGS.cut]);
      lines.push(['<i style="background:var(--force)"></i>force there', 'forces', null, MEANINGS.force]);
    }
    const effects = [...new Set([...loads, ...drawn.filter((line) => line.kind !== 'rod'),
                                 ...surfaces].map((one) => one.name))];
    if (effects.length) {
      lines.push([`<i style="background:${colors.load}"></i>${escaped(effects.join(', '))}`]);
    }
    if (drawn.some((line) => line.kind === 'rod')) {
      lines.push([`<i style="background:${ROD}"></i>massless rod`]);
    }
    const path = '<i style="background:var(--path)"></i>path';
    if (points.length) lines.push([`${path} of ${escaped(points[0].name)}`, 'path']);
    if (points.length > 1) {
      lines.push([`${path}${points.length > 2 ? 's' : ''} of ${
        points.length > 4 ? `${points.length - 1} other points`
          : points.slice(1).map(({name}) => escaped(name)).join(', ')}`, 'paths']);
    }
    if (columns.direction !== columns.plots) {
      lines.push(['<i style="background:#bf4dbf"></i>nearly unconstrained direction', null, 'direction',
                  MEANINGS.direction]);
    }
    const {ghost} = this.picture;
    if (ghost) {
      lines.push([`<i class="ghost"></i>${escaped(ghost.name)}`, null, null, ghost.meaning]);
    }
    lines.push(['<i style="background:currentColor;height:2px"></i>names', 'names']);
    byId('keys').replaceChildren(...lines.map(([html, key, id, meaning = '']) => {
      const line = make(`<label title="${escaped(meaning)}">${
        key ? '<input type="checkbox">' : ''}${html}</label>`);
      const box = line.querySelector('input');
      if (id) { line.id = id; line.hidden = true; }
      if (box) {
        box.checked = this.picture.shown[key];
        box.onchange = () => { this.picture.shown[key] = box.checked; };
      }
      return line;
    }));
  }

  transport() {
    if (this.wired) return;
    this.wired = true;
    byId('play').onclick = () => this.toggle();
    byId('reset').onclick = () => this.reset();
    byId('step').onclick = () => this.step();
    this.timeline = new Timeline(this);
    this.speedSlider = new Slider({
      label: 'speed', unit: '×', low: 0.01, high: 10, value: 1, log: true, reset: 1,
      onchange: (value) => {
        const factor = Math.max(0.01, Math.min(10, value));
        this.speed = factor;
        if (this.live) this.ask('speed', {factor: Number(factor.toPrecision(3))});
      }});
    byId('speed').append(this.speedSlider.element);
    for (const button of document.querySelectorAll('#views button')) {
      button.onclick = () => this.picture.view(button.dataset.view);
    }
    byId('follow').onchange = () => this.picture.followBody(Number(byId('follow').value));
    byId('measure').onclick = () => this.measure(!this.picture.measured);
    // What the mouse has used gives the keys back; what Tab has reached keeps them.
    let mouse = false;
    addEventListener('pointerdown', () => { mouse = true; }, true);
    addEventListener('keydown', (event) => {
      mouse = false;
      this.key(event);
    });
    for (const kind of ['change', 'click']) {
      document.addEventListener(kind, ({target}) => {
        const {tagName, type} = target;
        if (mouse && (tagName === 'SELECT' ? kind === 'change'
          : type !== 'text' && document.activeElement !== document.body)) {
          if (document.activeElement.tagName !== 'SELECT' || kind === 'change') {
            document.activeElement.blur();
          }
        }
      });
    }
  }

  key(event) {
    const {tagName, type} = event.target;
    if (event.ctrlKey || event.metaKey || event.altKey || byId('library').open) return;
    if (tagName === 'TEXTAREA' || (tagName === 'INPUT' && type === 'text')) return;
    const actions = {'.': () => this.step(), r: () => this.reset(), Escape: () => this.measure(false)};
    // Space is what presses a focused button, and opens a focused list.
    if (tagName === 'BODY' || type === 'range') actions[' '] = () => this.toggle();
    if (actions[event.key]) {
      actions[event.key]();
      event.preventDefault();
    } else if (tagName === 'SELECT' && event.key.length === 1 && event.key !== ' ') {
      // A letter would choose another entry.
      event.preventDefault();
    }
  }

  // Points that are clicked on are measured, until it is switched off.
  measure(on) {
    this.picture.measured = on ? [] : null;
    byId('measure').setAttribute('aria-pressed', on);
  }

  toggle() {
    if (this.live) this.ask(this.playing ? 'pause' : 'play');
    else {
      if (!this.playing && this.now >= this.end) this.now = this.begin;
      this.playing = !this.playing;
      this.last = performance.now();
    }
  }

  reset() {
    this.picture?.forget();
    this.timeline?.present();
    if (this.live) this.ask('reset');
    else [this.now, this.playing] = [this.begin, false];
  }

  step() {
    const count = Number(byId('count').value);
    this.timeline.present();
    if (this.live) this.ask('step', {count});
    else {
      this.playing = false;
      const at = Math.min(this.history.before(this.now) + count, this.history.count - 1);
      this.now = this.history.time(at);
    }
  }

  // Live.

  connect() {
    this.live = true;
    byId('count').hidden = false;
    const address = new URL('live' + location.search, location.href);
    address.protocol = address.protocol.replace('http', 'ws');
    if (!location.pathname.endsWith('/')) address.pathname = location.pathname + '/live';
    const socket = this.socket = new WebSocket(address);
    socket.binaryType = 'arraybuffer';
    socket.onmessage = ({data}) => this.hear(data);
    socket.onclose = () => {
      this.lost = true;
      this.complain('The server does not answer any more. This page goes on when it is back.');
      setTimeout(() => this.connect(), PATIENCE);
    };
  }

  ask(what, more = {}) {
    if (this.socket?.readyState === WebSocket.OPEN) {
      this.socket.send(JSON.stringify({do: what, ...more}));
    }
  }

  hear(data) {
    if (typeof data === 'string') {
      const message = JSON.parse(data);
      if (message.type === 'scene') {
        [this.lost, this.resumed] = [false, this.known === data];
        byId('message').hidden = true;
        // The same again after a break: nothing is built again, and what was asked meanwhile is lost.
        if (this.resumed) this.edit?.board?.check();
        else if (this.known) {
          this.renew(message);
          this.known = data;
        } else {
          this.known = data;
          this.begin(message);
        }
      } else this.follow(message);
      return;
    }
    const view = new DataView(data), numbers = new Float32Array(data, 16);
    const time = view.getFloat64(8, true), row = numbers.subarray(0, this.width);
    this.frame = {number: view.getUint32(0, true), time, row};
    this.fresh = true;
    const count = view.getUint32(4, true), each = this.width + 1;
    // After a break the samples come again that are kept, unless the run is another one.
    const kept = this.resumed && time >= this.history.end ? this.history.end : -Infinity;
    this.resumed = false;
    for (let k = 0; k < count; k++) {
      const first = this.width + k * each;
      if (time + numbers[first] <= kept) continue;
      this.arrived.push({time: time + numbers[first],
                         row: numbers.subarray(first + 1, first + each)});
    }
    this.arrived.push({time, row, frame: true});
  }

  // A machine, from its next frame on.
  begin(scene) {
    [this.fresh, this.arrived, this.shownRow] = [false, [], null];
    this.history = new History(scene);
    this.describe(scene);
    this.timeline.past = null;
    this.panels();
  }

  // Other numbers of the same machine, or one with other parts, or another one. Plots that were
  // closed stay so, and the camera stays where it is unless the machine is another.
  renew(scene) {
    const {title} = this.scene;
    if (structure(scene) !== structure(this.scene)) {
      const open = new Map(this.plots.groups.map((plot) => [plot.group, plot.open]));
      this.begin(scene);
      for (const plot of this.plots.groups) {
        if (open.has(plot.group) && open.get(plot.group) !== plot.open) plot.choice.click();
      }
      if (scene.title !== title) {
        this.picture.first();
        this.comparison.take(null);
      }
      return;
    }
    this.scene = scene;
    this.picture.reshape(scene);
    this.drives.describe(scene);
    if (this.controls) this.drives.follow(this.controls, (joint) => this.position(joint));
    this.edit?.describe(scene);
  }

  panels() {
    const scene = this.scene, ask = (what, more) => this.ask(what, more);
    for (const panel of document.querySelectorAll('.live')) panel.hidden = false;
    for (const id of ['drives', 'gravity', 'effects', 'method']) byId(id).replaceChildren();
    this.drives = new Drives(scene, byId('drives'), ask);
    byId('drives-panel').hidden = !scene.drives.length;
    this.gravity = scene.gravity ? new Gravity(scene, byId('gravity'), ask) : null;
    this.effects = new Effects(scene, byId('effects'), ask);
    if (scene.integrators) this.method = new Method(scene, byId('method'), ask);
    else byId('method-panel').hidden = true;
    byId('handle').hidden = !scene.poses;
    if (scene.handles && !this.edit) this.edit = this.picture.above = new Editing(this);
    else this.edit?.describe(scene);
    byId('edit-panel').hidden = byId('editing').hidden = !scene.handles;
    byId('dynamic').onclick = () => {
      this.ask('kinematic', {on: false});
      if (this.controls?.editing) this.ask('edit', {on: false});
    };
    byId('kinematic').onclick = () => this.ask('kinematic', {on: true});
  }

  position(joint) {
    const at = this.scene.plots.findIndex((plot) => (
      plot.group === 'joint position' && plot.name === joint));
    return this.frame ? this.frame.row[this.scene.columns.plots + at] : 0;
  }

  follow(controls) {
    this.controls = controls;
    if (controls.playing && !this.playing) this.shownAt = performance.now();
    this.playing = controls.playing;
    this.speedSlider.follow(controls.speed);
    this.drives.follow(controls, (joint) => this.position(joint));
    this.gravity?.follow(controls);
    if (controls.effects) {
      this.effects.follow(controls);
      this.picture.effects = controls.effects;
    }
    if (this.method) this.method.follow(controls);
    this.edit?.follow(controls);
    if (controls.kinematic || controls.editing) this.timeline.present();
    byId('dynamic').setAttribute('aria-pressed', !controls.kinematic && !controls.editing);
    byId('kinematic').setAttribute('aria-pressed', controls.kinematic);
    byId('hint').textContent = controls.kinematic
      ? `Drag points, or the sliders of the drives: the loops stay closed. ${
        this.scene.mode === 'node' ? 'The simulator takes this state over.' : 'This becomes the start.'}`
      : controls.editing ? 'Drag pins and points to other places.'
      : this.scene.hand ? 'Drag a point: a spring pulls it to the pointer.' : '';
    byId('worth').textContent = (controls.findings ?? []).join(' ');
    if (controls.busy) this.complain(`${controls.busy} …`, true);
    else if (controls.failure) this.complain(`${controls.failure} Reset returns to the start.`);
    else if (!this.lost) byId('message').hidden = true;
    const notes = controls.notes ?? [];
    // Those from before this page was opened were for others.
    if (this.lastNote >= 0) {
      for (const note of notes) if (note.number > this.lastNote) this.tell(note.text);
    }
    this.lastNote = Math.max(0, this.lastNote, ...notes.map((note) => note.number));
  }

  complain(text, calm = false) {
    const message = byId('message');
    message.textContent = text;
    message.classList.toggle('calm', calm);
    message.hidden = false;
  }

  tell(text) {
    const note = make('<div class="note"></div>');
    note.textContent = text;
    byId('notes').append(note);
    while (byId('notes').children.length > 3) byId('notes').firstChild.remove();
    setTimeout(() => note.remove(), 6000);
  }

  // Out of itself.

  // Machines that are drawn here.
  startEditor() {
    this.live = true;
    byId('count').hidden = false;
    this.editor = new EditorPage(this, this.data.editor);
  }

  // A machine that is simulated in the page: it answers as a server does.
  async startStandalone() {
    this.live = true;
    byId('count').hidden = false;
    try {
      this.socket = new Standalone(this, this.data.description, await Machine.of(this.data.machine));
    } catch (error) {
      this.complain(`This browser cannot run the machine of this page: ${error.message}`);
      throw error;
    }
    this.socket.begin();
  }

  startRecorded() {
    this.live = false;
    const {scene, times, rows} = this.data;
    this.history = new History(scene, unpacked(times, Float64Array), unpacked(rows, Float32Array));
    this.describe(scene);
    this.picture.record(this.history);
    [this.begin, this.end] = [this.history.begin, this.history.end];
    this.now = this.begin;
    this.last = performance.now();
    this.playing = true;
  }

  // The mouse: the camera, and points that are taken hold of.

  handle() {
    const solid = byId('solid'), pointers = new Map();
    let moving = null, spread = 0;
    const local = (event) => {
      const box = solid.getBoundingClientRect();
      return [event.clientX - box.left, event.clientY - box.top];
    };
    const may = () => this.live && this.timeline.past === null && !this.edit?.on && (this.scene.hand || this.controls?.kinematic);
    solid.onpointerdown = (event) => {
      solid.setPointerCapture(event.pointerId);
      pointers.set(event.pointerId, local(event));
      const [x, y] = local(event), picture = this.picture;
      const touch = event.pointerType === 'mouse' ? 22 : 34;
      if (picture.measured && event.button === 0 && picture.pick(picture.nearest(x, y, touch, true))) {
        moving = null;
        return;
      }
      if (event.button === 0 && !event.shiftKey && pointers.size === 1
          && this.edit?.down(x, y, event.pointerType !== 'mouse')) {
        moving = 'edit';
        return;
      }
      const found = event.button === 0 && !event.shiftKey && pointers.size === 1 && may()
        ? picture.nearest(x, y, touch) : null;
      if (found) {
        moving = 'hand';
        picture.held = found;
        this.through = picture.grabbed(found);
        picture.handAt = picture.unproject(x, y, this.through);
        this.ask('grab', {body: found[0], place: found[1], at: picture.handAt});
      } else if (pointers.size === 2) {
        const [a, b] = [...pointers.values()];
        [moving, spread] = ['pinch', Math.hypot(a[0] - b[0], a[1] - b[1])];
      } else moving = event.button === 0 && !event.shiftKey ? 'turn' : 'shift';
    };
    solid.onpointermove = (event) => {
      const place = local(event), picture = this.picture, before = pointers.get(event.pointerId);
      this.edit?.move(...place);
      if (!before) {
        picture.hover = picture.measured ? picture.nearest(...place, 22, true)
          : may() ? picture.nearest(...place, 22) : null;
        solid.classList.toggle('near', Boolean(picture.hover));
        return;
      }
      pointers.set(event.pointerId, place);
      const dx = place[0] - before[0], dy = place[1] - before[1];
      if (moving === 'edit') return;
      if (moving !== 'hand') picture.touched = true;
      if (moving === 'hand') {
        picture.handAt = picture.unproject(...place, this.through);
        this.pulled = true;
      } else if (moving === 'turn') {
        picture.yaw -= 0.008 * dx;
        picture.pitch = Math.max(-1.55, Math.min(1.55, picture.pitch + 0.008 * dy));
      } else if (moving === 'shift') this.shift(dx, dy);
      else if (moving === 'pinch' && pointers.size === 2) {
        const [a, b] = [...pointers.values()], now = Math.hypot(a[0] - b[0], a[1] - b[1]);
        this.zoom(spread / Math.max(now, 1));
        spread = now;
        this.shift(dx / 2, dy / 2);
      }
    };
    solid.onpointerup = solid.onpointercancel = (event) => {
      pointers.delete(event.pointerId);
      if (moving === 'edit') this.edit.up();
      if (moving === 'hand') {
        this.ask('release');
        this.picture.held = this.picture.handAt = null;
      }
      moving = null;
    };
    solid.onpointerleave = () => {
      this.picture.hover = null;
      solid.classList.remove('near');
    };
    solid.oncontextmenu = (event) => event.preventDefault();
    solid.ondblclick = () => {
      this.picture.touched = false;
      this.picture.fit();
    };
    solid.addEventListener('wheel', (event) => {
      this.zoom(Math.exp(0.0012 * event.deltaY));
      event.preventDefault();
    }, {passive: false});
  }

  zoom(factor) {
    const picture = this.picture;
    picture.touched = true;
    picture.distance = Math.max(0.2 * picture.size, Math.min(60 * picture.size,
                                                             picture.distance * factor));
  }

  shift(dx, dy) {
    const picture = this.picture, {right, top} = picture.seen;
    const scale = 2 * picture.distance * Math.tan(FIELD_OF_VIEW / 2) / picture.canvas.clientHeight;
    picture.target = add(picture.target, add(times(-scale * dx, right), times(scale * dy, top)));
  }

  // A frame of the screen.

  tick() {
    requestAnimationFrame(() => this.tick());
    if (!this.picture) return;
    if (this.live) this.takeFrame();
    else this.play();
    if (!this.shownRow) return;
    if (this.timeline.past !== null) this.timeline.show();
    this.comparison.show(this.now);
    if (this.pulled) {
      this.pulled = false;
      this.ask('pull', {at: this.picture.handAt});
    }
    this.edit?.tick();
    this.picture.draw(this.theme);
    const now = performance.now();
    if (this.playing && now - (this.readAt ?? 0) < READING) return;
    this.readAt = now;
    this.plots.draw(this.history, this.now, this.theme);
    this.state();
  }

  takeFrame() {
    const now = performance.now();
    if (!this.fresh) {
      if (this.playing && this.scene.mode === 'live' && !this.lost && now - this.shownAt > STILL) {
        this.waiting = true;
        this.complain('Still working …', true);
      }
      return;
    }
    this.fresh = false;
    this.shownAt = now;
    if (this.waiting) {
      this.waiting = false;
      byId('message').hidden = true;
    }
    const {number, time, row} = this.frame;
    for (const one of this.arrived.splice(0)) {
      if (this.history.add(one.time, one.row, one.frame)) {
        this.picture.forget();
        this.timeline.past = null;
      }
      this.picture.extend(one.row, one.time);
    }
    if (this.timeline.past === null) {
      [this.now, this.shownRow] = [time, row];
      this.picture.show(row, time);
    }
    this.count = (this.count ?? 0) + 1;
    this.ask('seen', {frame: number});
    if (this.controls?.kinematic) this.drives.follow(this.controls, (joint) => this.position(joint));
  }

  play() {
    const now = performance.now();
    if (this.playing) {
      this.now += (now - this.last) / 1000 * this.speed;
      if (this.now >= this.end) [this.now, this.playing] = [this.end, false];
    }
    this.last = now;
    this.shownRow = this.history.at(this.now);
    this.picture.show(this.shownRow, this.now);
  }

  state() {
    const play = byId('play');
    this.timeline.draw();
    play.classList.toggle('playing', this.playing);
    play.setAttribute('aria-label', this.playing ? 'pause' : 'play');
    byId('clock').textContent = `${this.now.toFixed(this.speed < 0.1 ? 4 : 3)} s`;
    const {columns} = this.scene, loose = byId('direction');
    // Not every machine has the columns of that direction.
    const near = columns.direction !== columns.plots && Number.isFinite(this.shownRow[columns.direction]);
    if (loose) loose.hidden = !near;
    const now = performance.now();
    if (now - (this.counted ?? 0) < 500) return;
    const parts = [], controls = this.controls;
    if (this.live) {
      const plot = (group) => columns.plots + this.scene.plots.findIndex(
        (one) => one.group === group);
      const rate = 1000 * (this.count ?? 0) / (now - (this.counted ?? now - 500));
      const cost = this.shownRow[plot('cost')];
      parts.push(`<span class="${this.lost ? 'bad' : ''}">${
        this.lost ? 'no connection' : this.playing ? 'running' : controls?.kinematic ? 'posing' : 'paused'}</span>`);
      if (this.timeline.past !== null) {
        parts.push(`<span class="wide">shown: <b>${short(this.history.end - this.now, 3)} s</b> ago</span>`);
      }
      const slow = this.playing && controls?.achieved !== null && controls?.achieved < LAGS * controls?.speed;
      if (slow) {
        parts.push(`<span class="bad">${near ? 'near singular, ' : 'slow, '}${short(controls.achieved, 2)} × real time</span>`);
      }
      if (this.playing && controls?.every > 1) {
        parts.push(`<span title="peaks of forces between them are not seen: a slower speed shows more">1 of <b>${
          controls.every}</b> steps seen</span>`);
      }
      if (this.playing) parts.push(`<span class="wide"><b>${Math.round(rate)}</b> Hz</span>`);
      if (this.scene.mode === 'live' && Number.isFinite(cost)) {
        parts.push(`<span class="wide">computing <b>${short(cost, 2)} %</b> of real time</span>`);
      }
      this.count = 0;
    } else {
      parts.push(`<span><b>${this.history.count}</b> states, <b>${
        short(this.end - this.begin, 4)}</b> s</span>`);
    }
    byId('status').innerHTML = parts.join('');
    this.counted = now;
  }
}

const page = new Page(JSON.parse(byId('data').textContent));
