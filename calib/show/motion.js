"use strict";
// Moves the robots from pose to pose and draws what was measured; see motion.py for the table.
(() => {
  const THREE = MeshCat.THREE;
  const table = JSON.parse(document.getElementById("table").textContent);
  const element = (name) => document.getElementById(name);
  const names = Object.keys(table.robots);
  const both = names.length > 1;
  const count = table.labels.length;
  const state = { row: table.start, mode: "side", arrows: table.arrows, robots: 1, alone: null };

  function floats(text) {
    return new Float32Array(Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0)).buffer);
  }
  function group(...path) {
    return viewer.scene_tree.find(["robots", ...path]).object;
  }

  const measured = floats(table.measured);
  const robots = {};
  for (const who of names) {
    robots[who] = { ...table.robots[who], poses: floats(table.robots[who].poses) };
  }
  const hasMeasured = measured.some((value) => Number.isFinite(value));

  // ---- where a mover is at a row, the calibrated robot's difference magnified ----

  const place = new THREE.Vector3(), turn = new THREE.Quaternion();
  const nominalPlace = new THREE.Vector3(), nominalTurn = new THREE.Quaternion(), step = new THREE.Quaternion();

  function read(who, row, mover, atPlace, atTurn) {
    const robot = robots[who];
    const values = state.alone && row === state.row ? state.alone[who] : robot.poses;
    const start = 7 * ((state.alone && row === state.row ? 0 : row * robot.movers) + mover);
    atPlace.fromArray(values, start);
    atTurn.fromArray(values, start + 3);
  }

  // The displacement from the nominal mover times a factor: the way along a line, the turn about its own axis.
  function locate(who, row, mover) {
    read(who, row, mover, place, turn);
    const same = robots[who].same[mover];
    if (who === "nominal" || state.robots === 1 || same < 0) return;
    read("nominal", row, same, nominalPlace, nominalTurn);
    place.sub(nominalPlace).multiplyScalar(state.robots).add(nominalPlace);
    step.copy(nominalTurn).conjugate().multiply(turn);
    if (step.w < 0) step.set(-step.x, -step.y, -step.z, -step.w);
    const half = Math.atan2(Math.hypot(step.x, step.y, step.z), step.w);
    const scale = half > 1e-12 ? Math.sin(state.robots * half) / Math.sin(half) : state.robots;
    step.set(scale * step.x, scale * step.y, scale * step.z, Math.cos(state.robots * half)).normalize();
    turn.copy(nominalTurn).multiply(step);
  }

  function target(who, row) {
    locate(who, row, robots[who].movers - 1);
    return place.clone();
  }

  function trueTarget(who, row) {
    const from = new THREE.Vector3();
    read(who, row, robots[who].movers - 1, from, turn);
    return from;
  }

  // Where the target was measured, moved away from the nominal one by the same factor; null where it was not.
  function seen(row) {
    if (state.alone && row === state.row) return null;
    if (!Number.isFinite(measured[3 * row])) return null;
    const at = new THREE.Vector3().fromArray(measured, 3 * row);
    const from = trueTarget("nominal", row);
    return at.sub(from).multiplyScalar(state.robots).add(from);
  }

  // ---- the robots ----

  const z = new THREE.Vector3(0, 0, 1), way = new THREE.Vector3();
  function pad(number) {
    return String(number).padStart(3, "0");
  }
  const moved = {};
  for (const who of names) {
    const links = viewer.scene_tree.find(["robots", who, "robot", "links"]).children;
    const at = Object.keys(links).map((name) => [Number(name), links[name].object]);
    const rods = robots[who].rods.map((ends, k) => [ends, group(who, "robot", "rods", pad(k))]);
    moved[who] = { links: at, rods };
  }

  function moveRobots() {
    for (const who of names) {
      for (const [mover, object] of moved[who].links) {
        locate(who, state.row, mover);
        object.position.copy(place);
        object.quaternion.copy(turn);
      }
      for (const [[start, end], object] of moved[who].rods) {
        locate(who, state.row, start);
        const from = place.clone();
        locate(who, state.row, end);
        way.subVectors(place, from);
        const length = way.length();
        object.position.copy(from).addScaledVector(way, 0.5);
        object.quaternion.setFromUnitVectors(z, length > 0 ? way.divideScalar(length) : z);
        object.scale.set(1, 1, Math.max(length, 1e-9));
      }
      const frames = marks[who].frames;
      frames.forEach((frame, k) => {
        locate(who, state.row, robots[who].movers - 3 + k);
        frame.position.copy(place);
        frame.quaternion.copy(turn);
      });
    }
  }

  // ---- what was measured: balls by kind of row, and arrows ----

  function many(geometry, colour, number, parent) {
    const material = new THREE.MeshPhongMaterial({ color: colour, shininess: 20 });
    const mesh = new THREE.InstancedMesh(geometry, material, Math.max(number, 1));
    mesh.count = number;
    mesh.frustumCulled = false;
    parent.add(mesh);
    return mesh;
  }

  const ball = new THREE.SphereGeometry(1, 20, 14);
  const shaft = new THREE.CylinderGeometry(1, 1, 1, 10).translate(0, 0.5, 0);
  const head = new THREE.ConeGeometry(1, 1, 14).translate(0, 0.5, 0);
  const axis = new THREE.CylinderGeometry(0.02, 0.02, 1, 8).translate(0, 0.5, 0);
  const dark = (colour) => "#" + new THREE.Color(colour).multiplyScalar(0.82).getHexString();

  function triad(size) {
    const result = new THREE.Group();
    for (const [colour, x, zed] of [["#d62728", -Math.PI / 2, 0], ["#2ca02c", 0, 0], ["#1f5fd0", 0, Math.PI / 2]]) {
      const bar = new THREE.Mesh(axis, new THREE.MeshPhongMaterial({ color: colour }));
      bar.rotation.set(zed, 0, x);
      result.add(bar);
    }
    result.scale.setScalar(size);
    return result;
  }

  const marks = {};
  for (const who of names) {
    const kinds = {};
    for (const kind of ["estimation", "validation", "flagged"]) {
      const rows = table.kinds.flatMap((one, row) => (one === kind && Number.isFinite(measured[3 * row]) ? [row] : []));
      const inner = new THREE.Group();
      group(who, kind).add(inner);
      kinds[kind] = { rows, inner, mesh: many(ball, table.colours[kind], rows.length, inner) };
    }
    const arrows = group(who, "arrows");
    const colour = dark(table.colours[who]);
    const frames = [0.16, 0.1, 0.1].map((length) => triad(length * table.size));
    frames.forEach((frame) => group(who, "frames").add(frame));
    marks[who] = { kinds, frames, shafts: many(shaft, colour, count, arrows), heads: many(head, colour, count, arrows) };
    addInstruments(who);
  }
  addCloud();

  function addInstruments(who) {
    if (!table.instruments.length) return;
    const parent = group(who, "instrument");
    const ends = [];
    table.instruments.forEach((pose, k) => {
      const body = new THREE.Mesh(ball, new THREE.MeshPhongMaterial({ color: table.colours.flagged }));
      body.scale.setScalar(2.2 * table.ball);
      const frame = triad(0.2 * table.size);
      for (const object of [body, frame]) object.position.fromArray(pose);
      frame.quaternion.fromArray(pose, 3);
      parent.add(body, frame);
      table.seenFrom.forEach((which, row) => {
        if (which !== k || !Number.isFinite(measured[3 * row])) return;
        ends.push(...pose.slice(0, 3), ...measured.subarray(3 * row, 3 * row + 3));
      });
    });
    const lines = new THREE.BufferGeometry();
    lines.setAttribute("position", new THREE.BufferAttribute(new Float32Array(ends), 3));
    const material = new THREE.LineBasicMaterial({ color: table.colours.flagged, transparent: true, opacity: 0.4 });
    parent.add(new THREE.LineSegments(lines, material));
  }

  function addCloud() {
    if (!table.cloud || !both) return;
    const points = floats(table.cloud.points), colours = floats(table.cloud.colours), inside = floats(table.cloud.measured);
    for (const [name, wanted] of [["cloud", (k) => inside[k] > 0], ["cloud-everywhere", () => true]]) {
      const chosen = [...inside.keys()].filter(wanted);
      const pick = (values) => new Float32Array(chosen.flatMap((k) => [...values.subarray(3 * k, 3 * k + 3)]));
      const geometry = new THREE.BufferGeometry();
      geometry.setAttribute("position", new THREE.BufferAttribute(pick(points), 3));
      geometry.setAttribute("color", new THREE.BufferAttribute(pick(colours), 3));
      const size = 0.011 * table.size;
      group("calibrated", name).add(new THREE.Points(geometry, new THREE.PointsMaterial({ size, vertexColors: true })));
    }
  }

  const matrix = new THREE.Matrix4(), y = new THREE.Vector3(0, 1, 0), scale = new THREE.Vector3();
  const nothing = new THREE.Matrix4().makeScale(0, 0, 0);
  let cut = 0;

  function setArrow(who, row) {
    const { shafts, heads } = marks[who];
    const start = target(who, row);
    let end = null;
    if (!(state.alone && row === state.row)) {
      if (Number.isFinite(measured[3 * row])) end = new THREE.Vector3().fromArray(measured, 3 * row);
      else if (!hasMeasured && both && who === "nominal") end = trueTarget("calibrated", row);
    }
    const vector = end && end.sub(trueTarget(who, row)).multiplyScalar(state.arrows);
    const longest = 0.8 * table.size;
    let length = vector ? vector.length() : 0;
    if (!(length > 0)) {
      shafts.setMatrixAt(row, nothing);
      heads.setMatrixAt(row, nothing);
      return;
    }
    vector.divideScalar(length);
    if (length > longest) {
      length = longest;
      cut += 1;
    }
    const thick = (row === state.row ? 0.0032 : 0.002) * table.size;
    const tip = Math.min(4.5 * thick, 0.5 * length);
    turn.setFromUnitVectors(y, vector);
    shafts.setMatrixAt(row, matrix.compose(start, turn, scale.set(thick, length - tip, thick)));
    start.addScaledVector(vector, length - tip);
    heads.setMatrixAt(row, matrix.compose(start, turn, scale.set(2.2 * thick, tip, 2.2 * thick)));
  }

  function drawMarks() {
    cut = 0;
    for (const who of names) {
      for (const { rows, mesh } of Object.values(marks[who].kinds)) {
        rows.forEach((row, k) => {
          const at = seen(row);
          const radius = (row === state.row ? 1.15 : 0.5) * table.ball;
          mesh.setMatrixAt(k, at ? matrix.compose(at, turn.identity(), scale.setScalar(radius)) : nothing);
        });
        mesh.instanceMatrix.needsUpdate = true;
      }
      for (let row = 0; row < count; row++) setArrow(who, row);
      marks[who].shafts.instanceMatrix.needsUpdate = true;
      marks[who].heads.instanceMatrix.needsUpdate = true;
    }
  }

  // ---- side by side, or one over the other ----

  function arrange() {
    const over = state.mode === "over";
    document.body.dataset.mode = state.mode;
    for (const who of names) {
      group(who).position.fromArray(over ? table.over : table.places[who]);
      for (const { inner } of Object.values(marks[who].kinds)) inner.visible = !(over && both && who === "nominal");
    }
    viewer.scene_tree.find(["Floor"]).object.position.fromArray(over ? table.floor : [0, 0, 0]);
    if (both) {
      group("calibrated", "robot").traverse((object) => {
        if (!object.material) return;
        object.material.transparent = over;
        object.material.opacity = over ? 0.5 : 1;
        object.material.needsUpdate = true;
      });
    }
    for (const button of document.querySelectorAll("[data-mode]")) {
      button.setAttribute("aria-pressed", String(button.dataset.mode === state.mode));
    }
  }

  function look() {
    viewer.camera.position.fromArray(table.cameras[state.mode]);
    stepBack();
  }

  // ---- words and numbers ----

  function mm(length) {
    const value = 1e3 * length;
    return value.toFixed(value < 1 ? 3 : value < 100 ? 2 : 0) + " mm";
  }
  const degrees = (angle) => ((180 / Math.PI) * angle).toFixed(3) + "\u00b0";

  function fill(parent, ...parts) {
    parent.replaceChildren(...parts.map((part) => {
      if (typeof part === "string") return document.createTextNode(part);
      const strong = document.createElement("b");
      strong.textContent = part[0];
      return strong;
    }));
  }

  function label() {
    if (state.alone) return state.alone.label;
    const kind = { estimation: "fitted", validation: "held back", flagged: "flagged", pose: "" }[table.kinds[state.row]];
    return table.labels[state.row] + (kind ? `, ${kind}` : "");
  }

  function points() {
    const result = {};
    for (const who of names) result[who] = trueTarget(who, state.row);
    if (!state.alone && Number.isFinite(measured[3 * state.row])) {
      result.measured = new THREE.Vector3().fromArray(measured, 3 * state.row);
    }
    return result;
  }

  function tell() {
    if (element("which")) element("which").textContent = label();
    const parts = [`Pose of ${label()}. `];
    const values = table.errors.map((errors) => (state.alone ? null : errors[state.row]));
    const turns = table.angles.map((angles) => (state.alone ? null : angles[state.row]));
    const show = (who) => (values[who] === null ? [] : [[mm(values[who])]])
      .concat(turns[who] === null ? [] : [values[who] === null ? "" : " and ", [degrees(turns[who])]]);
    if (values[0] !== null || turns[0] !== null) {
      parts.push("From what was measured: ", `${table.names[0].toLowerCase()} `, ...show(0));
      if (both) parts.push(`, ${table.names[1].toLowerCase()} `, ...show(1));
      parts.push(".");
    } else if (both) {
      const apart = trueTarget("nominal", state.row).distanceTo(trueTarget("calibrated", state.row));
      parts.push("The two robots put the target ", [mm(apart)], " apart.");
    }
    fill(element("pose"), ...parts);
    if (element("factors")) {
      const robotsSaid = both
        ? state.robots === 1 ? "Robots true to scale." : `Differences from ${table.names[0].toLowerCase()} drawn \u00d7 ${state.robots}.`
        : "Robot true to scale.";
      const arrowsSaid = `Arrows \u00d7 ${state.arrows}.`;
      const cutSaid = cut ? ` ${cut} longer than the scene ${cut > 1 ? "are" : "is"} cut.` : "";
      fill(element("factors"), `${arrowsSaid} ${robotsSaid}${cutSaid}`);
    }
    drawInset(points());
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
      svg(drawing, "circle", { cx, cy, r: who === "measured" ? 5 : 7, fill: table.colours[who] });
    }
    const power = 10 ** Math.floor(Math.log10(80 / unit));
    const bar = power * [5, 2, 1].find((factor) => factor * power <= (80 / unit) * 1.000001);
    svg(drawing, "path", { d: `M8 78v6h${unit * bar}v-6`, fill: "none", stroke: "#5a6875" });
    svg(drawing, "text", { x: 16 + unit * bar, y: 88, "font-size": 12, fill: "#5a6875" }, `${+(1e3 * bar).toPrecision(1)} mm`);
  }

  // ---- all of it ----

  function update() {
    moveRobots();
    drawMarks();
    tell();
    viewer.set_dirty();
  }

  function goTo(row) {
    state.alone = null;
    state.row = (row + count) % count;
    if (element("row")) element("row").value = state.row;
    update();
  }

  let playing = null;
  function play(on) {
    clearInterval(playing);
    playing = on ? setInterval(() => goTo(state.row + 1), 900) : null;
    element("play").classList.toggle("on", on);
    element("play").querySelector("path").setAttribute("d", on ? "M4 3h3v10H4zM9 3h3v10H9z" : "M4.5 3v10L13 8z");
  }

  if (element("row")) {
    element("row").addEventListener("input", () => goTo(Number(element("row").value)));
    element("back").addEventListener("click", () => goTo(state.row - 1));
    element("forward").addEventListener("click", () => goTo(state.row + 1));
    element("play").addEventListener("click", () => play(playing === null));
    document.addEventListener("keydown", (event) => {
      if (["INPUT", "SELECT", "BUTTON"].includes(event.target.tagName)) return;
      if (event.key === "ArrowLeft") goTo(state.row - 1);
      if (event.key === "ArrowRight") goTo(state.row + 1);
      if (event.key === " ") play(playing === null);
    });
  }
  for (const button of document.querySelectorAll("[data-mode]")) {
    button.addEventListener("click", () => {
      state.mode = button.dataset.mode;
      arrange();
      look();
      update();
    });
  }
  for (const name of ["arrows", "robots"]) {
    if (!element(name)) continue;
    element(name).addEventListener("change", () => {
      state[name] = Number(element(name).value);
      update();
    });
  }

  // A server that this page came from may send a pose of its own, or things for meshcat to draw.
  function listen() {
    const socket = new WebSocket(`ws://${location.host}/live`);
    socket.binaryType = "arraybuffer";
    socket.addEventListener("message", ({ data }) => {
      if (typeof data !== "string") {
        viewer.handle_command_bytearray(new Uint8Array(data));
        return;
      }
      const { pose } = JSON.parse(data);
      if (!pose) return;
      state.alone = { label: pose.label };
      for (const who of names) state.alone[who] = floats(pose.robots[who]);
      update();
    });
    socket.addEventListener("close", () => fill(element("pose"), "The server has stopped; the picture stays as it is."));
  }

  arrange();
  update();
  if ("live" in document.body.dataset) listen();
})();
