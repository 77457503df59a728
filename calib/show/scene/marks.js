// Marks around the robots: measured and predicted targets, arrows, frames, instruments, the tracker of a plan.
// With more rows than this the arrows are thin and faint, except that of the row shown.
const crowd = count > 40;
const faint = { transparent: true, opacity: 0.3, depthWrite: false };

function many(geometry, colour, number, parent, surface = {}) {
  const material = new THREE.MeshPhongMaterial({ color: colour, shininess: 20, ...surface });
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
  const surface = crowd ? faint : {};
  const colour = dark(table.colours[who]);
  const frames = [0.16, 0.1, 0.1].map((length) => triad(length * table.size));
  frames.forEach((frame) => group(who, "frames").add(frame));
  const predicted = many(ball, table.colours[who], hasMeasured ? count : 0, group(who, "predicted"));
  const shafts = many(shaft, colour, count, arrows, surface), heads = many(head, colour, count, arrows, surface);
  // The arrow of the row shown.
  const now = { shafts: many(shaft, colour, 1, arrows), heads: many(head, colour, 1, arrows) };
  marks[who] = { kinds, frames, predicted, shafts, heads, now };
}
addInstruments(names[names.length - 1]);

function addInstruments(who) {
  for (const pose of table.instruments) {
    const body = new THREE.Mesh(ball, new THREE.MeshPhongMaterial({ color: table.colours.beam }));
    body.scale.setScalar(2.2 * table.ball);
    const frame = triad(0.2 * table.size);
    for (const object of [body, frame]) object.position.fromArray(pose);
    frame.quaternion.fromArray(pose, 3);
    group(who, "instrument").add(body, frame);
  }
}

function lines(node, number, colour, opacity) {
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.BufferAttribute(new Float32Array(6 * number), 3));
  const material = new THREE.LineBasicMaterial({ color: colour, transparent: opacity < 1, opacity });
  const object = new THREE.LineSegments(geometry, material);
  object.frustumCulled = false;
  group("nominal", node).add(object);
  return object;
}
function setLines(object, ends) {
  object.geometry.attributes.position.array.set(ends.flat());
  object.geometry.attributes.position.needsUpdate = true;
}

// For a plan: the tracker, the line of sight to each target of the pose shown, and a line to the next pose.
const each = targets ? targets.length / 3 / count : 0;
const sight = targets ? lines("tracker", each, table.colours.beam, 1) : null;
const next = table.planned ? lines("next", 1, table.colours.way, 1) : null;
if (targets) {
  const body = new THREE.Mesh(ball, new THREE.MeshPhongMaterial({ color: table.colours.beam }));
  body.scale.setScalar(2.2 * table.ball);
  body.position.fromArray(table.tracker);
  group("nominal", "tracker").add(body);
  const all = Array.from({ length: count * each }, (_, k) => [...table.tracker, ...targets.slice(3 * k, 3 * k + 3)]);
  setLines(lines("sight", count * each, table.colours.beam, 0.35), all);
}
function drawLines() {
  if (sight) {
    const first = state.row * each;
    const seen = Array.from({ length: each }, (_, k) => [...targets.slice(3 * (first + k), 3 * (first + k + 1))]);
    setLines(sight, seen.map((at) => [...table.tracker, ...at]));
  }
  if (next) setLines(next, [trueTarget("nominal", state.row).toArray(), trueTarget("nominal", Math.min(state.row + 1, count - 1)).toArray()]);
}

const matrix = new THREE.Matrix4(), y = new THREE.Vector3(0, 1, 0), scale = new THREE.Vector3();
const nothing = new THREE.Matrix4().makeScale(0, 0, 0);
let cut = 0;

function setArrow(who, row) {
  const { shafts, heads, now } = marks[who];
  const start = target(who, row);
  shafts.setMatrixAt(row, nothing);
  heads.setMatrixAt(row, nothing);
  if (row === state.row) {
    now.shafts.setMatrixAt(0, nothing);
    now.heads.setMatrixAt(0, nothing);
  }
  let end = trueMeasured(who, row);
  if (!hasMeasured && both && who === "nominal") end = trueTarget("calibrated", row);
  if (!end) return;
  const vector = end.sub(trueTarget(who, row)).multiplyScalar(state.factor);
  let length = vector.length();
  if (!(length > 0)) return;
  vector.divideScalar(length);
  // Side by side a long arrow would reach the other robot; overlaid each ends at what was measured.
  const longest = 0.8 * table.size;
  if (length > longest && state.mode === "side") {
    length = longest;
    cut += 1;
  }
  const shown = row === state.row;
  const thick = (shown ? 0.0032 : crowd ? 0.0011 : 0.002) * table.size;
  const tip = Math.min(4.5 * thick, 0.5 * length);
  const parts = shown ? now : marks[who], index = shown ? 0 : row;
  turn.setFromUnitVectors(y, vector);
  parts.shafts.setMatrixAt(index, matrix.compose(start, turn, scale.set(thick, length - tip, thick)));
  start.addScaledVector(vector, length - tip);
  parts.heads.setMatrixAt(index, matrix.compose(start, turn, scale.set(2.2 * thick, tip, 2.2 * thick)));
}

function drawMarks() {
  cut = 0;
  for (const who of names) {
    for (const { rows, mesh } of Object.values(marks[who].kinds)) {
      rows.forEach((row, k) => {
        const at = measuredPlace(who, row);
        const radius = (row === state.row ? 1.15 : crowd ? 0.32 : 0.5) * table.ball;
        mesh.setMatrixAt(k, at ? matrix.compose(at, turn.identity(), scale.setScalar(radius)) : nothing);
      });
      mesh.instanceMatrix.needsUpdate = true;
    }
    const radius = (crowd ? 0.24 : 0.38) * table.ball;
    for (let row = 0; row < count; row++) {
      setArrow(who, row);
      marks[who].predicted.setMatrixAt(row, matrix.compose(target(who, row), turn.identity(), scale.setScalar(radius)));
    }
    const { predicted, shafts, heads, now } = marks[who];
    for (const mesh of [predicted, shafts, heads, now.shafts, now.heads]) mesh.instanceMatrix.needsUpdate = true;
  }
  drawLines();
}
