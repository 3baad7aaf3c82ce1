// The run's data and what holds at one time: pure look-ups, no drawing.
const data = await unpacked(document.getElementById("replay-data").textContent).json();
const times = data.times_s;
const { vehicles, decisions, lanes } = data;
const firstTime = times[0];
const lastTime = times[times.length - 1];
const ego = vehicles.find((vehicle) => vehicle.id === data.ego_id) ?? null;
const MODE_NAMES = { "-1": "decelerate", 0: "cruise", 1: "accelerate" };
// Times in the page are rounded to the microsecond, those of a caller may not be.
const SAME_TIME = 2e-6;

const clamp = (value, low, high) => Math.min(Math.max(value, low), high);
const mix = (a, b, fraction) => a + (b - a) * fraction;
const laneY = (lane) => ((lanes.count + 1) / 2 - lane) * lanes.width_m;
const fixed = (value, decimals) => (value === null || value === undefined ? "–" : value.toFixed(decimals));

function lastAtOrBefore(count, timeOf, time) {
  let low = 0;
  let high = count;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (timeOf(middle) <= time + SAME_TIME) low = middle + 1;
    else high = middle;
  }
  return low - 1;
}

// A recorded instant has fraction 0, so that its positions are the recorded ones to the last bit.
function cursorAt(time) {
  const frame = Math.max(0, lastAtOrBefore(times.length, (i) => times[i], time));
  const rest = time - times[frame];
  if (rest <= SAME_TIME || frame === times.length - 1) return { time: times[frame], frame, fraction: 0 };
  return { time, frame, fraction: rest / (times[frame + 1] - times[frame]) };
}

function stateOf(vehicle, cursor) {
  const i = cursor.frame - vehicle.first;
  const x = vehicle.x_m[i];
  if (x === undefined || x === null) return null;
  const f = cursor.fraction;
  const next = vehicle.x_m[i + 1];
  // Between its last record and the next instant a vehicle is nowhere.
  if (f > 0 && (next === undefined || next === null)) return null;
  const at = (column) => (f > 0 ? mix(column[i], column[i + 1], f) : column[i]);
  return {
    x: at(vehicle.x_m), y: at(vehicle.y_m), heading: at(vehicle.heading_rad), speed: at(vehicle.speed_mps),
    accel: at(vehicle.accel_mps2), lane: vehicle.lane[i], intended: vehicle.intended_lane[i], mode: vehicle.mode[i],
  };
}

const decisionAt = (time) => decisions[lastAtOrBefore(decisions.length, (i) => decisions[i].time_s, time)] ?? null;

// The view needs an x also where the ego is not recorded: its nearest record, or another vehicle's.
function focusX(cursor) {
  const subject = ego ?? vehicles[0];
  const state = stateOf(subject, cursor);
  if (state) return state.x;
  const recorded = subject.x_m.filter((x) => x !== null);
  return cursor.frame < subject.first ? recorded[0] : recorded[recorded.length - 1];
}

const gapOf = (front, frontLength, rear) => front - frontLength - rear;

// Along the road, bumper to bumper, whatever the lanes.
function alongGap(vehicle, state, egoState) {
  return Math.max(gapOf(state.x, vehicle.length_m, egoState.x), gapOf(egoState.x, ego.length_m, state.x));
}

function gapToEgo(vehicle, state, egoState) {
  if (!egoState || vehicle === ego || state.lane !== egoState.lane) return null;
  return alongGap(vehicle, state, egoState);
}

// The nearest vehicle ahead and behind in the ego's lane and in those beside it; ttc is null while nothing closes.
function neighbours(cursor) {
  const egoState = ego && stateOf(ego, cursor);
  if (!egoState || egoState.lane === null) return [];
  const found = [];
  for (const offset of [-1, 0, 1]) {
    const lane = egoState.lane + offset;
    if (lane >= 1 && lane <= lanes.count) found.push({ offset, lane, ahead: null, behind: null });
  }
  for (const vehicle of vehicles) {
    if (vehicle === ego) continue;
    const state = stateOf(vehicle, cursor);
    const row = state && found.find(({ lane }) => lane === state.lane);
    if (!row) continue;
    const side = state.x >= egoState.x ? "ahead" : "behind";
    const gap = alongGap(vehicle, state, egoState);
    if (row[side] && row[side].gap <= gap) continue;
    const closing = side === "ahead" ? egoState.speed - state.speed : state.speed - egoState.speed;
    row[side] = { vehicle, gap, closing, ttc: closing > 0 && gap >= 0 ? gap / closing : null };
  }
  return found;
}

const horizonOf = (decision) => Math.max(
  0,
  ...decision.plan.map((entry) => entry.step),
  ...decision.branches.map((branch) => branch.x_m.length),
  ...decision.forbidden.map((entry) => entry.step),
);

const horizonTime = (decision, step) => (data.period_s === null ? null : decision.time_s + step * data.period_s);

// Consecutive decisions of one status, so that a long fallback is one mark and not fifty.
function statusRuns() {
  const runs = [];
  decisions.forEach((decision, i) => {
    const until = decisions[i + 1]?.time_s ?? lastTime;
    const run = runs[runs.length - 1];
    if (run && run.status === decision.status) Object.assign(run, { until, count: run.count + 1 });
    else runs.push({ status: decision.status, from: decision.time_s, until, count: 1, reason: decision.reason });
  });
  return runs;
}

const KIND_NAMES = {
  left: "lane change left", right: "lane change right", relaxed: "relaxed", fallback: "fallback", incumbent: "incumbent",
  near_miss: "near miss", contact: "contact",
};

function eventList() {
  const changes = data.lane_changes.map((change) => ({
    time: change.time_s, kind: change.left ? "left" : "right",
    text: `lane change to the ${change.left ? "left" : "right"}, now lane ${change.lane}`,
  }));
  // A rule's decisions are neither optimal nor a departure from it.
  const statuses = statusRuns().filter((run) => !["optimal", "rule"].includes(run.status)).map((run) => ({
    time: run.from, until: run.until, kind: run.status,
    text: `${run.count > 1 ? `${run.count} decisions ` : ""}${run.status}${run.reason ? `: ${run.reason}` : ""}`,
  }));
  const conflicts = data.conflicts.map((one) => ({
    time: one.time_s, until: one.until_s, kind: one.kind, text: `${KIND_NAMES[one.kind]} with ${one.vehicle_id}`,
  }));
  return [...changes, ...statuses, ...conflicts].sort((a, b) => a.time - b.time);
}
const events = eventList();
