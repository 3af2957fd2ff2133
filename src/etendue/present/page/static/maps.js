// Maps of a metric over two axes: colour by value, numbers in the cells if there is room, the position of the sliders
// outlined.

const VIRIDIS = ['#440154', '#482475', '#414487', '#355f8d', '#2a788e', '#21918c', '#22a884', '#44bf70', '#7ad151', '#bddf26', '#fde725'];
const STOPS = VIRIDIS.map((hex) => [1, 3, 5].map((i) => parseInt(hex.slice(i, i + 2), 16)));

function shade(share) {
  const at = clamp(share, 0, 1) * (STOPS.length - 1), i = Math.min(STOPS.length - 2, Math.floor(at)), t = at - i;
  return STOPS[i].map((v, k) => Math.round(v + (STOPS[i + 1][k] - v) * t));
}
const bright = ([r, g, b]) => 0.2126 * r + 0.7152 * g + 0.0722 * b > 120;

// across, down: axes of the sweep; value(i, j): a number; pick(i, j). `meanings`: names of whole numbers; `range`: of
// the colours, if not the map's own.
function heatMap(host, width, { across, down, value, units, meanings, log, at, pick, label, range }) {
  const columns = across.values.length, rows = down ? down.values.length : 1;
  const left = down ? Math.min(110, 24 + 6.6 * Math.max(...down.values.map((_, j) => axisValue(down, j).length))) : 16;
  const bar = meanings.length ? 0 : 74, wide = width - left - 12 - bar;
  const cellWidth = wide / columns, cellHeight = rows === 1 ? 48 : rows > 30 ? 420 / rows : clamp(340 / rows, 14, 44), height = rows * cellHeight;
  const top = 26, bottom = 46, sharp = window.devicePixelRatio || 1;
  const all = new Float64Array(rows * columns);
  for (let j = 0; j < rows; j++) for (let i = 0; i < columns; i++) all[j * columns + i] = value(i, j);
  let [low, high] = [Infinity, -Infinity];
  for (const v of all) if (Number.isFinite(v) && (!log || v > 0)) { if (v < low) low = v; if (v > high) high = v; }
  if (range && Number.isFinite(low)) [low, high] = range;
  const turn = log ? Math.log : (v) => v;
  const share = (v) => (high > low ? (turn(v) - turn(low)) / (turn(high) - turn(low)) : 0.5);
  const tint = (v) => (meanings.length ? null : shade(share(v)));
  const root = svg('svg', { width, height: height + top + bottom, viewBox: `0 0 ${width} ${height + top + bottom}`, class: 'chart map', role: 'img', tabindex: 0, 'aria-label': `${label}: arrow keys move the cell` });
  const canvas = el('canvas', { class: 'under' });
  canvas.width = Math.round(width * sharp); canvas.height = Math.round((height + top + bottom) * sharp);
  canvas.style.width = `${width}px`;
  const pen = canvas.getContext('2d'), style = getComputedStyle(document.documentElement);
  pen.scale(sharp, sharp);
  const gap = cellWidth > 12 && cellHeight > 12 ? 1 : 0;
  for (let j = 0; j < rows; j++) for (let i = 0; i < columns; i++) {
    const v = all[j * columns + i];
    if (!Number.isFinite(v) || (log && v <= 0)) continue;
    pen.fillStyle = meanings.length ? style.getPropertyValue(`--c${v % COLOURS}`) : `rgb(${tint(v).join(',')})`;
    pen.fillRect(left + i * cellWidth, top + (rows - 1 - j) * cellHeight, Math.max(cellWidth - gap, 0.6), Math.max(cellHeight - gap, 0.6));
  }
  const texts = svg('g', { class: 'numbers' });
  const fits = cellWidth >= 34 && cellHeight >= 16 && rows * columns <= 900;
  if (fits) for (let j = 0; j < rows; j++) for (let i = 0; i < columns; i++) {
    const v = all[j * columns + i], name = meanings.length ? named(meanings[v] || '') : say(v, KNOWN);
    if (name.length * 6.2 > cellWidth && meanings.length) continue;
    texts.append(svg('text', { x: left + (i + 0.5) * cellWidth, y: top + (rows - 0.5 - j) * cellHeight + 4, 'text-anchor': 'middle', class: `${name.length * 6.4 > cellWidth - 4 ? 'small ' : ''}${!Number.isFinite(v) ? 'none' : meanings.length || !bright(tint(v)) ? 'light' : 'dark'}` }, name));
  }
  const ticks = svg('g', { class: 'ticks' });
  const wideName = 6.6 * Math.max(...across.values.map((_, i) => axisValue(across, i).length)) + 10, every = Math.max(1, Math.ceil(wideName / cellWidth)), stepDown = Math.max(1, Math.ceil(15 / cellHeight));
  for (let i = 0; i < columns; i += every) ticks.append(svg('text', { x: left + (i + 0.5) * cellWidth, y: top + height + 16, 'text-anchor': 'middle' }, axisValue(across, i)));
  if (down) for (let j = 0; j < rows; j += stepDown) ticks.append(svg('text', { x: left - 8, y: top + (rows - 0.5 - j) * cellHeight + 4, 'text-anchor': 'end' }, axisValue(down, j)));
  const names = svg('g', { class: 'axes' }, svg('text', { x: left + wide / 2, y: top + height + 38, 'text-anchor': 'middle' }, across.label), down ? svg('text', { x: left, y: 14, 'text-anchor': 'start' }, `↑ ${down.label}`) : null);
  const box = svg('rect', { class: 'chosen', x: left + at[0] * cellWidth - 0.5, y: top + (rows - 1 - at[1]) * cellHeight - 0.5, width: Math.max(cellWidth, 3), height: Math.max(cellHeight, 3), rx: Math.min(2, cellHeight / 2) });
  root.append(names, ticks, texts, box);
  if (bar && Number.isFinite(low)) {
    const x = left + wide + 16, steps = 40;
    for (let k = 0; k < steps; k++) root.append(svg('rect', { x, y: top + height * (1 - (k + 1) / steps), width: 12, height: height / steps + 0.6, fill: `rgb(${shade((k + 0.5) / steps).join(',')})` }));
    root.append(svg('g', { class: 'ticks' }, svg('text', { x: x + 18, y: top + 10 }, say(high, 3)), svg('text', { x: x + 18, y: top + height }, say(low, 3)), rows > 2 ? svg('text', { x: x + 18, y: top + height / 2 + 4 }, say(log ? Math.sqrt(low * high) : (low + high) / 2, 3)) : null));
  }
  const read = el('p', { class: 'readout' });
  const saying = (i, j) => {
    const v = all[j * columns + i], there = [`${across.label} ${axisValue(across, i)}`, down ? `${down.label} ${axisValue(down, j)}` : ''].filter(Boolean).join(', ');
    clear(read, el('strong', {}, meanings.length ? named(meanings[v] || '–') : withUnit(v, units, KNOWN)), ` at ${there}`);
  };
  const cellOf = (event) => {
    const b = root.getBoundingClientRect(), i = Math.floor((event.clientX - b.left - left) / cellWidth), j = rows - 1 - Math.floor((event.clientY - b.top - top) / cellHeight);
    return i >= 0 && j >= 0 && i < columns && j < rows ? [i, j] : null;
  };
  root.addEventListener('pointermove', (event) => { const c = cellOf(event); if (c) saying(...c); });
  root.addEventListener('pointerleave', () => saying(...at));
  root.addEventListener('click', (event) => { const c = cellOf(event); if (c) pick(...c); });
  root.addEventListener('keydown', (event) => {
    const step = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key];
    if (!step) return;
    event.preventDefault();
    host.again = true;
    pick(clamp(at[0] + step[0], 0, columns - 1), clamp(at[1] + step[1], 0, rows - 1));
  });
  saying(...at);
  const used = meanings.length ? el('ul', { class: 'legend' }, meanings.map((name, i) => el('li', {}, svg('svg', { width: 12, height: 12 }, svg('rect', { width: 12, height: 12, rx: 2, fill: colour(i) })), named(name)))) : null;
  const focused = host.contains(document.activeElement) || host.again;
  clear(host, el('div', { class: 'stacked' }, canvas, root), used, read);
  if (focused) { host.again = false; root.focus({ preventScroll: true }); }
}
