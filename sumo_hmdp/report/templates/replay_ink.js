// Canvases in CSS pixels, colours from the style sheet, and a few strokes that every drawing shares.
const FONT = "system-ui, -apple-system, 'Segoe UI', Roboto, 'Noto Sans', sans-serif";
const INK_NAMES = ["surface", "line", "ink", "muted", "road", "dash", "edge", "ego", "other", "highlight", "on-vehicle",
  "branch", "forbidden", "optimal", "relaxed", "fallback"];
let ink = {};

function readInk() {
  const style = getComputedStyle(document.documentElement);
  ink = Object.fromEntries(INK_NAMES.map((name) => [name, style.getPropertyValue(`--${name}`).trim()]));
}

// Sizes the bitmap to the element; returns a context in CSS pixels, cleared.
function begin(canvas) {
  const ratio = window.devicePixelRatio || 1;
  const width = canvas.clientWidth;
  const height = canvas.clientHeight;
  const [w, h] = [Math.round(width * ratio), Math.round(height * ratio)];
  if (canvas.width !== w || canvas.height !== h) Object.assign(canvas, { width: w, height: h });
  const ctx = canvas.getContext("2d");
  ctx.setTransform(ratio, 0, 0, ratio, 0, 0);
  ctx.clearRect(0, 0, width, height);
  return { ctx, width, height };
}

function segment(ctx, x1, y1, x2, y2) {
  ctx.beginPath();
  ctx.moveTo(x1, y1);
  ctx.lineTo(x2, y2);
  ctx.stroke();
}

function polyline(ctx, points) {
  ctx.beginPath();
  points.forEach(([x, y], i) => (i ? ctx.lineTo(x, y) : ctx.moveTo(x, y)));
  ctx.stroke();
}

function polygon(ctx, points) {
  ctx.beginPath();
  points.forEach(([x, y], i) => (i ? ctx.lineTo(x, y) : ctx.moveTo(x, y)));
  ctx.closePath();
}

function dot(ctx, x, y, radius) {
  ctx.beginPath();
  ctx.arc(x, y, radius, 0, 2 * Math.PI);
}

// The smallest of 1, 2, 5 times a power of ten that keeps ticks at least `pixels` apart.
function tickSpacing(pixelsPerUnit, pixels) {
  const least = pixels / pixelsPerUnit;
  const power = 10 ** Math.floor(Math.log10(least));
  return [1, 2, 5, 10].map((factor) => factor * power).find((spacing) => spacing >= least * (1 - 1e-9));
}

function ticksBetween(from, to, spacing) {
  const ticks = [];
  for (let i = Math.ceil(from / spacing - 1e-9); i * spacing <= to + spacing * 1e-9; i += 1) ticks.push(i * spacing);
  return ticks;
}

const hatches = new Map();

// Drawn in device pixels, or the hatch blurs on a dense screen.
function hatch(ctx, color) {
  const ratio = window.devicePixelRatio || 1;
  const key = `${color}@${ratio}`;
  if (!hatches.has(key)) {
    const size = Math.round(8 * ratio);
    const tile = Object.assign(document.createElement("canvas"), { width: size, height: size });
    const pen = tile.getContext("2d");
    pen.strokeStyle = color;
    pen.lineWidth = 1.1 * ratio;
    for (const shift of [-size, 0, size]) segment(pen, shift - 1, size + 1, shift + size + 1, -1);
    hatches.set(key, tile);
  }
  const tile = hatches.get(key);
  return { pattern: ctx.createPattern(tile, "repeat"), scale: 8 / tile.width };
}

const EVENT_INKS = { left: "ego", right: "ego", near_miss: "branch", contact: "ink" };
const eventInk = (kind) => ink[EVENT_INKS[kind] ?? kind] ?? ink.muted;

// A ring for a near miss, a cross for a contact.
function drawEncounter(ctx, kind, x, y, r) {
  ctx.strokeStyle = eventInk(kind);
  ctx.lineWidth = 2.4;
  if (kind === "near_miss") {
    dot(ctx, x, y, r - 0.6);
    ctx.stroke();
    return;
  }
  segment(ctx, x - r * 0.85, y - r * 0.85, x + r * 0.85, y + r * 0.85);
  segment(ctx, x - r * 0.85, y + r * 0.85, x + r * 0.85, y - r * 0.85);
}

// One glyph for each kind of event: shape tells as much as colour.
function eventGlyph(ctx, kind, x, y, r) {
  const shapes = {
    left: [[x - r, y + r * 0.8], [x, y - r], [x + r, y + r * 0.8]],
    right: [[x - r, y - r * 0.8], [x, y + r], [x + r, y - r * 0.8]],
    relaxed: [[x, y - r * 1.15], [x + r * 1.15, y], [x, y + r * 1.15], [x - r * 1.15, y]],
  };
  ctx.fillStyle = eventInk(kind);
  if (kind === "near_miss" || kind === "contact") {
    drawEncounter(ctx, kind, x, y, r);
    return;
  }
  polygon(ctx, shapes[kind] ?? [[x - r * 0.9, y - r * 0.9], [x + r * 0.9, y - r * 0.9], [x + r * 0.9, y + r * 0.9], [x - r * 0.9, y + r * 0.9]]);
  ctx.fill();
}
