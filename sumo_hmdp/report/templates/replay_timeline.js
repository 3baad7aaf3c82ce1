// The marks over the slider: lane changes, decisions that are not optimal, near misses and contacts.
const marks = document.getElementById("marks");
const THUMB = 14;
const GLYPH = 5;

// A slider's thumb stays inside its track, so half a thumb is lost at each end.
const markX = (time, width) => THUMB / 2 + ((time - firstTime) / Math.max(lastTime - firstTime, 1e-9)) * (width - THUMB);
const markTime = (x, width) => clamp(firstTime + ((x - THUMB / 2) / (width - THUMB)) * (lastTime - firstTime), firstTime, lastTime);

function drawMarks() {
  const { ctx, width, height } = begin(marks);
  const band = height - 4;
  ctx.globalAlpha = 0.9;
  for (const event of events) {
    if (event.until === undefined) continue;
    const x = markX(event.time, width);
    ctx.fillStyle = eventInk(event.kind);
    ctx.fillRect(x, band, Math.max(markX(event.until, width) - x, 2), 3);
  }
  ctx.globalAlpha = 1;
  for (const event of placedEvents(width)) eventGlyph(ctx, event.kind, event.x, band - 9, GLYPH);
}

// Glyphs that would touch move apart a little; the band below keeps the true time.
function placedEvents(width) {
  let least = 0;
  return events.map((event) => {
    const x = Math.max(markX(event.time, width), least);
    least = x + 2 * GLYPH + 1;
    return { ...event, x: Math.min(x, width - GLYPH) };
  });
}

function eventNear(x, width) {
  const near = placedEvents(width).filter((event) => Math.abs(event.x - x) <= 8);
  return near.sort((a, b) => Math.abs(a.x - x) - Math.abs(b.x - x))[0] ?? null;
}

// What the plots shade, in words, each after a swatch of its colour.
function fillShading() {
  const shaded = [...new Set(events.filter((event) => event.until !== undefined).map((event) => event.kind))];
  const named = shaded.map((kind) => {
    const swatch = make("i", { className: "swatch" });
    Object.assign(swatch.style, { background: eventInk(kind), opacity: 0.4 });
    return make("span", {}, swatch, KIND_NAMES[kind] ?? kind);
  });
  document.getElementById("shading").replaceChildren(...(named.length ? ["Shaded: ", ...named] : []));
}

function fillMarksKey() {
  fillShading();
  const order = Object.keys(KIND_NAMES);
  const kinds = [...new Set(events.map((event) => event.kind))].sort((a, b) => order.indexOf(a) - order.indexOf(b));
  document.getElementById("marks-key").replaceChildren(...kinds.map((kind) => {
    const canvas = make("canvas", {});
    Object.assign(canvas.style, { display: "inline-block", width: "12px", height: "12px", marginRight: "5px", verticalAlign: "-1px" });
    const ratio = window.devicePixelRatio || 1;
    Object.assign(canvas, { width: 12 * ratio, height: 12 * ratio });
    const ctx = canvas.getContext("2d");
    ctx.scale(ratio, ratio);
    eventGlyph(ctx, kind, 6, 6, 4.5);
    return make("span", {}, canvas, KIND_NAMES[kind] ?? kind);
  }));
  const text = events.map((event) => `${event.time.toFixed(2)} s ${event.text}`).join("; ");
  marks.setAttribute("aria-label", `Marks on the time line: ${text || "none"}`);
}
