// Small multiples: the same map for each value of a third axis, and of a fourth row by row, on the colour scale of the
// map above.

const MOST_PANELS = 12, MOST_ROWS_OF_PANELS = 6, PANEL_WIDTH = 132;
const SHADES = Array.from({ length: 256 }, (_, i) => shade(i / 255));

// At most `most` positions of an axis, including that of the slider.
function placesAlong(axis, most) {
  const found = spread(axis.values.length, most), now = state.at[axis.dim];
  if (!found.includes(now)) found[nearestOf(found, now)] = now;
  return found;
}

function panelMaps(host, width, { scalar, across, down, third, fourth, log, pick, label }) {
  const { figure, inner } = scalar, { low, high } = rangeOf(scalar), names = figure.meanings;
  const rowsOf = fourth ? placesAlong(fourth, MOST_ROWS_OF_PANELS) : [0];
  const room = Math.max(2, Math.floor(width / (fourth ? 92 : PANEL_WIDTH)));
  const each = placesAlong(third, fourth ? Math.min(MOST_PANELS, room) : MOST_PANELS), abreast = fourth ? each.length : Math.min(each.length, room, each.length > room && each.length <= 2 * room ? Math.ceil(each.length / 2) : room);
  const columns = across.values.length, rows = down ? down.values.length : 1, stories = fourth ? rowsOf.length : Math.ceil(each.length / abreast);
  const ticks = (axis) => [axisValue(axis, 0), axisValue(axis, axis.values.length - 1)];
  const left = down ? Math.min(84, 14 + 6.2 * Math.max(...ticks(down).map((t) => t.length))) : 4, gap = 12, head = 20, foot = 22, over = fourth ? 18 : 0;
  const wide = Math.min((width - left - 6) / abreast - gap, 230), tall = clamp(wide * Math.min(1, Math.max(0.5, rows / columns)), 26, 190), step = head + tall + (fourth ? over : 4);
  const height = stories * step + foot + 4, sharp = window.devicePixelRatio || 1, light = getComputedStyle(document.documentElement);
  const stepOf = (axis) => figure.steps[figure.axes.indexOf(axis.dim)] || 0;
  const base = figure.offset({ ...state.at, [across.dim]: 0, ...(down ? { [down.dim]: 0 } : {}), [third.dim]: 0, ...(fourth ? { [fourth.dim]: 0 } : {}) }) + inner;
  const at = (i, j, k, l) => figure.values[base + i * stepOf(across) + (down ? j * stepOf(down) : 0) + k * stepOf(third) + (fourth ? l * stepOf(fourth) : 0)];
  const turn = log ? Math.log : (v) => v, from = turn(low), span = turn(high) - from;
  const palette = names.length ? names.map((_, i) => [1, 3, 5].map((n) => parseInt(light.getPropertyValue(`--c${i % COLOURS}`).trim().slice(n, n + 2), 16))) : null;
  const tint = (v) => (palette ? palette[v] : SHADES[span > 0 ? clamp(Math.round(255 * (turn(v) - from) / span), 0, 255) : 128]);
  const canvas = el('canvas', { class: 'under' }), pen = canvas.getContext('2d'), small = el('canvas', {}), brush = small.getContext('2d');
  canvas.width = Math.round(width * sharp); canvas.height = Math.round(height * sharp); canvas.style.width = `${width}px`;
  pen.scale(sharp, sharp); pen.imageSmoothingEnabled = false;
  small.width = columns; small.height = rows;
  const root = svg('svg', { width, height, viewBox: `0 0 ${width} ${height}`, class: 'chart map panels', role: 'img', tabindex: 0, 'aria-label': `${label} by ${third.label}${fourth ? ` and ${fourth.label}` : ''}: arrow keys move between the panels` });
  const words = svg('g', { class: 'titles' }), sides = svg('g', { class: 'ticks' }), numbers = svg('g', { class: 'numbers' }), boxes = svg('g', {});
  const cellWidth = wide / columns, cellHeight = tall / rows, fits = cellWidth >= 36 && cellHeight >= 15;
  const places = [];
  rowsOf.forEach((l, line) => each.forEach((k, number) => {
    const row = fourth ? line : Math.floor(number / abreast), column = fourth ? number : number % abreast;
    places.push({ k, l, x: left + column * (wide + gap), y: row * step + head + over, row, column });
  }));
  for (const { k, l, x, y, row, column } of places) {
    const image = brush.createImageData(columns, rows);
    for (let j = 0; j < rows; j++) for (let i = 0; i < columns; i++) {
      const v = at(i, j, k, l);
      if (!Number.isFinite(v) || (log && v <= 0)) continue;
      const shown = tint(v);
      if (!shown) continue;
      image.data.set(shown, 4 * ((rows - 1 - j) * columns + i)); image.data[4 * ((rows - 1 - j) * columns + i) + 3] = 255;
    }
    brush.putImageData(image, 0, 0);
    pen.drawImage(small, x, y, wide, tall);
    if (fits) for (let j = 0; j < rows; j++) for (let i = 0; i < columns; i++) {
      const v = at(i, j, k, l), text = names.length ? '' : say(v, 3);
      if (text && text.length * 6.2 < cellWidth) numbers.append(svg('text', { x: x + (i + 0.5) * cellWidth, y: y + (rows - 0.5 - j) * cellHeight + 4, 'text-anchor': 'middle', class: Number.isFinite(v) ? (bright(tint(v)) ? 'dark' : 'light') : 'none' }, text));
    }
    const now = k === state.at[third.dim] && (!fourth || l === state.at[fourth.dim]);
    if (!fourth || row === 0) words.append(svg('text', { x: x + wide / 2, y: y - 5, 'text-anchor': 'middle', class: now && !fourth ? 'now' : '' }, axisValue(third, k)));
    if (fourth && column === 0) words.append(svg('text', { x: left, y: y - (row === 0 ? 21 : 5), class: 'row' }, `${fourth.label} ${axisValue(fourth, l)}`));
    boxes.append(svg('rect', { class: now ? 'panel now' : 'panel', x: x - 0.5, y: y - 0.5, width: wide + 1, height: tall + 1 }));
    if (now) boxes.append(svg('rect', { class: 'chosen', x: x + state.at[across.dim] * cellWidth, y: y + (rows - 1 - (down ? state.at[down.dim] : 0)) * cellHeight, width: Math.max(cellWidth, 3), height: Math.max(cellHeight, 3) }));
    if (down && column === 0) ticks(down).forEach((text, end) => { if (rows > 1 || end === 0) sides.append(svg('text', { x: left - 5, y: end ? y + 9 : y + tall - 1, 'text-anchor': 'end' }, text)); });
    const last = fourth ? row === stories - 1 : !places.some((other) => other.column === column && other.row > row);
    if (last) ticks(across).forEach((text, end) => { if ((columns > 1 || end === 0) && (text.length * 12.6 < wide || (end === 0 && text.length * 6.3 < wide))) sides.append(svg('text', { x: end ? x + wide : x, y: y + tall + 14, 'text-anchor': end ? 'end' : 'start' }, text)); });
  }
  root.append(words, sides, numbers, boxes);
  const read = el('p', { class: 'readout' });
  const placeOf = (event) => {
    const b = root.getBoundingClientRect(), px = event.clientX - b.left, py = event.clientY - b.top;
    const one = places.find(({ x, y }) => px >= x && px < x + wide && py >= y && py < y + tall);
    return one ? [Math.floor((px - one.x) / cellWidth), rows - 1 - Math.floor((py - one.y) / cellHeight), one.k, one.l] : null;
  };
  const placed = (i, j, k, l) => ({ [across.dim]: i, ...(down ? { [down.dim]: j } : {}), [third.dim]: k, ...(fourth ? { [fourth.dim]: l } : {}) });
  const saying = (place) => { const v = at(...place); clear(read, el('strong', {}, names.length ? named(names[v] || '–') : withUnit(v, figure.units)), ` at ${where([across, down, third, fourth].filter(Boolean).map((axis) => axis.dim), { ...state.at, ...placed(...place) })}`); };
  const here = () => [state.at[across.dim], down ? state.at[down.dim] : 0, state.at[third.dim], fourth ? state.at[fourth.dim] : 0];
  root.addEventListener('pointermove', (event) => { const place = placeOf(event); if (place) saying(place); });
  root.addEventListener('pointerleave', () => saying(here()));
  root.addEventListener('click', (event) => { const place = placeOf(event); if (place) pick(placed(...place)); });
  root.addEventListener('keydown', (event) => {
    const turnTo = { ArrowLeft: [third, -1], ArrowRight: [third, 1], ArrowUp: [fourth, -1], ArrowDown: [fourth, 1] }[event.key];
    if (!turnTo || !turnTo[0]) return;
    event.preventDefault();
    host.again = true;
    pick({ [turnTo[0].dim]: clamp(state.at[turnTo[0].dim] + turnTo[1], 0, turnTo[0].values.length - 1) });
  });
  saying(here());
  const part = (axis, shown) => `${axis.label}${shown.length < axis.values.length ? ` (${shown.length} of ${axis.values.length} values)` : ''}`;
  const title = el('p', { class: 'note over' }, `Panels: ${part(third, each)}${fourth ? `; rows: ${part(fourth, rowsOf)}` : ''}. Colours as above; across ${across.label}${down ? `, up ${down.label}` : ''}. Click to go there.`);
  const focused = host.contains(document.activeElement) || host.again;
  clear(host, title, el('div', { class: 'stacked' }, canvas, root), read);
  if (focused) { host.again = false; root.focus({ preventScroll: true }); }
}
