// Basics: elements that hold text as text, packed columns, numbers as words, and the positions of the sliders.

const SVG = 'http://www.w3.org/2000/svg';

function put(node, attributes, children) {
  for (const [name, value] of Object.entries(attributes || {})) {
    if (value === undefined || value === null || value === false) continue;
    if (name.startsWith('on')) node.addEventListener(name.slice(2), value);
    else if (name === 'value' || name === 'checked' || name === 'disabled') node[name] = value;
    else node.setAttribute(name, value === true ? '' : String(value));
  }
  for (const child of children.flat(3)) if (child !== null && child !== undefined && child !== false) node.append(child);
  return node;
}
const el = (tag, attributes, ...children) => put(document.createElement(tag), attributes, children);
const svg = (tag, attributes, ...children) => put(document.createElementNS(SVG, tag), attributes, children);
const clear = (node, ...children) => { node.replaceChildren(...children.flat(3).filter((c) => c !== null && c !== undefined && c !== false)); return node; };
const sum = (list) => list.reduce((a, b) => a + b, 0);
const clamp = (value, low, high) => Math.min(high, Math.max(low, value));

// ---- numbers

const TYPES = { f4: Float32Array, f8: Float64Array, u1: Uint8Array, u2: Uint16Array, u4: Uint32Array };

async function unpacked(text) {
  const packed = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream('deflate'));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

function column(bytes, place) {
  const Type = TYPES[place.kind], width = Type.BYTES_PER_ELEMENT, count = place.count;
  const own = bytes.subarray(place.at, place.at + count * width);
  if (width === 1) return own;
  const together = new Uint8Array(count * width);
  for (let b = 0; b < width; b++) for (let i = 0, j = b; i < count; i++, j += width) together[j] = own[b * count + i];
  return new Type(together.buffer);
}

const HIGH = { '-': '⁻', 0: '⁰', 1: '¹', 2: '²', 3: '³', 4: '⁴', 5: '⁵', 6: '⁶', 7: '⁷', 8: '⁸', 9: '⁹' };
const raised = (text) => [...String(text)].map((c) => HIGH[c] || c).join('');

const KNOWN = 3, EXACT = 17; // digits of a figure, which is seldom known to more; of what was given, which is said as it was
function say(value, digits = 4) {
  if (value === 'inf') return '∞';
  if (typeof value === 'boolean') return value ? 'yes' : 'no';
  if (typeof value === 'string') return value;
  if (Array.isArray(value)) return value.map((v) => say(v, digits)).join(', ');
  if (value === null || value === undefined || Number.isNaN(value)) return '–';
  if (typeof value !== 'number') return JSON.stringify(value);
  if (!Number.isFinite(value)) return value > 0 ? '∞' : '−∞';
  if (value === 0) return '0';
  if (digits === EXACT) return String(value).replace(/e([+-]?)(\d+)$/, (_, sign, power) => `·10${raised((sign === '-' ? '-' : '') + power)}`).replace('-', '−');
  const size = Math.abs(value);
  if (size < 1e-3 || size >= 1e6) {
    const [mantissa, power] = value.toExponential(Math.max(0, digits - 2)).split('e');
    const short = mantissa.includes('.') ? mantissa.replace(/0+$/, '').replace(/\.$/, '') : mantissa;
    return `${short.replace('-', '−')}·10${raised(Number(power))}`;
  }
  return String(Number(value.toPrecision(digits))).replace('-', '−');
}

const unit = (text) => (text === 'mm-1' ? 'lp/mm' : text || '').replace(/\bum/g, 'µm').replace(/([A-Za-zµ])(-?\d)/g, (_, letter, power) => letter + raised(power));
const withUnit = (value, units, digits) => (units === 's' && typeof value === 'number') ? seconds(value, digits) : (units ? `${say(value, digits)} ${unit(units)}` : say(value, digits));

function seconds(value, digits = 3) {
  if (value === null || value === undefined || Number.isNaN(value)) return '–';
  if (value === 0) return '0 s';
  const said = (factor) => say(value * factor, Math.min(digits, 9));
  if (value < 1e-3) return `${said(1e6)} µs`;
  if (value < 1) return `${said(1e3)} ms`;
  if (value < 120) return `${said(1)} s`;
  return value < 7200 ? `${said(1 / 60)} min` : `${said(1 / 3600)} h`;
}

const bytesOf = (value) => (value >= 1e6 ? `${say(value / 1e6, 3)} MB` : `${say(value / 1e3, 3)} kB`);
const count = (value) => String(value).replace(/\B(?=(\d{3})+$)/g, ' ');
const plural = (number, one, many) => `${count(number)} ${number === 1 ? one : many || `${one}s`}`;
const capital = (text) => text[0].toUpperCase() + text.slice(1);
const say_as = (words) => words.filter(Boolean).join(' ');

// Write a name out, word by word, as distributions spell it; a spelling that starts with _ applies to the end of a
// name.
function named(name) {
  const known = state.doc ? state.doc.spelling : {};
  for (const [end, said] of Object.entries(known)) if (end.startsWith('_') && name.endsWith(end)) name = name.slice(0, -end.length) + said;
  return name.split('_').map((word) => (Object.hasOwn(known, word) ? known[word] : word)).join(' ');
}

// As few digits as distinguish the values of an axis.
function digitsOf(axis) {
  if (!axis.digits) axis.digits = [3, 4, 5, 6, 8].find((n) => new Set(axis.values.map((v) => say(v, n))).size === new Set(axis.values).size) || 12;
  return axis.digits;
}
function axisValue(axis, index) {
  const value = axis.values[index];
  if (axis.text) return String(value);
  if (axis.factors) return `${value} (${axis.factors[index]})`;
  if (axis.prefix) return `${axis.prefix}${say(value, 3)}`;
  return axis.units === 's' ? seconds(value, digitsOf(axis)) : withUnit(value, axis.units, digitsOf(axis));
}

// ---- positions of the sliders

const state = { doc: null, at: {}, told: new Set(), waiting: false };

function tell() {
  if (state.waiting) return;
  state.waiting = true;
  requestAnimationFrame(() => { state.waiting = false; for (const one of [...state.told]) one(); });
}
function follow(draw) { state.told.add(draw); draw(); }
function move(places) {
  let moved = false;
  for (const [dim, place] of Object.entries(places)) if (state.at[dim] !== place) { state.at[dim] = place; moved = true; }
  if (moved) tell();
}
const axisOf = (dim) => state.doc.axes.find((axis) => axis.dim === dim);
const where = (dims, at = state.at) => dims.map((dim) => axisOf(dim)).filter(Boolean).map((axis) => `${axis.label} ${axisValue(axis, at[axis.dim])}`).join(', ');

// ---- metrics

class Figure {
  constructor(said, bytes) {
    Object.assign(this, said);
    this.values = column(bytes, said.data);
    this.shape = [...said.axes.map((dim) => axisOf(dim).values.length), ...said.dims.map((dim) => dim.size)];
    this.steps = this.shape.map((_, i) => this.shape.slice(i + 1).reduce((a, b) => a * b, 1));
    this.inner = said.dims.reduce((a, dim) => a * dim.size, 1);
    for (const dim of said.dims) for (const one of dim.coordinates) if (one.data) one.values = column(bytes, one.data);
    this.id = `${said.stage}.${said.variable}`;
  }
  offset(at) { return sum(this.axes.map((dim, i) => (at[dim] || 0) * this.steps[i])); }
  value(at, inner = 0) { return this.values[this.offset(at) + inner]; }
  words(value) { return this.meanings.length && this.meanings[value] ? named(this.meanings[value]) : withUnit(value, this.units, KNOWN); }
}

// One number per cell: a metric, or one of its labels ("level after filter").
function scalarsOf(figure) {
  if (!figure.dims.length) return [{ figure, inner: 0, id: figure.id, name: named(figure.variable), of: '' }];
  const labelled = figure.dims.every((dim) => dim.coordinates[0].labels && !dim.coordinates[0].axes.length) && figure.inner <= 16;
  if (!labelled) return [];
  return Array.from({ length: figure.inner }, (_, inner) => {
    let rest = inner;
    const parts = [...figure.dims].reverse().map((dim) => { const i = rest % dim.size; rest = Math.floor(rest / dim.size); return dim.coordinates[0].labels[i]; }).reverse();
    return { figure, inner, id: `${figure.id}[${parts.join(',')}]`, name: `${named(figure.variable)} · ${parts.join(', ')}`, of: parts.join(', ') };
  });
}

function rangeOf(scalar) {
  if (scalar.range) return scalar.range;
  const { figure, inner } = scalar;
  let low = Infinity, high = -Infinity, known = 0, total = 0;
  for (let i = inner; i < figure.values.length; i += figure.inner) {
    const v = figure.values[i];
    if (Number.isFinite(v)) { known++; total += v; if (v < low) low = v; if (v > high) high = v; }
  }
  scalar.range = { low, high, known, mean: total / known, varies: high > low };
  return scalar.range;
}

// ---- files

function download(name, text) {
  const link = el('a', { href: URL.createObjectURL(new Blob([text], { type: 'text/csv;charset=utf-8' })), download: name });
  document.body.append(link); link.click(); link.remove();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
}
function csvField(value) {
  if (value === null || value === undefined || Number.isNaN(value)) return '';
  if (typeof value === 'number') return String(value);
  let text = Array.isArray(value) ? value.join(' ') : String(value);
  if (/^[=+\-@\t\r]/.test(text)) text = `'${text}`; // a spreadsheet would take it for a formula
  return /[",\n\r;]/.test(text) ? `"${text.replace(/"/g, '""')}"` : text;
}
const csv = (rows) => rows.map((row) => row.map(csvField).join(',')).join('\r\n') + '\r\n';
const csvButton = (label, name, rows) => el('button', { type: 'button', class: 'quiet csv', 'data-csv': name, onclick: () => download(`${state.doc.archive}-${name}.csv`, csv(rows())) }, `↓ ${label}`);
