// Words and numbers about the row shown, and the target magnified.
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

function label() {
  return state.alone ? state.alone.label : labelOf(state.row);
}

// Text about a row beside the mouse.
function brief(row) {
  const values = names.map((_, who) => errorsOf(who, row)[0]).filter((text) => text !== undefined);
  return labelOf(row) + (values.length ? `: ${values.join(" \u2192 ")}` : "");
}

function points() {
  const result = {};
  for (const who of names) result[who] = trueTarget(who, state.row, true);
  if (!state.alone && Number.isFinite(measured[3 * state.row])) {
    result.measured = new THREE.Vector3().fromArray(measured, 3 * state.row);
  }
  return result;
}

function describe() {
  if (element("which")) element("which").textContent = label();
  const parts = [[label()], ". "];
  const show = (who) => errorsOf(who, state.row)
    .flatMap((text, k) => (k ? [" and ", [text]] : [[text]]));
  if (!state.alone && errorsOf(0, state.row).length) {
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
  drawInset(points());
  drawImage();
  fillNumbers();
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
  element("numbers").hidden = Boolean(state.alone);
  element("numbers").querySelector("h2").textContent = table.labels[state.row];
  const rows = element("numbers").querySelector("table");
  rows.replaceChildren();
  for (const [name, texts] of Object.entries(table.numbers)) {
    const row = rows.insertRow();
    row.insertCell().textContent = name;
    row.insertCell().textContent = texts[state.row];
  }
}

// Two or three points in the plane through them: no distance is foreshortened.
function flat(all) {
  const origin = all.nominal;
  const x = (all.calibrated || all.measured).clone().sub(origin);
  if (!(x.length() > 0) && all.measured) x.copy(all.measured).sub(origin);
  if (x.length() > 0) x.normalize();
  const result = {};
  for (const [who, at] of Object.entries(all)) {
    const from = at.clone().sub(origin);
    const along = from.dot(x);
    result[who] = [along, from.addScaledVector(x, -along).length()];
  }
  return result;
}

function svg(parent, tag, attributes, content) {
  const node = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [name, value] of Object.entries(attributes)) node.setAttribute(name, value);
  if (content) node.textContent = content;
  parent.appendChild(node);
}

function drawInset(all) {
  const inset = element("inset");
  if (!inset) return;
  const names3 = { nominal: table.names[0], calibrated: table.names[1], measured: "Measured" };
  const pairs = [["nominal", "measured"], ["calibrated", "measured"], ["nominal", "calibrated"]]
    .filter(([one, other]) => all[one] && all[other]);
  const drawing = inset.querySelector("svg"), rows = inset.querySelector("table");
  drawing.replaceChildren();
  rows.replaceChildren();
  inset.hidden = !pairs.length;
  if (!pairs.length) return;
  for (const [one, other] of pairs) {
    const row = rows.insertRow();
    row.insertCell().textContent = `${names3[one].toLowerCase()} to ${names3[other].toLowerCase()}`;
    row.insertCell().textContent = mm(all[one].distanceTo(all[other]));
  }
  const at = flat(all);
  const xs = Object.values(at).map((p) => p[0]), ys = Object.values(at).map((p) => p[1]);
  const wide = Math.max(...xs) - Math.min(...xs), high = Math.max(...ys) - Math.min(...ys);
  drawing.style.display = Math.max(wide, high) > 0 ? "" : "none";
  if (!(Math.max(wide, high) > 0)) return;
  // 170 by 92 units: room for the dots at the edges and the bar below.
  const unit = 1 / Math.max(wide / 142, high / 50);
  const put = (who) => [
    85 + unit * (at[who][0] - 0.5 * (Math.max(...xs) + Math.min(...xs))),
    36 - unit * (at[who][1] - 0.5 * (Math.max(...ys) + Math.min(...ys))),
  ];
  for (const [one, other] of pairs.slice(0, 2)) {
    const [x1, y1] = put(one), [x2, y2] = put(other);
    svg(drawing, "line", { x1, y1, x2, y2, stroke: table.colours[one], "stroke-width": 2 });
  }
  for (const who of Object.keys(at)) {
    const [cx, cy] = put(who);
    const colour = who === "measured" ? table.colours[table.kinds[state.row]] : table.colours[who];
    svg(drawing, "circle", { cx, cy, r: who === "measured" ? 5 : 7, fill: colour || table.colours.measured });
  }
  const power = 10 ** Math.floor(Math.log10(80 / unit));
  const bar = power * [5, 2, 1].find((factor) => factor * power <= (80 / unit) * 1.000001);
  svg(drawing, "path", { d: `M8 78v6h${unit * bar}v-6`, fill: "none", stroke: "#5a6875" });
  svg(drawing, "text", { x: 16 + unit * bar, y: 88, "font-size": 12, fill: "#5a6875" }, `${+(1e3 * bar).toPrecision(1)} mm`);
}
