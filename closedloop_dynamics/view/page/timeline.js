// Time that is shown: of a recording, or of a live run the present, or the past that is kept of it.

class Timeline {
  constructor(page) {
    this.page = page;
    // The time that is shown of a run that is live; null: the present.
    this.past = null;
    this.slider = byId('time');
    this.slider.oninput = () => this.seek(this.of(this.slider.valueAsNumber / 1000));
    byId('live').hidden = byId('kept').hidden = !page.live;
    byId('live').onclick = () => this.present();
  }

  of(share) {
    const {begin, end} = this.page.history;
    return begin + share * (end - begin);
  }

  seek(time) {
    const {page} = this;
    page.picture.forgetPeaks();
    if (page.live) this.past = time >= page.history.end ? null : time;
    else page.now = time;
    if (this.past === null && page.live) this.present();
  }

  // Show the present of a live run again.
  present() {
    this.past = null;
    const {page} = this;
    if (!page.frame) return;
    page.now = page.frame.time;
    page.shownRow = page.frame.row;
    page.picture.show(page.shownRow, page.now);
  }

  // Show the past, as far as it is kept.
  show() {
    const {page} = this;
    this.past = Math.max(this.past, page.history.begin);
    page.now = this.past;
    page.shownRow = page.history.at(page.now);
    page.picture.show(page.shownRow, page.now);
  }

  draw() {
    const {history, now, live} = this.page, {begin, end} = history;
    const share = (live && this.past === null) || !(end > begin) ? Number(live)
      : (now - begin) / (end - begin);
    if (!this.slider.matches(':active')) this.slider.value = Math.round(1000 * share);
    this.slider.style.setProperty('--to', `${100 * share}%`);
    if (!live) return;
    byId('kept').textContent = end > begin ? `${short(end - begin, 3)} s kept` : '';
    byId('live').setAttribute('aria-pressed', this.past === null);
  }
}
