// Lines and points in SVG: axes with round numbers, a legend, values under the pointer.

const COLOURS = 8; // --c0 .. --c7 of the style sheet
const colour = (i) => `var(--c${i % COLOURS})`;

function linearTicks(low, high, most) {
  const rough = (high - low) / Math.max(1, most), power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 2.5, 5, 10].map((m) => m * power).find((s) => s >= rough * 0.999) || 10 * power;
  const found = [];
  for (let v = Math.ceil(low / step - 1e-9) * step; v <= high + step * 1e-9 && found.length < 100; v += step) found.push(Math.abs(v) < step * 1e-9 ? 0 : Number(v.toPrecision(12)));
  return found;
}
function logTicks(low, high, most) {
  const from = Math.floor(Math.log10(low)), to = Math.ceil(Math.log10(high)), found = [];
  const decades = to - from, every = Math.max(1, Math.ceil(decades / most));
  for (let p = from; p <= to; p += every) for (const m of decades <= 2 ? [1, 2, 5] : [1]) { const v = m * 10 ** p; if (v >= low * 0.9999 && v <= high * 1.0001) found.push(Number(v.toPrecision(6))); }
  return found.length > 1 ? found : linearTicks(low, high, most);
}

// A scale from data to pixels: numbers, logarithms of numbers, or names.
function scaleOf(axis, from, to) {
  if (axis.names) {
    const step = (to - from) / axis.names.length;
    return { at: (i) => from + (i + 0.5) * step, back: (p) => clamp(Math.floor((p - from) / step), 0, axis.names.length - 1), ticks: axis.names.map((name, i) => [i, name]), names: true };
  }
  let [low, high] = axis.range;
  const log = axis.log && low > 0;
  if (!(high > low)) { const pad = Math.abs(low) * 0.1 || 1; low -= log ? low * 0.1 : pad; high += pad; }
  const turn = log ? Math.log : (v) => v;
  const [a, b] = [turn(low), turn(high)];
  const most = Math.max(2, Math.floor(Math.abs(to - from) / (axis.vertical ? 44 : 84)));
  return {
    at: (v) => from + ((turn(v) - a) / (b - a)) * (to - from),
    back: (p) => { const t = a + ((p - from) / (to - from)) * (b - a); return log ? Math.exp(t) : t; },
    ticks: (log ? logTicks(low, high, most) : linearTicks(low, high, most)).map((v) => [v, axis.say ? axis.say(v) : say(v, 3)]),
  };
}

function extent(values, log, zero) {
  let low = Infinity, high = -Infinity;
  for (const v of values) if (Number.isFinite(v) && (!log || v > 0)) { if (v < low) low = v; if (v > high) high = v; }
  if (low > high) return log ? [1, 10] : [0, 1];
  if (zero && !log && low > 0 && low < 0.35 * high) low = 0;
  if (log) return [low / (high / low) ** 0.03, high * (high / low) ** 0.03];
  const pad = (high - low) * 0.05;
  return [low === 0 ? 0 : low - pad, high + pad];
}

// Redraws when the width changes, so that nothing is stretched. Charts far from the window wait until they come near or
// the page is printed.
const unseen = new Set();
const near = new IntersectionObserver((entries) => { for (const entry of entries) { entry.target.near = entry.isIntersecting; if (entry.isIntersecting && unseen.delete(entry.target)) entry.target.drawNow(); } }, { rootMargin: '200px' });
addEventListener('beforeprint', () => { for (const host of [...unseen]) { unseen.delete(host); host.drawNow(); } });

function sized(host, draw) {
  let width = 0;
  host.drawNow = () => { const now = Math.floor(host.clientWidth); if (now > 0) { width = now; draw(now); } };
  host.redraw = () => { if (host.near) host.drawNow(); else unseen.add(host); };
  host.classList.add('empty');
  new ResizeObserver(() => { if (Math.floor(host.clientWidth) !== width) host.redraw(); }).observe(host);
  near.observe(host);
  return host;
}

function frame(width, height, x, y, margin) {
  const left = margin.left, right = width - margin.right, top = margin.top, bottom = height - margin.bottom;
  const sx = scaleOf(x, left, right), sy = scaleOf({ ...y, vertical: true }, bottom, top);
  const root = svg('svg', { width, height, viewBox: `0 0 ${width} ${height}`, class: 'chart', role: 'img' });
  const grid = svg('g', { class: 'grid' }), text = svg('g', { class: 'ticks' });
  const room = (right - left) / Math.max(1, sx.ticks.length), long = Math.max(...sx.ticks.map(([, t]) => t.length), 1);
  const slanted = sx.names && long * 6.6 > room - 4;
  const every = sx.names ? Math.max(1, Math.ceil(sx.ticks.length / Math.max(1, Math.floor((right - left) / (slanted ? 15 : 24))))) : 1;
  sx.ticks.forEach(([v, name], i) => {
    const p = sx.at(v);
    if (!sx.names) grid.append(svg('line', { x1: p, x2: p, y1: top, y2: bottom }));
    if (i % every) return;
    const short = name.length > 16 && slanted ? `${name.slice(0, 15)}…` : name;
    text.append(slanted ? svg('text', { x: p, y: bottom + 12, 'text-anchor': 'end', transform: `rotate(-38 ${p} ${bottom + 12})` }, short) : svg('text', { x: p, y: bottom + 17, 'text-anchor': 'middle' }, short));
  });
  for (const [v, name] of sy.ticks) {
    const p = sy.at(v);
    grid.append(svg('line', { x1: left, x2: right, y1: p, y2: p }));
    text.append(svg('text', { x: left - 8, y: p + 4, 'text-anchor': 'end' }, name));
  }
  const names = svg('g', { class: 'axes' },
    svg('line', { x1: left, x2: right, y1: bottom, y2: bottom }), svg('line', { x1: left, x2: left, y1: top, y2: bottom }),
    svg('text', { x: clamp((left + right) / 2, Math.min(width / 2, 3.1 * (x.label || '').length), Math.max(width / 2, width - 3.1 * (x.label || '').length)), y: height - 6, 'text-anchor': 'middle' }, x.label || ''),
    svg('text', { x: left, y: 13, 'text-anchor': 'start' }, y.label || ''));
  root.append(grid, names, text);
  return { root, sx, sy, left, right, top, bottom };
}

const MARGIN = { left: 62, right: 18, top: 26, bottom: 46 };

// series: [{name, points: [[x, y], ..], colour, dash, faint}]; marks: [{x, label}] are drawn as vertical lines.
function lines(host, width, { x, y, series, marks = [], height = 340, points = true, say: saying }) {
  const tall = x.names && Math.max(...x.names.map((n) => n.length), 1) * 6.6 > (width - 80) / x.names.length ? 40 : 0;
  const f = frame(width, height + tall, x, y, { ...MARGIN, bottom: MARGIN.bottom + tall });
  for (const mark of marks) {
    const p = f.sx.at(mark.x);
    if (!(p >= f.left && p <= f.right)) continue;
    f.root.append(svg('line', { x1: p, x2: p, y1: f.top, y2: f.bottom, class: 'mark' }), svg('text', { x: p + (p > f.right - 80 ? -5 : 5), y: f.top + 12, class: 'marked', 'text-anchor': p > f.right - 80 ? 'end' : 'start' }, mark.label));
  }
  series.forEach((one, i) => {
    const tint = one.colour || colour(i), seen = one.points.filter(([a, b]) => Number.isFinite(b) && (!y.log || b > 0) && (!x.log || a > 0));
    const path = seen.map(([a, b], k) => `${k ? 'L' : 'M'}${f.sx.at(a).toFixed(1)},${f.sy.at(b).toFixed(1)}`).join('');
    f.root.append(svg('path', { d: path, fill: 'none', stroke: tint, 'stroke-width': one.faint ? 1.25 : 2, 'stroke-dasharray': one.dash, 'stroke-linejoin': 'round', opacity: one.faint ? 0.55 : 1 }));
    if (points && seen.length <= 40) for (const [a, b] of seen) f.root.append(svg('circle', { cx: f.sx.at(a), cy: f.sy.at(b), r: 3, fill: tint }));
  });
  const dot = svg('circle', { r: 5, class: 'here', visibility: 'hidden' });
  f.root.append(dot);
  const read = el('p', { class: 'readout' }, ' ');
  f.root.addEventListener('pointermove', (event) => {
    const box = f.root.getBoundingClientRect(), px = event.clientX - box.left, py = event.clientY - box.top;
    let best = null;
    for (const one of series) for (const [a, b] of one.points) {
      if (!Number.isFinite(b) || (y.log && b <= 0)) continue;
      const d = (f.sx.at(a) - px) ** 2 + (f.sy.at(b) - py) ** 2;
      if (!best || d < best.d) best = { d, a, b, one };
    }
    if (!best) return;
    put(dot, { cx: f.sx.at(best.a), cy: f.sy.at(best.b), visibility: 'visible' }, []);
    clear(read, saying ? saying(best.one, best.a, best.b) : `${best.one.name ? `${best.one.name}: ` : ''}${say(best.b, KNOWN)} at ${x.names ? x.names[best.a] : say(best.a)}`);
  });
  f.root.addEventListener('pointerleave', () => { dot.setAttribute('visibility', 'hidden'); clear(read, ' '); });
  clear(host, f.root, legend(series), read);
  return f;
}

const legend = (series) => series.length > 1 && series.length <= 16
  ? el('ul', { class: 'legend' }, series.map((one, i) => { const sign = svg('svg', { width: 22, height: 10 }, svg('line', { x1: 1, x2: 21, y1: 5, y2: 5, stroke: one.colour || colour(i), 'stroke-width': one.faint ? 1.5 : 2.5, 'stroke-dasharray': one.dash })); return el('li', {}, sign, one.name); }))
  : null;

// Many points on a canvas, axes and front in SVG above it. points: {x: [], y: [], faint: []}; front: positions in them;
// star: the recommended one.
function scatter(host, width, { x, y, points, front, here, pick, saying, star, height = 400 }) {
  const f = frame(width, height, x, y, MARGIN);
  const canvas = el('canvas', { class: 'under' }), sharp = window.devicePixelRatio || 1;
  canvas.width = width * sharp; canvas.height = height * sharp;
  canvas.style.width = `${width}px`;
  const pen = canvas.getContext('2d'), style = getComputedStyle(document.documentElement), n = points.x.length;
  pen.scale(sharp, sharp);
  pen.fillStyle = style.getPropertyValue('--dots');
  const size = n > 5000 ? 1.5 : n > 800 ? 2.2 : 3.2, px = new Float32Array(n), py = new Float32Array(n);
  for (let i = 0; i < n; i++) {
    px[i] = f.sx.at(points.x[i]); py[i] = f.sy.at(points.y[i]);
    pen.globalAlpha = points.faint && points.faint[i] ? 0.25 : 1;
    pen.beginPath(); pen.arc(px[i], py[i], size, 0, 7); pen.fill();
  }
  const shown = front.length > 400 ? [] : front;
  f.root.append(svg('path', { d: front.map((i, k) => `${k ? 'L' : 'M'}${px[i].toFixed(1)},${py[i].toFixed(1)}`).join(''), class: 'front' }), ...shown.map((i) => svg('circle', { cx: px[i], cy: py[i], r: 4.5, class: 'front-dot' })));
  if (star !== undefined) f.root.append(svg('circle', { cx: px[star], cy: py[star], r: 7, class: 'star' }), svg('text', { x: px[star] + (px[star] > f.right - 90 ? -12 : 12), y: py[star] - 10, 'text-anchor': px[star] > f.right - 90 ? 'end' : 'start', class: 'starred' }, `${state.doc.words.build.toLowerCase()} this`));
  if (here !== null && here >= 0) f.root.append(svg('circle', { cx: px[here], cy: py[here], r: 8, class: 'chosen' }));
  const dot = svg('circle', { r: 6, class: 'here', visibility: 'hidden' }), read = el('p', { class: 'readout' }, saying(here !== null && here >= 0 ? here : -1));
  f.root.append(dot);
  const nearest = (event) => {
    const box = f.root.getBoundingClientRect(), ax = event.clientX - box.left, ay = event.clientY - box.top;
    let best = -1, least = 40 ** 2;
    for (let i = 0; i < n; i++) { const d = (px[i] - ax) ** 2 + (py[i] - ay) ** 2; if (d < least) { least = d; best = i; } }
    return best;
  };
  f.root.addEventListener('pointermove', (event) => { const i = nearest(event); if (i >= 0) { put(dot, { cx: px[i], cy: py[i], visibility: 'visible' }, []); clear(read, saying(i)); } });
  f.root.addEventListener('pointerleave', () => { dot.setAttribute('visibility', 'hidden'); clear(read, saying(here ?? -1)); });
  f.root.addEventListener('click', (event) => { const i = nearest(event); if (i >= 0) pick(i); });
  clear(host, el('div', { class: 'stacked' }, canvas, f.root), read);
}

// Positions on the front, by x: no other is at least as good in both and better in one.
function paretoFront(xs, ys, moreX, moreY) {
  const order = Array.from(xs, (_, i) => i).filter((i) => Number.isFinite(xs[i]) && Number.isFinite(ys[i]));
  const gx = (i) => (moreX ? -xs[i] : xs[i]), gy = (i) => (moreY ? -ys[i] : ys[i]);
  order.sort((a, b) => gx(a) - gx(b) || gy(a) - gy(b));
  const found = [];
  let best = Infinity;
  for (const i of order) if (gy(i) < best) { best = gy(i); found.push(i); }
  return found;
}
