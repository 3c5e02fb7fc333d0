"use strict";
const data = JSON.parse(document.getElementById("data").textContent);
const element = (id) => document.getElementById(id);
const stage = element("stage"), picture = element("picture"), overlay = element("overlay");
const loaded = new Map();  // name -> levels and scale
const waiting = new Map();
const state = { frame: 0, zoom: 1, x: 0, y: 0, blink: 0, placed: false };
window.view = state;

// Rows grow upwards, as in DS9.
function shown(name, given) {
  const image = new Image();
  image.onload = () => {
    const canvas = document.createElement("canvas");
    canvas.width = given.cols; canvas.height = given.rows;
    const context = canvas.getContext("2d", { colorSpace: "srgb", willReadFrequently: true });
    context.drawImage(image, 0, 0);
    const bytes = context.getImageData(0, 0, given.cols, given.rows).data;
    const levels = new Uint16Array(given.rows * given.cols);
    for (let k = 0; k < levels.length; k++) levels[k] = bytes[4 * k] * 256 + bytes[4 * k + 1];
    loaded.set(name, { ...given, levels, png: null });
    for (const done of waiting.get(name) || []) done();
    waiting.delete(name);
  };
  image.src = "data:image/png;base64," + given.png;
}

function load(name) {
  if (loaded.has(name)) return Promise.resolve();
  return new Promise((done) => {
    if (waiting.has(name)) { waiting.get(name).push(done); return; }
    waiting.set(name, [done]);
    const script = document.createElement("script");
    script.src = name + ".js";
    script.onerror = () => { element("status").textContent = name + ".js cannot be read"; };
    document.body.append(script);
    if (loaded.size > 8) loaded.delete(loaded.keys().next().value);
  });
}

const curves = {
  linear: (v) => v,
  sqrt: Math.sqrt,
  asinh: (v) => Math.asinh(10 * v) / Math.asinh(10),
  log: (v) => Math.log1p(1000 * v) / Math.log1p(1000),
};

// What a level stands for, see picture_of.
function value(frame, level) {
  const at = frame.bottom + (level - 1) * frame.step;
  return frame.soft === null ? at : frame.middle + frame.soft * Math.sinh(at);
}

// The value of a level with the digits that it has.
function words(frame, level) {
  if (level === 0) return "no number";
  const number = value(frame, level), step = value(frame, level + 0.5) - value(frame, level - 0.5);
  const digits = Math.ceil(Math.log10(Math.abs(number) / step));
  return Number(number.toPrecision(Math.min(Math.max(digits, 1), 15)));
}

function limits(frame) {
  const span = frame.high - frame.low;
  const low = frame.low + span * element("low").value / 50;
  const high = frame.high * 1 + span * (Math.pow(10, element("high").value / 50) - 1);
  return [low, Math.max(high, low + 1e-6 * span)];
}

function paint() {
  const frame = loaded.get(data.frames[state.frame].name);
  if (!frame) return;
  const [low, high] = limits(frame), curve = curves[element("stretch").value];
  const table = new Uint8Array(65536);
  for (let level = 1; level < 65536; level++) {
    const share = (value(frame, level) - low) / (high - low);
    table[level] = 255 * curve(Math.min(Math.max(share, 0), 1));
  }
  picture.width = frame.cols; picture.height = frame.rows;
  const context = picture.getContext("2d"), out = context.createImageData(frame.cols, frame.rows);
  const pixels = new Uint32Array(out.data.buffer);
  for (let row = 0; row < frame.rows; row++) {
    const to = (frame.rows - 1 - row) * frame.cols, from = row * frame.cols;
    for (let col = 0; col < frame.cols; col++) {
      const level = frame.levels[from + col], grey = table[level];
      pixels[to + col] = level === 0 ? 0xff502040 : 0xff000000 | grey << 16 | grey << 8 | grey;
    }
  }
  context.putImageData(out, 0, 0);
}

function mark(kind, name, attributes, words) {
  const made = document.createElementNS("http://www.w3.org/2000/svg", name);
  made.setAttribute("class", kind);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  if (words) {
    const title = document.createElementNS("http://www.w3.org/2000/svg", "title");
    title.textContent = words;
    made.append(title);
  }
  return made;
}

function draw() {
  const entry = data.frames[state.frame], frame = loaded.get(entry.name);
  overlay.replaceChildren();
  if (!frame) return;
  overlay.setAttribute("width", frame.cols); overlay.setAttribute("height", frame.rows);
  const layers = new Set([...document.querySelectorAll(".layer:checked")].map((box) => box.value));
  const up = (row) => frame.rows - 0.5 - row, right = (col) => col + 0.5;
  for (const streak of entry.streaks) {
    const kind = streak.published ? "published" : "rejected";
    if (!layers.has(kind)) continue;
    const [c0, r0, c1, r1] = streak.line, length = Math.max(Math.hypot(c1 - c0, r1 - r0), 1e-6);
    const across = [6 * (r1 - r0) / length, -6 * (c1 - c0) / length];  // beside the trail, which stays visible
    for (const side of [-1, 1])
      overlay.append(mark(kind, "line", {
        x1: right(c0 + side * across[0]), y1: up(r0 + side * across[1]),
        x2: right(c1 + side * across[0]), y2: up(r1 + side * across[1]) }, streak.words));
  }
  if (layers.has("star"))
    for (const [col, row] of entry.stars) overlay.append(mark("star", "circle", { cx: right(col), cy: up(row), r: 5 }));
}

function place() {
  for (const layer of [picture, overlay]) layer.style.transform = `translate(${state.x}px, ${state.y}px) scale(${state.zoom})`;
}

function fit() {
  const frame = loaded.get(data.frames[state.frame].name);
  if (!frame) return;
  state.zoom = Math.min(stage.clientWidth / frame.cols, stage.clientHeight / frame.rows);
  state.x = (stage.clientWidth - state.zoom * frame.cols) / 2;
  state.y = (stage.clientHeight - state.zoom * frame.rows) / 2;
  place();
}

function zoom(factor, x = stage.clientWidth / 2, y = stage.clientHeight / 2) {
  const next = Math.min(Math.max(state.zoom * factor, 0.01), 64);
  state.x = x - (x - state.x) * next / state.zoom;
  state.y = y - (y - state.y) * next / state.zoom;
  state.zoom = next;
  place();
}

async function go(number) {
  state.frame = (number + data.frames.length) % data.frames.length;
  const entry = data.frames[state.frame], asked = state.frame;
  await load(entry.name);
  if (asked !== state.frame) return;
  const published = entry.streaks.filter((streak) => streak.published).length;
  element("which").textContent = `frame ${entry.number} ${entry.file}: ${published} published, ${entry.streaks.length - published} rejected`;
  paint(); draw();
  if (!state.placed) { fit(); state.placed = true; }
}

function blink() {
  if (state.blink) { clearInterval(state.blink); state.blink = 0; } else state.blink = setInterval(() => go(state.frame + 1), 600);
  element("blink").setAttribute("aria-pressed", String(state.blink !== 0));
}

function sky() {
  document.body.classList.toggle("sky");
  const svg = element("sky");
  if (svg.childNodes.length) return;
  if (!data.sky.length) { svg.append(Object.assign(mark("", "text", { x: 20, y: 30 }), { textContent: "no trail has a direction" })); return; }
  const ra0 = data.sky[0].line[0], near = (ra) => ((ra - ra0 + 540) % 360) - 180;
  const all = data.sky.flatMap(({ line: [a, b, c, d] }) => [[near(a), b], [near(c), d]]);
  const [loX, hiX, loY, hiY] = [0, 1].flatMap((k) => [Math.min(...all.map((p) => p[k])), Math.max(...all.map((p) => p[k]))]);
  const narrow = Math.cos((loY + hiY) / 2 * Math.PI / 180);
  const scale = Math.min(900 / Math.max((hiX - loX) * narrow, 1e-6), 500 / Math.max(hiY - loY, 1e-6));
  const x = (ra) => 500 - (near(ra) - (loX + hiX) / 2) * narrow * scale, y = (dec) => 300 - (dec - (loY + hiY) / 2) * scale;
  for (const { line: [a, b, c, d], frame, tracklet } of data.sky)
    svg.append(mark("", "line", { x1: x(a), y1: y(b), x2: x(c), y2: y(d) }, `frame ${frame}` + (tracklet >= 0 ? `, tracklet ${tracklet}` : "")));
  const centre = `RA ${((ra0 + (loX + hiX) / 2 + 360) % 360).toFixed(3)} deg, Dec ${((loY + hiY) / 2).toFixed(3)} deg in the middle; east to the left`;
  svg.append(Object.assign(mark("", "text", { x: 20, y: 590 }), { textContent: centre }));
}

element("previous").onclick = () => go(state.frame - 1);
element("next").onclick = () => go(state.frame + 1);
element("blink").onclick = blink;
element("fit").onclick = fit;
element("tosky").onclick = sky;
for (const id of ["stretch", "low", "high"]) element(id).oninput = paint;
for (const box of document.querySelectorAll(".layer")) box.onchange = draw;
stage.addEventListener("wheel", (event) => {
  event.preventDefault();
  const box = stage.getBoundingClientRect();
  zoom(event.deltaY < 0 ? 1.25 : 0.8, event.clientX - box.left, event.clientY - box.top);
}, { passive: false });
let held = null;
stage.addEventListener("pointerdown", (event) => { held = [event.clientX - state.x, event.clientY - state.y]; });
window.addEventListener("pointerup", () => { held = null; });
stage.addEventListener("pointermove", (event) => {
  if (held) { state.x = event.clientX - held[0]; state.y = event.clientY - held[1]; place(); return; }
  const frame = loaded.get(data.frames[state.frame].name), box = stage.getBoundingClientRect();
  if (!frame) return;
  const col = Math.floor((event.clientX - box.left - state.x) / state.zoom);
  const row = frame.rows - 1 - Math.floor((event.clientY - box.top - state.y) / state.zoom);
  if (col < 0 || row < 0 || col >= frame.cols || row >= frame.rows) return;
  element("status").textContent = `row ${row}, col ${col}: ${words(frame, frame.levels[row * frame.cols + col])}`;
});
stage.addEventListener("keydown", (event) => {
  const stretch = element("stretch");
  const keys = {
    ArrowLeft: () => go(state.frame - 1), ArrowRight: () => go(state.frame + 1), "+": () => zoom(1.25), "-": () => zoom(0.8),
    0: fit, 1: () => zoom(1 / state.zoom), b: blink,
    s: () => { stretch.selectedIndex = (stretch.selectedIndex + 1) % stretch.length; paint(); },
  };
  if (!keys[event.key]) return;
  event.preventDefault();
  keys[event.key]();
});
go(0);
