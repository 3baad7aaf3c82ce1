// What bounds the plan: per step and side the branch, or stop line, that leaves it the least room.
const boundAt = (decision, step, side) => decision.bounds.find((bound) => bound.step === step && bound.side === side) ?? null;

function roomText(decision, step, side) {
  if (!decision.bounds) return "–";
  const bound = boundAt(decision, step, side);
  return bound ? fixed(bound.room_m, 1) : "free";
}

function boundText(decision) {
  if (!decision.plan.length) return decision.status === "rule" ? "A rule decides from the present gaps and plans nothing." : "There is no plan to bound.";
  if (!decision.bounds) return "What bounds the plan was not recorded: these results are of an earlier version.";
  if (!decision.bounds.length) return "Nobody shares a lane with the plan: its costs alone shape it.";
  const least = decision.bounds.reduce((a, b) => (b.room_m < a.room_m ? b : a));
  const entry = decision.plan.find(({ step }) => step === least.step);
  const time = horizonTime(decision, least.step);
  const where = `step ${least.step}${time === null ? "" : ` (${time.toFixed(2)} s)`}, lane ${entry.lane}`;
  const much = least.room_m < 0 ? `${(-least.room_m).toFixed(1)} m are missing` : `${least.room_m.toFixed(1)} m are left`;
  const asked = `${Math.abs(least.x_m - entry.x_m).toFixed(1)} m away, of ${least.distance_m.toFixed(1)} m asked for`;
  if (least.probability === null) return `Tightest at ${where}: ${much} to a stop line ${asked}.`;
  const branch = `branch of ${Number((100 * least.probability).toPrecision(2))} %`;
  return `Tightest at ${where}: ${much} to ${least.vehicle_id} ${least.side}, whose ${branch} is ${asked}.`;
}
