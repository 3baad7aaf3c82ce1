// The top view's ground: road, forbidden intervals, predicted branches and the plan. x runs right, y up.
const GUTTER = 34;
const TOP = 12;
const AXIS = 26;
const road = document.getElementById("road");
// `anchor` is the x in the middle of the view while it does not follow the ego.
const view = { span: 0, isFitted: true, horizon: 1, follow: true, anchor: 0, layers: { plan: true, branches: true, forbidden: true, labels: true } };

function laneHeight() {
  const comfortable = road.clientWidth < 700 ? 54 : 62;
  return clamp(Math.floor(340 / lanes.count), 30, comfortable);
}

const defaultSpan = () => clamp(road.clientWidth / 7.5, 80, 190);
const setSpan = (span) => { view.span = clamp(span, 40, 800); };

function roadFrame(cursor) {
  const width = road.clientWidth;
  const perLane = laneHeight();
  const pxPerX = (width - GUTTER) / view.span;
  const pxPerY = perLane / lanes.width_m;
  const left = (view.follow ? focusX(cursor) : view.anchor) - 0.34 * view.span;
  const bottom = TOP + perLane * lanes.count;
  return {
    width, perLane, pxPerX, pxPerY, left, right: left + view.span, bottom,
    px: (x) => GUTTER + (x - left) * pxPerX,
    py: (y) => TOP + (bottom - TOP) / 2 - y * pxPerY,
  };
}

function drawRoad(cursor, decision, highlighted) {
  road.style.height = `${TOP + laneHeight() * lanes.count + AXIS}px`;
  const { ctx } = begin(road);
  const frame = roadFrame(cursor);
  ctx.fillStyle = ink.road;
  ctx.fillRect(GUTTER, TOP, frame.width - GUTTER, frame.bottom - TOP);
  ctx.save();
  ctx.beginPath();
  ctx.rect(GUTTER, 0, frame.width - GUTTER, frame.bottom + AXIS);
  ctx.clip();
  drawLaneLines(ctx, frame);
  if (decision) drawDecision(ctx, frame, decision);
  const drawn = drawVehicles(ctx, frame, cursor, highlighted);
  drawXAxis(ctx, frame);
  ctx.restore();
  drawLaneNumbers(ctx, frame);
  return { frame, drawn };
}

function drawDecision(ctx, frame, decision) {
  const step = view.horizon;
  if (view.layers.forbidden) drawForbidden(ctx, frame, decision, step);
  if (view.layers.branches) drawBranches(ctx, frame, decision, step);
  if (view.layers.plan) drawPlan(ctx, frame, decision, step);
}

function drawLaneLines(ctx, frame) {
  ctx.strokeStyle = ink.dash;
  ctx.lineWidth = 2;
  // Fixed to the ground, so that they tell motion; longer when far away, or they would flicker.
  const unit = tickSpacing(frame.pxPerX, 34);
  ctx.setLineDash([unit * frame.pxPerX * 0.35, unit * frame.pxPerX * 0.65]);
  ctx.lineDashOffset = (((frame.left % unit) + unit) % unit) * frame.pxPerX;
  for (let i = 1; i < lanes.count; i += 1) {
    const y = TOP + i * frame.perLane;
    segment(ctx, GUTTER, y, frame.width, y);
  }
  ctx.setLineDash([]);
  ctx.strokeStyle = ink.edge;
  ctx.lineWidth = 1.5;
  segment(ctx, GUTTER, TOP, frame.width, TOP);
  segment(ctx, GUTTER, frame.bottom, frame.width, frame.bottom);
}

function drawXAxis(ctx, frame) {
  ctx.font = `11px ${FONT}`;
  ctx.textAlign = "center";
  ctx.textBaseline = "top";
  ctx.fillStyle = ink.muted;
  ctx.strokeStyle = ink.edge;
  ctx.lineWidth = 1;
  const spacing = tickSpacing(frame.pxPerX, 84);
  for (const x of ticksBetween(frame.left, frame.right, spacing / 5)) {
    const major = Math.abs(x / spacing - Math.round(x / spacing)) < 1e-6;
    const px = Math.round(frame.px(x)) + 0.5;
    segment(ctx, px, frame.bottom, px, frame.bottom + (major ? 6 : 3));
    if (major && px > GUTTER + 20 && px < frame.width - 22) ctx.fillText(`${Math.round(x)} m`, px, frame.bottom + 9);
  }
}

function drawLaneNumbers(ctx, frame) {
  ctx.font = `600 12px ${FONT}`;
  ctx.textAlign = "center";
  ctx.textBaseline = "middle";
  ctx.fillStyle = ink.muted;
  for (let lane = 1; lane <= lanes.count; lane += 1) ctx.fillText(String(lane), GUTTER / 2 + 2, frame.py(laneY(lane)));
  ctx.font = `11px ${FONT}`;
  ctx.textBaseline = "top";
  ctx.fillText("lane", GUTTER / 2 + 1, frame.bottom + 9);
}

// One union for each lane: overlapping intervals must not hatch twice.
function forbiddenUnions(decision, step) {
  const unions = [];
  const entries = decision.forbidden.filter((entry) => entry.step === step)
    .map((entry) => ({ lane: entry.lane, from: entry.x_from_m ?? -Infinity, to: entry.x_to_m ?? Infinity, leaving: entry.leaving_x_m ?? null }))
    .sort((a, b) => a.lane - b.lane || a.from - b.from);
  for (const entry of entries) {
    const last = unions[unions.length - 1];
    if (last && last.lane === entry.lane && entry.from <= last.to) {
      last.to = Math.max(last.to, entry.to);
      last.leaving ??= entry.leaving;
    } else unions.push({ ...entry });
  }
  return unions;
}

function drawForbidden(ctx, frame, decision, step) {
  const { pattern, scale } = hatch(ctx, ink.forbidden);
  // Anchored to the ground, or the hatch would crawl as the view follows the ego.
  pattern.setTransform(new DOMMatrix().translate(frame.px(0) % 8, TOP).scale(scale));
  for (const { lane, from, to, leaving } of forbiddenUnions(decision, step)) {
    const x1 = Math.max(frame.px(from), GUTTER - 4);
    const x2 = Math.min(frame.px(to), frame.width + 4);
    if (x2 <= x1) continue;
    const y = frame.py(laneY(lane)) - frame.perLane / 2 + 2;
    const rect = [x1, y, x2 - x1, frame.perLane - 4];
    ctx.globalAlpha = 0.08;
    ctx.fillStyle = ink.forbidden;
    ctx.fillRect(...rect);
    ctx.globalAlpha = 0.42;
    ctx.fillStyle = pattern;
    ctx.fillRect(...rect);
    ctx.globalAlpha = 0.9;
    ctx.strokeStyle = ink.forbidden;
    ctx.lineWidth = 1.5;
    for (const x of [x1, x2]) segment(ctx, x, y, x, y + frame.perLane - 4);
    if (leaving === null) continue;
    ctx.setLineDash([4, 4]);
    segment(ctx, frame.px(leaving), y, frame.px(leaving), y + frame.perLane - 4);
    ctx.setLineDash([]);
  }
  ctx.globalAlpha = 1;
}

const vehicleById = new Map(vehicles.map((vehicle) => [vehicle.id, vehicle]));

function startOf(vehicleId, decision) {
  const vehicle = vehicleById.get(vehicleId);
  const state = vehicle && stateOf(vehicle, cursorAt(decision.time_s));
  return state ? [[state.x, state.y]] : [];
}

// Branches that are drawn alike, each as points along the road; worked out once for a decision.
const branchGroups = new WeakMap();
const ALPHAS = 16;

function groupsOf(decision) {
  if (branchGroups.has(decision)) return branchGroups.get(decision);
  const groups = new Map();
  for (const branch of decision.branches) {
    const level = Math.round(ALPHAS * clamp(0.16 + 0.84 * (branch.probability ?? 1), 0, 1));
    const points = [...startOf(branch.vehicle_id, decision), ...branch.x_m.map((x, i) => [x, branch.y_m[i]])];
    if (!groups.has(level)) groups.set(level, []);
    if (points.length) groups.get(level).push({ branch, points, from: points[0][0], to: points[points.length - 1][0] });
  }
  // The likeliest last, on top.
  const sorted = [...groups].sort(([a], [b]) => a - b).map(([level, lines]) => ({ alpha: level / ALPHAS, lines }));
  branchGroups.set(decision, sorted);
  return sorted;
}

// One path for all branches of a group: hundreds of strokes of their own would take longer than a frame.
function drawBranches(ctx, frame, decision, step) {
  ctx.strokeStyle = ink.branch;
  ctx.fillStyle = ink.branch;
  ctx.lineWidth = 1.6;
  for (const { alpha, lines } of groupsOf(decision)) {
    const seen = lines.filter(({ from, to }) => to >= frame.left && from <= frame.right + 20);
    if (!seen.length) continue;
    ctx.globalAlpha = alpha;
    ctx.beginPath();
    for (const { points } of seen) {
      points.forEach(([x, y], i) => (i ? ctx.lineTo(frame.px(x), frame.py(y)) : ctx.moveTo(frame.px(x), frame.py(y))));
    }
    ctx.stroke();
    ctx.beginPath();
    for (const { branch, points } of seen) {
      for (const [x, y] of points.slice(-branch.x_m.length)) ctx.rect(frame.px(x) - 1.6, frame.py(y) - 1.6, 3.2, 3.2);
    }
    ctx.fill();
    drawEllipses(ctx, frame, seen, step - 1, alpha);
  }
  ctx.globalAlpha = 1;
}

function drawEllipses(ctx, frame, lines, i, alpha) {
  ctx.beginPath();
  for (const { branch } of lines) {
    if (i < 0 || i >= branch.x_m.length) continue;
    const radius = (std, scale) => Math.max(2 * (std[i] ?? 0) * scale, 2);
    const [x, y, r] = [frame.px(branch.x_m[i]), frame.py(branch.y_m[i]), radius(branch.x_std_m, frame.pxPerX)];
    ctx.moveTo(x + r, y);
    ctx.ellipse(x, y, r, radius(branch.y_std_m, frame.pxPerY), 0, 0, 2 * Math.PI);
  }
  ctx.globalAlpha = alpha * 0.28;
  ctx.fill();
  ctx.globalAlpha = alpha;
  ctx.stroke();
}

function drawPlan(ctx, frame, decision, step) {
  if (!decision.plan.length) return;
  const planned = decision.plan.map((entry) => [frame.px(entry.x_m), frame.py(laneY(entry.lane))]);
  const start = startOf(data.ego_id, decision).map(([x, y]) => [frame.px(x), frame.py(y)]);
  ctx.strokeStyle = ink.ego;
  ctx.lineWidth = 2.2;
  polyline(ctx, [...start, ...planned]);
  planned.forEach(([x, y], i) => {
    const chosen = decision.plan[i].step === step;
    dot(ctx, x, y, chosen ? 5 : 3);
    ctx.fillStyle = chosen ? ink.ego : ink.surface;
    ctx.fill();
    ctx.lineWidth = 1.8;
    ctx.stroke();
    if (chosen) drawGhost(ctx, frame, x, y);
  });
}

function drawGhost(ctx, frame, x, y) {
  if (!ego) return;
  const height = ego.width_m * frame.pxPerY;
  const length = ego.length_m * frame.pxPerX;
  ctx.setLineDash([4, 3]);
  ctx.lineWidth = 1.5;
  ctx.beginPath();
  ctx.roundRect(x - length, y - height / 2, length, height, 5);
  ctx.stroke();
  ctx.setLineDash([]);
}
