// What stands about the robots: measured and predicted targets, arrows, frames, instruments.
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
  const predicted = many(ball, table.colours[who], hasMeasured ? count : 0, group(who, "predicted"));
  marks[who] = { kinds, frames, predicted, shafts: many(shaft, colour, count, arrows), heads: many(head, colour, count, arrows) };
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
        const at = measuredPlace(row);
        const radius = (row === state.row ? 1.15 : 0.5) * table.ball;
        mesh.setMatrixAt(k, at ? matrix.compose(at, turn.identity(), scale.setScalar(radius)) : nothing);
      });
      mesh.instanceMatrix.needsUpdate = true;
    }
    const radius = 0.38 * table.ball;
    for (let row = 0; row < count; row++) {
      setArrow(who, row);
      marks[who].predicted.setMatrixAt(row, matrix.compose(target(who, row), turn.identity(), scale.setScalar(radius)));
    }
    marks[who].predicted.instanceMatrix.needsUpdate = true;
    marks[who].shafts.instanceMatrix.needsUpdate = true;
    marks[who].heads.instanceMatrix.needsUpdate = true;
  }
}
