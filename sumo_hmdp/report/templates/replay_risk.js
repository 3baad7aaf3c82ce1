// From whom and when the risk of a plan comes; only where the planner bounds the risk of whole plans.
const percent = (value) => (value < 1e-9 ? "0 %" : value >= 0.995 ? "100 %" : `${Number((100 * value).toPrecision(2))} %`);
const hasRisk = (decision) => typeof decision.risk_taken === "number";

function riskText(decision) {
  const asked = data.risk_level === null ? "" : ` of ${percent(data.risk_level)}`;
  const plan = decision.plan.length ? "Risk" : "Risk of the best plan, which was given up:";
  const first = decision.risk?.[0];
  const from = first ? `: ${first.vehicle_id} ${first.reason}, at step ${first.step} (${percent(first.total)})` : "";
  const rest = (decision.risk?.length ?? 0) - 1;
  const more = rest > 0 ? `, and ${rest} more vehicle${rest > 1 ? "s" : ""}` : "";
  return `${plan} ${percent(decision.risk_taken)}${asked}${from}${more}. The least of any plan is ${percent(decision.risk_least)}, contact ${percent(decision.contact_risk)}.`;
}

// What all vehicles add at one step.
const riskAt = (decision, step) => percent((decision.risk ?? []).reduce((sum, share) => sum + (share.parts[step - 1] ?? 0), 0));

function riskTable(decision) {
  if (!decision.risk?.length) return [];
  const rows = decision.risk.slice(0, 6).map((share) => make("tr", {}, make("th", { scope: "row", className: "word" }, share.vehicle_id),
    cell(percent(share.total)), cell(share.step), cell(share.reason, "word")));
  const heads = [["Vehicle", "word"], ["Adds"], ["Step"], ["Why, at that step", "word"]];
  const caption = make("caption", {}, "From whom the risk comes");
  return [make("table", { className: "actions-table risk-table" }, caption, headRow(heads), make("tbody", {}, ...rows))];
}
