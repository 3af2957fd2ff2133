// Linked pictures of stages: one position and one zoom for all, nearest neighbour; two of them under a wipe; values,
// lines, histograms.

const MOST_PANES = 4, REMEMBERED = 80;

class Panes {
  constructor(doc, before = null) {
    this.doc = doc;
    this.cache = new Map();
    this.stops = 0; this.wipe = 0.5; this.mode = 'beside'; this.held = null; this.point = null; this.along = 'x'; this.fitted = false;
    this.view = { x: 0, y: 0, scale: 1 };
    const names = doc.pictured, last = names.length - 1, raw = names.findIndex((p) => p.variable === 'raw');
    const shown = names.map((p, i) => i).filter((i) => names[i].variable === 'rgb_display');
    const b = shown.length ? shown[shown.length - 1] : last, a = raw >= 0 && raw !== b ? raw : Math.max(0, b - 1);
    this.panes = [this.pane(a), this.pane(b)];
    if (before && JSON.stringify(before.doc.pictured) === JSON.stringify(names)) { // the same archive, further on: keep the current view
      this.panes = before.panes.map((p) => this.pane(p.index));
      for (const name of ['mode', 'wipe', 'stops', 'held', 'view', 'fitted', 'along']) this[name] = before[name];
    }
    this.toolbar = el('div', { class: 'controls toolbar' });
    this.area = el('div', { class: 'panes' });
    this.status = el('p', { class: 'readout', id: 'pane-status' });
    this.table = el('div', { class: 'probe', id: 'probe' }, el('p', { class: 'note' }, 'Hover over a picture.'));
    this.lineHead = el('div', { class: 'head' }); this.linePlot = el('div', { class: 'plot', id: 'line-plot' });
    this.histogramHead = el('div', { class: 'head' }); this.histogramPlot = el('div', { class: 'plot', id: 'histogram' });
    this.probe = latest((place) => this.askProbe(place));
    this.line = latest(() => this.askLine());
    this.histogram = latest(() => this.askHistogram());
    this.lineHeading(); this.histogramHeading(); this.tools(); this.build();
    const goes = (f) => Number(doc.first.curves.includes(f.variable)), first = state.figures.filter((f) => f.curve && f.dims.length && f.values.some(Number.isFinite)).sort((p, q) => goes(q) - goes(p))[0];
    if (first) {
      this.curves = el('div', { class: 'plot', id: 'first-curve' });
      sized(this.curves, (width) => drawCurves(this.curves, width, first, 0, doc, 250));
      state.told.add(() => this.curves.redraw());
    }
    state.told.add(() => this.again());
    new ResizeObserver(() => this.draw()).observe(this.area);
    this.again();
  }

  pane(index) { return { index, canvas: null, bitmap: null, said: null, why: '' }; }
  what(pane) { return this.doc.pictured[pane.index]; }
  at(pane) { return this.mode === 'wipe' && this.held && pane === this.panes[1] ? this.held : state.at; }

  tools() {
    const button = (label, title, act, pressed) => el('button', { type: 'button', title, onclick: act, 'aria-pressed': pressed === undefined ? null : String(pressed) }, label);
    const mode = (name, label) => button(label, '', () => { this.mode = name; if (name === 'wipe') this.panes.length = 2; this.tools(); this.build(); this.again(); }, this.mode === name);
    const gain = el('input', { type: 'range', min: -4, max: 8, step: 0.5, value: this.stops, 'aria-label': 'brightness in stops', oninput: () => { this.stops = Number(gain.value); gainSaid.textContent = this.saidStops(); this.again(); } }), gainSaid = el('output', {}, this.saidStops());
    clear(this.toolbar,
      el('div', { class: 'group', role: 'group', 'aria-label': 'arrangement' }, mode('beside', 'Side by side'), mode('wipe', 'Wipe A | B')),
      el('div', { class: 'group', role: 'group', 'aria-label': 'zoom' }, button('Fit', 'whole picture (0)', () => { this.fit(); this.draw(); }), button('1 : 1', 'one picture pixel per screen pixel (1)', () => this.oneToOne()), button('−', 'zoom out', () => this.zoom(0.5)), button('+', 'zoom in', () => this.zoom(2))),
      this.mode === 'beside' && this.panes.length < Math.min(MOST_PANES, this.doc.pictured.length) ? button('+ picture', 'add a stage', () => { this.panes.push(this.pane(Math.max(0, this.panes[0].index - 1))); this.tools(); this.build(); this.again(); }) : null,
      this.mode === 'wipe' && this.doc.axes.length ? (this.held ? button('B follows the sliders', '', () => { this.held = null; this.tools(); this.again(); }, true) : button('Hold B at this cell', 'A follows the sliders, B stays', () => { this.held = { ...state.at }; this.tools(); this.again(); })) : null,
      el('label', { class: 'field gain' }, el('span', {}, 'brightness of linear pictures ', gainSaid), gain));
  }
  saidStops() { return `${this.stops > 0 ? '+' : this.stops < 0 ? '−' : '±'}${Math.abs(this.stops)} stops`; }

  build() {
    const pick = (pane) => choice(this.doc.pictured.map((p, i) => ({ value: i, name: `${named(p.stage)}: ${named(p.variable)}` })), pane.index, (i) => { pane.index = Number(i); pane.bitmap = null; this.again(); this.lineHeading(); this.histogramHeading(); }, 'picture');
    clear(this.area);
    this.area.className = `panes ${this.mode}`;
    if (this.mode === 'wipe') {
      const canvas = this.canvas(this.panes[0]), slide = el('input', { type: 'range', class: 'wipe', min: 0, max: 1000, value: this.wipe * 1000, 'aria-label': 'wipe between A and B', id: 'wipe', oninput: () => { this.wipe = Number(slide.value) / 1000; this.draw(); } });
      this.panes[1].canvas = null;
      this.area.append(el('div', { class: 'pane' }, el('div', { class: 'two' }, el('span', { class: 'side' }, 'A ', pick(this.panes[0])), el('span', { class: 'side' }, 'B ', pick(this.panes[1]))), canvas, slide));
    } else this.panes.forEach((pane, i) => this.area.append(el('div', { class: 'pane' }, el('div', { class: 'two' }, pick(pane), this.panes.length > 1 ? el('button', { type: 'button', class: 'quiet', 'aria-label': 'remove', onclick: () => { this.panes.splice(i, 1); this.tools(); this.build(); this.again(); } }, '×') : null), this.canvas(pane))));
    this.draw();
  }

  canvas(pane) {
    const canvas = el('canvas', { tabindex: 0, class: 'pixels', 'aria-label': 'pixels: drag or use the arrow keys to pan, + and − to zoom' });
    pane.canvas = canvas;
    let drag = null;
    const place = (event) => { const box = canvas.getBoundingClientRect(); return this.toPlace(event.clientX - box.left - box.width / 2, event.clientY - box.top - box.height / 2); };
    canvas.addEventListener('wheel', (event) => { event.preventDefault(); this.zoom(2 ** (-event.deltaY / 240), place(event)); }, { passive: false });
    canvas.addEventListener('pointerdown', (event) => {
      const box = canvas.getBoundingClientRect();
      drag = { x: event.clientX, y: event.clientY, from: { ...this.view }, far: false, wiping: this.mode === 'wipe' && Math.abs(event.clientX - box.left - this.wipe * box.width) < 12, box };
      canvas.setPointerCapture(event.pointerId);
    });
    canvas.addEventListener('pointermove', (event) => {
      if (!drag) { this.over = place(event); this.draw(); if (!this.point) this.probe({ pane, ...this.over }); return; }
      if (drag.wiping) { this.wipe = clamp((event.clientX - drag.box.left) / drag.box.width, 0, 1); const slide = document.getElementById('wipe'); if (slide) slide.value = this.wipe * 1000; this.draw(); return; }
      if (Math.hypot(event.clientX - drag.x, event.clientY - drag.y) > 3) drag.far = true;
      if (drag.far) { this.view.x = drag.from.x - (event.clientX - drag.x) / this.view.scale; this.view.y = drag.from.y - (event.clientY - drag.y) / this.view.scale; this.draw(); }
    });
    canvas.addEventListener('pointerup', (event) => { if (drag && !drag.far && !drag.wiping) { this.point = this.point ? null : { pane, ...place(event) }; this.probe({ pane, ...place(event) }); this.draw(); this.line(); } else if (drag?.far) this.histogram(); drag = null; });
    canvas.addEventListener('pointerleave', () => { this.over = null; this.draw(); });
    canvas.addEventListener('keydown', (event) => {
      const step = 40 / this.view.scale, act = { '+': () => this.zoom(2), '=': () => this.zoom(2), '-': () => this.zoom(0.5), 0: () => { this.fit(); this.draw(); }, 1: () => this.oneToOne(), ArrowLeft: () => { this.view.x -= step; this.draw(); }, ArrowRight: () => { this.view.x += step; this.draw(); }, ArrowUp: () => { this.view.y -= step; this.draw(); }, ArrowDown: () => { this.view.y += step; this.draw(); } }[event.key];
      if (act && !event.ctrlKey && !event.metaKey) { event.preventDefault(); act(); }
    });
    return canvas;
  }

  // ---- places: um on the image plane, or samples if a picture has no place on it

  toPlace(dx, dy) { return { x: this.view.x + dx / this.view.scale, y: this.view.y + dy / this.view.scale }; }
  reference() { return this.panes.map((p) => p.said).filter(Boolean).sort((a, b) => b.width * b.dx - a.width * a.dx)[0]; }
  extent(said) { return { x: said.x - said.dx / 2, y: said.y - said.dy / 2, width: said.width * said.dx, height: said.height * said.dy }; }
  // Where a picture lies in the view: its own place, or, if it has none on the plane, that of a picture that has.
  box(said) {
    const other = this.panes.map((p) => p.said).find((s) => s && s.plane);
    return !said.plane && other ? this.extent(other) : this.extent(said);
  }
  fit() {
    const pane = this.panes.find((p) => p.said && p.canvas);
    if (!pane) return;
    const smallest = this.panes.map((p) => p.said).filter(Boolean).map((s) => this.box(s)).sort((a, b) => a.width - b.width)[0];
    this.view.x = smallest.x + smallest.width / 2; this.view.y = smallest.y + smallest.height / 2;
    this.view.scale = Math.min(pane.canvas.clientWidth / smallest.width, pane.canvas.clientHeight / smallest.height) || 1;
    this.fitted = true;
    this.histogram();
  }
  oneToOne() { const said = (this.panes.find((p) => p.said && p.canvas) || {}).said; if (said) { this.view.scale = 1 / (this.box(said).width / said.width) / (window.devicePixelRatio || 1); this.draw(); this.histogram(); } }
  zoom(factor, about = { x: this.view.x, y: this.view.y }) {
    const scale = clamp(this.view.scale * factor, 1e-4, 1e5), k = this.view.scale / scale;
    this.view = { scale, x: about.x + (this.view.x - about.x) * k, y: about.y + (this.view.y - about.y) * k };
    this.draw(); this.histogram();
  }

  // ---- pictures

  again() { this.asked = (this.asked || 0) + 1; const now = this.asked; return Promise.all(this.panes.map((pane) => this.load(pane, now))).then(() => { if (now !== this.asked) return; if (!this.fitted) this.fit(); this.draw(); this.histogram(); if (this.point) { this.probe(this.point); this.line(); } this.area.dataset.shown = placesOf(state.at); }); }

  async load(pane, now) {
    const { stage, variable } = this.what(pane), at = this.at(pane), reach = this.doc.stages.find((s) => s.name === stage).axes, key = [stage, variable, this.stops, serial, ...reach.map((dim) => at[dim])].join('|');
    let found = this.cache.get(key);
    if (!found) {
      try {
        const answer = await ask('picture', { stage, variable, at: placesOf(at), stops: this.stops }), said = JSON.parse(answer.headers.get('X-Picture'));
        if (said.why) throw new Error(said.why);
        const bitmap = document.createElement('canvas');
        bitmap.width = said.width; bitmap.height = said.height;
        bitmap.getContext('2d').putImageData(new ImageData(new Uint8ClampedArray(await answer.arrayBuffer()), said.width, said.height), 0, 0);
        found = { said, bitmap, why: '' };
        this.cache.set(key, found);
        if (this.cache.size > REMEMBERED) this.cache.delete(this.cache.keys().next().value);
      } catch (error) { found = { said: null, bitmap: null, why: error.message }; }
    }
    if (now === this.asked) Object.assign(pane, found);
  }

  draw() { if (!this.drawing) { this.drawing = true; requestAnimationFrame(() => { this.drawing = false; this.paint(); }); } }
  paint() {
    const style = getComputedStyle(document.documentElement);
    for (const pane of this.panes) {
      const canvas = pane.canvas;
      if (!canvas || !canvas.clientWidth) continue;
      const sharp = window.devicePixelRatio || 1, width = Math.round(canvas.clientWidth * sharp), height = Math.round(canvas.clientHeight * sharp);
      if (canvas.width !== width || canvas.height !== height) { canvas.width = width; canvas.height = height; }
      const pen = canvas.getContext('2d');
      pen.fillStyle = style.getPropertyValue('--tile'); pen.fillRect(0, 0, width, height);
      if (this.mode === 'wipe') {
        const split = Math.round(this.wipe * width);
        pen.save(); pen.beginPath(); pen.rect(0, 0, split, height); pen.clip(); this.stamp(pen, this.panes[0], width, height, sharp); pen.restore();
        pen.save(); pen.beginPath(); pen.rect(split, 0, width - split, height); pen.clip(); this.stamp(pen, this.panes[1], width, height, sharp); pen.restore();
        pen.fillStyle = '#fff'; pen.fillRect(split - sharp, 0, 2 * sharp, height);
        pen.fillStyle = 'rgba(0,0,0,.55)'; pen.fillRect(split - 2 * sharp, 0, sharp, height); pen.fillRect(split + sharp, 0, sharp, height);
      } else this.stamp(pen, pane, width, height, sharp);
      const mark = this.point || this.over;
      if (mark) {
        const x = Math.round(((mark.x - this.view.x) * this.view.scale) * sharp + width / 2) + 0.5, y = Math.round(((mark.y - this.view.y) * this.view.scale) * sharp + height / 2) + 0.5;
        for (const [tint, wide] of [['rgba(0,0,0,.6)', 3], ['#fff', 1]]) { pen.strokeStyle = tint; pen.lineWidth = wide * sharp; pen.beginPath(); pen.moveTo(x - 9 * sharp, y); pen.lineTo(x + 9 * sharp, y); pen.moveTo(x, y - 9 * sharp); pen.lineTo(x, y + 9 * sharp); pen.stroke(); }
      }
      if (this.mode === 'wipe') break;
    }
    const said = this.panes.map((p) => p.said).find(Boolean), zoomed = said ? this.view.scale * (this.box(said).width / said.width) * (window.devicePixelRatio || 1) : 1;
    clear(this.status, said ? `${zoomed >= 1 ? `${say(zoomed, 3)} screen pixels per pixel` : `1 screen pixel shows ${say(1 / zoomed, 3)} pixels`} of ${named(this.what(this.panes.find((p) => p.said)).stage)}${this.held && this.mode === 'wipe' ? ` · B held at ${where(this.doc.axes.map((a) => a.dim), this.held)}` : ''}` : ' ');
  }
  stamp(pen, pane, width, height, sharp) {
    if (!pane.bitmap) { pen.fillStyle = getComputedStyle(document.documentElement).getPropertyValue('--soft'); pen.font = `${14 * sharp}px system-ui, sans-serif`; pen.textAlign = 'center'; pen.fillText(pane.why ? `no picture: ${pane.why.slice(0, 60)}` : 'loading …', width / 2, height / 2); return; }
    const b = this.box(pane.said), k = this.view.scale * sharp;
    pen.imageSmoothingEnabled = k * (b.width / pane.said.width) < 0.999; // never interpolate pixels that are large enough to see
    pen.drawImage(pane.bitmap, (b.x - this.view.x) * k + width / 2, (b.y - this.view.y) * k + height / 2, b.width * k, b.height * k);
  }

  // ---- values

  sampleOf(pane, place) {
    if (!pane.said) return null;
    const b = this.box(pane.said), u = (place.x - b.x) / b.width, v = (place.y - b.y) / b.height;
    return u >= 0 && v >= 0 && u < 1 && v < 1 ? { u, v, column: Math.floor(u * pane.said.width), row: Math.floor(v * pane.said.height) } : null;
  }
  words(place) {
    const said = place.pane.said, s = this.sampleOf(place.pane, place);
    if (!s) return null;
    const own = this.extent(said), x = said.plane ? place.x : own.x + s.u * own.width, y = said.plane ? place.y : own.y + s.v * own.height;
    return { at: placesOf(this.at(place.pane)), plane: said.plane ? '1' : '0', x, y, u: s.u, v: s.v };
  }
  async askProbe(place) {
    const words = this.words(place);
    if (!words) return;
    const { rows } = await (await ask('probe', words)).json(), many = (r) => r.values.length > 4;
    const value = (r) => (r.why ? el('span', { class: 'soft' }, r.why) : many(r) ? `${say(Math.min(...r.values))} … ${say(Math.max(...r.values))} in ${r.values.length} ${r.dims.some((dim) => this.doc.bins.includes(dim)) ? 'bands' : 'values'}` : r.values.map((v, i) => `${r.labels[i] ? `${r.labels[i]} ` : r.filter ? `${r.filter} ` : ''}${say(v, 5)}`).join('  '));
    const shown = tableOf(['stage', 'value', '', 'pixel'], rows.map((r) => [named(r.stage), el('span', { 'data-probe': `${r.stage}.${r.variable}`, 'data-values': JSON.stringify(r.values || []), 'data-row': r.row, 'data-column': r.column }, value(r)), unit(r.units || ''), r.why ? '' : `${r.row}, ${r.column}`]), 9);
    clear(this.table, el('p', { class: 'note' }, `${place.pane.said.plane ? `x ${say(Math.abs(place.x) < 1e-6 ? 0 : place.x, 4)} µm, y ${say(Math.abs(place.y) < 1e-6 ? 0 : place.y, 4)} µm on the image plane` : 'in samples of the picture'}${this.point ? ' · pinned; click a picture to release' : ''}`), shown);
    this.last = place;
    if (!this.point) this.line();
  }

  lineHeading() {
    clear(this.lineHead, el('h3', {}, 'Line profile'), el('div', { class: 'group' }, ['x', 'y'].map((along) => el('button', { type: 'button', 'aria-pressed': String(this.along === along), onclick: () => { this.along = along; this.lineHeading(); this.line(); } }, along === 'x' ? 'row' : 'column'))));
  }
  async askLine() {
    const place = this.point || this.last, s = place && this.sampleOf(place.pane, place);
    if (!s) return;
    const what = this.what(place.pane), number = this.along === 'x' ? s.row : s.column;
    const found = await (await ask('line', { ...what, at: placesOf(this.at(place.pane)), along: this.along, at_sample: number })).json();
    const tints = { R: '#d1453b', G: '#2e9e5b', B: '#3d74d6' };
    const series = Object.entries(found.series).map(([name, values], i) => ({ name, colour: tints[name] || colour(i), points: values.map((v, k) => [found.start + k * found.step, v]).filter((p) => p[1] !== null) }));
    const draw = (width) => lines(this.linePlot, width, { height: 230, points: false, x: { range: extent(series.flatMap((l) => l.points.map((p) => p[0]))), label: `${this.along}${found.plane ? ' (µm)' : ' (pixel)'}, ${this.along === 'x' ? 'row' : 'column'} ${number}` }, y: { range: extent(series.flatMap((l) => l.points.map((p) => p[1])), false, true), label: `${named(what.stage)}: ${named(what.variable)}${found.units ? ` (${unit(found.units)})` : ''}` }, series });
    if (this.linePlot.redraw) { this.linePlot.drawer = draw; this.linePlot.redraw(); } else { this.linePlot.drawer = draw; sized(this.linePlot, (width) => this.linePlot.drawer(width)); }
  }

  histogramHeading() { clear(this.histogramHead, el('h3', {}, `Histogram of the visible part of ${named(this.what(this.panes[0]).stage)}: ${named(this.what(this.panes[0]).variable)}`)); }
  async askHistogram() {
    const pane = this.panes[0];
    this.histogramHeading();
    if (!pane.said || !pane.canvas) return;
    const b = this.box(pane.said), half = { x: pane.canvas.clientWidth / 2 / this.view.scale, y: pane.canvas.clientHeight / 2 / this.view.scale }, w = pane.said.width, h = pane.said.height;
    const rows = [this.view.y - half.y, this.view.y + half.y].map((y) => ((y - b.y) / b.height) * h), columns = [this.view.x - half.x, this.view.x + half.x].map((x) => ((x - b.x) / b.width) * w);
    const found = await (await ask('histogram', { ...this.what(pane), at: placesOf(this.at(pane)), y0: clamp(Math.floor(rows[0]), 0, h), y1: clamp(Math.ceil(rows[1]), 0, h), x0: clamp(Math.floor(columns[0]), 0, w), x1: clamp(Math.ceil(columns[1]), 0, w) })).json();
    if (!found.channels.length) { clear(this.histogramPlot, el('p', { class: 'note' }, 'No part of it is visible.')); return; }
    const tints = { R: '#d1453b', G: '#2e9e5b', B: '#3d74d6' }, step = (found.high - found.low) / found.channels[0].counts.length || 1;
    const series = found.channels.map((c, i) => ({ name: c.name, colour: tints[c.name] || colour(i), points: c.counts.flatMap((n, k) => [[found.low + k * step, n], [found.low + (k + 1) * step, n]]) }));
    const share = (v) => (v === null ? '–' : v === 0 ? '0' : `${say(100 * v, 3)} %`), statistics = tableOf(['', 'mean', 'std dev', 'mean / std dev', 'at or below 0', 'clipped'], found.channels.map((c) => [c.name || 'all', say(c.mean), say(c.deviation, 3), c.deviation > 0 ? say(c.mean / c.deviation, 3) : '–', share(c.at_zero), share(c.at_top)]), 1);
    const draw = (width) => { lines(this.histogramPlot, width, { height: 220, points: false, x: { range: [found.low, found.high], label: `value${found.units ? ` (${unit(found.units)})` : ''}` }, y: { range: extent(series.flatMap((l) => l.points.map((p) => p[1])), false, true), label: 'pixels' }, series, marks: found.ceiling && found.ceiling <= found.high ? [{ x: found.ceiling, label: 'clipped' }] : [] }); this.histogramPlot.append(statistics); };
    if (this.histogramPlot.redraw) { this.histogramPlot.drawer = draw; this.histogramPlot.redraw(); } else { this.histogramPlot.drawer = draw; sized(this.histogramPlot, (width) => this.histogramPlot.drawer(width)); }
  }
}
