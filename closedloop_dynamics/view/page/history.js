// The states that a page has: the newest ones of a live run, or all rows of a recording.

// Most bytes of rows that are kept of a live run, and rows that there is room for at first.
const MOST_BYTES = 64e6, FIRST_ROWS = 1024;
// Frames of a live run that plots show.
const SHOWN = 600;
// Times of states between frames are that exact [s].
const TIME_ROUNDING = 1e-6;

class History {
  constructor({columns, bodies}, times, rows) {
    this.columns = columns;
    this.bodies = bodies.length;
    this.width = columns.width;
    this.fixed = Boolean(times);
    this.times = times ?? new Float64Array(FIRST_ROWS);
    this.rows = rows ?? new Float32Array(FIRST_ROWS * this.width);
    this.most = Math.max(FIRST_ROWS, Math.floor(MOST_BYTES / 4 / this.width));
    this.count = times ? times.length : 0;
    this.start = 0;
    // Times of the frames that are shown; of a recording, lines that were drawn.
    this.frames = [];
    this.lines = new Map();
  }

  // Return whether this is a state of another run than those before, which are forgotten.
  add(time, row, frame = false) {
    // What is sent between frames has times in single precision.
    if (!frame && Math.abs(time - this.end) < TIME_ROUNDING) time = this.end;
    const again = this.count > 0 && time < this.end;
    if (again) {
      this.count = this.start = 0;
      this.frames = [];
    }
    if (frame && time !== this.frames.at(-1) && this.frames.push(time) > SHOWN) this.frames.shift();
    if (this.count && time === this.end) this.count -= 1;
    if (this.count === this.times.length) this.makeRoom();
    const place = (this.start + this.count) % this.times.length;
    this.times[place] = time;
    this.rows.set(row, place * this.width);
    this.count += 1;
    return again;
  }

  // For one row more; in a full history the oldest goes.
  makeRoom() {
    const size = this.times.length, more = Math.min(this.most, 2 * size);
    if (more === size) {
      this.start = (this.start + 1) % size;
      this.count -= 1;
      return;
    }
    const {times, rows} = this;
    this.times = new Float64Array(more);
    this.times.set(times);
    this.rows = new Float32Array(more * this.width);
    this.rows.set(rows);
  }

  // What is kept now, as a recording.
  copy() {
    const times = new Float64Array(this.count), rows = new Float32Array(this.count * this.width);
    for (let k = 0; k < this.count; k++) {
      times[k] = this.time(k);
      rows.set(this.row(k), k * this.width);
    }
    return {times, rows};
  }

  get begin() { return this.time(0); }

  get end() { return this.time(this.count - 1); }

  time(k) { return this.times[(this.start + k) % this.times.length]; }

  row(k) {
    const first = ((this.start + k) % this.times.length) * this.width;
    return this.rows.subarray(first, first + this.width);
  }

  // What is plotted, by its number.
  value(k, plot) {
    return this.rows[((this.start + k) % this.times.length) * this.width + this.columns.plots + plot];
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

  // The rows next to a time, and how far it is from the first to the second.
  about(time) {
    const k = this.before(time), next = Math.min(k + 1, this.count - 1);
    const span = this.time(next) - this.time(k);
    return [k, next, span > 0 ? Math.max(0, Math.min(1, (time - this.time(k)) / span)) : 0];
  }

  // What is plotted at a time, on the line between the states next to it.
  valueAt(time, plot) {
    const [k, next, share] = this.about(time), value = this.value(k, plot);
    return share > 0 ? value + share * (this.value(next, plot) - value) : value;
  }

  // The row of a time, between the two next to it.
  at(time) {
    const [k, next, share] = this.about(time), row = this.row(k).slice(), after = this.row(next);
    if (!(share > 0)) return row;
    const {poses, direction, estimate = direction} = this.columns;
    const mixed = this.columns.others ?? this.width;
    for (let i = 0; i < mixed; i++) {
      if (i < direction || i >= this.columns.plots) row[i] += share * (after[i] - row[i]);
    }
    // Quaternions of one pose have two signs; the two of neighbours are to agree.
    const before = this.row(k);
    const turns = [poses, ...estimate === direction ? [] : [estimate]].flatMap((first) => (
      Array.from({length: this.bodies}, (_, b) => first + 7 * b + 3)));
    for (const q of turns) {
      let same = 0;
      for (let i = q; i < q + 4; i++) same += before[i] * after[i];
      if (same < 0) {
        for (let i = q; i < q + 4; i++) row[i] = (1 - share) * before[i] - share * after[i];
      }
    }
    return row;
  }
}

// Numbers that are packed into a page, and out of it.
function unpacked(text, Kind) {
  return new Kind(Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer);
}

function packed(values) {
  const bytes = new Uint8Array(values.buffer, values.byteOffset, values.byteLength);
  const parts = [];
  // Each part has whole groups of three bytes, so that the parts can be joined.
  for (let k = 0; k < bytes.length; k += 24_576) {
    parts.push(btoa(String.fromCharCode(...bytes.subarray(k, k + 24_576))));
  }
  return parts.join('');
}
