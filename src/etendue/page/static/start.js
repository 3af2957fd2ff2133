// The page put together.

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
  const head = header(doc), bar = sliders(doc), main = el('main', {});
  const failed = doc.failures.rows.length > 0 || doc.damaged.length > 0;
  const made = [
    () => (failed ? failedPart(doc) : null), () => (doc.live ? livePart(doc) : null), () => glance(doc), () => cellPart(doc, scalars),
    () => mapPart(doc, scalars), () => curvesPart(doc, state.figures), () => tradePart(doc, scalars), () => themePart(doc, scalars),
    () => errorPart(doc), () => omittedPart(doc), () => (failed ? null : failedPart(doc)), () => allPart(doc, scalars, state.figures), () => provenance(doc),
  ].map(standing).filter(Boolean);
  main.append(...made);
  clear(root, head, el('div', { class: 'held' }, navigation(), bar), main, el('footer', {}, `${doc.made_by} · this page asks no network for anything${doc.live ? ' but the program that shows it' : ''}`));
  root.dataset.ready = 'yes';
  if (location.hash) document.getElementById(location.hash.slice(1))?.scrollIntoView();
}

// A part that cannot be drawn takes no other with it.
function standing(make) {
  try { return make(); } catch (error) { console.error(error); return el('section', {}, el('p', { class: 'broken' }, `A part of this page could not be drawn: ${error.message}`)); }
}

begin().catch((error) => { clear(document.getElementById('page'), el('p', { class: 'broken' }, `This page could not be drawn: ${error.message}. It needs a browser of 2023 or later.`)); console.error(error); });
