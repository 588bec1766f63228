// All plots: which are open, what they are drawn over, what of it is seen, and the cursor.

// A group that is closed at first, as those about the method are; most lines of a group that says of
// none that it is to be seen.
const HIDDEN = 'joint velocity', FEW = 4;
const TURN = 2 * Math.PI;
// Shortest drag, and height from which it zooms values, too [CSS pixels].
const DRAGGED = 6, TALL = 28;

// Share of what is usual for a machine below which numbers are rounding.
const ROUNDING = 1e-10;

// The largest number of a unit that is no more than rounding in a machine.
function rounding(unit, {weight, size}) {
  const work = weight * size;
  return ROUNDING * ({N: weight, 'N m': work, J: work, W: work, m: size, 'm/s': size,
                      rad: 1, 'rad/s': 1}[unit] ?? 0);
}

class Plots {
  constructor(described, place, menu, over) {
    this.described = described;
    this.groups = [];
    // The column that they are drawn over, -1: time; the part of it that is chosen by hand; the
    // time that the pointer is at; another run that is compared.
    [this.over, this.zoom, this.cursor, this.other] = [-1, null, null, null];
    const columns = described.plots.map((plot, column) => ({...plot, column}));
    const choices = [];
    for (const name of new Set(columns.map((plot) => plot.group))) {
      const plot = new Plot(name, columns.filter((one) => one.group === name)
        .sort((a, b) => b.shown - a.shown), (unit) => rounding(unit, described));
      const {method} = plot.series[0];
      plot.open = name !== HIDDEN && !method;
      plot.card.hidden = !plot.open;
      place.append(plot.card);
      const choice = make(`<label><input type="checkbox">${escaped(name)}</label>`);
      choice.firstChild.checked = plot.open;
      choice.firstChild.onchange = () => {
        plot.open = choice.firstChild.checked;
        plot.card.hidden = !plot.open;
      };
      plot.choice = choice.firstChild;
      choices.push([method, choice]);
      this.handle(plot);
      this.groups.push(plot);
    }
    this.offer(choices, menu);
    this.choose(over, columns);
    // Only what can be seen is drawn.
    this.visible = new Set();
    this.watch = new IntersectionObserver((entries) => {
      for (const entry of entries) {
        this.visible[entry.isIntersecting ? 'add' : 'delete'](entry.target);
      }
    });
    for (const plot of this.groups) this.watch.observe(plot.canvas);
  }

  // Which are open; those about the method behind one switch.
  offer(choices, menu) {
    const [motion, method] = [false, true].map((which) => (
      choices.filter(([of]) => Boolean(of) === which).map(([, choice]) => choice)));
    menu.append(...motion);
    if (!method.length) return;
    const all = make('<label><input type="checkbox" id="about-method">how it is computed:</label>');
    all.firstChild.onchange = () => {
      for (const {firstChild} of method) if (firstChild.checked !== all.firstChild.checked) firstChild.click();
    };
    menu.append(all, ...method);
  }

  // What they may be drawn over: coordinates first.
  choose(select, columns) {
    const groups = [...new Set(columns.map(({group}) => group))];
    select.replaceChildren(make('<option value="-1">over time</option>'), ...groups.map((group) => make(
      `<optgroup label="${escaped(group)}">${columns.filter((one) => one.group === group).map((one) => (
        `<option value="${one.column}">over ${escaped(one.name)}</option>`)).join('')}</optgroup>`)));
    select.onchange = () => {
      this.over = Number(select.value);
      this.reset();
    };
  }

  reset() {
    this.zoom = null;
    for (const plot of this.groups) plot.zoom = null;
  }

  recolor(colors) { for (const plot of this.groups) plot.recolor(colors); }

  // Compare with another run, null: with none; columns are those of the same names.
  compare(run) {
    this.other = run && {history: run.history, columns: this.described.plots.map(({group, name}) => (
      run.scene.plots.findIndex((one) => one.group === group && one.name === name)))};
  }

  // What is seen of the runs.
  view(history, now) {
    const over = this.over, [from, to] = this.times(history, now);
    const own = {history, columns: this.described.plots.map((_, column) => column)};
    const runs = [own, ...this.other ? [this.other] : []].filter((run) => (
      over < 0 || run.columns[over] >= 0));
    const parts = runs.map((run) => ({
      ...run, begin: run.history.before(from), end: run.history.before(to)}));
    const drawn = over < 0 ? null : this.described.plots[over];
    // All turns of an angle that makes more than one lie above one another.
    const turn = drawn && drawn.unit === 'rad' && drawn.group === 'joint position'
      && this.turns(parts) ? TURN : 0;
    const folded = (value) => (turn ? value - TURN * Math.floor(value / TURN) : value);
    for (const run of parts) {
      run.x = over < 0 ? (k) => run.history.time(k)
        : (k) => folded(run.history.value(k, run.columns[over]));
    }
    const at = Math.max(history.begin, Math.min(history.end, this.cursor ?? now));
    const x = over < 0 ? (time) => time : (time) => folded(history.valueAt(time, over));
    return {
      runs: parts, turn, at, x, pointed: this.cursor !== null, times: [from, to],
      marked: this.cursor !== null || history.fixed || over >= 0 || now < history.end,
      unit: over < 0 ? 's' : drawn.unit, name: over < 0 ? 'time' : drawn.name,
      limits: this.zoom ?? (over < 0 ? [from, to] : this.range(parts)),
      label: `t = ${short(at, 5)} s${over < 0 ? '' : `, ${short(x(at))} ${drawn.unit}`}`};
  }

  // Times that are drawn: of a live run the last ones, or those about the past that is shown.
  times(history, now) {
    if (this.over < 0 && this.zoom) return this.zoom;
    const {begin, end} = history;
    if (history.fixed) return [begin, end];
    const span = Math.max(end - Math.max(history.frames[0] ?? end, begin), 0.02);
    const from = now < end - span ? Math.max(begin, now - span / 2) : Math.max(begin, end - span);
    return [from, from + span];
  }

  // Whether a run makes more than a turn of the coordinate that they are drawn over.
  turns(runs) {
    return runs.some((run) => {
      const [low, high] = this.ends([run], (k) => run.history.value(k, run.columns[this.over]));
      return high - low > TURN;
    });
  }

  // The least and the largest of a number of all rows.
  ends(runs, of) {
    let low = Infinity, high = -Infinity;
    for (const run of runs) {
      for (let k = run.begin; k <= run.end; k++) {
        const value = of(k, run);
        if (!Number.isFinite(value)) continue;
        low = Math.min(low, value);
        high = Math.max(high, value);
      }
    }
    return [low, high];
  }

  // From the least to the largest of what they are drawn over.
  range(runs) {
    let [low, high] = this.ends(runs, (k, run) => run.x(k));
    if (!(low < high)) [low, high] = Number.isFinite(low) ? [low - 0.5, low + 0.5] : [0, 1];
    const room = 0.02 * (high - low);
    return [low - room, high + room];
  }

  draw(history, now, theme) {
    if (!history.count) return;
    const view = this.seen = this.view(history, now);
    this.history = history;
    for (const plot of this.groups) {
      if (plot.open && this.visible.has(plot.canvas)) plot.show(view, theme);
    }
  }

  // The pointer: the cursor; a drag looks closer, with shift it moves what is seen.

  handle(plot) {
    const canvas = plot.canvas;
    canvas.onpointerdown = (event) => {
      if (!plot.seen) return;
      canvas.setPointerCapture(event.pointerId);
      const begin = [event.offsetX, event.offsetY];
      if (event.shiftKey || event.button) {
        plot.moved = {begin, from: plot.seen, tall: plot.zoom !== null};
      } else plot.dragged = {begin, end: begin, tall: false};
    };
    canvas.onpointermove = (event) => {
      const place = [event.offsetX, event.offsetY];
      if (plot.dragged) {
        plot.dragged.end = place;
        plot.dragged.tall = Math.abs(place[1] - plot.dragged.begin[1]) > TALL;
      } else if (plot.moved) this.move(plot, place);
      this.point(plot, place);
    };
    canvas.onpointerup = () => {
      const {dragged} = plot;
      plot.dragged = plot.moved = null;
      if (dragged && Math.abs(dragged.end[0] - dragged.begin[0]) > DRAGGED) this.closer(plot, dragged);
    };
    canvas.onpointercancel = () => { plot.dragged = plot.moved = null; };
    canvas.onpointerleave = () => { this.cursor = null; };
    canvas.ondblclick = () => this.reset();
    canvas.oncontextmenu = (event) => event.preventDefault();
    canvas.addEventListener('wheel', (event) => {
      // Without Ctrl the page scrolls; a pinch on a touchpad comes with it.
      if (!event.ctrlKey || !plot.seen) return;
      event.preventDefault();
      const factor = Math.exp(0.002 * event.deltaY), {from, to} = plot.seen;
      const at = this.unit(plot.seen, event.offsetX);
      this.zoom = [at + factor * (from - at), at + factor * (to - at)];
    }, {passive: false});
  }

  // What is at a place across, and at a height.
  unit({left, right, from, to}, x) { return from + (x - left) / (right - left) * (to - from); }

  height({top, bottom, low, high}, y) { return low + (bottom - y) / (bottom - top) * (high - low); }

  closer(plot, {begin, end, tall}) {
    const {seen} = plot, ends = [begin, end];
    const edge = ([x]) => this.unit(seen, Math.max(seen.left, Math.min(seen.right, x)));
    this.zoom = ends.map(edge).sort((a, b) => a - b);
    if (tall) plot.zoom = ends.map(([, y]) => this.height(seen, y)).sort((a, b) => a - b);
  }

  move(plot, [x, y]) {
    const {begin, from, tall} = plot.moved;
    const dx = this.unit(from, begin[0]) - this.unit(from, x);
    this.zoom = [from.from + dx, from.to + dx];
    if (!tall) return;
    const dy = this.height(from, begin[1]) - this.height(from, y);
    plot.zoom = [from.low + dy, from.high + dy];
  }

  // The time under the pointer: of those that have the coordinate there, the last one.
  point(plot, [x]) {
    const {seen} = plot, {history} = this;
    if (!seen || x < seen.left || x > seen.right) { this.cursor = null; return; }
    const at = this.unit(seen, x);
    if (this.over < 0) { this.cursor = at; return; }
    const [{begin, end, x: place}] = this.seen.runs;
    let best = end;
    for (let k = end; k >= begin; k--) {
      if (Math.abs(place(k) - at) < Math.abs(place(best) - at)) best = k;
    }
    this.cursor = history.time(best);
  }
}
