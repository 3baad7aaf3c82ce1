// Why no other first action was taken: of each the cost of its best plan, or what stands against it.
const ACTION_WORDS = { left: "left", keep: "keep lane", right: "right" };
const nameOf = (action) => `${ACTION_WORDS[action.lateral] ?? action.lateral}, ${action.mode}`;

function whyText(action, chosen) {
  if (action.chosen) return action.reason ? `taken; ${action.reason}` : "taken";
  if (action.verdict !== "feasible") return action.reason;
  const keeps = typeof action.risk === "number" ? "keeps the risk" : "keeps every distance";
  if (chosen?.verdict !== "feasible") return keeps;
  const more = action.objective - chosen.objective;
  if (Math.abs(more) < 1e-6) return "as good";
  return `${keeps}, costs ${Number(Math.abs(more).toPrecision(3))} ${more < 0 ? "less" : "more"}`;
}

// What a rule forbids, those together that the same rule forbids.
function forbiddenText(actions) {
  const byReason = new Map();
  for (const action of actions) byReason.set(action.reason, [...(byReason.get(action.reason) ?? []), nameOf(action)]);
  return `Not allowed: ${[...byReason].map(([reason, names]) => `${names.join("; ")} – ${reason}`).join(". ")}.`;
}

function actionsOf(decision) {
  if (decision.status === "rule") return decision.notes.lanes.length ? [] : [make("p", { className: "empty" }, "A rule weighs no other first actions.")];
  if (!decision.actions) {
    return [make("p", { className: "empty" }, "Why no other first action was taken is not in this page: ", make("code", {}, "sumo-hmdp replay DIR RUN_ID"), " works it out.")];
  }
  if (!decision.actions.length) {
    return [make("p", { className: "empty" }, "What the other first actions would lead to could not be worked out.")];
  }
  const chosen = decision.actions.find((action) => action.chosen) ?? null;
  const risky = decision.actions.some((action) => typeof action.risk === "number");
  const open = (action) => action.verdict !== "inadmissible" || action.chosen;
  const rows = decision.actions.filter(open).map((action) => {
    const name = make("th", { scope: "row", className: "word" }, nameOf(action));
    const row = make("tr", {}, name, cell(significant(action.objective)), ...(risky ? [cell(typeof action.risk === "number" ? percent(action.risk) : "–")] : []), cell(whyText(action, chosen), "word"));
    if (action.chosen) row.setAttribute("aria-current", "true");
    return row;
  });
  const heads = [["First action", "word"], ["Best cost"], ...(risky ? [["Risk"]] : []), ["Why, or why not", "word"]];
  const caption = make("caption", {}, "First actions, each with the best plan that begins with it");
  const table = make("table", { className: "actions-table" }, caption, headRow(heads), make("tbody", {}, ...rows));
  const shut = decision.actions.filter((action) => !open(action));
  return shut.length ? [table, make("p", { className: "note not-allowed" }, forbiddenText(shut))] : [table];
}
