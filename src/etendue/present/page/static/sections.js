// The frame of the page: its header, its parts, the sliders, the overview, sections of distributions, provenance.

const parts = [];
const SHORT = { cell: 'The choice', maps: 'Maps', subjects: 'Metrics', error: 'Error and time', omitted: 'Left out', figures: 'Files', provenance: 'Provenance', live: 'Pixels' };

function section(id, title, lead, ...content) {
  const made = el('section', { id, 'aria-labelledby': `${id}-title` }, el('h2', { id: `${id}-title` }, title), lead ? el('p', { class: 'lead' }, lead) : null, ...content);
  parts.push({ id, title: SHORT[id] || title, made });
  return made;
}

const card = (...content) => el('div', { class: 'card' }, ...content);
const field = (label, control) => el('label', { class: 'field' }, el('span', {}, label), control);

function choice(options, value, change, label) {
  const made = el('select', { 'aria-label': label, onchange: () => change(made.value) });
  const groups = new Map();
  for (const one of options) {
    if (!one.group) { made.append(el('option', { value: one.value }, one.name)); continue; }
    if (!groups.has(one.group)) { groups.set(one.group, el('optgroup', { label: one.group })); made.append(groups.get(one.group)); }
    groups.get(one.group).append(el('option', { value: one.value }, one.name));
  }
  made.value = value;
  return made;
}
const tick = (label, checked, change) => { const box = el('input', { type: 'checkbox', checked, onchange: () => change(box.checked) }); return el('label', { class: 'tick' }, box, label); };

// ---- head

function header(doc) {
  const cells = sum(doc.stages.map((s) => s.cells)), points = doc.axes.reduce((a, axis) => a * axis.values.length, 1);
  const spent = sum(doc.stages.map((s) => s.seconds || 0)), failed = sum(doc.failures.rows.map((row) => row.cells));
  const chip = (kind, text) => el('span', { class: `chip ${kind}` }, text);
  const chips = [];
  if (doc.running) chips.push(chip('busy', doc.live ? 'running' : 'still running when this page was made'));
  else if (!doc.ended) chips.push(chip('warn', 'interrupted'));
  if (failed) chips.push(chip('bad', `${plural(failed, 'cell')} failed`));
  if (doc.damaged.length) chips.push(chip('bad', `${plural(doc.damaged.length, 'array')} damaged`));
  else if (doc.ended && !failed) chips.push(chip('good', 'complete, no failures'));
  const state = el('div', { class: 'chips', id: 'chips' }, chips);
  const about = points > 1
    ? `${plural(points, doc.words.point)}: ${doc.axes.map((axis) => `${axis.values.length} × ${axis.label}`).join(', ')}.`
    : `One ${doc.words.point}.`;
  return el('header', {},
    el('div', { class: 'top' }, el('p', { class: 'kind' }, `${doc.live ? 'etendue · live view' : 'etendue · report'}${doc.archive === doc.name ? '' : ` · ${doc.archive}`}`), themeSwitch()),
    el('div', { class: 'top' }, el('h1', {}, doc.title || doc.name), state), doc.description ? el('p', { class: 'about' }, doc.description) : null,
    el('p', { class: 'facts', title: `started ${doc.provenance.began.replace('T', ' ').replace('Z', ' UTC')}` }, `${about} ${plural(doc.stages.length, 'stage')}, ${plural(cells, 'cell')} (one stage at one set of values), ${seconds(spent)} of computing time.`),
    standInsLine(doc.provenance.stated));
}

function themeSwitch() {
  const root = document.documentElement, names = ['auto', 'light', 'dark'];
  let now = 'auto';
  try { now = localStorage.getItem('etendue-theme') || 'auto'; } catch { /* a file may have no storage */ }
  const show = () => { if (now === 'auto') root.removeAttribute('data-theme'); else root.setAttribute('data-theme', now); button.textContent = { auto: '◐ auto', light: '☀ light', dark: '☾ dark' }[now]; };
  const button = el('button', { type: 'button', class: 'quiet', id: 'theme', 'aria-label': 'light or dark', onclick: () => {
    now = names[(names.indexOf(now) + 1) % 3];
    try { localStorage.setItem('etendue-theme', now); } catch { /* as above */ }
    show(); tell();
  } });
  show();
  return button;
}

function navigation() {
  const links = parts.map((part) => el('a', { href: `#${part.id}` }, part.title));
  const nav = el('nav', { 'aria-label': 'parts of this page' }, links);
  const seen = new IntersectionObserver((entries) => {
    for (const entry of entries) if (entry.isIntersecting) links.forEach((link, i) => link.classList.toggle('now', parts[i].id === entry.target.id));
  }, { rootMargin: '-30% 0px -60% 0px' });
  parts.forEach((part) => seen.observe(part.made));
  return nav;
}

// ---- sliders

function sliders(doc) {
  if (!doc.axes.some((axis) => axis.values.length > 1)) return null;
  const bar = el('div', { class: 'sliders', role: 'group', 'aria-label': 'position on the axes of the sweep' });
  for (const axis of doc.axes) {
    const said = el('output', {}), last = axis.values.length - 1;
    const input = el('input', { type: 'range', min: 0, max: last, step: 1, 'aria-label': axis.label, 'data-axis': axis.dim, disabled: last === 0, oninput: () => move({ [axis.dim]: Number(input.value) }) });
    bar.append(el('label', { class: 'slider' }, el('span', { class: 'name' }, axis.label, said), input, el('span', { class: 'ends' }, el('span', {}, axisValue(axis, 0)), el('span', {}, axisValue(axis, last)))));
    follow(() => { input.value = state.at[axis.dim]; said.textContent = axisValue(axis, state.at[axis.dim]); input.setAttribute('aria-valuetext', said.textContent); });
  }
  return bar;
}

// ---- overview

function glance(doc) {
  const swept = doc.axes.map((axis) => [axis.label, axis.values.length > 6 || !axis.values.length ? `${axisValue(axis, 0)} … ${axisValue(axis, axis.values.length - 1)}` : axis.values.map((_, i) => axisValue(axis, i)).join(', '), `${axis.values.length} values`]);
  const row = (one) => [named(one.name), withUnit(one.value, one.units, EXACT), one.what];
  const shared = doc.shared, { quantities: order, off } = doc.first, whole = doc.words.whole;
  const listed = shared.filter((one) => order.includes(one.name) && !(Object.hasOwn(off, one.name) && one.value === off[one.name])).sort((a, b) => order.indexOf(a.name) - order.indexOf(b.name));
  const first = order.length ? listed : shared, rest = shared.filter((one) => !first.includes(one));
  const facts = (rows) => el('dl', { class: 'facts-list' }, rows.map(([name, value, what]) => el('div', { title: what }, el('dt', {}, name), el('dd', {}, value))));
  const strip = el('ol', { class: 'strip' });
  const pictures = doc.pictures.strip || [];
  for (const one of pictures) {
    const stage = doc.stages.find((s) => s.name === one.stage);
    strip.append(el('li', {}, el('figure', {},
      el('div', { class: 'tile' }, el('img', { src: `data:image/webp;base64,${one.data}`, alt: `${one.variable} after ${one.stage}`, width: one.shown[0], height: one.shown[1], loading: 'lazy' })),
      el('figcaption', {}, el('strong', {}, `${stage ? stage.order : ''} ${named(one.stage)}`), el('span', {}, stage && stage.role[0] ? stage.role[0] : ''), el('span', { class: 'soft' }, `${named(one.variable)} · ${one.size[0]} × ${one.size[1]}${one.unencoded ? ' · without gamma' : ''}${one.how === 'lossless' ? '' : ` · ${one.how}`}`)))));
  }
  const chain = el('ol', { class: 'chain' }, doc.stages.map((stage) => el('li', { class: stage.failed ? 'failed' : '' }, el('strong', {}, named(stage.name)), el('span', {}, stage.what || stage.role[0] || stage.use.join(', ')))));
  const made = section('glance', `The ${whole} at a glance`, doc.words.chain,
    card(el('div', { class: 'columns' }, swept.length ? el('div', {}, el('h3', {}, 'Swept'), facts(swept.map(([a, b, c]) => [a, b, c]))) : null, el('div', {}, el('h3', {}, 'Constant'), facts(first.map(row)))),
      rest.length ? el('details', {}, el('summary', {}, `All ${shared.length} quantities`), facts(rest.map(row))) : null),
    pictures.length ? card(el('h3', {}, doc.words.strip), strip, el('p', { class: 'note' }, `${doc.axes.length ? `At ${where(doc.axes.map((a) => a.dim), doc.start)}. ` : ''}Linear pictures of one kind share one brightness, set so that the first of them is bright; display values are shown unchanged. At most 256 × 256 samples.`), doc.live ? null : picturesNote(doc)) : null,
    el('details', { class: 'card' }, el('summary', {}, `What each of the ${doc.stages.length} stages does`), chain));
  parts[parts.length - 1].title = capital(whole);
  return made;
}

// ---- sections of distributions: paragraphs, tables, pictures

function addedPart(one) {
  const block = (own) => {
    if (own.table) return tableOf(own.table.head, own.table.rows.map((row) => row.map((value) => say(value))), 1);
    return own.picture ? el('img', { class: 'added', src: own.picture, alt: own.alt }) : el('p', {}, own.paragraph);
  };
  return section(`added-${one.name}`, one.title, '', card(one.why ? el('p', { class: 'broken' }, one.why) : one.blocks.map(block), el('p', { class: 'note' }, `Section provided by ${one.origin}.`)));
}

// A line on values of presets that no source gives; null if there are none.
function standInsLine(stated) {
  const counts = Object.entries(stated || {}).map(([word, titles]) => [word, Object.values(titles).map((values) => Object.values(values).filter((one) => one.source.startsWith('typical')).length)]);
  const parts = counts.filter(([, own]) => Math.max(...own) > 0).map(([word, own]) => {
    const [low, high] = [Math.min(...own), Math.max(...own)];
    return `${low === high ? high : `${low} to ${high}`} values of ${own.length > 1 ? 'each' : 'the'} ${word}`;
  });
  return parts.length ? el('p', { class: 'facts' }, `No source gives ${parts.join(' and ')}: typical ones stand in, so a difference may be one of stand-ins. Provenance lists them.`) : null;
}

// ---- where the values of presets come from

function statedPart(stated) {
  const all = Object.entries(stated || {}).flatMap(([word, titles]) => Object.entries(titles).map(([title, values]) => [`${word} ${title}`, Object.entries(values)]));
  if (!all.length) return null;
  const standsIn = ([, one]) => one.source.startsWith('typical');
  const count = (values) => `${values.length - values.filter(standsIn).length} of ${values.length} values have a source`;
  const row = ([name, one]) => el('div', {}, el('dt', {}, name), el('dd', {}, standsIn([name, one]) ? 'stand-in: no source gives it' : [one.source, one.licence].filter(Boolean).join(', '), one.note ? `; ${one.note}` : ''));
  return card(el('h3', {}, 'Where values come from'), ...all.map(([title, values]) =>
    el('details', {}, el('summary', {}, `${title}: ${count(values)}`), el('dl', { class: 'facts-list' }, values.map(row)))));
}

// ---- provenance

function provenance(doc) {
  const p = doc.provenance, versions = (map) => Object.entries(map).map(([name, version]) => `${name} ${say(version, EXACT)}`).join(', ');
  const command = (text, what) => el('div', { class: 'command' }, el('code', {}, text), el('span', {}, what));
  const again = [
    command(`etendue reproduce ${doc.archive}`, 'recomputes it from the archive alone and compares every cell'),
    p.pipeline_file ? command(`etendue run ${doc.archive}/${p.pipeline_file} --archive again`, 'runs the same pipeline into a new archive') : null,
    command(`etendue verify ${doc.archive}`, 'reads every byte against its checksum'),
    command(`etendue view ${doc.archive}`, 'every pixel of every stage, live'),
    command(`etendue report ${doc.archive} -o report.html`, 'this page'),
  ];
  return section('provenance', 'Provenance', 'Everything here was simulated; the commands below reproduce it.',
    card(el('h3', {}, 'Reproduce it'), again),
    statedPart(p.stated),
    card(el('dl', { class: 'facts-list' },
      [['archive', doc.archive], ['pipeline', doc.name], ['started', p.began], ['runs', String(p.runs)], ['options', versions(p.options)], ['changed on the command line', versions(p.overrides) || 'none'], ['platform', versions(p.platform)], ['libraries', versions(p.libraries)], ['stages from', p.distributions.join(', ')], ['page made by', doc.made_by]].map(([a, b]) => el('div', {}, el('dt', {}, a), el('dd', {}, b)))),
      el('details', {}, el('summary', {}, 'The pipeline file'), el('pre', {}, p.text))));
}
