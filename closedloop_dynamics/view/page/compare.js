// Another run beside the one that is shown: its machine is drawn pale, its lines in the plots dotted.

// How much of the paper is in its colours.
const PALE = 0.66;

class Ghost {
  // ``scene``: the machine that it is of, as it is described; ``picture``: where it is drawn.
  constructor(picture, name, scene, history, meaning = MEANINGS.ghost) {
    [this.picture, this.name, this.scene, this.history] = [picture, name, scene, history];
    this.meaning = meaning;
    // The same picture of another machine, in paler colours.
    const pale = this.pale = Object.create(picture);
    Object.assign(pale, {
      described: scene, size: scene.size, baked: null, bakedTheme: null, stretchedTheme: null,
      everBaked: null, solids: new Map(), stretching: {}, effects: {}, ghost: null, row: null,
      frames: [], parts: new Parts(scene, picture.meshes)});
    pale.load = (parts, theme) => picture.load(parts.map((part) => ({
      ...part, color: mixed(part.color === INK ? theme.driven : part.color, theme.paper)})), theme);
    [pale.guides, pale.ropes, pale.paths] = [new Guides(pale), new Ropes(pale), new Trails(pale)];
    pale.paths.record(history);
  }

  show(time) {
    const {pale, history, scene} = this;
    const shown = Math.max(history.begin, Math.min(history.end, time));
    pale.row = history.at(shown);
    pale.frames = scene.bodies.map((_, k) => ofPose(pale.row, scene.columns.poses + 7 * k));
    pale.guides.follow();
    pale.paths.follow(shown);
  }

  drop() {
    const {pale} = this;
    for (const {mesh} of pale.solids.values()) pale.drop(mesh);
    for (const mesh of Object.values(pale.stretching)) pale.drop(mesh);
    for (const {mesh} of pale.guides.all) pale.drop(mesh);
    for (const trail of pale.paths.all) trail.drop();
  }

  // Behind the machine that is shown.
  draw(theme, ratio) {
    const {pale} = this, {gl} = pale;
    if (!pale.row) return;
    if (pale.baked !== theme) pale.bake(theme);
    for (const [body, {mesh}] of pale.solids) pale.mesh(mesh, pale.frameOf(body));
    pale.guides.draw(theme);
    pale.ropes.draw();
    pale.paths.draw({...theme, path: hex(mixed(rgb(theme.path), theme.paper, 0.45))}, ratio);
    gl.useProgram(pale.solid.program);
    gl.enable(gl.DEPTH_TEST);
    gl.clear(gl.DEPTH_BUFFER_BIT);
  }
}

const mixed = (color, paper, share = PALE) => color.map((c, k) => c + share * (paper[k] - c));
const hex = (color) => `#${color.map((c) => Math.round(255 * c).toString(16).padStart(2, '0')).join('')}`;

// The description and the states in the text of a saved page; null: it is none.
function savedRun(text) {
  const found = text.match(/<script type="application\/json" id="data">(.*?)<\/script>/s);
  const data = found && JSON.parse(found[1]);
  return data?.scene ? {scene: data.scene, history: new History(
    data.scene, unpacked(data.times, Float64Array), unpacked(data.rows, Float32Array))} : null;
}

// What can be compared, asked for by buttons.
class Comparison {
  constructor(page) {
    this.page = page;
    // Where there is room beside the plots.
    byId('runs-panel').open = matchMedia('(min-width: 1500px)').matches;
    byId('keep').hidden = !page.live;
    byId('keep').onclick = () => this.keep();
    byId('drop').onclick = () => this.take(null);
    byId('beside').onchange = async ({target}) => {
      const [file] = target.files;
      if (!file) return;
      const run = savedRun(await file.text());
      target.value = '';
      if (run) this.take(new Ghost(page.picture, file.name, run.scene, run.history));
      else page.tell(`${file.name}: expected a page that was saved here, or by closedloop view --save`);
    };
    this.ghost = this.estimate = null;
  }

  // After the machine has got other parts, or other plots.
  renew() {
    const {page} = this, {scene, history} = page, {estimate, direction} = scene.columns;
    page.plots.compare(this.ghost);
    this.estimate?.drop();
    this.estimate = (estimate ?? direction) === direction ? null : new Ghost(
      page.picture, 'as estimated', {...scene, columns: {...scene.columns, poses: estimate}}, history,
      MEANINGS.estimate);
    page.picture.ghost = this.ghost ?? this.estimate;
  }

  // The run that is shown, as it is up to now, beside the next one.
  keep() {
    const {page} = this, {times, rows} = page.history.copy();
    if (!times.length) return;
    this.take(new Ghost(page.picture, `the run kept at ${short(page.history.end, 4)} s`, page.scene,
                        new History(page.scene, times, rows)));
  }

  take(ghost) {
    const {page} = this;
    this.ghost?.drop();
    this.ghost = ghost;
    page.picture.ghost = ghost ?? this.estimate;
    page.plots.compare(ghost);
    byId('other').hidden = byId('drop').hidden = !ghost;
    byId('other').querySelector('span').textContent = ghost ? ghost.name : '';
    page.legend();
  }

  show(time) {
    this.ghost?.show(time);
    this.estimate?.show(time);
  }
}
