// How the page opens: the cell to choose, its picture, the front on which it lies, what limits it, how large its error
// may be.

const isSaid = (scalar, said) => scalar.figure.stage === said.stage && scalar.figure.variable === said.variable && scalar.inner === said.inner;
const percentOf = (share) => `${say(100 * share, 2)} %`;
const listed = (words) => (words.length > 1 ? `${words.slice(0, -1).join(', ')} and ${words[words.length - 1]}` : words.join(''));

function openingPart(doc, scalars) {
  const { front, open, limits, error } = doc.opening;
  const numbers = open.map((one) => scalars.find((s) => isSaid(s, one))).filter(Boolean), picture = doc.live ? null : chosenPicture(doc);
  if (!numbers.length && !picture) return null;
  const on = front && [front.x, front.y].map((one) => scalars.find((s) => isSaid(s, one)));
  const figuresOf = el('dl', { class: 'big open' });
  follow(() => clear(figuresOf, numbers.map((s) => el('div', { title: dotsOf(s) }, el('dt', {}, named(s.figure.variable)), el('dd', {}, s.figure.words(s.figure.value(state.at, s.inner))), errorBehind(doc, s), el('dd', { class: 'soft' }, s.figure.label)))));
  const moved = el('p', { class: 'note moved' }), limitHead = el('h3', {}), wrongHead = el('h3', {});
  follow(() => { const dims = doc.axes.map((a) => a.dim), here = dims.every((dim) => state.at[dim] === doc.start[dim]), of = here ? 'it' : front ? 'the choice' : 'the starting cell'; clear(limitHead, `What limits ${of}`); clear(wrongHead, `Error of ${of === 'it' ? 'this cell' : of}`); clear(moved, here || !dims.length ? null : [`${picture ? 'Picture and metrics' : 'Metrics'} are for ${where(dims)}. `, el('button', { type: 'button', class: 'quiet', onclick: () => move(doc.start) }, front ? 'Back to the choice' : 'Back')]); });
  const swept = doc.axes.filter((axis) => axis.values.length > 1), title = front ? `${doc.words.build} ${front.dims.map((dim) => called(axisOf(dim), doc.start[dim])).join(', ')}` : swept.length ? `One ${doc.words.place} of the sweep` : `The ${doc.words.place}`;
  const words = el('div', { class: 'words' }, front ? [el('p', { class: 'why' }, whyOf(front, on, doc.words)), rangesOf(front, doc.start)] : el('p', { class: 'why' }, swept.length ? `At ${where(swept.map((a) => a.dim), doc.start)}; use the sliders to change it. No two metrics of this sweep trade off, so there is no recommendation.` : doc.axes.length ? `At ${where(doc.axes.map((a) => a.dim), doc.start)}.` : `One ${doc.words.cell}, nothing swept.`), moved, front ? frontPlot(doc, front, on) : null);
  const limit = limitsOf(doc, limits, front, on), wrong = errorOf(doc, error);
  const below = [limit.length ? el('div', { class: 'limits' }, limitHead, limit) : null, el('div', { class: 'wrong' }, wrongHead, wrong)];
  const kept = el('div', { class: 'kept' }, el('h3', {}, 'Metrics'), figuresOf);
  const made = section('cell', title, '', el('div', { class: `card first${picture ? '' : ' plain'}${front ? '' : ' alone'}` },
    picture, el('div', {}, words, front ? null : kept, front ? null : el('div', { class: 'beneath two-up' }, below)),
    front ? el('div', { class: 'beneath' }, below[0], kept, below[1]) : null));
  made.classList.add('opening');
  if (!front) parts[parts.length - 1].title = capital(doc.words.place);
  return made;
}

// ---- the picture at the position of the sliders, or the nearest available

function chosenPicture(doc) {
  const series = (doc.pictures.series || []).filter((one) => Object.keys(one.pictures).length);
  if (!series.length) return null;
  const places = doc.pictures.places, dims = doc.axes.map((a) => a.dim), spans = doc.axes.map((a) => Math.max(1, a.values.length - 1));
  let shown = 0;
  const picture = el('img', { alt: 'the chosen cell' }), tile = el('div', { class: 'tile large' }, picture), below = el('figcaption', {});
  const draw = () => {
    const one = series[shown];
    let near = null, least = Infinity;
    for (const place of places) {
      if (!one.pictures[one.axes.map((dim) => place[dims.indexOf(dim)]).join(',')]) continue;
      const away = sum(one.axes.map((dim) => { const k = dims.indexOf(dim); return Math.abs(place[k] - state.at[dim]) / spans[k]; }));
      if (away < least) { least = away; near = place; }
    }
    const at = Object.fromEntries(dims.map((dim, k) => [dim, near[k]])), exact = one.axes.every((dim) => at[dim] === state.at[dim]);
    const key = one.axes.map((dim) => at[dim]).join(','), size = one.sizes[key];
    tile.style.setProperty('aspect-ratio', `${size[0]} / ${size[1]}`);
    picture.src = `data:image/webp;base64,${one.pictures[key]}`;
    picture.alt = `${one.variable} after ${one.stage} at ${where(one.axes, at)}`;
    const own = one.axes.length ? `at ${one.axes.map((dim) => axisValue(axisOf(dim), at[dim])).join(', ')}` : '';
    clear(below, el('span', { title: `${one.how}${one.scaled ? ', brightness adapted per cell' : ''}` }, `${size[0]} × ${size[1]} `), exact ? el('span', {}, own) : el('span', { class: 'near' }, `nearest available, ${own}`));
  };
  follow(draw);
  const which = series.length > 1 ? choice(series.map((one, i) => ({ value: i, name: named(one.stage) })), 0, (i) => { shown = Number(i); draw(); }, 'picture') : null;
  return el('figure', { class: 'shown' }, tile, el('div', { class: 'below' }, below, which));
}

// Number and kind of pictures, and what was left out.
function picturesNote(doc) {
  const series = (doc.pictures.series || []).filter((one) => Object.keys(one.pictures).length), places = doc.pictures.places || [];
  if (!series.length) return null;
  const n = sum(series.map((one) => Object.keys(one.pictures).length));
  return el('p', { class: 'note' }, `${doc.axes.length ? `Pictures of ${plural(places.length, 'chosen cell')} (corners, the choice and positions in between)` : 'Pictures of the cell'}, ${n} in total, ${bytesOf(doc.pictures.bytes)}, at most 256 × 256 samples${doc.axes.length ? '; elsewhere the nearest is shown and named. Metrics cover every cell' : ''}.${doc.pictures.left_out.length ? ` Left out for size: ${doc.pictures.left_out.join(', ')}.` : ''} Every pixel: etendue view ${doc.archive}.`);
}

// ---- why

const called = (axis, place) => (axis.prefix || axis.text ? '' : `${axis.label} `) + axisValue(axis, place);
const kindOf = (front, k, scalar) => front.said[k] || scalar.name;

function whyOf(front, on, words) {
  const best = on.map((s, k) => `${percentOf(front.shares[k])} of the best ${kindOf(front, k, s)}`);
  const all = front.burnt === front.cells, sound = all ? front.cells : front.cells - front.burnt;
  return [`Of ${say_as([plural(sound, words.cell), front.burnt && !all && words.within])} this one is the best compromise: ${listed(best)}. Every other falls below ${percentOf(Math.min(...front.shares))} in one of the two, or is no better.`,
    all ? ` All of them ${say_as([words.over, words.over_what])}.` : front.burnt ? ` ${say_as([plural(front.burnt, words.cell), 'that', front.burnt === 1 ? words.overs : words.over, words.over_what, front.burnt === 1 ? 'is' : 'are'])} drawn faint.` : ''];
}

// What was swept, and which values of the choice are at the end of their axis: the best may lie beyond.
function rangesOf(front, at) {
  const axes = front.dims.map(axisOf).filter((axis) => axis.values.length > 1), ends = [];
  const ranges = axes.map((axis) => {
    if (axis.text) return `${axis.label} ${listed(axis.values.map(String))}`;
    const order = axis.values.map((_, i) => i).sort((a, b) => axis.values[a] - axis.values[b]), [least, most] = [order[0], order[order.length - 1]];
    if (at[axis.dim] === least || at[axis.dim] === most) ends.push(axis.prefix ? axisValue(axis, at[axis.dim]) : called(axis, at[axis.dim]));
    return `${axis.label} ${axisValue(axis, least)} to ${axisValue(axis, most)}`;
  });
  return el('p', { class: 'why swept' }, `Swept: ${ranges.join(', ')}.`, ends.length ? el('strong', {}, ` ${listed(ends)} ${ends.length === 1 ? 'is at the end of its axis' : 'are at the ends of their axes'}: try values beyond.`) : null);
}

// Whether a cell clips too much to be chosen; null if none does.
function clipsOf(front) {
  if (!front || !front.usable) return null;
  const usable = column(state.bytes, front.usable), sizes = front.dims.map((dim) => axisOf(dim).values.length);
  return (at) => !usable[front.dims.reduce((a, dim, k) => a * sizes[k] + at[dim], 0)];
}

function frontPlot(doc, front, on) {
  const [x, y] = on, plot = el('div', { class: 'plot', id: 'front' }), sizes = front.dims.map((dim) => axisOf(dim).values.length), total = sizes.reduce((a, b) => a * b, 1);
  const place = (n) => { let rest = n; const found = {}; for (let k = front.dims.length - 1; k >= 0; k--) { found[front.dims[k]] = rest % sizes[k]; rest = Math.floor(rest / sizes[k]); } return found; };
  const number = (at) => front.dims.reduce((a, dim, k) => a * sizes[k] + at[dim], 0), clips = clipsOf(front);
  const kind = (k) => ({ label: `${named(on[k].figure.variable)}${on[k].figure.units ? `, ${unit(on[k].figure.units)}` : ''}`, better: front.better[k] === 'higher' });
  sized(plot, (width) => {
    const xs = [], ys = [], cells = [], faint = [];
    for (let n = 0; n < total; n++) {
      const at = place(n), a = x.figure.value(at, x.inner), b = y.figure.value(at, y.inner);
      if (Number.isFinite(a) && Number.isFinite(b)) { xs.push(a); ys.push(b); cells.push(n); faint.push(clips ? clips(at) : false); }
    }
    const index = new Map(cells.map((n, i) => [n, i])), line = front.on.map((at) => index.get(number(at))).filter((i) => i !== undefined);
    const saying = (i) => (i < 0 ? ' ' : [`${named(x.figure.variable)} ${withUnit(xs[i], x.figure.units, KNOWN)}, ${named(y.figure.variable)} ${withUnit(ys[i], y.figure.units, KNOWN)} at ${front.dims.map((dim) => axisValue(axisOf(dim), place(cells[i])[dim])).join(', ')}${faint[i] ? `, ${doc.words.overs}` : ''}`]);
    const [a, b] = [kind(0), kind(1)];
    scatter(plot, width, { height: 240, x: { range: extent(xs), label: `${a.label}${a.better ? ' →' : ', ← lower is better'}` }, y: { range: extent(ys, false, true), label: `${b.better ? '↑' : '↓ lower is better:'} ${b.label}` }, points: { x: xs, y: ys, faint }, front: line, here: index.get(number(state.at)) ?? -1, star: index.get(number(doc.start)), pick: (i) => move(place(cells[i])), saying });
  });
  state.told.add(() => plot.redraw());
  return plot;
}

// ---- what limits it

function changed(scalar, now, then) {
  if (scalar.figure.units === 'dB' || scalar.figure.units === 'stop' || !now) { const d = then - now; return `${d > 0 ? '+' : d < 0 ? '−' : '±'}${say(Math.abs(d), 2)} ${unit(scalar.figure.units)}`.trim(); }
  const d = Math.round(100 * (then / now - 1));
  return `${d > 0 ? '+' : d < 0 ? '−' : '±'}${Math.abs(d)} %`;
}

function limitsOf(doc, limits, front, on) {
  const said = limits.map((one) => {
    const what = [capital(one.about), ': '], factor = one.said || named(one.factor);
    if (one.capped > 1.005 && one.factor !== one.cap) return el('p', {}, ...what, el('strong', {}, one.cap_words), `${one.cap_said ? ` (${one.cap_said})` : ''}, then ${factor}.`);
    return el('p', {}, ...what, el('strong', {}, factor), one.gain && one.gain > 1 ? `; without it ${say(one.gain, 2)} times as high.` : '.');
  });
  if (!front || !front.beside.length) return said;
  const short = on.map((s, k) => front.short[k] || s.name);
  const rows = front.beside.map((one) => el('tr', { class: one.usable ? '' : 'clips' }, el('td', {}, axisValue(axisOf(one.dim), one.place)), on.map((s, k) => el('td', { class: 'number' }, changed(s, s.figure.value(doc.start, s.inner), one.values[k]))), el('td', {}, one.usable ? '' : doc.words.overs)));
  return [...said, el('table', { class: 'beside-it' }, el('thead', {}, el('tr', {}, el('th', { scope: 'col' }, 'one step away'), short.map((name) => el('th', { scope: 'col', class: 'number' }, name)), el('th', { scope: 'col' }))), el('tbody', {}, rows))];
}

// The error of a metric at the position of the sliders: measured there, or that of the whole sweep.
function errorBehind(doc, scalar) {
  if (!doc.answer) return null;
  const key = `${scalar.figure.stage}.${scalar.figure.variable}`, here = Object.entries(doc.answer.at).every(([dim, at]) => state.at[dim] === at);
  const text = (here ? doc.answer.here : doc.answer.sweep)[key];
  return text ? el('dd', { class: 'error' }, text) : null;
}

function errorOf(doc, error) {
  if (!doc.ended) return el('p', {}, 'Available when the run has finished.');
  const whole = doc.measured[0], answer = doc.answer;
  return [answer && answer.pictures.length ? el('p', {}, el('strong', {}, 'The answer'), ', against the same with everything refined: ', answer.pictures.join('; '), '.') : null,
    answer ? answer.notes.map((text) => el('p', { class: 'soft' }, `${capital(text)}.`)) : null,
    error.stage ? el('p', {}, 'Largest error of a single stage: ', el('strong', {}, say(error.largest, 2)), ` of full scale (${named(error.stage)}, basis: ${error.how}).`) : el('p', {}, 'No stage states an error.'),
    error.bound ? el('p', {}, `Error bound of what was left out or approximated: ${say(error.bound, 2)} per stage.`) : null,
    whole ? el('p', {}, `Omissions and coarser settings, the whole ${doc.words.whole}: ${named(whole.variable)} ${say(whole.rms, 2)} rms from the reference settings.`) : answer ? null : el('p', { class: 'soft' }, `The whole ${doc.words.whole}: `, el('span', { class: 'command' }, 'etendue run … --measure'))];
}
