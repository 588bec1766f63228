// What is plotted over time, and where its numbers are kept.

const LOGARITHMIC = ['closure error', 'error of the energy balance', 'angle from a singularity',
                     'estimated error'];
// Rows of a live motion that are kept, and frames of it that are shown.
const KEPT = 40_000, SHOWN = 600;
// Below this a logarithmic plot draws nothing.
const LEAST = 1e-18;

// Rows that came live, the newest ones, or all rows of a recording.
class History {
  constructor(width, first, times, rows) {
    this.width = width;
    this.first = first;
    this.fixed = Boolean(times);
    this.times = times ?? new Float64Array(KEPT);
    this.rows = rows ?? new Float32Array(KEPT * (width - first));
    this.skip = times ? first : 0;
    this.stride = times ? width : width - first;
    this.count = times ? times.length : 0;
    this.start = 0;
    // Times of the frames that are shown.
    this.frames = [];
  }

  add(time, values, frame = false) {
    // What comes before is of another run.
    if (this.count && time < this.time(this.count - 1)) {
      this.count = this.start = 0;
      this.frames = [];
    }
    if (frame && time !== this.frames.at(-1) && this.frames.push(time) > SHOWN) this.frames.shift();
    if (this.count && time === this.time(this.count - 1)) this.count -= 1;
    if (this.count === KEPT) {
      this.start = (this.start + 1) % KEPT;
      this.count -= 1;
    }
    const place = (this.start + this.count) % KEPT;
    this.times[place] = time;
    this.rows.set(values, place * this.stride);
    this.count += 1;
  }

  time(k) { return this.times[(this.start + k) % this.times.length]; }

  value(k, column) {
    return this.rows[((this.start + k) % this.times.length) * this.stride + this.skip + column];
  }

  // The number of the last row that is not after a time.
  before(time) {
    let low = 0, high = this.count - 1;
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if (this.time(middle) <= time) low = middle; else high = middle - 1;
    }
    return low;
  }
}

class Plot {
  constructor(group, series, colors) {
    this.group = group;
    this.log = LOGARITHMIC.includes(group);
    this.series = series.map((one, k) => ({
      ...one, color: colors[k % colors.length], dash: [[], [5, 3], [2, 2]][Math.floor(
        k / colors.length) % 3]}));
    this.card = document.createElement('div');
    this.card.className = 'plot';
    const units = [...new Set(series.map((one) => one.unit))].join(', ');
    this.card.innerHTML = `<div class="plot-head"><b>${escaped(group)}</b>
      <span class="unit">${escaped(units)}</span><span class="at"></span></div>
      <canvas role="img" aria-label="${escaped(group)} over time"></canvas>
      <div class="chips"></div>`;
    this.canvas = this.card.querySelector('canvas');
    this.chips = this.card.querySelector('.chips');
    for (const one of this.series) {
      const chip = document.createElement('button');
      chip.className = 'chip';
      chip.innerHTML = `<i style="background:${one.color}"></i>${escaped(one.name)}
        <span class="value"></span>`;
      chip.setAttribute('aria-pressed', one.shown);
      chip.onclick = () => {
        one.shown = !one.shown;
        chip.setAttribute('aria-pressed', one.shown);
      };
      one.chip = chip.querySelector('.value');
      this.chips.append(chip);
    }
    this.pointer = null;
    this.canvas.addEventListener('pointermove', (event) => { this.pointer = event.offsetX; });
    this.canvas.addEventListener('pointerleave', () => { this.pointer = null; });
  }

  draw(history, now, theme, window) {
    const canvas = this.canvas, ratio = Math.min(devicePixelRatio || 1, 2);
    const width = canvas.clientWidth, height = canvas.clientHeight;
    if (!width || !history.count) return;
    if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
      [canvas.width, canvas.height] = [Math.round(width * ratio), Math.round(height * ratio)];
    }
    const pen = canvas.getContext('2d');
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, width, height);
    const left = 50, right = width - 8, top = 6, bottom = height - 18;
    const [from, to] = window;
    const begin = history.before(from), end = history.before(to);
    const shown = this.series.filter((one) => one.shown);
    const runs = shown.map((one) => this.run(history, one, begin, end, 2 * (right - left)));
    const [low, high] = this.limits(runs);
    const x = (time) => left + (time - from) / (to - from || 1) * (right - left);
    const y = (value) => {
      const v = this.log ? Math.log10(Math.max(Math.abs(value), LEAST)) : value;
      return bottom - (v - low) / (high - low) * (bottom - top);
    };
    this.axes(pen, theme, {left, right, top, bottom, low, high, from, to, x});
    pen.save();
    pen.beginPath();
    pen.rect(left, top - 2, right - left, bottom - top + 4);
    pen.clip();
    pen.lineWidth = 1.5;
    shown.forEach((one, number) => {
      pen.strokeStyle = one.color;
      pen.setLineDash(one.dash);
      pen.beginPath();
      let down = false;
      for (const [time, value] of runs[number]) {
        if (!this.drawable(value)) { down = false; continue; }
        if (down) pen.lineTo(x(time), y(value));
        else pen.moveTo(x(time), y(value));
        down = true;
      }
      pen.stroke();
    });
    pen.setLineDash([]);
    pen.restore();
    const pointed = this.pointer !== null && this.pointer > left;
    const time = pointed ? from + (this.pointer - left) / (right - left) * (to - from) : now;
    if (pointed || history.fixed) {
      pen.strokeStyle = pointed ? theme.ink : theme.muted;
      pen.lineWidth = 1;
      pen.beginPath();
      pen.moveTo(x(time), top);
      pen.lineTo(x(time), bottom);
      pen.stroke();
    }
    const at = history.before(time);
    this.card.querySelector('.at').textContent = pointed ? `t = ${short(history.time(at), 5)} s` : '';
    for (const one of this.series) {
      const value = history.value(at, one.column);
      one.chip.textContent = `${short(value)}${Number.isFinite(value) ? ` ${one.unit}` : ''}`;
    }
  }

  drawable(value) { return Number.isFinite(value) && !(this.log && Math.abs(value) < LEAST); }

  // Times and values of a series from all its rows: where there are more than so many, the lowest
  // and the highest of neighbours, in their order.
  run(history, one, begin, end, most) {
    const key = [begin, end, most, history.count].join();
    if (history.fixed && one.key === key) return one.run;
    const run = [], every = Math.max(1, Math.ceil(2 * (end - begin + 1) / most));
    const put = (k) => run.push([history.time(k), history.value(k, one.column)]);
    for (let first = begin; first <= end; first += every) {
      let low = -1, high = -1;
      for (let k = first; k < first + every && k <= end; k++) {
        const value = history.value(k, one.column);
        if (!this.drawable(value)) continue;
        if (low < 0 || value < history.value(low, one.column)) low = k;
        if (high < 0 || value > history.value(high, one.column)) high = k;
      }
      put(low < 0 ? first : Math.min(low, high));
      if (low !== high) put(Math.max(low, high));
    }
    [one.key, one.run] = [key, run];
    return run;
  }

  limits(runs) {
    let low = Infinity, high = -Infinity;
    for (const run of runs) {
      for (const [, number] of run) {
        if (!this.drawable(number)) continue;
        const value = this.log ? Math.log10(Math.abs(number)) : number;
        low = Math.min(low, value);
        high = Math.max(high, value);
      }
    }
    if (low > high) return this.log ? [-12, 0] : [0, 1];
    if (this.log) return [Math.floor(low - 0.05), Math.max(Math.ceil(high + 0.05), Math.floor(low) + 2)];
    // What stands still is drawn as a straight line, not as its last digits.
    const least = 1e-4 * Math.max(Math.abs(low), Math.abs(high)) || 2;
    const more = Math.max(0, least - (high - low)) / 2, room = 0.08 * (high - low + 2 * more);
    return [low - more - room, high + more + room];
  }

  axes(pen, theme, {left, right, top, bottom, low, high, from, to, x}) {
    pen.font = '11px system-ui, sans-serif';
    pen.fillStyle = theme.muted;
    pen.strokeStyle = theme.line;
    pen.lineWidth = 1;
    pen.textAlign = 'right';
    pen.textBaseline = 'middle';
    const step = this.log ? Math.max(1, Math.ceil((high - low) / 3)) : tickStep(high - low, 3);
    for (let v = Math.ceil(low / step - 1e-9) * step; v <= high + 1e-9 * step; v += step) {
      const y = Math.round(bottom - (v - low) / (high - low) * (bottom - top)) + 0.5;
      pen.beginPath();
      pen.moveTo(left, y);
      pen.lineTo(right, y);
      pen.stroke();
      pen.fillText(this.log ? `1e${Math.round(v)}`.replace('-', '−') : tick(v, step), left - 6, y);
    }
    pen.textAlign = 'center';
    pen.textBaseline = 'top';
    // So few that they have room.
    const period = tickStep(to - from, 2.4);
    if (!(period > 0)) return;
    for (let t = Math.ceil(from / period - 1e-9) * period; t <= to + 1e-9 * period; t += period) {
      if (x(t) < left + 8 || x(t) > right - 14) continue;
      pen.fillText(`${tick(t, period)} s`, x(t), bottom + 5);
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

class Plots {
  constructor(described, place, menu, colors) {
    this.groups = [];
    const names = [...new Set(described.plots.map((plot) => plot.group))];
    const hidden = ['joint velocity', 'error of the energy balance'];
    names.forEach((name) => {
      const series = described.plots.map((plot, column) => ({...plot, column}))
        .filter((plot) => plot.group === name)
        .sort((a, b) => b.shown - a.shown);
      const plot = new Plot(name, series, colors);
      plot.open = !hidden.includes(name);
      place.append(plot.card);
      const choice = document.createElement('label');
      choice.innerHTML = '<input type="checkbox">' + escaped(name);
      const box = choice.firstChild;
      box.checked = plot.open;
      box.onchange = () => {
        plot.open = box.checked;
        plot.card.hidden = !plot.open;
      };
      plot.card.hidden = !plot.open;
      menu.append(choice);
      this.groups.push(plot);
    });
    // Only what can be seen is drawn.
    this.visible = new Set();
    this.watch = new IntersectionObserver((entries) => {
      for (const entry of entries) {
        this.visible[entry.isIntersecting ? 'add' : 'delete'](entry.target);
      }
    });
    for (const plot of this.groups) this.watch.observe(plot.canvas);
  }

  draw(history, now, theme) {
    if (!history.count) return;
    let window;
    if (history.fixed) window = [history.time(0), history.time(history.count - 1)];
    else {
      const end = history.time(history.count - 1);
      const begin = Math.max(history.frames[0] ?? end, history.time(0));
      window = [begin, Math.max(end, begin + 0.02)];
    }
    for (const plot of this.groups) {
      if (plot.open && this.visible.has(plot.canvas)) plot.draw(history, now, theme, window);
    }
  }
}
