// The top view's vehicles and their labels, and what lies under the pointer.
const MODE_GLYPHS = { "-1": "«", 0: "–", 1: "»" };
const LABEL_HEIGHT = 13;

function outline(frame, vehicle, state) {
  const [cos, sin] = [Math.cos(state.heading), Math.sin(state.heading)];
  const corner = (back, side) => [
    frame.px(state.x - back * cos - side * sin), frame.py(state.y - back * sin + side * cos),
  ];
  const half = vehicle.width_m / 2;
  // At least 4 px long, or a far view loses its vehicles.
  const length = Math.max(vehicle.length_m, 4 / frame.pxPerX);
  return [corner(0, half), corner(0, -half), corner(length, -half), corner(length, half)];
}

function boundsOf(points) {
  const xs = points.map(([x]) => x);
  const ys = points.map(([, y]) => y);
  return { x1: Math.min(...xs), x2: Math.max(...xs), y1: Math.min(...ys), y2: Math.max(...ys) };
}

function roundedPolygon(ctx, points, radius) {
  const last = points[points.length - 1];
  ctx.beginPath();
  ctx.moveTo((last[0] + points[0][0]) / 2, (last[1] + points[0][1]) / 2);
  points.forEach((point, i) => {
    const next = points[(i + 1) % points.length];
    ctx.arcTo(point[0], point[1], (point[0] + next[0]) / 2, (point[1] + next[1]) / 2, radius);
  });
  ctx.closePath();
}

function visibleVehicles(frame, cursor) {
  const shown = [];
  for (const vehicle of vehicles) {
    const state = stateOf(vehicle, cursor);
    if (!state || state.x < frame.left - 1 || state.x - vehicle.length_m > frame.right) continue;
    const points = outline(frame, vehicle, state);
    shown.push({ vehicle, state, points, bounds: boundsOf(points) });
  }
  return shown;
}

function drawVehicles(ctx, frame, cursor, highlighted) {
  const shown = visibleVehicles(frame, cursor);
  // The ego last: nothing may cover it.
  for (const item of [...shown].reverse()) drawVehicle(ctx, frame, item, item.vehicle === highlighted);
  if (view.layers.labels) drawLabels(ctx, frame, shown, highlighted);
  return shown;
}

function drawVehicle(ctx, frame, { vehicle, state, points, bounds }, isHighlighted) {
  const length = bounds.x2 - bounds.x1;
  ctx.fillStyle = vehicle === ego ? ink.ego : ink.other;
  ctx.strokeStyle = isHighlighted ? ink.highlight : ink.surface;
  ctx.lineWidth = isHighlighted ? 2.5 : 1;
  roundedPolygon(ctx, points, Math.min(6, length / 3));
  ctx.fill();
  ctx.stroke();
  const middle = [(points[0][0] + points[2][0]) / 2, (points[0][1] + points[2][1]) / 2];
  if (length >= 16 && state.mode !== null) {
    ctx.font = `700 14px ${FONT}`;
    ctx.textAlign = "center";
    ctx.textBaseline = "middle";
    ctx.fillStyle = ink["on-vehicle"];
    ctx.fillText(MODE_GLYPHS[state.mode], middle[0], middle[1]);
  }
  drawIntention(ctx, frame, vehicle, state, middle);
}

function drawIntention(ctx, frame, vehicle, state, [x, y]) {
  if (state.intended === null || state.intended === state.lane) return;
  const side = state.intended < state.lane ? -1 : 1;
  const foot = y + side * ((vehicle.width_m / 2) * frame.pxPerY + 2);
  ctx.fillStyle = ink.ink;
  polygon(ctx, [[x - 5, foot], [x + 5, foot], [x, foot + side * 6]]);
  ctx.fill();
}

const overlaps = (a, b) => a.x1 < b.x2 && b.x1 < a.x2 && a.y1 < b.y2 && b.y1 < a.y2;

// Greedy, most important first: a label that finds no free place is left out and stays in the table below.
function drawLabels(ctx, frame, shown, highlighted) {
  const egoX = shown.find((item) => item.vehicle === ego)?.state.x ?? (frame.left + frame.right) / 2;
  const rank = ({ vehicle, state }) => (vehicle === ego ? -2 : vehicle === highlighted ? -1 : Math.abs(state.x - egoX));
  const taken = shown.map((item) => item.bounds);
  ctx.textAlign = "left";
  ctx.textBaseline = "alphabetic";
  ctx.lineJoin = "round";
  const visible = shown.filter(({ bounds }) => bounds.x2 > GUTTER + 3 && bounds.x1 < frame.width - 3);
  for (const item of visible.sort((a, b) => rank(a) - rank(b))) {
    const place = freePlace(ctx, frame, item, taken);
    if (!place) continue;
    taken.push(place.box);
    drawLabel(ctx, place);
  }
}

function shortened(id) {
  return id.length > 14 ? `${id.slice(0, 13)}…` : id;
}

function freePlace(ctx, frame, { vehicle, state, bounds }, taken) {
  ctx.font = `650 11px ${FONT}`;
  const name = shortened(vehicle.id);
  const nameWidth = ctx.measureText(name).width;
  ctx.font = `11px ${FONT}`;
  const speed = ` ${state.speed.toFixed(1)}`;
  const speedWidth = ctx.measureText(speed).width;
  const center = (bounds.x1 + bounds.x2) / 2;
  const pointsUp = state.intended !== null && state.intended < state.lane;
  const below = bounds.y2 + 2;
  const above = bounds.y1 - LABEL_HEIGHT - 2;
  // Away from the arrow that shows an intended lane change.
  const rows = state.intended > state.lane ? [above, below + 6] : [below, pointsUp ? above - 6 : above];
  const short = [nameWidth, ""];
  // Far away there are many labels and little room: the id is what one looks for.
  const forms = frame.pxPerX < 2.5 && vehicle !== ego ? [short] : [[nameWidth + speedWidth, speed], short];
  for (const [width, text] of forms) {
    for (const y1 of rows) {
      // A vehicle at the edge keeps its label inside.
      const middle = clamp(center, GUTTER + width / 2 + 3, frame.width - width / 2 - 3);
      const box = { x1: middle - width / 2 - 2, x2: middle + width / 2 + 2, y1, y2: y1 + LABEL_HEIGHT };
      const inside = box.y1 >= 0 && box.y2 <= frame.bottom && box.x1 >= GUTTER && box.x2 <= frame.width;
      if (inside && !taken.some((other) => overlaps(box, other))) return { box, name, nameWidth, speed: text };
    }
  }
  return null;
}

function drawLabel(ctx, { box, name, nameWidth, speed }) {
  const [x, y] = [box.x1 + 2, box.y2 - 3];
  ctx.strokeStyle = ink.road;
  ctx.lineWidth = 3;
  ctx.fillStyle = ink.ink;
  for (const [font, text, left] of [[`650 11px ${FONT}`, name, x], [`11px ${FONT}`, speed, x + nameWidth]]) {
    ctx.font = font;
    ctx.strokeText(text, left, y);
    ctx.fillText(text, left, y);
  }
}

function vehicleUnder(drawn, x, y) {
  const reach = 4;
  return drawn.find(({ bounds }) => x >= bounds.x1 - reach && x <= bounds.x2 + reach
    && y >= bounds.y1 - reach && y <= bounds.y2 + reach) ?? null;
}

function tipText({ vehicle, state }, egoState) {
  const gap = gapToEgo(vehicle, state, egoState);
  return [
    vehicle.id,
    `${state.speed.toFixed(2)} m/s, ${fixed(state.accel, 2)} m/s²`,
    `lane ${state.lane ?? "–"}, intends ${state.intended ?? "–"}, ${MODE_NAMES[state.mode] ?? "no mode"}`,
    ...(gap === null ? [] : [`gap to ego ${gap.toFixed(2)} m`]),
  ].join("\n");
}
