// Tables: all metrics by subject, error against run time, what was left out, failures.

function tableOf(head, rows, numbersFrom = 1, empty = 'Nothing.') {
  if (!rows.length) return el('p', { class: 'note' }, empty);
  return el('div', { class: 'scroll', tabindex: 0, role: 'region' }, el('table', {}, el('thead', {}, el('tr', {}, head.map((h, i) => el('th', { scope: 'col', class: i >= numbersFrom ? 'number' : '' }, h)))), el('tbody', {}, rows.map((row) => el('tr', {}, row.map((v, i) => el('td', { class: i >= numbersFrom ? 'number' : '' }, v)))))));
}

// ---- all metrics

function figureRows(scalars) {
  return scalars.map((s) => {
    const r = rangeOf(s), value = s.figure.value(state.at, s.inner), words = (v) => (s.figure.meanings.length ? s.figure.words(v) : say(v, KNOWN));
    return [el('span', { title: dotsOf(s) }, s.name), named(s.figure.stage), words(value), r.known ? words(r.low) : '–', r.known && !s.figure.meanings.length ? say(r.mean, KNOWN) : '–', r.known ? words(r.high) : '–', unit(s.figure.units)];
  });
}
const figureTable = (scalars) => {
  const one = !state.doc.axes.length, short = (row) => (one ? [row[0], row[1], row[2], row[6]] : row);
  return tableOf(short(['metric', 'stage', one ? 'value' : 'selected', 'min', 'mean', 'max', 'unit']), figureRows(scalars).map(short), 2);
};

// All metrics, folded by subject.
function subjectsPart(doc, scalars) {
  const known = scalars.filter((s) => rangeOf(s).known), folded = doc.opening.subjects.map(({ subject, figures }) => {
    const own = figures.flatMap(([stage, variable]) => known.filter((s) => s.figure.stage === stage && s.figure.variable === variable));
    if (!own.length) return null;
    const host = el('div', {}), details = el('details', { class: 'card', 'data-subject': subject, ontoggle: () => draw() }, el('summary', {}, `${subject[0].toUpperCase()}${subject.slice(1)} (${own.length})`), host);
    const draw = () => { if (details.open) clear(host, figureTable(own)); };
    state.told.add(draw);
    return details;
  }).filter(Boolean);
  return folded.length ? section('subjects', 'All metrics, by subject', doc.axes.length ? 'For the selected cell, and over all cells.' : '', ...folded) : null;
}

function allPart(doc, scalars, figures) {
  const sets = new Map();
  for (const s of scalars) { const key = s.figure.axes.join(' × '); if (!sets.has(key)) sets.set(key, []); sets.get(key).push(s); }
  const rowsOf = (own) => {
    const dims = own[0].figure.axes, sizes = dims.map((dim) => axisOf(dim).values.length), total = sizes.reduce((a, b) => a * b, 1), rows = [[...dims.map((dim) => { const a = axisOf(dim); return a.units ? `${dim} [${a.units}]` : dim; }), ...own.map((s) => (s.figure.units ? `${s.id} [${s.figure.units}]` : s.id))]];
    for (let n = 0; n < total; n++) {
      let rest = n; const at = {};
      for (let k = dims.length - 1; k >= 0; k--) { at[dims[k]] = rest % sizes[k]; rest = Math.floor(rest / sizes[k]); }
      rows.push([...dims.map((dim) => axisOf(dim).values[at[dim]]), ...own.map((s) => s.figure.value(at, s.inner))]);
    }
    return rows;
  };
  const files = [...sets].map(([key, own]) => csvButton(`${key ? key.replace(/_/g, ' ') : 'without axes'} (${plural(own.length, 'metric')})`, `figures-${key.replace(/ × /g, '-') || 'all'}`, () => rowsOf(own)));
  const curves = figures.filter((f) => f.dims.length && !scalarsOf(f).length).map((f) => csvButton(named(f.variable), `${f.stage}-${f.variable}`, () => curveRows(f)));
  const cells = doc.cells.rows && doc.cells.columns.stage ? csvButton(`all ${count(doc.cells.rows)} cells: seconds, errors`, 'cells', () => cellRows(doc)) : null;
  const omitted = doc.omitted.length ? el('p', { class: 'note' }, `Too large for a page: ${doc.omitted.map((o) => `${o.stage}.${o.variable} (${o.why})`).join('; ')}.`) : null;
  if (!scalars.length && !cells) return null;
  return section('figures', 'All metrics, as files', 'Every number in the archive except pictures. The CSV files are made from this page, offline.',
    card(el('h3', {}, 'CSV files'), el('div', { class: 'files' }, files, curves, csvButton('stages', 'stages', () => stageTable(doc)), cells), omitted));
}

function curveRows(f) {
  const dims = [...f.axes, ...f.dims.map((d) => d.name)], rows = [[...dims, `${f.id} [${f.units || '1'}]`]], shape = f.shape, total = f.values.length;
  for (let n = 0; n < total; n++) {
    let rest = n; const at = [];
    for (let k = shape.length - 1; k >= 0; k--) { at[k] = rest % shape[k]; rest = Math.floor(rest / shape[k]); }
    const labels = at.map((i, k) => { if (k < f.axes.length) return axisOf(f.axes[k]).values[i]; const c = f.dims[k - f.axes.length].coordinates[0]; return c.labels ? c.labels[i] : c.axes.length ? i : c.values[i]; });
    rows.push([...labels, f.values[n]]);
  }
  return rows;
}

const STAGE_HEAD = ['stage', 'use', 'axes', 'cells', 'done', 'left_out', 'failed', 'skipped', 'seconds', 'error_least', 'error', 'how', 'bound'];
const stageTable = (doc) => [STAGE_HEAD, ...doc.stages.map((s) => STAGE_HEAD.map((key) => (key === 'stage' ? s.name : s[key])))];

function cellRows(doc) {
  const { columns, at, rows } = doc.cells, names = Object.keys(columns), dims = Object.keys(at), bytes = state.bytes;
  const own = names.map((name) => ({ words: columns[name].words, values: column(bytes, columns[name]) })), places = dims.map((dim) => column(bytes, at[dim]));
  const found = [[...dims, ...names]];
  for (let i = 0; i < rows; i++) found.push([...places.map((p, k) => axisOf(dims[k]).values[p[i]] ?? ''), ...own.map((c) => (c.words ? c.words[c.values[i]] : c.values[i]))]);
  return found;
}

// ---- error against run time

function errorPart(doc) {
  const total = sum(doc.stages.map((s) => s.seconds || 0)) || 1, host = el('div', { class: 'plot' });
  const rows = doc.stages.map((s) => [`${s.order} ${named(s.name)}`, count(s.done + s.left_out), seconds(s.seconds), `${say((100 * (s.seconds || 0)) / total, 2)} %`, s.error_least !== null && s.error_least !== s.error ? `${say(s.error_least, 2)} … ${say(s.error, 2)}` : say(s.error, 2), s.how.join(', '), say(s.bound || null, 2)]);
  const dots = doc.stages.filter((s) => s.error > 0 && s.seconds > 0);
  if (dots.length > 1) {
    sized(host, (width) => {
      const xs = dots.map((s) => s.seconds), ys = dots.map((s) => s.error), x = { range: extent(xs, true), log: true, label: 'run time of the stage over all cells (s)' }, y = { range: extent(ys, true), log: true, label: 'largest stated error, relative to full scale' };
      scatter(host, width, { height: 340, x, y, points: { x: xs, y: ys }, front: [], here: -1, pick: () => {}, saying: (i) => (i < 0 ? 'Hover over a dot for its stage.' : `${named(dots[i].name)}: error ${say(dots[i].error, 2)} (${dots[i].how.join(', ')}), ${seconds(dots[i].seconds)}`) });
      const texts = svg('g', { class: 'ticks' }), root = host.querySelector('svg'), f = { sx: scaleOf(x, MARGIN.left, width - MARGIN.right), sy: scaleOf({ ...y, vertical: true }, 340 - MARGIN.bottom, MARGIN.top) }, taken = [];
      for (const s of [...dots].sort((a, b) => b.seconds - a.seconds)) {
        const name = named(s.name), px = f.sx.at(s.seconds), py = f.sy.at(s.error), end = px + name.length * 6.4 > width - 24, box = [end ? px - 8 - name.length * 6.4 : px + 8, py - 8, name.length * 6.4, 14];
        if (taken.some((b) => b[0] < box[0] + box[2] && box[0] < b[0] + b[2] && b[1] < box[1] + box[3] && box[1] < b[1] + b[3])) continue;
        taken.push(box);
        texts.append(svg('text', { x: end ? px - 8 : px + 8, y: py + 4, 'text-anchor': end ? 'end' : 'start' }, name));
      }
      root.append(texts);
    });
    state.told.add(() => host.redraw());
  }
  const measured = doc.measured.length
    ? card(el('h3', {}, 'Measured against the reference settings'), el('p', { class: 'note' }, `The whole ${doc.words.whole} recomputed with every knob at its reference, on sample cells; relative to full scale.`), tableOf(['variable', 'rms', 'max', 'basis'], doc.measured.slice(0, 20).map((m) => [named(m.variable), say(m.rms, 2), say(m.max, 2), m.how]), 1))
    : el('p', { class: 'note' }, `The error of the whole ${doc.words.whole} was not measured: run etendue run … --measure to add it to this page.`);
  return section('error', 'Error against run time', 'Run time of each stage and its error from its own exact result, relative to full scale. The error of the answer is at the top of the page: it follows these errors to the end of the chain and includes discretisation. Basis of the error: a proven bound, a fitted law, or a measurement.',
    card(dots.length > 1 ? host : null, tableOf(['stage', 'cells', 'run time', 'share', 'stated error', 'basis', 'omission bound'], rows, 1), el('p', { class: 'note' }, doc.ended ? 'Run time is thread time, summed over cells.' : 'Errors are in the ledger, which is written when the run has finished.', csvButton('stages as CSV', 'stages', () => stageTable(doc)))),
    measured, blamePart(doc));
}

// Each stage's share of the losses, at one cell, if requested.
function blamePart(doc) {
  if (!doc.shares && !doc.blame) return null;
  const found = doc.blame, cell = doc.words.cell, commands = [doc.losses_command, `etendue report ${doc.archive} --blame`].filter(Boolean);
  const ways = el('p', { class: 'note' }, `Each stage's share of the loss of ${doc.words.lost_words}, at the starting cell: `, commands.flatMap((text, i) => [i ? ', or in this page: ' : '', el('code', {}, text)]), '.');
  if (!found || !found.losses.length) return card(el('h3', {}, 'Share of the loss by stage'), found ? el('p', {}, `Not available: ${found.why || 'no losses were computed'}.`) : ways, found ? found.notes.map((note) => el('p', { class: 'note' }, note)) : null);
  const at = doc.axes.length ? ` at ${where(doc.axes.map((a) => a.dim), found.at)}` : '';
  const bar = (share, most) => { const wide = (58 * Math.abs(share || 0)) / (most || 1); return svg('svg', { class: 'share', width: 120, height: 14, viewBox: '0 0 120 14', 'aria-hidden': 'true' }, svg('line', { class: 'axis', x1: 60, x2: 60, y1: 0, y2: 14 }), svg('rect', { class: share < 0 ? 'won' : 'lost', x: share < 0 ? 60 - wide : 60, y: 2, width: wide, height: 10 })); };
  const percent = (share) => (share === null || share === undefined ? '–' : `${(100 * share).toFixed(1).replace('-', '−')} %`), lost = (value, units) => `${say(value, 3)} ${units === 'CIEDE2000^2' ? 'ΔE₀₀²' : units}`;
  const games = found.losses.map((loss) => { const most = Math.max(...loss.stages.map((one) => Math.abs(one.share || 0))); return el('div', { class: 'loss' }, el('h4', {}, loss.what[0].toUpperCase() + loss.what.slice(1)),
    el('p', { class: 'note' }, `${loss.figure}: ${say(loss.value, 4)}, ideal ${cell} ${say(loss.ideal, 4)}; lost ${lost(loss.loss, loss.unit)}. From ${loss.orders ? `${loss.orders} random orders` : 'all sets of stages'}, ${loss.coalitions} ${cell}s.`),
    tableOf(['stage', 'share', '', 'lost', 'without it'], loss.stages.map((one) => [named(one.stage), percent(one.share), bar(one.share, most), lost(one.loss, loss.unit), one.figure_without === null ? '–' : say(one.figure_without, 4)]), 1)); });
  const rows = () => [['loss', 'stage', 'share', 'lost', 'unit', 'figure without it'], ...found.losses.flatMap((loss) => loss.stages.map((one) => [loss.what, one.stage, one.share, one.loss, loss.unit, one.figure_without]))];
  return card(el('h3', {}, 'Share of the loss by stage'), el('p', { class: 'note' }, (found.about || `What a stage adds to a loss{at}; a stage below 0 wins back.`).replace('{at}', at)),
    el('div', { class: 'losses' }, games), found.notes.map((note) => el('p', { class: 'note' }, note)), el('p', { class: 'note' }, csvButton('losses as CSV', 'losses', rows), doc.losses_command ? [' also ', el('code', {}, doc.losses_command)] : null));
}

// ---- left out, failed

function omittedPart(doc) {
  const rows = doc.omissions.map((o) => [named(o.stage), o.kind, o.why, `${count(o.cells)} of ${count(o.of)}`, o.bound === 0 ? '0' : say(o.bound, 2), seconds(o.saved)]);
  return section('omitted', 'What was left out, and why', 'The plan leaves out or coarsens what the scene does not need, within the requested tolerance.',
    card(tableOf(['stage', '', 'reason or setting', 'cells', 'error bound', 'time saved'], rows, 3, doc.ended ? 'Nothing was left out.' : 'Available when the run has finished.')));
}

function failedPart(doc) {
  const { rows, skipped } = doc.failures;
  const body = rows.length
    ? rows.map((row) => el('div', { class: 'failure' }, el('h3', {}, `${named(row.stage)}: ${plural(row.cells, 'cell')}`), el('pre', {}, row.message || 'no message'), row.examples.length ? el('p', { class: 'note' }, `at ${row.examples.map((at) => Object.entries(at).map(([dim, v]) => { const axis = axisOf(dim), i = axis ? axis.values.indexOf(v) : -1; return axis && i >= 0 ? `${axis.label} ${axisValue(axis, i)}` : `${dim} ${say(v)}`; }).join(', ') || 'the only cell').join('; ')}${row.cells > row.examples.length ? '; …' : ''}`) : null))
    : el('p', { class: 'fine' }, 'No cell failed.');
  const damaged = doc.damaged.length ? el('div', { class: 'failure' }, el('h3', {}, `Damaged: ${plural(doc.damaged.length, 'array')}, not shown`), el('pre', {}, doc.damaged.slice(0, 20).join('\n')), el('p', { class: 'note' }, `Repair it: etendue verify ${doc.archive} --repair`)) : null;
  return section('failed', 'Failures', '', card(damaged, body, skipped ? el('p', { class: 'note' }, `${plural(skipped, 'cell')} after them ${skipped === 1 ? 'was' : 'were'} skipped.`) : null));
}
