// What bounds a plan: the forbidden stretches beside it, and whose predicted branch each of them ends with.

// Of the branches whose mean lies in a stretch, the last one towards the end in question made that end.
function makerOf(decision, step, lane, stretch, isUpperEnd) {
  const inside = decision.branches.filter((branch) => {
    const [x, y] = [branch.x_m[step - 1], branch.y_m[step - 1]];
    return x !== undefined && x >= stretch.from && x <= stretch.to && Math.abs(y - laneY(lane)) < 0.9 * lanes.width_m;
  });
  const sign = isUpperEnd ? 1 : -1;
  return inside.sort((a, b) => sign * (b.x_m[step - 1] - a.x_m[step - 1]))[0] ?? null;
}

// The free window of the plan's lane around the plan at one step; an end is null where nothing bounds it. A plan inside
// a forbidden stretch has negative room to that stretch's nearer end.
function windowAround(decision, entry) {
  const found = { behind: null, ahead: null };
  for (const stretch of forbiddenUnions(decision, entry.step)) {
    if (stretch.lane !== entry.lane) continue;
    const isAhead = stretch.to > entry.x_m && (stretch.from >= entry.x_m || entry.x_m - stretch.from <= stretch.to - entry.x_m);
    const side = isAhead ? "ahead" : "behind";
    const room = isAhead ? stretch.from - entry.x_m : entry.x_m - stretch.to;
    if (found[side] && found[side].room <= room) continue;
    found[side] = { room, maker: makerOf(decision, entry.step, entry.lane, stretch, !isAhead) };
  }
  return found;
}

function tightest(decision) {
  let least = null;
  for (const entry of decision.plan) {
    for (const [side, end] of Object.entries(windowAround(decision, entry))) {
      if (end && (!least || end.room < least.room)) least = { ...end, side, entry };
    }
  }
  return least;
}

function boundText(decision) {
  if (!decision.plan.length) return decision.status === "rule" ? "A rule decides from the present gaps and plans nothing." : "There is no plan to bound.";
  const least = tightest(decision);
  if (!least) return "Nothing forbidden in the lanes of the plan: its costs alone shape it.";
  const { entry, maker, side } = least;
  const time = horizonTime(decision, entry.step);
  const where = `step ${entry.step}${time === null ? "" : ` (${time.toFixed(2)} s)`}, lane ${entry.lane}`;
  const who = maker ? `${maker.vehicle_id}, whose branch of ${Number((100 * maker.probability).toPrecision(2))} % is ${Math.abs(maker.x_m[entry.step - 1] - entry.x_m).toFixed(1)} m away` : "a stop line or a branch that is not drawn";
  const much = least.room < 0 ? `${(-least.room).toFixed(1)} m are missing` : `${least.room.toFixed(1)} m are left`;
  return `Tightest at ${where}: ${much} to what is forbidden ${side} for ${who}.`;
}
