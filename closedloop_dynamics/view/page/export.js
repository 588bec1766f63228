// Files that a page writes: pictures, plots, numbers, and itself with what it has seen in it.

// This page as it came, before and after its data.
const [BEFORE_DATA, AFTER_DATA] = (() => {
  const page = `<!DOCTYPE html>\n${document.documentElement.outerHTML}`;
  const begin = page.indexOf('id="data">') + 'id="data">'.length;
  return [page.slice(0, begin), `${page.slice(page.indexOf('<\/script>', begin))}\n`];
})();
// A sheet of plots [pixels]: width, height of each, room above and below it.
const SHEET = {width: 640, height: 190, head: 26, foot: 24, margin: 12};
// Dots of a picture for each pixel.
const FINE = 2;
// Rows of a table that are written at once.
const ROWS = 500;

class Files {
  constructor(page) {
    this.page = page;
    for (const button of document.querySelectorAll('#files button')) {
      button.onclick = async () => this.give(...await this.make(button.dataset.file));
    }
  }

  get name() { return this.page.scene.title.replace(/[^A-Za-z0-9_-]+/g, '_').replace(/^_+|_+$/g, ''); }

  give(name, blob) {
    // A link in the page's own document: in that of a template, without a window, a click does nothing.
    const link = Object.assign(document.createElement('a'), {
      download: name, href: URL.createObjectURL(blob)});
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 60_000);
  }

  // The name and the content of a file.
  async make(what) {
    const {name} = this, kinds = {svg: 'image/svg+xml', csv: 'text/csv', html: 'text/html'};
    const text = (ending, parts) => [`${name}.${ending}`, new Blob(
      parts, {type: `${kinds[ending.split('.').pop()]};charset=utf-8`})];
    if (what === 'picture.png') return [`${name}.png`, await this.picture()];
    if (what === 'picture.svg') return text('svg', [this.drawing()]);
    if (what === 'plots.png') return [`${name}_plots.png`, await this.sheetPicture()];
    if (what === 'plots.svg') {
      const [width, height] = this.sheetSize(), pen = new SvgPen(width, height);
      this.sheet(pen);
      const [, blob] = text('svg', [pen.svg()]);
      return [`${name}_plots.svg`, blob];
    }
    return what === 'csv' ? text('csv', [...this.table()]) : text('html', this.document());
  }

  // The machine.

  async picture() {
    const {picture, theme} = this.page, {canvas, lines} = picture;
    picture.draw(theme);
    // What WebGL has drawn is there until the browser goes on.
    const copy = document.createElement('canvas');
    [copy.width, copy.height] = [canvas.width, canvas.height];
    const pen = copy.getContext('2d');
    pen.drawImage(canvas, 0, 0);
    if (!lines.hidden) pen.drawImage(lines, 0, 0, canvas.width, canvas.height);
    return blobOf(copy);
  }

  drawing() {
    const {picture, theme} = this.page, {clientWidth, clientHeight} = picture.canvas;
    const pen = new SvgPen(clientWidth, clientHeight);
    pen.fillStyle = hex(theme.paper);
    pen.fillRect(0, 0, clientWidth, clientHeight);
    new VectorPicture(picture, theme).write(pen);
    return pen.svg();
  }

  // The plots that are open.

  get open() { return this.page.plots.groups.filter((plot) => plot.open); }

  sheetSize() {
    const {width, height, head, foot, margin} = SHEET;
    return [width, 2 * margin + this.open.length * (head + height + foot)];
  }

  sheet(pen) {
    const {plots, history, now, theme} = this.page, {width, height, head, foot, margin} = SHEET;
    const view = plots.view(history, now);
    pen.fillStyle = hex(theme.card);
    pen.fillRect(0, 0, ...this.sheetSize());
    this.open.forEach((plot, k) => {
      pen.save();
      pen.translate(margin, margin + k * (head + height + foot));
      pen.textAlign = 'left';
      pen.textBaseline = 'alphabetic';
      pen.font = '600 13px system-ui, sans-serif';
      pen.fillStyle = theme.ink;
      pen.fillText(`${plot.group}${plot.units && ` [${plot.units}]`} over ${view.name}`, 0, 15);
      pen.translate(0, head);
      plot.draw(pen, plot.frame(width - 2 * margin, height, view), view, theme);
      pen.translate(0, height + 12);
      this.keys(pen, plot, view, theme, width - 2 * margin);
      pen.restore();
    });
  }

  // Which line is which, as many as there is room for.
  keys(pen, plot, view, theme, width) {
    pen.font = FONT;
    pen.textAlign = 'left';
    pen.textBaseline = 'middle';
    const lines = plot.series.filter((one) => one.shown).map(({name, color, dash}) => (
      {name, color, dash, alpha: 1, wide: 2}));
    if (view.runs.length > 1) {
      lines.unshift({name: this.page.comparison.ghost.name, color: theme.ink, ...OTHER, wide: OTHER.width});
    }
    let x = 50;
    for (const {name, color, dash, alpha, wide} of lines) {
      const length = pen.measureText(name).width;
      if (x + 24 + length > width) break;
      pen.strokeStyle = color;
      pen.globalAlpha = alpha;
      pen.lineWidth = wide;
      pen.setLineDash(dash);
      pen.beginPath();
      pen.moveTo(x, 0);
      pen.lineTo(x + 18, 0);
      pen.stroke();
      pen.setLineDash([]);
      pen.globalAlpha = 1;
      pen.fillStyle = theme.ink;
      pen.fillText(name, x + 23, 0);
      x += 38 + length;
    }
  }

  async sheetPicture() {
    const canvas = document.createElement('canvas'), size = this.sheetSize();
    [canvas.width, canvas.height] = size.map((length) => FINE * length);
    const pen = canvas.getContext('2d');
    pen.scale(FINE, FINE);
    this.sheet(pen);
    return blobOf(canvas);
  }

  // All states that are kept, with all their numbers, as `closedloop` reads them.

  * table() {
    const {history, scene} = this.page;
    const columns = scene.files.map((name, k) => [name, k]).filter(([name]) => name);
    const quoted = (name) => (/[",\n]/.test(name) ? `"${name.replaceAll('"', '""')}"` : name);
    yield `${['time [s]', ...columns.map(([name]) => name)].map(quoted).join()}\n`;
    // Numbers of single precision have so many digits.
    const digits = (value) => (Number.isFinite(value) ? String(Number(value.toPrecision(9))) : 'nan');
    for (let first = 0; first < history.count; first += ROWS) {
      const lines = [];
      for (let k = first; k < Math.min(first + ROWS, history.count); k++) {
        const row = history.row(k);
        lines.push([history.time(k), ...columns.map(([, column]) => digits(row[column]))].join());
      }
      yield `${lines.join('\n')}\n`;
    }
  }

  // This page as a recording.
  document() {
    const {page} = this, {times, rows} = page.history.copy();
    const scene = {...page.scene, mode: 'recording', handles: null, sliders: null, curves: null};
    const data = {scene, count: times.length, times: packed(times), rows: packed(rows)};
    // In a script, '</' would end it.
    return [BEFORE_DATA, JSON.stringify(data).replaceAll('<', '\\u003c'), AFTER_DATA];
  }
}

const blobOf = (canvas) => new Promise((done) => { canvas.toBlob(done, 'image/png'); });
