// Speed and intended lane over time: lines drawn once to a bitmap, the cursor over it on every frame.
const MARGIN = { left: 36, right: 12, top: 8, bottom: 24 };

const timeScale = (width) => {
  const [from, to] = [MARGIN.left, width - MARGIN.right];
  const span = Math.max(lastTime - firstTime, 1e-9);
  return {
    from, to, perSecond: (to - from) / span,
    px: (time) => from + ((time - firstTime) / span) * (to - from),
    time: (px) => clamp(firstTime + ((px - from) / (to - from)) * span, firstTime, lastTime),
  };
};

function speedRange() {
  let [low, high] = [Infinity, -Infinity];
  for (const vehicle of vehicles) {
    for (const speed of vehicle.speed_mps) {
      if (speed === null) continue;
      low = Math.min(low, speed);
      high = Math.max(high, speed);
    }
  }
  if (low > high) return [0, 1];
  const pad = Math.max((high - low) * 0.08, 0.5);
  return [Math.max(0, low - pad), high + pad];
}

// Vehicles in one lane run side by side within 60 % of the lane, the ego in the middle.
const laneOffset = (() => {
  const others = vehicles.filter((vehicle) => vehicle !== ego);
  const offsets = new Map(others.map((vehicle, i) => {
    const rank = Math.floor(i / 2) + 1;
    const most = Math.ceil(others.length / 2);
    return [vehicle, (i % 2 ? 1 : -1) * (0.06 + (0.26 * rank) / most)];
  }));
  return (vehicle) => offsets.get(vehicle) ?? 0;
})();

const speedPlot = {
  canvas: document.getElementById("speed-plot"), output: document.getElementById("speed-now"),
  range: speedRange(), flip: false, stepped: false,
  values: (vehicle) => vehicle.speed_mps, shift: () => 0,
  ticks: (perUnit) => ticksBetween(...speedPlot.range, tickSpacing(perUnit, 30)),
  text: (vehicle, state) => `${shortened(vehicle.id)} ${state.speed.toFixed(1)} m/s`,
};
const lanePlot = {
  canvas: document.getElementById("lane-plot"), output: document.getElementById("lane-now"),
  range: [0.5, lanes.count + 0.5], flip: true, stepped: true,
  values: (vehicle) => vehicle.intended_lane, shift: laneOffset,
  ticks: () => Array.from({ length: lanes.count }, (_, i) => i + 1),
  text: (vehicle, state) => `${shortened(vehicle.id)} lane ${state.intended ?? "–"}`,
};
const plots = [speedPlot, lanePlot];

function valueScale(plot, height) {
  const [low, high] = plot.range;
  const [top, bottom] = [MARGIN.top, height - MARGIN.bottom];
  const perUnit = (bottom - top) / (high - low);
  return { top, bottom, perUnit, py: (value) => (plot.flip ? top + (value - low) * perUnit : bottom - (value - low) * perUnit) };
}

function drawPlotGround(ctx, plot, width, height) {
  const time = timeScale(width);
  const value = valueScale(plot, height);
  ctx.font = `11px ${FONT}`;
  ctx.lineWidth = 1;
  ctx.strokeStyle = ink.line;
  ctx.fillStyle = ink.muted;
  ctx.textAlign = "right";
  ctx.textBaseline = "middle";
  for (const tick of plot.ticks(value.perUnit)) {
    const y = Math.round(value.py(tick)) + 0.5;
    segment(ctx, time.from, y, time.to, y);
    ctx.fillText(String(Number(tick.toFixed(6))), time.from - 8, y);
  }
  ctx.textBaseline = "top";
  const spacing = tickSpacing(time.perSecond, 64);
  for (const tick of ticksBetween(firstTime, lastTime, spacing)) {
    const x = Math.round(time.px(tick)) + 0.5;
    segment(ctx, x, value.bottom, x, value.bottom + 4);
    ctx.textAlign = x > time.to - 12 ? "right" : "center";
    ctx.fillText(`${Number(tick.toFixed(6))} s`, x, value.bottom + 8);
  }
  drawStatusBands(ctx, time, value);
}

function drawStatusBands(ctx, time, value) {
  ctx.globalAlpha = 0.14;
  for (const event of events) {
    if (event.until === undefined) continue;
    ctx.fillStyle = eventInk(event.kind);
    const x = time.px(event.time);
    ctx.fillRect(x, value.top, Math.max(time.px(event.until) - x, 1), value.bottom - value.top);
  }
  ctx.globalAlpha = 1;
}

function drawSeries(ctx, plot, vehicle, time, value) {
  const values = plot.values(vehicle);
  const shift = plot.shift(vehicle);
  ctx.beginPath();
  let before = null;
  values.forEach((number, i) => {
    if (number !== null) {
      const [x, y] = [time.px(times[vehicle.first + i]), value.py(number + shift)];
      if (before === null) ctx.moveTo(x, y);
      else {
        if (plot.stepped) ctx.lineTo(x, before);
        ctx.lineTo(x, y);
      }
      before = y;
    } else before = null;
  });
  ctx.stroke();
}

function drawPlotBitmap(plot, highlighted) {
  plot.bitmap ??= document.createElement("canvas");
  const { canvas, bitmap } = plot;
  const ratio = window.devicePixelRatio || 1;
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  Object.assign(bitmap, { width: Math.round(width * ratio), height: Math.round(height * ratio) });
  const ctx = bitmap.getContext("2d");
  ctx.setTransform(ratio, 0, 0, ratio, 0, 0);
  drawPlotGround(ctx, plot, width, height);
  const [time, value] = [timeScale(width), valueScale(plot, height)];
  ctx.lineJoin = "round";
  const crowd = vehicles.filter((vehicle) => vehicle !== ego && vehicle !== highlighted);
  const styles = [
    [crowd, ink.other, 1, crowd.length > 30 ? 0.35 : 0.7], [highlighted ? [highlighted] : [], ink.highlight, 2, 1],
    [ego ? [ego] : [], ink.ego, 2.5, 1],
  ];
  for (const [group, color, width_px, alpha] of styles) {
    Object.assign(ctx, { strokeStyle: color, lineWidth: width_px, globalAlpha: alpha });
    group.forEach((vehicle) => drawSeries(ctx, plot, vehicle, time, value));
  }
}

function plotValue(plot, vehicle, state) {
  const number = plot === speedPlot ? state.speed : state.intended;
  return number === null ? null : number + plot.shift(vehicle);
}

function drawPlot(plot, cursor, highlighted) {
  const { ctx, width, height } = begin(plot.canvas);
  ctx.drawImage(plot.bitmap, 0, 0, width, height);
  const [time, value] = [timeScale(width), valueScale(plot, height)];
  const x = time.px(cursor.time);
  ctx.strokeStyle = ink.ink;
  ctx.lineWidth = 1;
  segment(ctx, x, value.top, x, value.bottom);
  const parts = [];
  for (const [vehicle, color, name] of [[highlighted, ink.highlight, "highlight"], [ego, ink.ego, "ego"]]) {
    const state = vehicle && stateOf(vehicle, cursor);
    if (!state) continue;
    parts.unshift([plot.text(vehicle, state), name]);
    const number = plotValue(plot, vehicle, state);
    if (number === null) continue;
    Object.assign(ctx, { fillStyle: color, strokeStyle: ink.surface, lineWidth: 1.5 });
    dot(ctx, x, value.py(number), 4.5);
    ctx.fill();
    ctx.stroke();
  }
  const line = parts.map(([text]) => text).join("|");
  if (plot.line !== line) plot.output.replaceChildren(...parts.map(([text, name]) => make("span", { className: name }, text)));
  plot.line = line;
}
