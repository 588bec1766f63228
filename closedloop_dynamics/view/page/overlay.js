// What is written and ringed above the picture: names, measures, what the pointer is on.

class Overlay {
  constructor(scene) {
    this.scene = scene;
    this.pen = scene.pen;
  }

  draw(theme) {
    const {pen, scene} = this, {lines, canvas, held, handAt, measured, shown, above} = scene;
    const touched = held ?? scene.hover;
    lines.hidden = !touched && !shown.names && !measured?.length && !above?.pointing;
    if (lines.hidden) return;
    const ratio = lines.width / canvas.clientWidth;
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, canvas.clientWidth, canvas.clientHeight);
    pen.lineJoin = pen.lineCap = 'round';
    if (held && handAt) {
      const [a, b] = [scene.grabbed(held), handAt].map((place) => scene.project(place));
      pen.strokeStyle = theme.accent;
      pen.lineWidth = 2;
      pen.setLineDash([5, 4]);
      pen.beginPath();
      pen.moveTo(a[0], a[1]);
      pen.lineTo(b[0], b[1]);
      pen.stroke();
      pen.setLineDash([]);
      this.ring(b, 6, theme.accent);
    }
    if (touched) this.ring(scene.project(scene.grabbed(touched)), 9, theme.accent);
    if (measured) this.drawMeasured(theme);
    if (shown.names) this.drawNames(theme);
    if (above?.pointing) above.draw();
  }

  // Distances between neighbours of the measured places, and the angle at the middle one.
  drawMeasured(theme) {
    const {pen, scene} = this;
    const flat = scene.measured.map((one) => scene.project(scene.grabbed(one)));
    pen.strokeStyle = theme.accent;
    pen.lineWidth = 2;
    pen.beginPath();
    flat.forEach(([x, y], k) => { pen[k ? 'lineTo' : 'moveTo'](x, y); });
    pen.stroke();
    for (const place of flat) this.ring(place, 6, theme.accent);
    scene.measurements().forEach(({text, at, unit}) => {
      const [x, middle] = scene.project(at), y = middle + (unit === 'm' ? 0 : 30);
      pen.font = '600 13px system-ui, sans-serif';
      pen.lineWidth = 4;
      pen.strokeStyle = theme.halo;
      pen.strokeText(text, x + 12, y - 10);
      pen.fillStyle = theme.accent;
      pen.fillText(text, x + 12, y - 10);
    });
  }

  ring([x, y], radius, color) {
    const pen = this.pen;
    pen.strokeStyle = color;
    pen.lineWidth = 2.2;
    pen.beginPath();
    pen.arc(x, y, radius, 0, 7);
    pen.stroke();
  }

  drawNames(theme) {
    const {pen, scene} = this, taken = [];
    pen.font = '600 12px system-ui, sans-serif';
    pen.lineWidth = 3.5;
    const write = (text, place, color) => {
      let [x, y] = scene.project(place);
      x += 10;
      y -= 8;
      const width = pen.measureText(text).width;
      // One below the other where they would overlap.
      while (taken.some((box) => Math.abs(box[1] - y) < 14 && x < box[0] + box[2] && box[0] < x + width)) {
        y += 14;
      }
      taken.push([x, y, width]);
      pen.strokeStyle = theme.halo;
      pen.strokeText(text, x, y);
      pen.fillStyle = color;
      pen.fillText(text, x, y);
    };
    for (const joint of scene.described.joints) {
      write(joint.name, moved(scene.frameOf(joint.parent), joint.place), theme.ink);
    }
    for (const cut of scene.described.cuts) {
      write(cut.name, moved(scene.frameOf(cut.body_a), cut.point_a), theme.cut);
    }
  }
}
