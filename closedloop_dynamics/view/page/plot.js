// One plot: lines of a run, and of another one that is compared, on a canvas or in a file.

// Below this a logarithmic plot draws nothing.
const LEAST = 1e-18;
const DASHES = [[], [5, 3], [2, 2]];
// How the other run is drawn.
const OTHER = {alpha: 0.8, width: 1.3, dash: [1.5, 2]};
// Lines of a recording that are kept.
const MOST_LINES = 300;
const FONT = '11px system-ui, sans-serif';
// Width of a letter of it, at most [pixels].
const LETTER = 6.6;

class Plot {
  // `rounding`: the largest number of a unit that says nothing.
  constructor(group, series, rounding = () => 0) {
    this.group = group;
    this.log = Boolean(series[0].log);
    this.rounding = this.log ? 0 : Math.max(...series.map(({unit}) => rounding(unit)));
    // Where none is to be seen before others, the first ones are.
    const some = series.some(({shown}) => shown);
    this.series = series.map((one, k) => ({...one, number: k, shown: some ? one.shown : k < FEW}));
    this.units = [...new Set(series.map((one) => one.unit))].join(', ');
    // Values that are seen, where they were chosen by hand; what is dragged over.
    this.zoom = this.dragged = null;
    this.build();
  }

  build() {
    this.card = make(`<div class="plot"><div class="plot-head"><b>${escaped(this.group)}</b>
      <span class="unit">${escaped(this.units)}</span><span class="at"></span></div>
      <canvas role="img" aria-label="plot of ${escaped(this.group)}"
      title="drag: look closer · shift and drag: move · Ctrl and wheel: zoom · double click: all"></canvas>
      <div class="chips"></div></div>`);
    this.canvas = this.card.querySelector('canvas');
    this.chips = this.card.querySelector('.chips');
    this.at = this.card.querySelector('.at');
    for (const one of this.series) {
      const chip = make(`<button class="chip" aria-pressed="${one.shown}"><i></i>${
        escaped(one.name)} <span class="value"></span></button>`);
      chip.onclick = () => {
        one.shown = !one.shown;
        chip.setAttribute('aria-pressed', one.shown);
      };
      one.chip = chip.querySelector('.value');
      this.chips.append(chip);
    }
  }

  recolor(colors) {
    this.series.forEach((one, k) => {
      one.color = colors[k % colors.length];
      one.dash = DASHES[Math.floor(k / colors.length) % DASHES.length];
      this.chips.children[k].querySelector('i').style.background = one.color;
    });
  }

  // The frame of a plot of a size: where it is, and what is at its edges.
  frame(width, height, view) {
    const [from, to] = view.limits;
    const box = {left: 50, right: width - 8, top: 6, bottom: height - 18};
    const runs = this.runs(view, 2 * (box.right - box.left));
    const [low, high] = this.zoom ?? this.limits(runs), marks = this.marks(low, high);
    box.left = Math.max(box.left, LETTER * Math.max(...marks.map(([, text]) => text.length)) + 12);
    const x = (value) => box.left + (value - from) / (to - from || 1) * (box.right - box.left);
    const y = (value) => {
      const v = this.log ? Math.log10(Math.max(Math.abs(value), LEAST)) : value;
      return box.bottom - (v - low) / (high - low) * (box.bottom - box.top);
    };
    return {...box, width, height, from, to, low, high, x, y, runs, marks};
  }

  // Heights that are marked, with what is written at each.
  marks(low, high) {
    const decades = this.log && high - low >= 2, found = [];
    const step = decades ? Math.max(1, Math.ceil((high - low) / 3)) : tickStep(high - low, 3);
    for (let v = Math.ceil(low / step - 1e-9) * step; v <= high + 1e-9 * step; v += step) {
      found.push([this.log ? 10 ** v : v, decades ? `1e${Math.round(v)}`.replace('-', '−')
        : this.log ? short(10 ** v) : tick(v, step)]);
    }
    return found;
  }

  show(view, theme) {
    const canvas = this.canvas, ratio = Math.min(devicePixelRatio || 1, 2);
    const width = canvas.clientWidth, height = canvas.clientHeight;
    if (!width) return;
    const [wide, high] = [width, height].map((length) => Math.round(length * ratio));
    if (canvas.width !== wide || canvas.height !== high) [canvas.width, canvas.height] = [wide, high];
    const pen = canvas.getContext('2d');
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, width, height);
    this.seen = this.frame(width, height, view);
    this.draw(pen, this.seen, view, theme);
    this.mark(pen, view, theme);
    this.tell(view);
  }

  draw(pen, frame, view, theme) {
    const {left, right, top, bottom, x, y} = frame;
    this.axes(pen, theme, frame, view);
    pen.save();
    pen.beginPath();
    pen.rect(left, top - 2, right - left, bottom - top + 4);
    pen.clip();
    for (const {one, other, places} of frame.runs) {
      if (!other && !view.turn) this.band(pen, one, places, frame);
      pen.strokeStyle = one.color;
      pen.globalAlpha = other ? OTHER.alpha : 1;
      pen.lineWidth = other ? OTHER.width : 1.5;
      pen.setLineDash(other ? OTHER.dash : one.dash);
      pen.beginPath();
      let before = null;
      for (const place of places) {
        const [u, v] = place;
        if (!this.drawable(v) || !Number.isFinite(u)) { before = null; continue; }
        // An angle that begins a new turn begins a new line.
        const on = before !== null && !(view.turn && Math.abs(u - before) > view.turn / 2);
        pen[on ? 'lineTo' : 'moveTo'](x(u), y(v));
        before = u;
      }
      pen.stroke();
    }
    pen.setLineDash([]);
    pen.globalAlpha = 1;
    pen.restore();
  }

  // Two standard deviations of an estimate on both sides of it.
  band(pen, one, places, {x, y}) {
    const known = places.filter(([u, v, wide]) => wide > 0 && Number.isFinite(u) && this.drawable(v));
    if (!known.length) return;
    pen.fillStyle = one.color;
    pen.globalAlpha = 0.2;
    pen.beginPath();
    known.forEach(([u, v, wide], k) => pen[k ? 'lineTo' : 'moveTo'](x(u), y(v + wide)));
    for (const [u, v, wide] of known.reverse()) pen.lineTo(x(u), y(v - wide));
    pen.fill();
  }

  // Where the cursor is, and what is dragged over.
  mark(pen, view, theme) {
    const {left, right, top, bottom, x} = this.seen;
    pen.lineWidth = 1;
    const at = view.x(view.at);
    if (view.marked && x(at) >= left && x(at) <= right) {
      pen.strokeStyle = view.pointed ? theme.ink : theme.muted;
      pen.beginPath();
      pen.moveTo(x(at), top);
      pen.lineTo(x(at), bottom);
      pen.stroke();
    }
    if (!this.dragged) return;
    const {begin, end, tall} = this.dragged;
    pen.globalAlpha = 0.2;
    pen.fillStyle = theme.accent;
    pen.fillRect(Math.min(begin[0], end[0]), tall ? Math.min(begin[1], end[1]) : top,
                 Math.abs(end[0] - begin[0]), tall ? Math.abs(end[1] - begin[1]) : bottom - top);
    pen.globalAlpha = 1;
  }

  // Values at the cursor, or of now.
  tell(view) {
    this.at.textContent = view.pointed ? view.label : '';
    for (const one of this.series) {
      const [value, other] = view.runs.map((run) => {
        const column = run.columns[one.column];
        return column < 0 || view.at > run.history.end ? NaN : run.history.valueAt(view.at, column);
      });
      one.chip.textContent = short(Math.abs(value) > this.rounding ? value : 0 * value) + (view.runs.length > 1 ? ` | ${short(other)}` : '')
        + (Number.isFinite(value) ? ` ${one.unit}` : '');
    }
  }

  drawable(value) { return Number.isFinite(value) && !(this.log && Math.abs(value) < LEAST); }

  // The lines: of the other run first, which this one's lie above.
  runs(view, most) {
    const shown = this.series.filter((one) => one.shown);
    return view.runs.map((run, number) => ({...run, other: number > 0})).reverse().flatMap((run) => (
      shown.filter((one) => run.columns[one.column] >= 0).map((one) => ({
        one, other: run.other, places: this.run(
          run.history, run.columns[one.column], run.begin, run.end, most).map((k) => [
          run.x(k), run.history.value(k, run.columns[one.column]),
          one.deviation == null ? 0 : 2 * run.history.value(k, one.deviation)])}))));
  }

  // Numbers of the rows of a line, of all: where there are more than so many, the lowest and the
  // highest of neighbours, in their order.
  run(history, column, begin, end, most) {
    const key = [column, begin, end, most].join(), known = history.lines;
    if (history.fixed && known.has(key)) return known.get(key);
    const run = [], every = Math.max(1, Math.ceil(2 * (end - begin + 1) / most));
    for (let first = begin; first <= end; first += every) {
      let low = -1, high = -1;
      for (let k = first; k < first + every && k <= end; k++) {
        const value = history.value(k, column);
        if (!this.drawable(value)) continue;
        if (low < 0 || value < history.value(low, column)) low = k;
        if (high < 0 || value > history.value(high, column)) high = k;
      }
      run.push(low < 0 ? first : Math.min(low, high));
      if (low !== high) run.push(Math.max(low, high));
    }
    if (history.fixed) {
      if (known.size > MOST_LINES) known.clear();
      known.set(key, run);
    }
    return run;
  }

  limits(runs) {
    let low = Infinity, high = -Infinity;
    for (const {places} of runs) {
      for (const [, number] of places) {
        if (!this.drawable(number)) continue;
        const value = this.log ? Math.log10(Math.abs(number)) : number;
        low = Math.min(low, value);
        high = Math.max(high, value);
      }
    }
    if (low > high) return this.log ? [-12, 0] : [0, 1];
    if (this.log) return [Math.floor(low - 0.05), Math.max(Math.ceil(high + 0.05), Math.floor(low) + 2)];
    // What stands still is drawn as a straight line, not as its last digits.
    const most = Math.max(Math.abs(low), Math.abs(high));
    const least = most > this.rounding ? 1e-4 * most : 2;
    const more = Math.max(0, least - (high - low)) / 2, room = 0.08 * (high - low + 2 * more);
    return [low - more - room, high + more + room];
  }

  axes(pen, theme, {width, left, right, bottom, from, to, x, y, marks}, view) {
    pen.font = FONT;
    pen.fillStyle = theme.muted;
    pen.strokeStyle = theme.line;
    pen.lineWidth = 1;
    pen.textAlign = 'right';
    pen.textBaseline = 'middle';
    for (const [value, text] of marks) {
      const height = Math.round(y(value)) + 0.5;
      pen.beginPath();
      pen.moveTo(left, height);
      pen.lineTo(right, height);
      pen.stroke();
      pen.fillText(text, left - 6, height);
    }
    pen.textAlign = 'center';
    pen.textBaseline = 'top';
    // So few that they have room.
    const period = tickStep(to - from, 2.4);
    if (!(period > 0)) return;
    for (let t = Math.ceil(from / period - 1e-9) * period; t <= to + 1e-9 * period; t += period) {
      const text = `${tick(t, period)} ${view.unit}`, half = pen.measureText(text).width / 2;
      if (x(t) < left + 8 || x(t) + half > width) continue;
      pen.fillText(text, x(t), bottom + 5);
    }
  }
}

// A label of an axis, with the digits by which it differs from its neighbours.
function tick(value, step) {
  if (Math.abs(value) < 1e-9 * step) return '0';
  const lost = Math.floor(Math.log10(Math.abs(value)) + 1e-9) - Math.floor(Math.log10(step) + 1e-9);
  return short(value, Math.max(1, lost + 2));
}

// A round distance of which so many fit, at least.
function tickStep(range, count) {
  return roundDown(range / count);
}
