// Exploration of the sweep: maps, curves, trade-offs.

const moreIsBetter = (scalar) => scalar.figure.better !== 'lower';
const rank = (scalar) => { const i = state.doc.opening.open.findIndex((one) => isSaid(scalar, one)); return i < 0 ? state.doc.opening.open.length : i; };
const options = (scalars) => scalars.map((s) => ({ value: s.id, name: `${s.name}${s.figure.units ? ` (${unit(s.figure.units)})` : ''}`, group: `${named(s.figure.stage)}` }));
const dotsOf = (scalar) => `${scalar.figure.label}${scalar.of ? `, ${scalar.of}` : ''}`;
const axisLabel = (scalar) => `${scalar.name}${scalar.figure.units ? ` (${unit(scalar.figure.units)})` : ''}`;

// The first by rank: each variable once, or with `apart` each stage once.
function best(scalars, n, apart = false, varying = true) {
  const seen = new Set(), found = [];
  for (const s of [...scalars].sort((a, b) => rank(a) - rank(b) || b.inner - a.inner)) {
    const key = apart ? s.figure.stage : s.figure.variable;
    if (seen.has(key) || !rangeOf(s).known || (varying && !rangeOf(s).varies) || s.figure.meanings.length) continue;
    seen.add(key); found.push(s);
    if (found.length === n) break;
  }
  return found;
}

// ---- maps and lines over the axes

function mapPart(doc, scalars) {
  const able = scalars.filter((s) => s.figure.axes.some((dim) => axisOf(dim).values.length > 1) && rangeOf(s).known);
  if (!able.length) return null;
  let scalar = best(able, 1)[0] || able[0], across = null, down = null, third = null, log = false;
  const wideRange = () => { const { low, high } = rangeOf(scalar); return low > 0 && high / low > 30 && !scalar.figure.meanings.length; };  // above this ratio colours are logarithmic
  log = wideRange();
  const panels = el('div', { class: 'plot', id: 'panels' });
  const map = el('div', { class: 'plot', id: 'map' }), curve = el('div', { class: 'plot', id: 'lines' }), controls = el('div', { class: 'controls' }), title = el('h3', {}), meaning = el('p', { class: 'note' });
  const dims = () => scalar.figure.axes.filter((dim) => axisOf(dim).values.length > 1);
  const fit = () => { const own = dims(); if (!own.includes(across)) across = own.reduce((a, b) => (axisOf(b).values.length > 3 * axisOf(a).values.length ? b : a)); if (down === across || !own.includes(down)) down = own.find((dim) => dim !== across) || null; if (!rest().includes(third)) third = rest()[0] || null; };
  const rest = () => dims().filter((dim) => dim !== across && dim !== down);
  const redraw = () => { map.redraw(); panels.redraw(); curve.redraw(); };
  const drawControls = () => {
    fit();
    panels.hidden = !third;
    const own = dims().map((dim) => ({ value: dim, name: axisOf(dim).label }));
    const again = () => { drawControls(); redraw(); };
    clear(controls, field('Metric', choice(options(able), scalar.id, (id) => { scalar = able.find((s) => s.id === id); log = wideRange(); again(); }, 'figure')),
      own.length > 1 ? field('Across', choice(own, across, (dim) => { if (dim === down) down = across; across = dim; again(); }, 'across')) : null,
      own.length > 1 ? field('Up', choice(own, down, (dim) => { if (dim === across) across = down; down = dim; again(); }, 'up')) : null,
      rest().length > 1 ? field('Panels', choice(own.filter((one) => rest().includes(one.value)), third, (dim) => { third = dim; again(); }, 'panels')) : null,
      rangeOf(scalar).low > 0 && rangeOf(scalar).high / rangeOf(scalar).low > 5 && !scalar.figure.meanings.length ? tick('logarithmic', log, (on) => { log = on; redraw(); }) : null);
    clear(title, axisLabel(scalar));
    clear(meaning, `${dotsOf(scalar)}; from the stage “${named(scalar.figure.stage)}”.`);
  };
  const value = (places) => { const v = scalar.figure.value({ ...state.at, ...places }, scalar.inner); return v; };
  sized(map, (width) => {
    fit();
    const a = axisOf(across), b = down && axisOf(down), others = rest(), { low, high } = rangeOf(scalar);
    heatMap(map, width, { across: a, down: b, value: (i, j) => value({ [across]: i, ...(b ? { [down]: j } : {}) }), units: scalar.figure.units, meanings: scalar.figure.meanings, log: log && rangeOf(scalar).low > 0, at: [state.at[across], b ? state.at[down] : 0], label: axisLabel(scalar), range: others.length ? [low, high] : null, pick: (i, j) => move({ [across]: i, ...(b ? { [down]: j } : {}) }) });
    if (others.length) map.append(el('p', { class: 'note' }, `At ${where(others)}; one colour scale for the whole sweep. Use the slider to move to other planes; they are shown small below.`));
  });
  sized(panels, (width) => {
    fit();
    const fourth = rest().find((dim) => dim !== third);
    if (third) panelMaps(panels, width, { scalar, across: axisOf(across), down: down && axisOf(down), third: axisOf(third), fourth: fourth && axisOf(fourth), log: log && rangeOf(scalar).low > 0, pick: move, label: axisLabel(scalar) });
    else clear(panels);
  });
  sized(curve, (width) => {
    fit();
    const a = axisOf(across), b = down && axisOf(down), shown = b ? spread(b.values.length, 8) : [0], names = a.text;
    if (b && !shown.includes(state.at[down])) shown[nearestOf(shown, state.at[down])] = state.at[down];
    const series = shown.map((j) => ({ name: b ? axisValue(b, j) : '', colour: b ? ramp(shown.indexOf(j), shown.length) : colour(0), faint: b && j !== state.at[down], points: a.values.map((v, i) => [names ? i : v, value({ [across]: i, ...(b ? { [down]: j } : {}) })]) }));
    const wide = !names && a.values[0] > 0 && a.values[a.values.length - 1] / a.values[0] >= 8;
    lines(curve, width, { x: names ? { names: a.values.map(String), label: a.label } : { range: extent(a.values, wide), log: wide, label: `${a.label}${a.units ? ` (${unit(a.units)})` : ''}` }, y: { range: extent(series.flatMap((s) => s.points.map((p) => p[1])), log && rangeOf(scalar).low > 0, true), log: log && rangeOf(scalar).low > 0, label: axisLabel(scalar) }, series, say: (one, x, v) => `${withUnit(v, scalar.figure.units, KNOWN)} at ${a.label} ${names ? a.values[x] : axisValue(a, a.values.indexOf(x))}${b ? `, ${b.label} ${one.name}` : ''}` });
    if (b) curve.prepend(el('p', { class: 'note over' }, `Lines: ${b.label}${shown.length < b.values.length ? ` (${shown.length} of ${b.values.length})` : ''}`));
  });
  drawControls();
  state.told.add(redraw);
  return section('maps', 'Over the axes', 'How any metric changes over the sweep. Click a cell of the map, or use the arrow keys, to go there.', card(controls, title, meaning, map, panels, curve));
}

const spread = (n, most) => (n <= most ? Array.from({ length: n }, (_, i) => i) : Array.from({ length: most }, (_, i) => Math.round((i * (n - 1)) / (most - 1))));
const nearestOf = (list, value) => list.reduce((b, v, i) => (Math.abs(v - value) < Math.abs(list[b] - value) ? i : b), 0);
const isDark = () => getComputedStyle(document.documentElement).colorScheme === 'dark';
const ramp = (i, n) => `rgb(${shade((isDark() ? 0.34 : 0.04) + ((isDark() ? 0.66 : 0.8) * i) / Math.max(1, n - 1)).join(',')})`;

// ---- functions: variables with a dim of their own

function curvesPart(doc, figures) {
  const able = figures.filter((f) => f.dims.length && f.inner > 1 && f.dims[f.dims.length - 1].size > 1 && f.values.some(Number.isFinite));
  if (!able.length) return null;
  const numeric = (f) => !f.dims[f.dims.length - 1].coordinates[0].labels;
  able.sort((a, b) => score(b) - score(a));
  function score(f) { return f.curve + (numeric(f) ? 2 : 0); }
  let figure = able[0], against = 0;
  const plot = el('div', { class: 'plot', id: 'curves' }), controls = el('div', { class: 'controls' }), meaning = el('p', { class: 'note' });
  const coordinates = () => figure.dims[figure.dims.length - 1].coordinates;
  const drawControls = () => {
    const again = () => { drawControls(); plot.redraw(); };
    clear(controls, field('Function', choice(able.map((f) => ({ value: f.id, name: `${named(f.variable)}${f.units ? ` (${unit(f.units)})` : ''}`, group: named(f.stage) })), figure.id, (id) => { figure = able.find((f) => f.id === id); against = 0; again(); }, 'function')),
      coordinates().length > 1 ? field('Against', choice(coordinates().map((c, i) => ({ value: i, name: `${named(c.name)}${c.units ? ` (${unit(c.units)})` : ''}` })), against, (i) => { against = Number(i); plot.redraw(); }, 'against')) : null);
    clear(meaning, `${figure.label}; from the stage “${named(figure.stage)}”.`);
  };
  sized(plot, (width) => drawCurves(plot, width, figure, against, doc));
  drawControls();
  state.told.add(() => plot.redraw());
  return section('curves', 'Curves', `Curves of the selected cell: ${doc.words.curves}.`, card(controls, meaning, plot));
}

function drawCurves(plot, width, figure, against, doc, height = 340) {
  const last = figure.dims[figure.dims.length - 1], along = last.coordinates[against] || last.coordinates[0], rows = figure.inner / last.size;
  const others = figure.dims.slice(0, -1), at = state.at, start = figure.offset(at);
  const offset = along.axes.reduce((a, dim) => a * axisOf(dim).values.length + (at[dim] || 0), 0) * last.size;
  const xs = along.labels ? along.labels.slice(offset, offset + last.size) : Array.from(along.values.subarray(offset, offset + last.size));
  const names = Array.from({ length: Math.min(rows, 16) }, (_, k) => { let rest = k; return [...others].reverse().map((dim) => { const i = rest % dim.size; rest = Math.floor(rest / dim.size); const c = dim.coordinates[0]; return c.labels ? c.labels[i] : withUnit(c.values[i], c.units); }).reverse().join(', '); });
  const channels = { R: '#d1453b', G: '#2e9e5b', B: '#3d74d6' };
  const series = names.map((name, k) => ({ name, colour: channels[name] || colour(k), points: xs.map((x, i) => [along.labels ? i : x, figure.values[start + k * last.size + i]]) }));
  const marks = along.labels ? [] : nyquistOf(last, xs);
  const all = series.flatMap((s) => s.points.map((p) => p[1]));
  const shares = figure.units === '' && all.every((v) => !(v < -0.02 || v > 1.3));
  lines(plot, width, { height, x: along.labels ? { names: xs, label: named(along.name) } : { range: extent(xs), label: `${along.label}${along.units ? ` (${unit(along.units)})` : ''}` }, y: { range: shares ? [Math.min(0, ...all.filter(Number.isFinite)), Math.max(1, ...all.filter(Number.isFinite)) * 1.02] : extent(all, false, true), label: `${named(figure.variable)}${figure.units ? ` (${unit(figure.units)})` : ''}` }, series, marks, points: Boolean(along.labels) });
  if (rows > 16) plot.append(el('p', { class: 'note' }, `First 16 of ${rows} curves.`));
}

// Half a cycle per pixel, whatever the unit of the frequency.
function nyquistOf(dim, xs) {
  const own = dim.coordinates.find((c) => !c.labels && !c.axes.length && /pixel/.test(c.units));
  const i = own ? Array.from(own.values).findIndex((v, k) => k > 0 && v >= 0.5) : -1;
  if (i < 1) return [];
  const share = (0.5 - own.values[i - 1]) / (own.values[i] - own.values[i - 1]);
  return [{ x: xs[i - 1] + share * (xs[i] - xs[i - 1]), label: 'Nyquist' }];
}

// ---- trade-offs

// Two metrics worth trading: those of the front with which the page opens, else the first two.
function opposed(able) {
  const { front } = state.doc.opening;
  const on = front ? [front.x, front.y].map((one) => able.find((s) => isSaid(s, one))).filter(Boolean) : [];
  if (on.length === 2) return { x: on[0], y: on[1] };
  const apart = best(able, 2, true), two = apart.length === 2 ? apart : best(able, 2);
  return { x: two[0] || able[0], y: two[1] || able.find((s) => s !== (two[0] || able[0])) };
}

function tradePart(doc, scalars) {
  const able = scalars.filter((s) => rangeOf(s).varies && !s.figure.meanings.length);
  if (able.length < 2) return null;
  const chosen = opposed(able);
  const clips = clipsOf(doc.opening.front), { dims: judged = [], clipped } = doc.opening.front || {};
  let [moreX, moreY] = [moreIsBetter(chosen.x), moreIsBetter(chosen.y)], logX = false, logY = false, current = null;
  const plot = el('div', { class: 'plot', id: 'trade-plot' }), controls = el('div', { class: 'controls' }), table = el('div', {});
  const collect = () => {
    const dims = doc.axes.map((a) => a.dim).filter((dim) => chosen.x.figure.axes.includes(dim) || chosen.y.figure.axes.includes(dim)), sizes = dims.map((dim) => axisOf(dim).values.length), total = sizes.reduce((a, b) => a * b, 1);
    const xs = [], ys = [], places = [], faint = [], at = {}, judge = clips && judged.every((dim) => dims.includes(dim));
    for (let n = 0; n < total; n++) {
      let rest = n;
      for (let k = dims.length - 1; k >= 0; k--) { at[dims[k]] = rest % sizes[k]; rest = Math.floor(rest / sizes[k]); }
      const x = chosen.x.figure.value(at, chosen.x.inner), y = chosen.y.figure.value(at, chosen.y.inner);
      if (Number.isFinite(x) && Number.isFinite(y) && (!logX || x > 0) && (!logY || y > 0)) { xs.push(x); ys.push(y); places.push(n); faint.push(judge ? clips(at) : false); }
    }
    const place = (i) => { let rest = places[i]; const found = {}; for (let k = dims.length - 1; k >= 0; k--) { found[dims[k]] = rest % sizes[k]; rest = Math.floor(rest / sizes[k]); } return found; };
    const number = (where) => dims.reduce((a, dim, k) => a * sizes[k] + where[dim], 0);
    const index = new Map(places.map((n, i) => [n, i]));
    const able = faint.every((one) => one) ? faint.map(() => false) : faint; // if all of them clip, they are compared
    current = { dims, xs, ys, place, faint: able, front: paretoFront(xs.map((x, i) => (able[i] ? NaN : x)), ys, moreX, moreY), here: () => index.get(number(state.at)) ?? -1 };
  };
  sized(plot, (width) => {
    const { dims, xs, ys, place, faint, front, here } = current;
    const saying = (i) => (i < 0 ? 'Hover over a dot; click to go there.' : `${withUnit(xs[i], chosen.x.figure.units, KNOWN)} · ${withUnit(ys[i], chosen.y.figure.units, KNOWN)} at ${where(dims, place(i))}${faint[i] ? ', clips' : ''}`);
    scatter(plot, width, { x: { range: extent(xs, logX), log: logX, label: `${axisLabel(chosen.x)}, ${moreX ? 'higher is better →' : '← lower is better'}` }, y: { range: extent(ys, logY), log: logY, label: `${moreY ? '↑ higher' : '↓ lower'} is better: ${axisLabel(chosen.y)}` }, points: { x: xs, y: ys, faint }, front, here: here(), pick: (i) => move(place(i)), saying });
  });
  const drawTable = () => {
    const { dims, xs, ys, place, faint, front } = current, burnt = faint.filter((one) => one).length, shown = front.slice(0, 12);
    clear(table, front.length ? tableOf(['', ...dims.map((dim) => axisOf(dim).label), axisLabel(chosen.x), axisLabel(chosen.y)], shown.map((i, k) => [String(k + 1), ...dims.map((dim) => axisValue(axisOf(dim), place(i)[dim])), say(xs[i], KNOWN), say(ys[i], KNOWN)]), 1 + dims.length) : null,
      el('p', { class: 'note' }, `${plural(front.length, 'cell')} of ${count(xs.length)} on the front: no other cell is at least as good in both${burnt ? ` and clips no more than ${percentOf(clipped)} of pixels or white; ${plural(burnt, 'cell')} that ${burnt === 1 ? 'does' : 'do'} ${burnt === 1 ? 'is' : 'are'} drawn faint` : ''}. ${front.length > 12 ? 'The first 12. ' : ''}`, csvButton('front as CSV', 'front', () => [[...dims, chosen.x.id, chosen.y.id], ...front.map((i) => [...dims.map((dim) => axisOf(dim).values[place(i)[dim]]), xs[i], ys[i]])])));
  };
  const again = () => { collect(); drawControls(); plot.redraw(); drawTable(); };
  const able2 = options(able);
  function drawControls() {
    const positive = (s) => rangeOf(s).low > 0;
    clear(controls, el('div', { class: 'controls inner' }, field('Across', choice(able2, chosen.x.id, (id) => { chosen.x = able.find((s) => s.id === id); moreX = moreIsBetter(chosen.x); logX = logX && positive(chosen.x); again(); }, 'across')), tick('higher is better', moreX, (on) => { moreX = on; again(); }), positive(chosen.x) ? tick('log', logX, (on) => { logX = on; again(); }) : null),
      el('div', { class: 'controls inner' }, field('Up', choice(able2, chosen.y.id, (id) => { chosen.y = able.find((s) => s.id === id); moreY = moreIsBetter(chosen.y); logY = logY && positive(chosen.y); again(); }, 'up')), tick('higher is better', moreY, (on) => { moreY = on; again(); }), positive(chosen.y) ? tick('log', logY, (on) => { logY = on; again(); }) : null));
  }
  again();
  let seen = state.bytes;
  state.told.add(() => { if (seen !== state.bytes) { seen = state.bytes; collect(); drawTable(); } plot.redraw(); });
  return section('trade', 'Trade-offs', 'One dot per cell. The line is the Pareto front: no other cell is better in both metrics.', card(controls, plot, table));
}
