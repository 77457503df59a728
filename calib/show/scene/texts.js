// Texts about the row shown: its errors, what is magnified, joint values.

function sized(value, mark) {
  return value.toFixed(value < 1 ? 3 : value < 100 ? 2 : 0) + mark;
}
const mm = (length) => sized(1e3 * length, " mm");

// The errors of both robots in each unit that was measured.
const rowErrors = table.errors.map((unit) => ({ ...unit, robots: unit.robots.map(floats) }));

// Each known error of a robot at a row, with its unit.
function errorsOf(who, row) {
  const known = rowErrors.filter((unit) => Number.isFinite(unit.robots[who][row]));
  return known.map((unit) => sized(unit.factor * unit.robots[who][row], unit.mark));
}

function fill(parent, ...parts) {
  parent.replaceChildren(...parts.map((part) => {
    if (typeof part === "string") return document.createTextNode(part);
    const strong = document.createElement("b");
    strong.textContent = part[0];
    return strong;
  }));
}

function labelOf(row) {
  const kind = table.kinds[row] === "pose" ? "" : table.kinds[row];
  return table.labels[row] + (kind ? `, ${kind}` : "");
}

// Text about a row beside the mouse.
function brief(row) {
  const values = names.map((_, who) => errorsOf(who, row)[0]).filter((text) => text !== undefined);
  return labelOf(row) + (values.length ? `: ${values.join(" \u2192 ")}` : "");
}

function describe() {
  if (element("which")) element("which").textContent = labelOf(state.row);
  const parts = [[labelOf(state.row)], ". "];
  const show = (who) => errorsOf(who, state.row)
    .flatMap((text, k) => (k ? [" and ", [text]] : [[text]]));
  if (errorsOf(0, state.row).length) {
    parts.push("Residual: ", `${table.names[0].toLowerCase()} `, ...show(0));
    if (both) parts.push(`, ${table.names[1].toLowerCase()} `, ...show(1));
    parts.push(".");
  } else if (both) {
    const apart = trueTarget("nominal", state.row, true).distanceTo(trueTarget("calibrated", state.row));
    parts.push("Distance between the targets of the two robots: ", [mm(apart)], ".");
  }
  // The slider names the row too.
  const isAll = parts.length === 2 && element("which");
  fill(element("pose"), ...(isAll ? [] : parts));
  if (element("factors")) {
    fill(element("factors"), state.mode === "over" ? overlaidText() : sideText());
  }
}

function sideText() {
  const ends = hasMeasured ? "from predicted towards measured" : `from ${table.names[0].toLowerCase()} to ${table.names[1].toLowerCase()}`;
  const robotsText = both ? "Robots true to scale." : "Robot true to scale.";
  const cutText = cut ? ` ${cut} longer than the scene ${cut > 1 ? "are" : "is"} cut.` : "";
  return `Arrows ${ends}, \u00d7 ${state.factor}. ${robotsText}${cutText}`;
}

function overlaidText() {
  const what = hasMeasured ? "robot, measured targets and arrows" : "robot and arrows";
  const text = `Differences from ${table.names[0].toLowerCase()} \u00d7 ${state.factor}: ${what}.`;
  if (!bases) return text;
  if (state.anchor === "tracker") return `${text} Each robot stands in the measurement frame as it was registered.`;
  return `${text} The robots share their base: the difference of their registered frames adds to the ${table.names[0].toLowerCase()} arrows.`;
}

// Joint values and the like of the pose shown.
function fillNumbers() {
  if (!element("numbers")) return;
  element("numbers").querySelector("h2").textContent = table.labels[state.row];
  const rows = element("numbers").querySelector("table");
  rows.replaceChildren();
  for (const [name, texts] of Object.entries(table.numbers)) {
    const row = rows.insertRow();
    row.insertCell().textContent = name;
    row.insertCell().textContent = texts[state.row];
  }
}
