// Assembly of the page.

async function begin() {
  const doc = JSON.parse(document.getElementById('document').textContent), root = document.getElementById('page');
  await show(doc, root);
}

async function show(doc, root) {
  state.doc = doc;
  state.told.clear();
  parts.length = 0;
  state.at = { ...doc.start, ...Object.fromEntries(Object.entries(state.at).filter(([dim, i]) => doc.axes.some((a) => a.dim === dim && i < a.values.length))) };
  state.bytes = await unpacked(doc.blob);
  state.figures = doc.figures.map((said) => new Figure(said, state.bytes));
  const scalars = state.figures.flatMap(scalarsOf);
  state.scalars = scalars;
  const failed = doc.failures.rows.length > 0 || doc.damaged.length > 0;
  const draw = (list) => list.map(standing).filter(Boolean);
  const first = draw([() => (failed ? failedPart(doc) : null), () => (doc.live ? livePart(doc) : openingPart(doc, scalars))]);
  const rest = draw([
    () => (doc.live ? openingPart(doc, scalars) : null), () => glance(doc), () => mapPart(doc, scalars), () => curvesPart(doc, state.figures), () => tradePart(doc, scalars),
    () => errorPart(doc), () => omittedPart(doc), () => (failed ? null : failedPart(doc)), () => subjectsPart(doc, scalars), () => allPart(doc, scalars, state.figures), ...doc.sections.map((one) => () => addedPart(one)), () => provenance(doc),
  ]);
  const head = header(doc), held = el('div', { class: 'held' }, navigation(), sliders(doc)), foot = el('footer', {}, `${doc.made_by} · this page loads nothing from the network${doc.live ? '; it talks only to the program that shows it' : ''}`);
  clear(root, head, doc.live ? [held, el('main', {}, first, rest)] : el('main', {}, first, held, rest), foot);
  root.dataset.ready = 'yes';
  if (location.hash) document.getElementById(location.hash.slice(1))?.scrollIntoView();
}

// If a part cannot be drawn, the others still are.
function standing(make) {
  try { return make(); } catch (error) { console.error(error); return el('section', {}, el('p', { class: 'broken' }, `A part of this page could not be drawn: ${error.message}`)); }
}

begin().catch((error) => { clear(document.getElementById('page'), el('p', { class: 'broken' }, `This page could not be drawn: ${error.message}. It needs a browser of 2023 or later.`)); console.error(error); });
