// The one place that holds what changes (time, playing, highlight), and the controls that change it.
const element = (id) => document.getElementById(id);
const slider = element("time");
const stillness = matchMedia("(prefers-reduced-motion: reduce)");
const darkness = matchMedia("(prefers-color-scheme: dark)");
const app = { cursor: cursorAt(firstTime), playing: false, rate: 1, clock: 0, last: 0, decision: undefined, highlighted: null, drawn: [], queued: false, told: 0, drag: null };

// A page that is not shown, such as in a closed dialog, has no width to draw on.
const isShown = () => road.clientWidth > 0;

function draw() {
  app.queued = false;
  if (!isShown()) return;
  const decision = decisionAt(app.cursor.time);
  if (decision !== app.decision) changeDecision(decision);
  app.drawn = drawRoad(app.cursor, decision, app.highlighted).drawn;
  plots.forEach((plot) => drawPlot(plot, app.cursor, app.highlighted));
  showTime();
  if (!app.playing || performance.now() - app.told > 250) tell(decision);
}

function redraw() {
  if (app.queued) return;
  app.queued = true;
  requestAnimationFrame(draw);
}

function redrawAll() {
  if (!isShown()) return;
  plots.forEach((plot) => drawPlotBitmap(plot, app.highlighted));
  drawMarks();
  fillMarksKey();
  showScale();
  redraw();
}

function changeDecision(decision) {
  app.decision = decision;
  if (decision) view.horizon = clamp(view.horizon, 1, Math.max(horizonOf(decision), 1));
  showDecision(decision, chooseHorizon);
  showHorizon(decision);
}

function showTime() {
  const { time, frame, fraction } = app.cursor;
  element("clock").textContent = time.toFixed(2);
  const between = fraction > 0 && !app.playing;
  element("clock-aside").textContent = between ? "between records" : `of ${lastTime.toFixed(2)} s`;
  slider.value = time;
  slider.setAttribute("aria-valuetext", `${time.toFixed(2)} s, record ${frame + 1} of ${times.length}`);
}

// The picture in words; four times a second is enough while it plays.
function tell(decision) {
  app.told = performance.now();
  const text = sceneText(app.cursor, decision);
  // Read out only where the picture stands still, or it would never stop.
  element("instant").setAttribute("aria-live", app.playing ? "off" : "polite");
  if (element("instant").textContent !== text) element("instant").textContent = text;
  road.setAttribute("aria-label", `Top view of the road. ${text}`);
  showNeighbours(app.cursor);
  showScene(app.cursor);
}

function showScale() {
  const { pxPerX, pxPerY } = roadFrame(app.cursor);
  element("scale").textContent = `${Math.round(view.span)} m of road; across drawn ${(pxPerY / pxPerX).toFixed(1)}× as large as along`;
}

function seek(time) {
  app.clock = clamp(time, firstTime, lastTime);
  app.cursor = cursorAt(app.clock);
  redraw();
}

const seekRecord = (frame) => seek(times[clamp(frame, 0, times.length - 1)]);
const nearestRecord = (time) => {
  const { frame } = cursorAt(time);
  return time - times[frame] > (times[frame + 1] ?? Infinity) - time ? frame + 1 : frame;
};

function stepBy(count) {
  setPlaying(false);
  const { frame, fraction } = app.cursor;
  seekRecord(count < 0 && fraction > 0 ? frame : frame + count);
}

function decisionBy(count) {
  setPlaying(false);
  const i = lastAtOrBefore(decisions.length, (k) => decisions[k].time_s, app.cursor.time);
  const target = decisions[clamp(i + count, 0, decisions.length - 1)];
  if (target) seek(target.time_s);
}

function eventBy(count) {
  setPlaying(false);
  const others = events.filter((event) => (count < 0 ? event.time < app.cursor.time - SAME_TIME : event.time > app.cursor.time + SAME_TIME));
  const target = count < 0 ? others[others.length - 1] : others[0];
  if (target) seek(target.time);
}

function follow(isWanted) {
  if (!isWanted) view.anchor = view.follow ? focusX(app.cursor) : view.anchor;
  view.follow = isWanted;
  element("follow").checked = isWanted;
  redraw();
}

function setPlaying(playing) {
  if (playing === app.playing) return;
  app.playing = playing && times.length > 1;
  element("play").setAttribute("aria-pressed", String(app.playing));
  element("play").setAttribute("aria-label", app.playing ? "Pause" : "Play");
  element("tip").hidden = true;
  if (!app.playing) {
    redraw();
    return;
  }
  if (app.cursor.time >= lastTime) seek(firstTime);
  app.last = performance.now();
  requestAnimationFrame(advance);
}

function advance(now) {
  if (!app.playing) return;
  // A tab that slept must not leap.
  app.clock += Math.min(Math.max(now - app.last, 0), 250) / 1000 * app.rate;
  app.last = now;
  const cursor = cursorAt(app.clock);
  // Who asked for less motion gets the recorded instants without the tween between them.
  app.cursor = stillness.matches ? cursorAt(times[cursor.frame]) : cursor;
  if (app.clock >= lastTime) setPlaying(false);
  draw();
  requestAnimationFrame(advance);
}

function chooseHorizon(step) {
  view.horizon = clamp(step, 1, Math.max(app.decision ? horizonOf(app.decision) : 1, 1));
  showHorizon(app.decision);
  redraw();
}

function zoom(factor) {
  setSpan(factor === null ? defaultSpan() : view.span * factor);
  view.isFitted = factor === null;
  showScale();
  redraw();
}

function highlight(vehicle) {
  app.highlighted = vehicle === ego ? null : vehicle;
  element("highlight").value = app.highlighted ? String(vehicles.indexOf(app.highlighted)) : "";
  redrawAll();
}

function showTip(event) {
  if (app.playing || app.drag?.moved) return;
  const tip = element("tip");
  const box = road.getBoundingClientRect();
  const under = vehicleUnder(app.drawn, event.clientX - box.left, event.clientY - box.top);
  tip.hidden = !under;
  road.style.cursor = under ? "pointer" : "default";
  if (!under) return;
  tip.textContent = tipText(under, ego && stateOf(ego, app.cursor));
  const x = clamp(under.bounds.x1, 6, Math.max(box.width - tip.offsetWidth - 6, 6));
  const below = under.bounds.y2 + 8;
  tip.style.left = `${x}px`;
  const above = Math.max(under.bounds.y1 - tip.offsetHeight - 8, 2);
  tip.style.top = `${below + tip.offsetHeight > box.height ? above : below}px`;
}

function setTheme(theme) {
  document.documentElement.dataset.theme = theme;
  element("theme-name").textContent = theme === "dark" ? "Light" : "Dark";
  readInk();
  redrawAll();
}

const KEYS = {
  ArrowLeft: (event) => (event.shiftKey ? decisionBy(-1) : stepBy(-1)),
  ArrowRight: (event) => (event.shiftKey ? decisionBy(1) : stepBy(1)),
  Home: () => { setPlaying(false); seek(firstTime); },
  End: () => { setPlaying(false); seek(lastTime); },
  " ": () => setPlaying(!app.playing),
  ",": () => eventBy(-1),
  ".": () => eventBy(1),
  f: () => follow(!view.follow),
  // Inside a report it closes the replay.
  Escape: () => window.frameElement?.dispatchEvent(new Event("leave")),
  "[": () => chooseHorizon(view.horizon - 1),
  "]": () => chooseHorizon(view.horizon + 1),
  "+": () => zoom(1 / 1.4), "=": () => zoom(1 / 1.4), "-": () => zoom(1.4), 0: () => zoom(null),
};

function onKey(event) {
  if (event.ctrlKey || event.metaKey || event.altKey || !Object.hasOwn(KEYS, event.key)) return;
  const target = event.target instanceof Element ? event.target : document.body;
  if (target.closest("select")) return;
  // Space belongs to a focused control, and arrows to a focused region that scrolls.
  if (event.key === " " && target.closest("button, summary, a, input[type=checkbox]")) return;
  if (target.closest(".scroll") && !target.closest("button")) return;
  event.preventDefault();
  KEYS[event.key](event);
}

function seekByPointer(canvas, timeAt) {
  const go = (event) => {
    const box = canvas.getBoundingClientRect();
    seek(timeAt(event.clientX - box.left, box.width));
  };
  canvas.addEventListener("pointerdown", (event) => {
    if (event.button !== 0) return;
    setPlaying(false);
    canvas.setPointerCapture(event.pointerId);
    go(event);
  });
  canvas.addEventListener("pointermove", (event) => { if (canvas.hasPointerCapture(event.pointerId)) go(event); });
}

function wirePlayback() {
  slider.min = firstTime;
  slider.max = lastTime;
  slider.disabled = times.length < 2;
  slider.addEventListener("input", () => { setPlaying(false); seekRecord(nearestRecord(Number(slider.value))); });
  element("play").addEventListener("click", () => setPlaying(!app.playing));
  element("back").addEventListener("click", () => stepBy(-1));
  element("forward").addEventListener("click", () => stepBy(1));
  element("event-back").addEventListener("click", () => eventBy(-1));
  element("event-forward").addEventListener("click", () => eventBy(1));
  element("rate").addEventListener("change", (event) => { app.rate = Number(event.target.value); });
  document.addEventListener("keydown", onKey);
  plots.forEach((plot) => seekByPointer(plot.canvas, (x, width) => times[nearestRecord(timeScale(width).time(x))]));
  seekByPointer(marks, (x, width) => eventNear(x, width)?.time ?? times[nearestRecord(markTime(x, width))]);
}

// Dragging the road moves the view along it, which then no longer follows.
function dragRoad() {
  road.addEventListener("pointerdown", (event) => {
    if (event.button === 0) app.drag = { from: event.clientX, anchor: view.follow ? focusX(app.cursor) : view.anchor, moved: false };
  });
  road.addEventListener("pointermove", (event) => {
    if (!app.drag || !event.buttons) return;
    const by = event.clientX - app.drag.from;
    if (!app.drag.moved && Math.abs(by) < 5) return;
    app.drag.moved = true;
    road.setPointerCapture(event.pointerId);
    follow(false);
    view.anchor = app.drag.anchor - by / roadFrame(app.cursor).pxPerX;
    element("tip").hidden = true;
  });
}

function wireView() {
  dragRoad();
  element("follow").addEventListener("change", (event) => follow(event.target.checked));
  element("zoom-in").addEventListener("click", () => zoom(1 / 1.4));
  element("zoom-out").addEventListener("click", () => zoom(1.4));
  element("zoom-reset").addEventListener("click", () => zoom(null));
  road.addEventListener("wheel", (event) => { event.preventDefault(); zoom(Math.exp(clamp(event.deltaY, -200, 200) / 500)); }, { passive: false });
  road.addEventListener("pointermove", showTip);
  road.addEventListener("pointerleave", () => { element("tip").hidden = true; });
  road.addEventListener("click", (event) => {
    const wasDrag = app.drag?.moved;
    app.drag = null;
    if (wasDrag) return;
    const box = road.getBoundingClientRect();
    const under = vehicleUnder(app.drawn, event.clientX - box.left, event.clientY - box.top);
    highlight(under && under.vehicle !== app.highlighted ? under.vehicle : null);
  });
  element("highlight").append(...vehicles.filter((vehicle) => vehicle !== ego)
    .map((vehicle) => make("option", { value: vehicles.indexOf(vehicle) }, vehicle.id)));
  element("highlight").addEventListener("change", (event) => highlight(vehicles[event.target.value] ?? null));
  for (const box of document.querySelectorAll("[data-layer]")) {
    box.addEventListener("change", () => { view.layers[box.dataset.layer] = box.checked; redraw(); });
  }
  element("horizon-less")?.addEventListener("click", () => chooseHorizon(view.horizon - 1));
  element("horizon-more")?.addEventListener("click", () => chooseHorizon(view.horizon + 1));
  element("scene").addEventListener("toggle", () => showScene(app.cursor));
}

function wirePage() {
  element("theme").addEventListener("click", () => setTheme(document.documentElement.dataset.theme === "dark" ? "light" : "dark"));
  darkness.addEventListener("change", (event) => setTheme(event.matches ? "dark" : "light"));
  for (const link of document.querySelectorAll("[data-seek]")) {
    link.addEventListener("click", (event) => { event.preventDefault(); setPlaying(false); seek(Number(link.dataset.seek)); });
  }
  let width = 0;
  new ResizeObserver(() => {
    if (road.clientWidth === width || !isShown()) return;
    if (view.isFitted) zoom(null);
    width = road.clientWidth;
    redrawAll();
  }).observe(road);
}

wirePlayback();
wireView();
fillEvents(seek);
wirePage();
setSpan(defaultSpan());
setTheme(darkness.matches ? "dark" : "light");
const asked = Number(new URLSearchParams(location.hash.slice(1)).get("t") ?? NaN);
seek(Number.isFinite(asked) ? asked : firstTime);
draw();

window.replay = {
  seek: (time) => { setPlaying(false); seek(Number(time)); },
  state: () => ({
    time: app.cursor.time,
    vehicles: Object.fromEntries(vehicles.map((vehicle) => [vehicle.id, stateOf(vehicle, app.cursor)])
      .filter(([, state]) => state).map(([id, state]) => [id, { x_m: state.x, y_m: state.y }])),
    playing: app.playing,
    decision_index: decisionAt(app.cursor.time)?.decision_index ?? null,
    neighbours: neighbours(app.cursor).flatMap(({ lane, behind, ahead }) => [[behind, "behind"], [ahead, "ahead"]]
      .filter(([one]) => one)
      .map(([one, side]) => ({ lane, side, vehicle_id: one.vehicle.id, gap_m: one.gap, ttc_s: one.ttc }))),
    view: { follow: view.follow, left_m: roadFrame(app.cursor).left, right_m: roadFrame(app.cursor).right },
  }),
};
