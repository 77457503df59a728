// Buttons, slider, keys and mouse, and the initial view from the address.

// ---- side by side, or one over the other ----

function arrange() {
  const over = state.mode === "over";
  document.body.dataset.mode = state.mode;
  if (element("anchors")) element("anchors").hidden = !over;
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
  for (const name of ["mode", "anchor"]) {
    for (const button of document.querySelectorAll(`button[data-${name}]`)) {
      button.setAttribute("aria-pressed", String(button.dataset[name] === state[name]));
    }
  }
}

function look() {
  placeCamera(table.cameras[state.mode]);
}

// ---- from row to row ----

function update() {
  moveRobots();
  drawMarks();
  describe();
  fillNumbers();
  drawInset();
  drawImage();
  viewer.set_dirty();
}

function goTo(row) {
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
    // A list and the slider have arrow keys of their own; boxes and buttons take the space bar.
    const { tagName, type } = event.target;
    const arrows = tagName !== "SELECT" && type !== "range";
    if (arrows && event.key === "ArrowLeft") goTo(state.row - 1);
    if (arrows && event.key === "ArrowRight") goTo(state.row + 1);
    if (event.key === " " && !["SELECT", "BUTTON"].includes(tagName) && type !== "checkbox") {
      play(playing === null);
      event.preventDefault();
    }
  });
}

// The mark nearest to the mouse, if it is near: its row.
const screen = new THREE.Vector3();
function rowAt(event) {
  const { left, top, width, height } = pane.getBoundingClientRect();
  let best = null, nearest = event.pointerType === "touch" ? 26 : 14;
  for (const who of names) {
    const parent = group(who);
    if (!both || who === "calibrated" || state.mode === "side") {
      for (let row = 0; row < count; row++) {
        const at = measuredPlace(who, row) || target(who, row);
        parent.localToWorld(screen.copy(at)).project(viewer.camera);
        const x = left + (0.5 + 0.5 * screen.x) * width, y = top + (0.5 - 0.5 * screen.y) * height;
        const far = Math.hypot(x - event.clientX, y - event.clientY);
        if (screen.z < 1 && far < nearest) [best, nearest] = [row, far];
      }
    }
  }
  return best;
}

function pointAt(event) {
  const row = event.buttons ? null : rowAt(event);
  const hint = element("hint");
  hint.hidden = row === null;
  element("meshcat-pane").style.cursor = row === null ? "" : "pointer";
  if (row === null) return;
  const { left, top } = pane.getBoundingClientRect();
  hint.style.left = event.clientX - left + "px";
  hint.style.top = event.clientY - top + "px";
  hint.textContent = brief(row);
}

// A click on a mark shows its row; a drag turns the scene.
const pressed = { x: NaN, y: NaN };
if (count > 1) {
  pane.addEventListener("pointermove", pointAt);
  pane.addEventListener("pointerdown", (event) => Object.assign(pressed, { x: event.clientX, y: event.clientY }), true);
  // The viewer's own controls stop clicks, but not the release of a button.
  window.addEventListener("pointerup", (event) => {
    const still = Math.hypot(event.clientX - pressed.x, event.clientY - pressed.y) < 4;
    const row = still ? rowAt(event) : null;
    pressed.x = NaN;
    if (row !== null) goTo(row);
  }, true);
}

for (const button of document.querySelectorAll("button[data-mode]")) {
  button.addEventListener("click", () => {
    state.mode = button.dataset.mode;
    arrange();
    look();
    update();
  });
}
for (const button of document.querySelectorAll("button[data-anchor]")) {
  button.addEventListener("click", () => {
    state.anchor = button.dataset.anchor;
    arrange();
    update();
  });
}
if (element("factor")) {
  element("factor").addEventListener("change", () => {
    state.factor = Number(element("factor").value);
    update();
  });
}

// Paper shows a copy of the scene, because WebGL's drawing is gone when the page is printed.
const paper = document.createElement("canvas");
paper.id = "paper";
pane.after(paper);
window.addEventListener("beforeprint", () => {
  const drawn = viewer.renderer.domElement;
  [paper.width, paper.height] = [drawn.width, drawn.height];
  viewer.renderer.render(viewer.scene, viewer.camera);
  paper.getContext("2d").drawImage(drawn, 0, 0);
  // A4, 1122 by 793 px: picture and labels as on the screen, scaled together.
  const { clientWidth: width, clientHeight: height } = pane;
  const style = { "--w": `${width}px`, "--h": `${height}px`, "--k": Math.min(1122 / width, 793 / height) };
  for (const [name, value] of Object.entries(style)) element("picture").style.setProperty(name, value);
});

// The address may set the initial view, such as view.html#row=35&mode=over&factor=50.
function start() {
  const parameters = new URLSearchParams(location.hash.slice(1));
  const mode = parameters.get("mode");
  // Older addresses have two factors.
  const factor = ["factor", ...(mode === "over" ? ["robots", "arrows"] : ["arrows"])].map((name) => parameters.get(name)).find(Boolean);
  const choice = element("factor") && [...element("factor").options].find((one) => one.value === factor);
  if (choice) {
    choice.selected = true;
    state.factor = Number(choice.value);
  }
  const pose = Number(parameters.get("pose")) - 1;
  const row = pose in table.labels ? pose : table.labels.indexOf(`row ${parameters.get("row")}`);
  if (row >= 0) state.row = row;
  if (element("row")) element("row").value = state.row;
  if (bases && ["base", "tracker"].includes(parameters.get("anchor"))) state.anchor = parameters.get("anchor");
  if (both && Object.hasOwn(table.cameras, mode) && mode !== state.mode) {
    state.mode = mode;
    look();
  }
}

start();
arrange();
update();
window.addEventListener("hashchange", () => {
  start();
  arrange();
  update();
});
