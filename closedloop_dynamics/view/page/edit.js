// What is edited: pins and points are dragged, parts added, numbers changed; machines opened, saved.

// How near the pointer must be [CSS pixels]: a pin, with a finger, a link.
const NEAR = 18, FINGER = 34, ON_LINK = 12;
// Radii of the rings that are dragged [CSS pixels].
const PIN_RING = 8, POINT_RING = 6;
// What can be added, in words: what is clicked on.
const ADDED = {
  link: ['link', 'Click where it begins, on a body or the ground, then where it ends: on a pin or a '
    + 'link it is joined there.'],
  pin: ['pin joint', 'Click the place on one body, then the other body: they are joined there.'],
  rod: ['massless rod', 'Click its two ends.'],
  point: ['point', 'Click the place: on a link, or on the ground.'],
  spring: ['spring', 'Click its two ends.'],
  damper: ['damper in a joint', 'Click the joint.'],
  force: ['force', 'Click where it acts, then where it points to.'],
  drive: ['drive of a joint', 'Click the joint.']};
const IN_PLANE = ['link', 'pin'], OF_JOINT = ['damper', 'drive'];

// The address of what the server of this page has.
const served = (path) => escaped(`/${path}${location.search}`);

// The data that a page is built from: where they differ, the page is built again.
function structure(scene) {
  const names = (items) => items.map(({name, type, actuated}) => [name, type, actuated]);
  return JSON.stringify([scene.title, scene.planar, scene.columns, scene.plots, scene.loads,
    names(scene.bodies), names(scene.joints), names(scene.cuts), names(scene.points),
    scene.removable?.effect,
    scene.drives?.map(({joint, modes}) => [joint, modes]), scene.own]);
}

class Editing {
  constructor(page) {
    this.page = page;
    this.on = false;
    this.adding = null;
    this.first = null;
    this.pointer = null;
    this.held = null;
    this.build();
    this.describe(page.scene);
  }

  ask(what, more) { this.page.ask(what, more); }

  build() {
    const panel = make(`<div><div class="row">
      <button data-do="undo" title="undo (Ctrl+Z)">undo</button>
      <button data-do="redo" title="redo (Ctrl+Y)">redo</button>
      <button data-do="assemblies" title="all ways to put it together">assemblies …</button>
      <select id="add" aria-label="add a part"></select>
      <select id="remove" aria-label="remove a part"></select></div>
      <p class="hint"></p>
      <div class="row"><input type="text" class="name" aria-label="name of the file">
      <button data-do="save" title="in the folder where closedloop view was started">save</button>
      <a class="button" href="${served('scene.yaml')}" download>download</a></div></div>`);
    byId('edit').replaceChildren(...panel.children);
    const edit = byId('edit');
    this.hint = edit.querySelector('.hint');
    this.name = edit.querySelector('.name');
    [this.menu, this.less] = edit.querySelectorAll('select');
    this.link = edit.querySelector('a');
    this.name.oninput = () => { this.link.download = `${this.name.value}.yaml`; };
    for (const button of edit.querySelectorAll('button')) {
      button.onclick = () => this.ask(button.dataset.do, button.dataset.do === 'save'
        ? {name: this.name.value} : {});
    }
    [this.undo, this.redo, this.other] = edit.querySelectorAll('button');
    this.other.onclick = () => this.assemblies();
    this.menu.onchange = () => this.begin(this.menu.value || null);
    this.less.onchange = () => {
      const [kind, name] = this.less.value.split(' ');
      this.less.value = '';
      this.ask('remove', {kind, name});
    };
    byId('editing').onclick = () => this.ask('edit', {on: true});
    addEventListener('keydown', (event) => {
      if (event.key === 'Escape') this.begin(null);
      if (!(event.ctrlKey || event.metaKey) || event.target.type === 'text') return;
      const what = {z: event.shiftKey ? 'redo' : 'undo', y: 'redo'}[event.key.toLowerCase()];
      if (what) {
        this.ask(what);
        event.preventDefault();
      }
    });
    this.library();
    byId('new').hidden = false;
    byId('new').onclick = () => (this.board ??= new Board(this.host())).open();
  }

  // What checks and simulates a drawing: the server.
  host() {
    // Answers go to all pages: of each page they have numbers of their own.
    let number = Math.floor(1e9 * Math.random());
    this.waiting = {};
    return {
      reads: true,
      check: (name, text) => new Promise((done) => {
        this.waiting = {number: ++number, done};
        this.ask('check', {number, name, text});
      }),
      simulate: (name, text) => {
        this.drawn = name;
        this.ask('load', {name, text});
      }};
  }

  // Machines to open.

  library() {
    const dialog = byId('library'), list = byId('machines');
    byId('open').hidden = false;
    byId('open').onclick = async () => {
      dialog.showModal();
      const answer = await fetch(served('machines.json'));
      this.machines = await answer.json();
      this.list(list);
    };
    dialog.querySelector('[type="search"]').oninput = () => this.list(list);
    dialog.querySelector('button').onclick = () => dialog.close();
    dialog.querySelector('[type="file"]').onchange = async ({target}) => {
      const [file] = target.files;
      if (!file) return;
      const name = file.name.replace(/\.ya?ml$/i, '').replace(/[^A-Za-z0-9_]/g, '_');
      this.ask('load', {name: /^[A-Za-z]/.test(name) ? name : `m_${name}`,
                        text: await file.text()});
      target.value = '';
      dialog.close();
    };
  }

  list(place) {
    const wanted = byId('library').querySelector('[type="search"]').value.toLowerCase();
    const card = ({kind, name, text}) => {
      const button = make(`<button><img loading="lazy" alt="" src="${
        served(`picture/${kind}/${name}.svg`)}"><b>${escaped(name).replaceAll('_', '_<wbr>')}</b><small>${escaped(text)}</small></button>`);
      button.onclick = () => {
        this.ask('open', {name, kind});
        byId('library').close();
      };
      return button;
    };
    const found = this.machines.filter(({name, text}) => (
      `${name} ${text}`.toLowerCase().includes(wanted)));
    place.replaceChildren(...[['yours', 'Files in this folder'], ['shipped', 'Shipped machines']]
      .flatMap(([kind, title]) => {
        const some = found.filter((one) => one.kind === kind);
        return some.length ? [make(`<h3>${title}</h3>`), ...some.map(card)] : [];
      }));
  }

  // Pictures of all assemblies, to click on.
  async assemblies() {
    const dialog = make('<dialog class="choice"><header><h2>Assemblies</h2><button class="icon" aria-label="close">×</button></header><p class="hint">looking for all of them …</p><div class="machines"></div></dialog>');
    document.body.append(dialog);
    dialog.onclose = () => dialog.remove();
    dialog.querySelector('button').onclick = () => dialog.close();
    dialog.showModal();
    const {words, pictures} = await (await fetch(served('assemblies.json'))).json();
    dialog.querySelector('p').textContent = words;
    dialog.querySelector('div').replaceChildren(...pictures.map((picture, number) => {
      const button = make(`<button><img alt="assembly ${number + 1}" src="data:image/svg+xml,${
        encodeURIComponent(picture)}"><b>${number + 1}</b></button>`);
      button.onclick = () => {
        this.ask('assemble', {number});
        dialog.close();
      };
      return button;
    }));
  }

  // What the server sends.

  describe(scene) {
    if (this.drawn === scene.title) {
      this.drawn = null;
      this.board.element.close();
    }
    if (this.title !== scene.title) {
      this.title = scene.title;
      this.name.value = `${scene.title}_edited`;
      this.name.oninput();
    }
    this.menus(scene);
    // Pins are seen at their upper ends.
    const pins = [...scene.joints, ...scene.cuts];
    this.handles = (scene.handles ?? []).map((handle) => {
      const pin = handle.kind === 'point' || !scene.planar ? null
        : pins.find(({name}) => name === handle.name);
      const [x, y, z] = handle.place;
      return {...handle, place: [x, y, z + (pin ? pin.heights[1] + 0.016 * scene.size : 0)]};
    });
    this.curves = (scene.curves ?? []).map(({places}) => (
      Array.from({length: places.length / 3}, (_, k) => places.slice(3 * k, 3 * k + 3))));
    this.numbers ??= new Numbers((what, more) => this.ask(what, more));
    this.numbers.describe(scene.sliders ?? []);
  }

  // What can be added, and removed.
  menus({planar, removable = {}}) {
    const key = JSON.stringify([planar, removable]);
    if (key === this.offered) return;
    this.offered = key;
    this.menu.innerHTML = '<option value="">add</option>'
      + Object.keys(ADDED).filter((what) => planar || !IN_PLANE.includes(what)).map((what) => (
        `<option value="${what}">${ADDED[what][0]}</option>`)).join('');
    this.less.innerHTML = '<option value="">remove</option>'
      + Object.entries(removable).filter(([, names]) => names.length).map(([kind, names]) => (
        `<optgroup label="${kind}">${names.map((name) => (
          `<option value="${kind} ${escaped(name)}">${escaped(name)}</option>`)).join('')}</optgroup>`))
        .join('');
  }

  // Whole curves are seen at first; the view stays while it is edited.
  fit() {
    const {picture} = this.page;
    if (!picture.extent || !this.curves.length) return;
    for (const place of this.curves.flat()) {
      place.forEach((x, k) => {
        picture.extent.low[k] = Math.min(picture.extent.low[k], x);
        picture.extent.high[k] = Math.max(picture.extent.high[k], x);
      });
    }
    if (!picture.touched) picture.fit();
    picture.touched = true;
  }

  follow({editing, undoable, checked}) {
    if (checked && checked.number === this.waiting?.number) this.waiting.done(checked);
    [this.undo.disabled, this.redo.disabled] = undoable.map((can) => !can);
    byId('editing').setAttribute('aria-pressed', editing);
    if (this.on !== editing) {
      this.begin(null);
      if (editing) this.fit();
    }
    this.on = editing;
    this.menu.hidden = this.less.hidden = this.other.hidden = !editing;
    this.say();
  }

  say() {
    this.hint.textContent = this.adding ? ADDED[this.adding][1]
      : this.on ? 'Drag a pin or a point: the others stay. The machine stands where it starts.'
        : 'Numbers may be changed while it moves; “edit it” moves pins, adds and removes parts.';
  }

  begin(what) {
    [this.adding, this.first] = [what, null];
    this.menu.value = what ?? '';
    this.say();
  }

  // The pointer.

  place(handle) { return moved(this.page.picture.frameOf(handle.body), handle.place); }

  nearest(x, y, reach, only = () => true) {
    let best = null, least = reach;
    for (const handle of this.handles.filter(only)) {
      const [u, v] = this.page.picture.project(this.place(handle));
      const away = Math.hypot(u - x, v - y);
      // Points win over the pins that they lie on only where they are nearer.
      if (away < least) [best, least] = [handle, away];
    }
    return best;
  }

  bodyName(number) { return number < 0 ? 'ground' : this.page.scene.bodies[number].name; }

  // What is under the pointer: a body and a place in the world; the ground where nothing is.
  target(x, y, reach) {
    const {picture, scene} = this.page, found = picture.nearest(x, y, reach);
    if (found) return {body: found[0], at: picture.grabbed(found), on: true};
    const ground = scene.planar ? this.nearest(x, y, reach, ({body}) => body < 0) : null;
    if (ground) return {body: -1, at: this.place(ground), on: true};
    const at = picture.unproject(x, y, scene.planar ? [0, 0, 0] : picture.target);
    let body = -1, least = ON_LINK;
    scene.bodies.forEach(({grabs}, number) => {
      const ends = grabs.map((place) => picture.project(moved(picture.frames[number], place)));
      ends.forEach((a, k) => ends.slice(k + 1).forEach((b) => {
        const away = toLine([x, y], a, b);
        if (away < least) [body, least] = [number, away];
      }));
    });
    return {body, at, on: body >= 0};
  }

  down(x, y, finger) {
    const reach = finger ? FINGER : NEAR;
    if (!this.on) return false;
    if (this.adding) {
      this.click(x, y, reach);
      return true;
    }
    this.held = this.nearest(x, y, reach);
    if (this.held) this.through = this.place(this.held);
    return Boolean(this.held);
  }

  click(x, y, reach) {
    const what = this.adding;
    if (OF_JOINT.includes(what)) {
      const joint = this.nearest(x, y, reach, ({kind}) => kind === 'joint');
      if (!joint) return;
      this.ask('add', {what, joint: joint.name});
    } else {
      const found = this.target(x, y, reach);
      if (what !== 'point' && !this.first) {
        this.first = found;
        return;
      }
      const a = this.first ?? found;
      this.ask('add', {what, body_a: this.bodyName(a.body), a: a.at, ...(this.first ? {
        b: found.at, ...(found.on || what !== 'link' ? {body_b: this.bodyName(found.body)} : {})}
        : {})});
    }
    this.begin(null);
  }

  move(x, y) {
    this.pointer = [x, y];
    if (this.held) this.wanted = this.page.picture.unproject(x, y, this.through);
  }

  up() {
    this.tick();
    this.held = null;
  }

  // A frame of the screen: what was dragged is sent, handles and curves are drawn.

  tick() {
    if (!this.held || !this.wanted) return;
    this.ask('move', {kind: this.held.kind, name: this.held.name, at: this.wanted});
    this.wanted = null;
  }

  // Curves, pins as rings and points as smaller ones, by the strokes of the picture.
  paint(theme, strokes) {
    const [path, accent, halo] = [theme.path, theme.accent, theme.halo].map(rgb);
    for (const curve of this.curves) strokes.line(curve.flat(), PATH, path);
    for (const [radius, some] of [[PIN_RING, this.handles.filter(({kind}) => kind !== 'point')],
                                  [POINT_RING, this.handles.filter(({kind}) => kind === 'point')]]) {
      const places = some.flatMap((handle) => this.place(handle));
      strokes.dots(places, radius, accent);
      strokes.dots(places, radius - 2, halo);
    }
    const held = this.held && this.handles.find(({name, kind}) => (
      name === this.held.name && kind === this.held.kind));
    if (held) strokes.dots(this.place(held), held.kind === 'point' ? POINT_RING : PIN_RING, accent);
  }

  // Whether a line leads from the first place that was clicked on to the pointer.
  get pointing() { return this.on && Boolean(this.first && this.pointer); }

  draw() {
    const {picture} = this.page, {pen} = picture;
    pen.save();
    pen.lineWidth = 2;
    pen.strokeStyle = this.page.theme.accent;
    pen.setLineDash([5, 4]);
    pen.beginPath();
    pen.moveTo(...picture.project(this.first.at));
    pen.lineTo(...this.pointer);
    pen.stroke();
    pen.restore();
  }
}

// How far a place on the screen is from the line between two others.
function toLine([x, y], [a, b], [c, d]) {
  const [u, v] = [c - a, d - b], length = u * u + v * v || 1;
  const share = Math.max(0, Math.min(1, ((x - a) * u + (y - b) * v) / length));
  return Math.hypot(a + share * u - x, b + share * v - y);
}
