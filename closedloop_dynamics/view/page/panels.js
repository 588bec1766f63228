// What is asked for beside the picture: drives, gravity, effects, the method.

const make = (html) => {
  const holder = document.createElement('template');
  holder.innerHTML = html.trim();
  return holder.content.firstChild;
};

// A slider with a number beside it; what is being changed by hand is not overwritten.
class Slider {
  constructor({label, unit, low, high, value, onchange, log = false, reset = null}) {
    this.log = log;
    [this.low, this.high] = [low, high];
    this.element = make(`<div class="slider"><label>${escaped(label)}</label>
      <input type="range" min="0" max="1000" aria-label="${escaped(label)}">
      <span class="entry"><input type="text" inputmode="decimal" aria-label="${escaped(label)} (${
  escaped(unit)})"><span class="unit">${escaped(unit)}</span></span></div>`);
    [this.range, this.entry] = this.element.querySelectorAll('input');
    this.onchange = onchange;
    this.range.oninput = () => this.set(this.of(this.range.valueAsNumber / 1000), true);
    if (reset !== null) this.range.ondblclick = () => this.set(reset, true);
    this.entry.onchange = () => {
      const typed = Number(this.entry.value.replace('−', '-').replace(',', '.'));
      if (Number.isFinite(typed) && this.entry.value.trim() !== '') this.set(typed, true);
      else this.show(this.value);
    };
    this.entry.onkeydown = (event) => { if (event.key === 'Enter') this.entry.blur(); };
    this.set(value, false);
  }

  of(share) {
    const [a, b] = this.log ? [Math.log(this.low), Math.log(this.high)] : [this.low, this.high];
    const value = a + share * (b - a);
    return this.log ? Math.exp(value) : value;
  }

  set(value, notify) {
    this.value = value;
    this.show(value);
    if (notify) this.onchange(value);
  }

  show(value) {
    const [a, b, v] = this.log ? [this.low, this.high, value].map(Math.log)
      : [this.low, this.high, value];
    const share = Math.max(0, Math.min(1, (v - a) / (b - a)));
    this.range.value = Math.round(1000 * share);
    const zero = this.log || this.low >= 0 ? 0
      : Math.min(1, -this.low / (this.high - this.low));
    const [from, to] = [Math.min(zero, share), Math.max(zero, share)].map((s) => `${100 * s}%`);
    this.range.style.setProperty('--from', from);
    this.range.style.setProperty('--to', to);
    if (document.activeElement !== this.entry) this.entry.value = short(value, 4);
  }

  // Take what the server sends, unless a hand is on it.
  follow(value) {
    if (document.activeElement === this.range && this.range.matches(':active')) return;
    this.value = value;
    this.show(value);
  }

  limits(low, high, unit) {
    [this.low, this.high] = [low, high];
    this.element.querySelector('.unit').textContent = unit;
    this.show(this.value);
  }
}

// Sliders of lengths, masses and parameters.
class Numbers {
  constructor(ask) { this.ask = ask; }

  describe(sliders) {
    const keys = sliders.map(({key}) => key).join();
    byId('numbers-panel').hidden = !sliders.length;
    if (keys === this.keys) {
      sliders.forEach(({key, value}) => this.sliders[key].follow(value));
      return;
    }
    this.keys = keys;
    this.sliders = {};
    const groups = [...new Set(sliders.map(({group}) => group))];
    byId('numbers').replaceChildren(...groups.map((group, k) => {
      const box = make(`<details${k ? '' : ' open'}><summary>${escaped(group)}</summary></details>`);
      for (const one of sliders.filter((each) => each.group === group)) {
        const slider = new Slider({
          label: one.label, unit: one.unit, low: one.low, high: one.high, value: one.value,
          reset: one.value, onchange: (value) => this.ask('set', {key: one.key, value})});
        this.sliders[one.key] = slider;
        box.append(slider.element);
      }
      return box;
    }));
  }
}

class Drives {
  constructor(described, place, ask) {
    this.rows = {};
    this.described = described;
    for (const drive of described.drives) {
      const row = make(`<div class="drive"><b title="${escaped(drive.joint)}">${escaped(drive.joint)}</b>
        <select aria-label="what drives ${escaped(drive.joint)}">
        ${drive.modes.map((mode) => `<option value="${mode}">${
          mode === 'torque' && drive.slides ? 'force' : mode}</option>`).join('')}</select></div>`);
      const select = row.querySelector('select');
      select.onchange = () => ask('drive', {joint: drive.joint, mode: select.value});
      const slider = new Slider({
        label: drive.slides ? 'force' : 'torque', unit: drive.slides ? 'N' : 'N m',
        low: -drive.torque, high: drive.torque, value: 0, reset: 0,
        onchange: (value) => {
          const kinematic = this.kinematic;
          ask(kinematic ? 'pose' : 'command', {joint: drive.joint, value});
        }});
      slider.element.classList.add('bare');
      const law = make(`<span class="law entry" hidden><span>=</span><input type="text"
        aria-label="position of ${escaped(drive.joint)} over the time t" title="position as an
        expression in the time t, such as 1.05+2*pi*t or 0.3*sin(2*t)"><span class="unit">${
        drive.slides ? 'm' : 'rad'}</span></span>`);
      const input = law.querySelector('input');
      input.onchange = () => ask('command', {joint: drive.joint, value: input.value});
      input.onkeydown = (event) => { if (event.key === 'Enter') input.blur(); };
      const own = make('<span class="hint own" hidden></span>');
      row.append(slider.element, law, own);
      place.append(row);
      this.rows[drive.joint] = {select, slider, law, input, own, drive, mode: 'torque'};
    }
    place.classList.toggle('long', described.drives.some(({joint}) => joint.length > 9));
    if (described.drives.length) {
      const all = make(`<div class="all group" role="group" aria-label="how it is driven">${
        [['own', 'own motion', 'as the machine is made to move: by its controller, or its drives'],
         ['held', 'held', 'all drives hold the joints where they are'],
         ['free', 'free', 'no drive exerts anything']].map(([which, text, title]) => (
          `<button data-motion="${which}" title="${title}">${text}</button>`)).join('')}</div>`);
      all.firstChild.hidden = !described.own;
      for (const button of all.children) {
        button.onclick = () => ask('motion', {which: button.dataset.motion});
      }
      place.prepend(all);
      this.all = all;
    }
  }

  // Other ends of sliders.
  describe({drives}) {
    for (const drive of drives) Object.assign(this.rows[drive.joint], {drive, mode: null});
  }

  follow({drives, kinematic, motion}, position) {
    this.kinematic = kinematic;
    if (this.all) {
      this.all.hidden = kinematic;
      for (const button of this.all.children) {
        button.setAttribute('aria-pressed', button.dataset.motion === motion);
      }
    }
    for (const [joint, {mode, value}] of Object.entries(drives)) {
      const row = this.rows[joint], now = kinematic ? 'position' : mode;
      row.select.disabled = kinematic;
      row.select.value = now;
      if (row.mode !== now) {
        row.mode = now;
        const {slides, torque, speed, position: range} = row.drive;
        if (now === 'torque') row.slider.limits(-torque, torque, slides ? 'N' : 'N m');
        else if (now === 'speed') row.slider.limits(-speed, speed, slides ? 'm/s' : 'rad/s');
        else row.slider.limits(...range, slides ? 'm' : 'rad');
        row.slider.element.hidden = now === 'expression' || now === 'own';
        row.law.hidden = now !== 'expression';
        row.own.hidden = now !== 'own';
      }
      if (now === 'expression') {
        if (document.activeElement !== row.input) row.input.value = value;
      } else if (now === 'own') row.own.textContent = value.replaceAll('_', ' ');
      else row.slider.follow(kinematic ? position(joint) : value);
    }
  }
}

// Gravity's direction: an arrow in a circle that turns, in space with a second one that tilts.
class Gravity {
  constructor(described, place, ask) {
    this.name = described.gravity;
    this.planar = described.planar;
    this.ask = ask;
    const element = make(`<div class="gravity"><label class="switch"><input type="checkbox">
      <span>gravity</span></label><canvas width="144" height="144" tabindex="0" role="slider"
      aria-label="direction of gravity" aria-valuetext=""></canvas>
      <div class="grow"></div></div>`);
    place.append(element);
    this.box = element.querySelector('input');
    this.box.onchange = () => ask('effect', {name: this.name, enabled: this.box.checked});
    this.dial = element.querySelector('canvas');
    this.size = new Slider({label: 'strength', unit: 'm/s²', low: 0, high: 20, value: 9.81,
                            onchange: (value) => { this.strength = value; this.send(); }});
    element.querySelector('.grow').append(this.size.element);
    if (!this.planar) {
      this.tilt = new Slider({label: 'tilt', unit: '°', low: 0, high: 180, value: 0,
                              onchange: (value) => {
                                this.tilted = value * Math.PI / 180;
                                this.send();
                              }});
      element.querySelector('.grow').append(this.tilt.element);
    }
    [this.angle, this.strength, this.tilted] = [-Math.PI / 2, 9.81, 0];
    const turn = (event) => {
      const box = this.dial.getBoundingClientRect();
      this.angle = Math.atan2(box.top + box.height / 2 - event.clientY,
                              event.clientX - box.left - box.width / 2);
      // To the nearest 5 degrees.
      this.angle = Math.round(this.angle / (Math.PI / 36)) * (Math.PI / 36);
      if (!this.planar && this.tilted === 0) this.tilted = Math.PI / 6;
      this.send();
    };
    this.dial.onpointerdown = (event) => {
      this.dial.setPointerCapture(event.pointerId);
      this.turning = true;
      turn(event);
    };
    this.dial.onpointermove = (event) => { if (this.turning) turn(event); };
    this.dial.onpointerup = this.dial.onpointercancel = () => { this.turning = false; };
    this.dial.onkeydown = (event) => {
      const step = {ArrowLeft: 1, ArrowRight: -1}[event.key];
      if (step) {
        this.angle += step * Math.PI / 12;
        this.send();
        event.preventDefault();
      }
    };
  }

  vector() {
    const [c, s] = [Math.cos(this.angle), Math.sin(this.angle)];
    const direction = this.planar ? [c, s]
      : [Math.sin(this.tilted) * c, Math.sin(this.tilted) * s, -Math.cos(this.tilted)];
    return direction.map((x) => this.strength * (Math.abs(x) < 1e-12 ? 0 : x));
  }

  send() {
    this.ask('effect', {name: this.name, values: {acceleration: this.vector()}});
    this.draw();
  }

  follow({effects}) {
    const {enabled, values} = effects[this.name];
    this.box.checked = enabled;
    if (!this.turning) {
      const g = values.acceleration;
      this.strength = Math.hypot(...g);
      if (this.strength > 0) {
        if (this.planar) this.angle = Math.atan2(g[1], g[0]);
        else {
          this.tilted = Math.acos(Math.max(-1, Math.min(1, -g[2] / this.strength)));
          if (Math.hypot(g[0], g[1]) > 1e-9) this.angle = Math.atan2(g[1], g[0]);
        }
      }
      this.size.follow(this.strength);
      if (this.tilt) this.tilt.follow(this.tilted * 180 / Math.PI);
    }
    this.draw();
  }

  draw() {
    const style = getComputedStyle(document.documentElement);
    const pen = this.dial.getContext('2d'), middle = 72, radius = 60;
    pen.clearRect(0, 0, 144, 144);
    pen.lineWidth = 3;
    pen.strokeStyle = style.getPropertyValue('--line');
    pen.beginPath();
    pen.arc(middle, middle, radius, 0, 7);
    pen.stroke();
    pen.globalAlpha = this.box.checked ? 1 : 0.35;
    pen.strokeStyle = pen.fillStyle = style.getPropertyValue('--accent');
    const length = radius * (this.planar ? 1 : Math.abs(Math.sin(this.tilted)));
    pen.save();
    pen.translate(middle, middle);
    pen.rotate(-this.angle);
    pen.lineWidth = 6;
    pen.lineCap = 'round';
    if (length > 12) {
      pen.beginPath();
      pen.moveTo(0, 0);
      pen.lineTo(length - 16, 0);
      pen.stroke();
      pen.beginPath();
      pen.moveTo(length, 0);
      pen.lineTo(length - 20, -11);
      pen.lineTo(length - 20, 11);
      pen.fill();
    } else {
      pen.beginPath();
      pen.arc(0, 0, 8, 0, 7);
      pen.fill();
    }
    pen.restore();
    pen.globalAlpha = 1;
  }
}

class Effects {
  constructor(described, place, ask) {
    [this.place, this.ask, this.gravity, this.rows] = [place, ask, described.gravity, null];
    this.meanings = described.meanings;
  }

  build(effects) {
    this.rows = {};
    for (const [name, effect] of Object.entries(effects)) {
      if (name === this.gravity) continue;
      const row = make(`<details class="effect"><summary><label class="switch">
        <input type="checkbox" aria-label="${escaped(name)}"><span>${escaped(name)}</span></label>
        <span class="unit">${escaped(effect.type)}</span></summary><div class="values"></div></details>`);
      const box = row.querySelector('input');
      box.onchange = () => this.ask('effect', {name, enabled: box.checked});
      const entries = {};
      for (const [key, value] of Object.entries(effect.values)) {
        if (typeof value === 'string') continue;
        const {meaning = '', unit = ''} = this.meanings[effect.type]?.[key] ?? {};
        const entry = make(`<label class="value" title="${escaped(meaning)}"><span>${
          escaped(key.replaceAll('_', ' '))}</span><input type="text" inputmode="decimal">
          <span class="unit">${escaped(unit)}</span></label>`);
        const input = entry.querySelector('input');
        input.onchange = () => {
          const text = input.value.replaceAll('−', '-');
          const numbers = text.split(/[,;\s]+/).filter(Boolean).map(Number);
          const values = Array.isArray(value) ? numbers
            : text.trim() === '' ? null : typeof value === 'boolean' ? text === 'true' : numbers[0];
          this.ask('effect', {name, values: {[key]: values}});
        };
        input.onkeydown = (event) => { if (event.key === 'Enter') input.blur(); };
        entries[key] = input;
        row.querySelector('.values').append(entry);
      }
      this.place.append(row);
      this.rows[name] = {box, entries};
    }
    this.place.hidden = !Object.keys(this.rows).length;
  }

  follow({effects}) {
    if (!this.rows) this.build(effects);
    for (const [name, {box, entries}] of Object.entries(this.rows)) {
      const {enabled, values} = effects[name];
      box.checked = enabled;
      for (const [key, input] of Object.entries(entries)) {
        if (document.activeElement === input) continue;
        const value = values[key];
        input.value = value === null ? '' : Array.isArray(value)
          ? value.map((x) => short(x, 6)).join(', ') : typeof value === 'number' ? short(value, 6)
            : value;
      }
    }
  }
}

class Method {
  constructor(described, place, ask) {
    const options = (names) => names.map((name) => (
      `<option value="${escaped(name)}">${escaped(name)}</option>`)).join('');
    const kinds = described.integrators, of = (kind) => Object.keys(kinds).filter(
      (name) => kinds[name] === kind);
    const element = make(`<div class="method"><label class="value"><span>integrator</span>
      <select data-key="integrator"><optgroup label="controls its error">${options(of('adaptive'))}
      </optgroup><optgroup label="fixed steps">${options(of('fixed step'))}</optgroup></select></label>
      <label class="value"><span>stabilisation</span><select data-key="stabilisation">${
  options(described.stabilisations)}</select></label>
      <label class="value"><span>accuracy <i>rad or m in a second</i></span><input type="text"
      inputmode="decimal" data-key="accuracy"></label>
      <label class="value"><span>budget <i>of real time</i></span><input type="text"
      inputmode="decimal" data-key="budget"></label>
      <label class="value"><span>tolerance <i>of a step</i></span><input type="text"
      inputmode="decimal" data-key="tolerance"></label>
      <label class="value"><span>step size <i>s</i></span><input type="text" inputmode="decimal"
      data-key="step_size"></label></div>`);
    place.append(element);
    this.inputs = Object.fromEntries([...element.querySelectorAll('[data-key]')].map(
      (input) => [input.dataset.key, input]));
    for (const [key, input] of Object.entries(this.inputs)) {
      input.onchange = () => ask('method', {values: {
        [key]: input.tagName === 'SELECT' ? input.value : input.value.trim() === '' ? null
          : Number(input.value.replaceAll('−', '-'))}});
      input.onkeydown = (event) => { if (event.key === 'Enter') input.blur(); };
    }
  }

  follow({method, unused}) {
    for (const [key, input] of Object.entries(this.inputs)) {
      input.closest('label').hidden = unused.includes(key) || !(key in method);
      if (!(key in method)) continue;
      if (document.activeElement === input && input.tagName === 'INPUT') continue;
      input.value = input.tagName === 'SELECT' ? method[key] : method[key] === null ? ''
        : short(method[key]).replace('−', '-');
    }
  }
}
