// The robots: the page's table of their poses, the row shown, and what is magnified.
// Each robot stands at its own base, unless the overlaid ones are shown as they were registered.
const THREE = MeshCat.THREE;
const table = JSON.parse(document.getElementById("table").textContent);
const element = (name) => document.getElementById(name);
const names = Object.keys(table.robots);
const both = names.length > 1;
const count = table.labels.length;
const state = { row: table.start, mode: "side", anchor: "base", factor: table.factor };

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
// Base of the nominal robot in the calibrated one's at each row, as registered; null if they are the same.
const bases = table.bases ? floats(table.bases) : null;
const targets = table.targets ? floats(table.targets) : null;

// ---- the pose of a mover at a row, with the calibrated robot's difference magnified ----

const place = new THREE.Vector3(), turn = new THREE.Quaternion();
const nominalPlace = new THREE.Vector3(), nominalTurn = new THREE.Quaternion(), step = new THREE.Quaternion();

const basePlace = new THREE.Vector3(), baseTurn = new THREE.Quaternion();
function readBase(row) {
  basePlace.fromArray(bases, 7 * row);
  baseTurn.fromArray(bases, 7 * row + 3);
}
function asRegistered() {
  return state.mode === "over" && state.anchor === "tracker";
}
// Side by side the robots are true to scale.
function robotsFactor() {
  return state.mode === "over" ? state.factor : 1;
}

function read(who, row, mover, atPlace, atTurn, registered = asRegistered()) {
  const robot = robots[who];
  const start = 7 * (row * robot.movers + mover);
  atPlace.fromArray(robot.poses, start);
  atTurn.fromArray(robot.poses, start + 3);
  if (!(bases && registered && who === "nominal")) return;
  readBase(row);
  atPlace.applyQuaternion(baseTurn).add(basePlace);
  atTurn.premultiply(baseTurn);
}

// The displacement from the nominal mover times a factor: the shift along its line, the turn about its own axis.
function locate(who, row, mover) {
  read(who, row, mover, place, turn);
  const same = robots[who].same[mover];
  const factor = robotsFactor();
  if (who === "nominal" || factor === 1 || same < 0) return;
  read("nominal", row, same, nominalPlace, nominalTurn);
  place.sub(nominalPlace).multiplyScalar(factor).add(nominalPlace);
  step.copy(nominalTurn).conjugate().multiply(turn);
  if (step.w < 0) step.set(-step.x, -step.y, -step.z, -step.w);
  const half = Math.atan2(Math.hypot(step.x, step.y, step.z), step.w);
  const scale = half > 1e-12 ? Math.sin(factor * half) / Math.sin(half) : factor;
  step.set(scale * step.x, scale * step.y, scale * step.z, Math.cos(factor * half)).normalize();
  turn.copy(nominalTurn).multiply(step);
}

function target(who, row) {
  locate(who, row, robots[who].movers - 1);
  return place.clone();
}

function trueTarget(who, row, registered) {
  const from = new THREE.Vector3();
  read(who, row, robots[who].movers - 1, from, turn, registered);
  return from;
}

// The measured target, true to scale, side by side as each robot was registered; null if it was not measured.
function trueMeasured(who, row) {
  if (!Number.isFinite(measured[3 * row])) return null;
  const at = new THREE.Vector3().fromArray(measured, 3 * row);
  if (!bases || who === "calibrated" || state.mode === "over") return at;
  readBase(row);
  return at.sub(basePlace).applyQuaternion(baseTurn.conjugate());
}

// The same, moved away from the nominal target by the robots' factor.
function measuredPlace(who, row) {
  const at = trueMeasured(who, row);
  const from = at && trueTarget("nominal", row);
  return at && at.sub(from).multiplyScalar(robotsFactor()).add(from);
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
