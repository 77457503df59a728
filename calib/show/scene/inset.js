// The inset beside the robots: the target of the row shown magnified, with the distances between its points.

// The target of each robot and the measured one at the row shown, all in the calibrated robot's base.
function points() {
  const result = {};
  for (const who of names) result[who] = trueTarget(who, state.row, true);
  if (Number.isFinite(measured[3 * state.row])) {
    result.measured = new THREE.Vector3().fromArray(measured, 3 * state.row);
  }
  return result;
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

function drawInset() {
  const inset = element("inset");
  if (!inset) return;
  const all = points();
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
