// The live page: progress of the run, and the part that shows every pixel of every stage.

const asking = (what, words) => `${location.pathname.replace(/[^/]*$/, '')}${what}?${new URLSearchParams(words)}`;
const waiting = new Map();
addEventListener('message', (event) => { if (event.source === parent && waiting.has(event.data?.number)) { waiting.get(event.data.number)(event.data); waiting.delete(event.data.number); } });

// In a notebook the page is in a frame, and its parent sends the requests.
async function askHolder(what, words) {
  const number = askHolder.last = (askHolder.last || 0) + 1;
  const answer = await new Promise((done) => { waiting.set(number, done); parent.postMessage({ etendue: 1, number, what, words }, '*'); });
  if (answer.why) throw new Error(answer.why);
  return { headers: { get: () => answer.said }, arrayBuffer: async () => answer.body, json: async () => JSON.parse(new TextDecoder().decode(answer.body)) };
}

async function ask(what, words = {}) {
  if (state.doc.live.through === 'frame') return askHolder(what, words);
  const answer = await fetch(asking(what, words));
  if (!answer.ok) throw new Error((await answer.text()).trim() || `status ${answer.status}`);
  return answer;
}
const placesOf = (at) => state.doc.axes.map((axis) => `${axis.dim}:${at[axis.dim]}`).join(',');

// One request at a time: of those that arrive meanwhile only the last is sent.
function latest(work) {
  let busy = false, next = null;
  return async function run(...args) {
    if (busy) { next = args; return; }
    busy = true;
    try { await work(...args); } catch (error) { if (!(error instanceof TypeError)) console.warn(error.message); } finally { busy = false; }
    if (next) { const again = next; next = null; run(...again); }
  };
}

function progressOf(doc) {
  const bar = el('progress', { max: 1, value: 0, 'aria-label': 'cells done' }), text = el('span', {}), made = el('div', { class: 'progress', id: 'progress', role: 'status' }, bar, text);
  made.show = (now) => {
    const { planned, finished, rate, left, running, failed } = now;
    bar.max = planned || 1; bar.value = finished || 0;
    const share = planned ? ` (${Math.floor((100 * finished) / planned)} %)` : '';
    text.textContent = `${running ? 'running: ' : now.ended ? '' : 'interrupted: '}${count(finished ?? 0)} of ${count(planned ?? 0)} cells${share}${failed ? `, ${plural(failed, 'failed', 'failed')}` : ''}${running && rate ? `, ${say(rate, 3)} cells/s` : ''}${running && left !== null && left !== undefined ? `, about ${seconds(left)} left` : ''}`;
    made.hidden = !running && now.ended;
  };
  made.show({ ...doc.progress, running: doc.running, ended: doc.ended, failed: 0 });
  return made;
}

let serial = 0, timer = null;

function watch(doc, bar) {
  serial = doc.live.serial;
  clearTimeout(timer);
  const look = async () => {
    let wait = 4000;
    try {
      const now = await (await ask('state')).json();
      bar.show(now);
      bar.classList.remove('gone');
      if (now.serial !== serial) { serial = now.serial; await renew(now); }
      if (now.running) wait = 1000;
    } catch { bar.hidden = false; bar.classList.add('gone'); bar.lastChild.textContent = 'disconnected: etendue view has stopped'; wait = 5000; }
    timer = setTimeout(look, wait);
  };
  timer = setTimeout(look, 800);
}

// New numbers in the same page; a new page if more than numbers has changed.
async function renew(now) {
  const fresh = await (await ask('document')).json(), through = state.doc.live.through, same = (a, b) => JSON.stringify(a) === JSON.stringify(b);
  fresh.live.through = through;
  const ids = (list) => list.map((f) => [f.stage, f.variable, f.data.count]);
  if (now.running && fresh.running && same(fresh.axes, state.doc.axes) && same(ids(fresh.figures), ids(state.doc.figures)) && same(fresh.pictured, state.doc.pictured) && !fresh.failures.rows.length) {
    const bytes = await unpacked(fresh.blob);
    fresh.figures.forEach((said, i) => { state.figures[i].values = column(bytes, said.data); });
    state.scalars.forEach((scalar) => { delete scalar.range; });
    state.bytes = bytes;
    tell();
    state.panes?.again();
  } else await show(fresh, document.getElementById('page'));
}

function livePart(doc) {
  const bar = progressOf(doc);
  watch(doc, bar);
  if (!doc.pictured.length) return section('live', 'Every pixel', '', card(bar, el('p', { class: 'note' }, 'This archive stores no pictures.')));
  const view = new Panes(doc, state.panes);
  state.panes = view;
  return section('live', 'Every pixel', 'Read directly from the store. Drag to pan, scroll to zoom, hover for values at every stage; click to pin a position for the line and the table.',
    card(bar, view.toolbar, view.area, view.status), el('div', { class: 'pair' }, card(el('h3', {}, 'Under the pointer'), view.table), el('div', {}, card(view.lineHead, view.linePlot), card(view.histogramHead, view.histogramPlot), view.curves ? card(el('h3', {}, 'Transfer by stage'), view.curves) : null)));
}
