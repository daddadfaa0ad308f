"use strict";
const tables = JSON.parse(document.getElementById("data").textContent);
const show = (id) => document.getElementById(id);
const numbers = (text) => Float64Array.from(new Float32Array(Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer));
for (const table of tables) {
  table.value = numbers(table.value);
  table.stderr = numbers(table.stderr);
  table.at = table.axes.map((axis) => axis.start);
  if (table.directions) table.directions.value = numbers(table.directions.value);
}

// --- interpolation, as in splits.tables.interpolation -------------------------------------------

const laws = {
  cosine: [(x) => -Math.cos(x * Math.PI / 180), (y) => Math.acos(Math.min(1, Math.max(-1, -y))) * 180 / Math.PI],
  logarithm: [Math.log, Math.exp],
  square_root: [Math.sqrt, (y) => y * y],
  identity: [(x) => x, (y) => y],
};
const STENCIL_SIZE = 4;

function nearest(at, x, count) {
  count = Math.min(count, at.length);
  let right = at.findIndex((one) => one >= x);
  if (right < 0) right = at.length;
  const first = Math.min(Math.max(right - Math.floor(count / 2), 0), at.length - count);
  return Array.from({ length: count }, (_, i) => first + i);
}

function lagrange(at, x) {
  return at.map((one, i) => at.reduce((weight, other, j) => (i === j ? weight : weight * (x - other) / (one - other)), 1));
}

function weightsAt(axis, value) {
  const law = laws[axis.law][0];
  const at = axis.nodes.map(law), x = law(value);
  const stencil = nearest(at, x, STENCIL_SIZE);
  const weights = lagrange(stencil.map((i) => at[i]), x);
  const nodeProduct = stencil.reduce((product, i) => product * (x - at[i]), 1);
  const errorWeights = [];
  if (nodeProduct !== 0 && at.length === 2) {
    errorWeights.push([-weights[0] * weights[1], weights[0] * weights[1]]);
  } else if (nodeProduct !== 0) {
    const ordered = [...stencil].sort((i, j) => Math.abs(at[i] - x) - Math.abs(at[j] - x) || i - j);
    if (at.length <= STENCIL_SIZE) {
      const row = at.map(() => 0), few = ordered.slice(0, -1), found = lagrange(few.map((i) => at[i]), x);
      stencil.forEach((i, k) => { row[i] += weights[k]; });
      few.forEach((i, k) => { row[i] -= found[k]; });
      errorWeights.push(row);
      return { stencil, weights, errorWeights };
    }
    for (const node of ordered.slice(0, 2)) {
      const rest = at.map((_, i) => i).filter((i) => i !== node);
      const few = nearest(rest.map((i) => at[i]), at[node], STENCIL_SIZE).map((i) => rest[i]);
      const scale = Math.abs(nodeProduct / few.reduce((product, i) => product * (at[node] - at[i]), 1));
      const row = at.map(() => 0), found = lagrange(few.map((i) => at[i]), at[node]);
      row[node] += scale;
      few.forEach((i, k) => { row[i] -= scale * found[k]; });
      errorWeights.push(row);
    }
  }
  return { stencil, weights, errorWeights };
}

// Interpolate along the first axis: values, standard errors of nodes, and interpolation errors.
function along(read, axis, value) {
  const w = weightsAt(axis, value), size = read.value.length / axis.nodes.length;
  const out = { value: new Float64Array(size), stderr: new Float64Array(size), interpolationError: new Float64Array(size) };
  for (let i = 0; i < size; i++) {
    let v = 0, correlated = 0, variance = 0, previous = 0, added = 0;
    w.stencil.forEach((node, k) => {
      const j = node * size + i, weight = w.weights[k];
      v += weight * read.value[j];
      correlated += weight * read.stderr[j];
      variance += (weight * read.stderr[j]) ** 2;
      previous += Math.abs(weight) * read.interpolationError[j];
    });
    for (const row of w.errorWeights) {
      let deviation = 0;
      for (let node = 0; node < row.length; node++) deviation += row[node] * read.value[node * size + i];
      added = Math.max(added, Math.abs(deviation));
    }
    out.value[i] = v;
    out.stderr[i] = Math.max(Math.abs(correlated), Math.sqrt(variance));
    out.interpolationError[i] = Math.hypot(previous, added);
  }
  return out;
}

function interp(table, at) {
  let read = { value: table.value, stderr: table.stderr, interpolationError: new Float64Array(table.value.length) };
  table.axes.forEach((axis, k) => { read = along(read, axis, at[k]); });
  return { value: read.value, error: read.stderr.map((s, i) => Math.hypot(s, read.interpolationError[i])) };
}

// --- display ------------------------------------------------------------------------------------

const digits = (x) => Number(x.toPrecision(4)).toString();
let chosen = 0, cursor = null;

function colourOf(table, value) {
  const [x, y, z] = table.weights.map((row) => row.reduce((sum, w, i) => sum + w * value[i], 0));
  const linear = [
    3.2406 * x - 1.5372 * y - 0.4986 * z, -0.9689 * x + 1.8758 * y + 0.0415 * z, 0.0557 * x - 0.204 * y + 1.057 * z,
  ];
  return linear.map((c) => {
    const bent = c <= 0.0031308 ? 12.92 * c : 1.055 * Math.max(c, 0) ** (1 / 2.4) - 0.055;
    return Math.round(255 * Math.min(1, Math.max(0, bent)));
  });
}

// --- directions ---------------------------------------------------------------------------------

// Two nodes and their weights, linear in a transform; values outside the range use its end.
function between(nodes, law, value) {
  const at = nodes.map(law), x = Math.min(Math.max(law(value), at[0]), at[at.length - 1]);
  const right = Math.max(1, at.findIndex((one) => one >= x)), weight = (x - at[right - 1]) / (at[right] - at[right - 1]);
  return [[right - 1, 1 - weight], [right, weight]];
}

function amountOf(table, name) {
  const k = table.axes.findIndex((axis) => axis.name === name);
  return k < 0 ? null : table.at[k];
}

// Reflectance factors over polar angle and azimuth for the selected grains and incidence.
function factors(table, nm) {
  const d = table.directions, rows = d.polar.length, columns = d.azimuth.length, size = rows * columns;
  const near = d.wavelength.reduce((best, one, i) => (Math.abs(one - nm) < Math.abs(d.wavelength[best] - nm) ? i : best), 0);
  const out = new Float64Array(size);
  for (const [i, a] of between(d.optical_radius_um, Math.log, amountOf(table, "optical_radius_um"))) {
    for (const [j, b] of between(d.incidence_deg, laws.cosine[0], amountOf(table, "incidence_deg"))) {
      const from = ((i * d.incidence_deg.length + j) * d.wavelength.length + near) * size;
      for (let k = 0; k < size; k++) out[k] += a * b * Math.log(d.value[from + k]);
    }
  }
  out.forEach((x, k) => { out[k] = Math.exp(x); });
  return { nm: d.wavelength[near], value: out, rows, columns };
}

const SHADES = [[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]];

function shade(fraction) {
  const x = Math.min(Math.max(fraction, 0), 1) * (SHADES.length - 1), i = Math.min(Math.floor(x), SHADES.length - 2);
  return SHADES[i].map((c, k) => c + (x - i) * (SHADES[i + 1][k] - c));
}

function hemisphere(table, nm) {
  show("where").hidden = !table.directions;
  if (!table.directions) return;
  const d = table.directions, found = factors(table, nm), { value, rows, columns } = found;
  const low = Math.min(...value), high = Math.max(...value), canvas = show("hemisphere");
  const half = canvas.width / 2, radius = half - 4, paper = canvas.getContext("2d"), image = paper.createImageData(canvas.width, canvas.height);
  const last = d.polar[rows - 1];
  for (let v = 0; v < canvas.height; v++) {
    for (let u = 0; u < canvas.width; u++) {
      const x = (u + 0.5 - half) / radius, y = (v + 0.5 - half) / radius, r = Math.hypot(x, y);
      if (r > 1) continue;
      // The radius is proportional to the polar angle; azimuth 0 (forward) is to the right.
      const p = Math.min(r * 90, last) / last * (rows - 1), a = Math.abs(Math.atan2(y, x)) / Math.PI * (columns - 1);
      const i = Math.min(Math.floor(p), rows - 2), j = Math.min(Math.floor(a), columns - 2), s = p - i, t = a - j;
      const at = (m, n) => value[m * columns + n];
      const here = (1 - s) * ((1 - t) * at(i, j) + t * at(i, j + 1)) + s * ((1 - t) * at(i + 1, j) + t * at(i + 1, j + 1));
      const rgb = shade((here - low) / (high - low || 1));
      image.data.set([rgb[0], rgb[1], rgb[2], 255], 4 * (v * canvas.width + u));
    }
  }
  paper.putImageData(image, 0, 0);
  const size = amountOf(table, "optical_radius_um"), beam = amountOf(table, "incidence_deg");
  const ends = [d.optical_radius_um, d.incidence_deg], outside = [size, beam].some((x, k) => x < ends[k][0] || x > ends[k][ends[k].length - 1]);
  const text = `Reflected light at ${found.nm} nm: π·BRDF from ${low.toFixed(2)} to ${high.toFixed(2)}. ` +
    `The rim is the horizon; light comes from the left. Clean, dry grains. Standard error: ${Math.round(100 * d.typical)} % typically, ${Math.round(100 * d.error)} % at most` +
    (outside ? `; shown for the nearest of ${ends[0][0]} to ${ends[0][ends[0].length - 1]} µm and ${ends[1][0]} to ${ends[1][ends[1].length - 1]}°.` : ".");
  show("direction-note").textContent = text;
  show("scale").style.background = `linear-gradient(to right, ${SHADES.map((c) => `rgb(${c})`).join(", ")})`;
  show("lowest").textContent = low.toFixed(2);
  show("highest").textContent = high.toFixed(2);
  canvas.setAttribute("aria-label", text);
  canvas.dataset.factors = Array.from(value, (x) => x.toFixed(5)).join(" ");
}

function draw() {
  const table = tables[chosen], w = table.wavelength, found = interp(table, table.at);
  const left = 48, right = 616, top = 12, bottom = 322, first = w[0], last = w[w.length - 1];
  const x = (nm) => left + (right - left) * (nm - first) / (last - first);
  const y = (r) => bottom - (bottom - top) * Math.min(Math.max(r, 0), 1.05) / 1.05;
  const path = (rows) => rows.map(([a, b], i) => `${i ? "L" : "M"}${a.toFixed(1)} ${b.toFixed(1)}`).join("");
  const line = w.map((nm, i) => [x(nm), y(found.value[i])]);
  const upper = w.map((nm, i) => [x(nm), y(found.value[i] + 2 * found.error[i])]);
  const lower = w.map((nm, i) => [x(nm), y(found.value[i] - 2 * found.error[i])]).reverse();
  let marks = "";
  for (const r of [0, 0.2, 0.4, 0.6, 0.8, 1]) {
    marks += `<path class="axis" d="M${left} ${y(r)}H${right}"/><text x="${left - 6}" y="${y(r) + 4}" text-anchor="end">${r}</text>`;
  }
  const step = last - first > 1000 ? 500 : 100;
  for (let nm = Math.ceil(first / step) * step; nm <= last; nm += step) {
    marks += `<path class="axis" d="M${x(nm)} ${bottom}v5"/><text x="${x(nm)}" y="${bottom + 19}" text-anchor="middle">${nm}</text>`;
  }
  marks += `<text transform="translate(12 ${(top + bottom) / 2}) rotate(-90)" text-anchor="middle">reflectance</text>`;
  marks += `<text x="${(left + right) / 2}" y="356" text-anchor="middle">wavelength (nm)</text>`;
  const place = cursor === null ? Math.floor(w.length / 4) : cursor;
  const mark = `<path class="cursor" d="M${x(w[place])} ${top}V${bottom}"/>`;
  show("chart").innerHTML = `${marks}<path class="band" d="${path([...upper, ...lower])}Z"/><path class="model" d="${path(line)}"/>${mark}`;
  show("readout").textContent = `Reflectance at ${w[place]} nm: ${found.value[place].toFixed(4)} ± ${found.error[place].toFixed(4)}`;
  const rgb = colourOf(table, found.value), hex = "#" + rgb.map((c) => c.toString(16).padStart(2, "0")).join("");
  hemisphere(table, w[place]);
  show("swatch").style.background = hex;
  show("colour").textContent = hex;
  show("python").textContent = python(table);
  show("chart").dataset.values = Array.from(found.value, (v) => v.toFixed(6)).join(" ");
  show("chart").dataset.errors = Array.from(found.error, (v) => v.toFixed(6)).join(" ");
  history.replaceState(null, "", `#${[chosen, ...table.at].join("/")}`);
  return found;
}

function python(table) {
  const given = table.axes.map((axis, k) => `${JSON.stringify(axis.name)}: ${digits(table.at[k])}`);
  return `splits.open_table(${JSON.stringify(table.file)}).interp(**{${given.join(", ")}})`;
}

function sliders() {
  const table = tables[chosen];
  show("sliders").replaceChildren();
  table.axes.forEach((axis, k) => {
    const [there, back] = laws[axis.law], box = document.createElement("div");
    const low = there(axis.nodes[0]), high = there(axis.nodes[axis.nodes.length - 1]), id = `axis${k}`;
    box.className = "slider";
    const words = document.createElement("span"), output = document.createElement("output");
    const label = document.createElement("label"), input = document.createElement("input");
    words.textContent = axis.label;
    for (const one of [label, output]) one.setAttribute("for", id);
    for (const [key, value] of Object.entries({ type: "range", id, min: 0, max: 1000, step: 1 })) input.setAttribute(key, value);
    label.append(words, output);
    box.append(label, input);
    input.value = Math.round(1000 * (there(table.at[k]) - low) / (high - low));
    const update = () => {
      output.textContent = `${digits(table.at[k])} ${axis.unit}`.trim();
      input.setAttribute("aria-valuetext", output.textContent);
    };
    input.addEventListener("input", () => {
      const fraction = input.value / 1000;
      // The ends are exact nodes; values in between are rounded to three digits.
      const value = fraction === 0 ? axis.nodes[0] : fraction === 1 ? axis.nodes[axis.nodes.length - 1] : Number(back(low + fraction * (high - low)).toPrecision(3));
      table.at[k] = Math.min(Math.max(value, axis.nodes[0]), axis.nodes[axis.nodes.length - 1]);
      update();
      draw();
    });
    update();
    show("sliders").append(box);
  });
}

function media() {
  tables.forEach((table, number) => {
    const label = document.createElement("label"), input = document.createElement("input");
    Object.assign(input, { type: "radio", name: "medium", defaultChecked: number === chosen });
    input.addEventListener("change", () => { chosen = number; cursor = null; start(); });
    label.append(input, ` ${table.label}`);
    show("media").append(label);
  });
}

function start() {
  show("about").textContent = tables[chosen].about;
  show("note").textContent = tables[chosen].note;
  sliders();
  draw();
}

function point(event) {
  const box = show("chart").getBoundingClientRect(), table = tables[chosen];
  const fraction = ((event.clientX - box.left) / box.width * 640 - 48) / 568;
  cursor = Math.round(Math.min(Math.max(fraction, 0), 1) * (table.wavelength.length - 1));
  draw();
}

show("chart").addEventListener("pointermove", point);
show("chart").addEventListener("pointerdown", point);
show("chart").addEventListener("keydown", (event) => {
  const step = { ArrowLeft: -1, ArrowRight: 1, PageDown: -10, PageUp: 10 }[event.key];
  if (!step) return;
  event.preventDefault();
  const last = tables[chosen].wavelength.length - 1;
  cursor = Math.min(Math.max((cursor === null ? Math.floor((last + 1) / 4) : cursor) + step, 0), last);
  draw();
});
show("csv").addEventListener("click", () => {
  const table = tables[chosen], found = interp(table, table.at);
  const lines = table.wavelength.map((nm, i) => `${nm},${found.value[i].toFixed(6)},${found.error[i].toFixed(6)}`);
  const head = `# ${python(table)}\nwavelength_nm,reflectance,reflectance_stderr\n`;
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([head + lines.join("\n") + "\n"], { type: "text/csv" }));
  link.download = "splits.csv";
  link.click();
  URL.revokeObjectURL(link.href);
});
show("copy").addEventListener("click", () => navigator.clipboard.writeText(show("python").textContent));
// State in the address after #: the number of the table and a value for each axis.
function fromAddress() {
  const [number, ...at] = location.hash.slice(1).split("/").map(Number);
  const table = tables[number];
  if (!table || at.length !== table.axes.length) return;
  if (!at.every((x, k) => x >= table.axes[k].nodes[0] && x <= table.axes[k].nodes[table.axes[k].nodes.length - 1])) return;
  chosen = number;
  table.at = at;
}

fromAddress();
media();
start();
