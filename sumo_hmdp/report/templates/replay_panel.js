// The parts of the page that are text: the decision, the vehicles at an instant, the events.
function make(tag, properties, ...children) {
  const element = Object.assign(document.createElement(tag), properties);
  element.append(...children.map((child) => (child instanceof Node ? child : String(child))));
  return element;
}

const cell = (text, className = "") => make("td", { className }, text);
const headRow = (names) => make("thead", {}, make("tr", {}, ...names.map(([name, className = ""]) => make("th", { scope: "col", className }, name))));
const fact = (name, ...values) => make("div", {}, make("dt", {}, name), make("dd", {}, ...values));

function significant(value) {
  if (value === null) return "–";
  return Math.abs(value) >= 1e5 || (value !== 0 && Math.abs(value) < 1e-3) ? value.toExponential(2) : Number(value.toPrecision(5)).toString();
}

function showDecision(decision, onStep) {
  const title = document.getElementById("decision-title");
  const box = document.getElementById("decision");
  if (!decision) {
    title.textContent = "Decision";
    box.replaceChildren(make("p", { className: "empty" }, decisions.length ? "No decision at this instant yet." : "This run recorded no decisions."));
    return;
  }
  title.textContent = `Decision ${decision.decision_index} at ${decision.time_s.toFixed(2)} s`;
  const badge = make("span", { className: "badge" }, decision.status || "no status");
  badge.dataset.status = decision.status;
  const head = make("div", { className: "decision-head" }, badge, make("b", {}, actionText(decision)));
  const why = decision.reason ? [make("p", { className: "why" }, decision.reason)] : [];
  box.replaceChildren(head, ...why, make("p", { className: "bound" }, hasRisk(decision) ? riskText(decision) : boundText(decision)),
    ...notesOf(decision), factsOf(decision), ...riskTable(decision), planTable(decision, onStep), ...actionsOf(decision));
}

function actionText(decision) {
  const lateral = { left: "left", keep: "keep lane", right: "right" }[decision.lateral] ?? decision.lateral;
  return [lateral, decision.mode].filter(Boolean).join(", ") + (decision.lane === null ? "" : ` (lane ${decision.lane})`);
}

function factsOf(decision) {
  const subjects = new Set(decision.branches.map((branch) => branch.vehicle_id)).size;
  const count = decision.branch_count ?? decision.branches.length;
  return make("dl", { className: "facts" },
    fact("Objective", significant(decision.objective)),
    fact("Violation (m)", significant(decision.violation_m)),
    fact("Solve time (ms)", fixed(decision.solve_time_ms, 1)),
    fact("Solver", decision.solver || "–"),
    fact(hasRisk(decision) ? "Places" : "Branches", count, ...(subjects && !hasRisk(decision) ? [make("small", {}, ` of ${subjects} vehicle${subjects > 1 ? "s" : ""}`)] : [])),
    fact(hasRisk(decision) ? "Dropped prob." : "Pruned prob.", significant(decision.pruned_prob)));
}

function planTable(decision, onStep) {
  if (!decision.plan.length) return make("p", { className: "empty" }, "This decision has no plan.");
  const rows = decision.plan.map((entry) => {
    const choose = make("button", { type: "button" }, entry.step);
    choose.setAttribute("aria-label", `Show horizon step ${entry.step}`);
    const row = make("tr", {}, make("td", {}, choose), cell(fixed(horizonTime(decision, entry.step), 2)),
      cell(entry.lateral ?? "–", "word"), cell(entry.mode ?? "–", "word"), cell(entry.lane ?? "–"),
      cell(fixed(entry.x_m, 1)), cell(fixed(entry.speed_mps, 1)),
      ...(hasRisk(decision) ? [cell(riskAt(decision, entry.step))] : [cell(roomText(decision, entry.step, "behind")), cell(roomText(decision, entry.step, "ahead"))]));
    row.dataset.step = entry.step;
    row.addEventListener("click", () => onStep(entry.step));
    return row;
  });
  const heads = [["Step"], ["t (s)"], ["Lateral", "word"], ["Mode", "word"], ["Lane"], ["x (m)"], ["m/s"], ...(hasRisk(decision) ? [["Risk"]] : [["Room behind"], ["ahead (m)"]])];
  const table = make("table", { className: "plan-table" }, headRow(heads), make("tbody", {}, ...rows));
  const scroll = make("div", { className: "scroll", tabIndex: 0 }, table);
  scroll.setAttribute("role", "region");
  scroll.setAttribute("aria-label", "Plan");
  return scroll;
}

function showHorizon(decision) {
  const output = document.getElementById("horizon");
  if (!output) return;
  const most = decision ? horizonOf(decision) : 0;
  const time = decision && most ? horizonTime(decision, view.horizon) : null;
  output.textContent = most ? `${view.horizon} of ${most}${time === null ? "" : `, ${time.toFixed(2)} s`}` : "–";
  document.getElementById("horizon-less").disabled = !most || view.horizon <= 1;
  document.getElementById("horizon-more").disabled = !most || view.horizon >= most;
  for (const row of document.querySelectorAll(".plan-table tbody tr")) {
    row.setAttribute("aria-selected", String(Number(row.dataset.step) === view.horizon));
  }
}

function showScene(cursor) {
  if (!document.getElementById("scene").open) return;
  const egoState = ego && stateOf(ego, cursor);
  const rows = vehicles.map((vehicle) => [vehicle, stateOf(vehicle, cursor)]).filter(([, state]) => state)
    .sort(([, a], [, b]) => b.x - a.x)
    .map(([vehicle, state]) => make("tr", {}, cell(vehicle.id), cell(state.lane ?? "–"), cell(state.intended ?? "–"),
      cell(MODE_NAMES[state.mode] ?? "–", "word"), cell(state.x.toFixed(2)), cell(state.y.toFixed(2)),
      cell(state.speed.toFixed(2)), cell(fixed(state.accel, 2)), cell(fixed(gapToEgo(vehicle, state, egoState), 2))));
  const heads = [["Vehicle"], ["Lane"], ["Intends"], ["Mode", "word"], ["x (m)"], ["y (m)"], ["Speed (m/s)"], ["Acceleration (m/s²)"], ["Gap to ego (m)"]];
  document.getElementById("scene-table").replaceChildren(headRow(heads), make("tbody", {}, ...rows));
}

// Whom the ego touches at a time, and whom it nearly does.
const conflictsAt = (time, kind) => data.conflicts.filter((one) => one.kind === kind && time >= one.time_s - 1e-6 && time <= one.until_s + 1e-6).map((one) => one.vehicle_id);

const ttcText = ({ ttc }) => (ttc === null ? "not closing" : `TTC ${ttc >= 100 ? "over 100" : ttc.toFixed(1)} s`);

// The instant in words, for the line under the road and for screen readers.
function sceneText(cursor, decision) {
  const egoState = ego && stateOf(ego, cursor);
  const start = `${cursor.time.toFixed(2)} s: `;
  if (!egoState) return `${start}the ego is not on the road.`;
  const ahead = neighbours(cursor).find(({ offset }) => offset === 0)?.ahead;
  const touched = conflictsAt(cursor.time, "contact");
  const near = conflictsAt(cursor.time, "near_miss").filter((id) => !touched.includes(id));
  const conflict = [touched.length ? `contact with ${touched.join(", ")}` : "", near.length ? `near miss with ${near.join(", ")}` : ""].filter(Boolean).join("; ");
  const leader = ahead ? `${ahead.vehicle.id} ahead, gap ${ahead.gap.toFixed(1)} m, ${ttcText(ahead)}` : "nobody ahead in its lane";
  const decided = decision ? ` Decision ${decision.decision_index}, ${decision.status}: ${actionText(decision)}.` : "";
  return `${start}ego in lane ${egoState.lane ?? "–"} at ${egoState.x.toFixed(1)} m, ${fixed(egoState.speed, 1)} m/s; ${conflict ? `${conflict}; ` : ""}${leader}.${decided}`;
}

const LANE_WORDS = { "-1": "left", 0: "own", 1: "right" };

function neighbourCell(found) {
  if (!found) return make("td", { className: "word none" }, "nobody");
  const close = found.ttc !== null && found.ttc < 3 ? " close" : "";
  return make("td", { className: `word${close}` }, make("b", {}, shortened(found.vehicle.id)), make("br", {}),
    found.gap < 0 ? "alongside" : `${found.gap.toFixed(1)} m, ${ttcText(found)}`);
}

function showNeighbours(cursor) {
  const rows = neighbours(cursor).map(({ offset, lane, behind, ahead }) => make("tr", {},
    make("th", { scope: "row" }, `${LANE_WORDS[offset]} (${lane})`), neighbourCell(behind), neighbourCell(ahead)));
  const box = document.getElementById("neighbours");
  if (!rows.length) {
    box.replaceChildren(make("p", { className: "empty" }, "The ego is not on the road."));
    return;
  }
  const heads = [["Lane"], ["Behind", "word"], ["Ahead", "word"]];
  box.replaceChildren(make("table", {}, headRow(heads), make("tbody", {}, ...rows)));
}

function fillEvents(onSeek) {
  document.getElementById("event-count").textContent = `(${events.length})`;
  const items = events.map((event) => {
    const button = make("button", { type: "button" }, make("b", {}, `${event.time.toFixed(2)} s`), ` ${event.text}`);
    button.addEventListener("click", () => onSeek(event.time));
    return make("li", {}, button);
  });
  if (!items.length) items.push(make("li", { className: "empty" }, "No lane change, no near miss, and every decision was optimal."));
  document.getElementById("event-list").replaceChildren(...items);
}
