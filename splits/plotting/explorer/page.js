"use strict";
const tables = JSON.parse(document.getElementById("data").textContent);
const show = (id) => document.getElementById(id);
const numbers = (text) => Float64Array.from(new Float32Array(Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer));
for (const table of tables) {
  table.value = numbers(table.value);
  table.stderr = numbers(table.stderr);
  table.at = table.axes.map((axis) => axis.start);
  for (const axis of table.axes) if (axis.measured) axis.measured.factors = numbers(axis.measured.factors);
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

// A coordinate is a power, or the logarithm for power 0, of the distance from an origin.
function coordinate([isCosine, power, origin], value) {
  const distance = (isCosine ? -Math.cos(value * Math.PI / 180) : value) - origin;
  if (power === 1) return distance;
  const size = Math.abs(distance), bent = power === 0 ? Math.log(size) : size ** power;
  return (distance < 0 ? -1 : 1) * (power < 0 ? -bent : bent);
}

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

function stencilOf(at, x) {
  const nodes = nearest(at, x, STENCIL_SIZE), near = nodes.map((i) => at[i]);
  return { nodes, weights: lagrange(near, x), product: near.reduce((product, one) => product * (x - one), 1) };
}

// Add weights of nodes to a row of weights of all nodes.
function put(row, nodes, weights, scale = 1) {
  nodes.forEach((node, k) => { row[node] += scale * weights[k]; });
  return row;
}

// Weights of all nodes of an axis, and the product of distances, for each of its coordinates.
function weightsAt(axis, value) {
  return axis.coordinates.map((one) => {
    const stencil = stencilOf(axis.nodes.map((node) => coordinate(one, node)), coordinate(one, value));
    return { row: put(axis.nodes.map(() => 0), stencil.nodes, stencil.weights), product: stencil.product };
  });
}

// Weights of estimates of an error that was not measured.
function estimatesAt(axis, value) {
  const one = axis.coordinates[0], at = axis.nodes.map((node) => coordinate(one, node)), x = coordinate(one, value);
  const { nodes, weights, product } = stencilOf(at, x), rows = [], last = at.length - 1;
  if (product === 0) return rows;
  const blank = () => at.map(() => 0);
  const ordered = [...nodes].sort((i, j) => Math.abs(at[i] - x) - Math.abs(at[j] - x) || i - j);
  if (at.length === 2) {
    rows.push([-weights[0] * weights[1], weights[0] * weights[1]]);
  } else if (at.length <= STENCIL_SIZE) {
    const few = ordered.slice(0, -1);
    rows.push(put(put(blank(), nodes, weights), few, lagrange(few.map((i) => at[i]), x), -1));
  } else {
    for (const node of ordered.slice(0, 2)) {
      const rest = at.map((_, i) => i).filter((i) => i !== node), omitted = stencilOf(rest.map((i) => at[i]), at[node]);
      const scale = Math.abs(product / omitted.product), row = blank();
      row[node] += scale;
      rows.push(put(row, omitted.nodes.map((i) => rest[i]), omitted.weights, -scale));
    }
  }
  if (value < axis.nodes[1] || value > axis.nodes[last - 1]) {
    const right = axis.nodes.findIndex((node) => node >= value), two = [right - 1, right];
    for (const other of axis.compared) {
      const found = lagrange(two.map((i) => coordinate(other, axis.nodes[i])), coordinate(other, value));
      rows.push(put(put(blank(), nodes, weights), two, found, -1));
    }
  }
  return rows;
}

// Sums over the nodes of all axes, with rows of weights: one for all wavelengths, or one for each.
function combine(table, values, rows, power = 1) {
  const width = table.wavelength.length;
  return table.axes.reduce((read, axis, k) => {
    const size = read.length / axis.nodes.length, out = new Float64Array(size);
    for (let node = 0; node < axis.nodes.length; node++) {
      for (let i = 0; i < size; i++) out[i] += rows[k](i % width)[node] ** power * read[node * size + i];
    }
    return out;
  }, values);
}

// Two nodes and the fraction of the second, linear in the default coordinate of an axis.
function linear(nodes, law, value) {
  if (nodes.length === 1) return [[0, 1]];
  const at = nodes.map(laws[law][0]), x = laws[law][0](value);
  let right = at.findIndex((one) => one >= x);
  right = Math.min(Math.max(right < 0 ? at.length : right, 1), at.length - 1);
  const fraction = Math.min(Math.max((x - at[right - 1]) / (at[right] - at[right - 1]), 0), 1);
  return [[right - 1, 1 - fraction], [right, fraction]];
}

// The measured error of an axis, as splits.tables.interpolation: signed, and its square.
function measuredError(table, axis, value, at) {
  const m = axis.measured, width = table.wavelength.length, size = m.factors.length / m.between.length;
  const right = axis.nodes.findIndex((node) => node >= value);
  const first = m.count * Math.min(Math.max((right < 0 ? axis.nodes.length : right) - 1, 0), axis.nodes.length - 2);
  const law = laws[axis.law][0], positions = m.between.slice(first, first + m.count).map(law), x = law(value);
  const above = positions.findIndex((one) => one >= x);
  const left = Math.min(Math.max((above < 0 ? m.count : above) - 1, 0), m.count - 2);
  const fraction = (x - positions[left]) / (positions[left + 1] - positions[left]), inside = Math.min(Math.max(fraction, 0), 1);
  const start = (first + left) * size, signed = new Float64Array(width), squared = new Float64Array(width), step = new Float64Array(width);
  let places = [[0, 1]];
  for (const other of m.others) {
    const two = linear(other.nodes, other.law, at[other.axis]);
    places = places.flatMap(([place, weight]) => two.map(([i, w]) => [place * other.nodes.length + i, weight * w]));
  }
  for (const [place, weight] of places) {
    for (let i = 0; i < width; i++) {
      const low = m.factors[start + place * width + i], high = m.factors[start + size + place * width + i];
      signed[i] += weight * ((1 - inside) * low + inside * high);
      squared[i] += weight * ((1 - inside) * low ** 2 + inside * high ** 2);
      step[i] += weight * (high - low);
    }
  }
  const count = size / width;
  for (let i = 0; i < width; i++) {
    let mean = 0;
    for (let place = 0; place < count; place++) {
      mean += (1 - inside) * m.factors[start + place * width + i] ** 2 + inside * m.factors[start + size + place * width + i] ** 2;
    }
    squared[i] += (fraction - inside) ** 2 * step[i] ** 2 + m.share ** 2 * mean / count;
  }
  return { signed, squared };
}

function interp(table, at) {
  const weights = table.axes.map((axis, k) => weightsAt(axis, at[k]));
  const rows = table.axes.map((axis, k) => (i) => weights[k][axis.choice[i]].row);
  const value = combine(table, table.value, rows), width = table.wavelength.length;
  const correlated = combine(table, table.stderr, rows), variance = combine(table, table.stderr.map((s) => s * s), rows, 2);
  const sum = new Float64Array(width), squares = new Float64Array(width);
  table.axes.forEach((axis, k) => {
    if (axis.measured) {
      const found = measuredError(table, axis, at[k], at);
      for (let i = 0; i < width; i++) {
        const product = weights[k][axis.choice[i]].product;
        sum[i] += product * found.signed[i];
        squares[i] += product ** 2 * found.squared[i];
      }
      return;
    }
    const largest = new Float64Array(width);
    for (const row of estimatesAt(axis, at[k])) {
      const found = combine(table, table.value, rows.map((one, j) => (j === k ? () => row : one)));
      found.forEach((x, i) => { largest[i] = Math.max(largest[i], Math.abs(x)); });
    }
    largest.forEach((x, i) => { sum[i] += x; squares[i] += x * x; });
  });
  const error = value.map((_, i) => Math.hypot(
    Math.max(Math.abs(correlated[i]), Math.sqrt(variance[i])), Math.max(Math.abs(sum[i]), Math.sqrt(squares[i])),
  ));
  return { value, error };
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
  const d = table.directions, rows = d.polar_deg.length, columns = d.azimuth_deg.length, size = rows * columns;
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
  const last = d.polar_deg[rows - 1];
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
  return `splits.Table(${JSON.stringify(table.file)}).interp(**{${given.join(", ")}})`;
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
