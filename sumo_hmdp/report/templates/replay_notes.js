// What the planner notes of a decision: lane by lane as a table, the rest as a list.
function notesOf(decision) {
  const { columns, lanes: rows, others } = decision.notes;
  const parts = [];
  if (others.length) parts.push(make("dl", { className: "facts notes" }, ...others.map(([name, text]) => fact(name, text))));
  if (rows.length) {
    const body = rows.map(([lane, texts]) => make("tr", {}, make("th", { scope: "row" }, lane), ...texts.map((text) => cell(text || "–", "word"))));
    const caption = make("caption", {}, "What the planner notes of each lane");
    parts.push(make("table", { className: "notes-table" }, caption, headRow([["Lane"], ...columns.map((name) => [name, "word"])]), make("tbody", {}, ...body)));
  }
  return parts;
}
