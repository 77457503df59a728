"use strict";
const pane = document.getElementById("meshcat-pane");
const viewer = new MeshCat.Viewer(pane);

// Narrower than the 16:9 that the camera was placed for: step back.
let stepped = 1;
function stepBack() {
  const narrow = Math.max(1, (16 / 9) * (pane.clientHeight / pane.clientWidth));
  viewer.camera.position.multiplyScalar(narrow / stepped);
  stepped = narrow;
}

// By itself the viewer would be as high as the window, and coarse on a high-resolution screen.
const fit = viewer.set_3d_pane_size;
viewer.set_3d_pane_size = () => {
  fit.call(viewer, pane.clientWidth, pane.clientHeight);
  stepBack();
};
viewer.renderer.setPixelRatio(Math.min(window.devicePixelRatio, 2));
const text = atob(document.getElementById("scene").textContent);
const bytes = Uint8Array.from(text, (letter) => letter.charCodeAt(0));
// The viewer's decoder is not exported: let its own method decode and hand the message to this function.
MeshCat.Viewer.prototype.handle_command_bytearray.call({ handle_command: draw }, bytes);

function draw(scene) {
  for (const command of scene.commands) {
    if (command.type === "set_object" && command.object.geometries) {
      command.object.geometries = command.object.geometries.map((name) => scene.geometries[name]);
    }
    viewer.handle_command(command);
  }
}

// Place the camera as for 16:9, or take it as the scene has placed it.
function placeCamera(position) {
  if (position) viewer.camera.position.fromArray(position);
  stepped = 1;
  stepBack();
}
placeCamera();
new ResizeObserver(() => viewer.set_3d_pane_size()).observe(pane);

// The boxes of the legend show and hide.
function showOrHide(box) {
  for (const node of box.dataset.show.split(" ")) {
    viewer.set_property(["robots", ...node.split("/")], "visible", box.checked);
  }
  viewer.set_dirty();
}
for (const box of document.querySelectorAll("[data-show]")) {
  box.addEventListener("change", () => showOrHide(box));
  if (!box.checked) showOrHide(box);
}

// On a small screen the page is stacked, and the layers are folded at first.
const layers = document.getElementById("layers");
const stacked = window.matchMedia("screen and (max-width: 760px), screen and (max-aspect-ratio: 1/1), screen and (max-height: 520px)");
function fold() {
  layers.open = !stacked.matches;
}
fold();
stacked.addEventListener("change", fold);

// Labels stay below their robots; those of the other arrangement are hidden.
const labels = [...document.querySelectorAll(".label")];
const point = new MeshCat.THREE.Vector3();
function follow() {
  const mode = document.body.dataset.mode;
  for (const label of labels) {
    viewer.scene.updateMatrixWorld();
    point.fromArray(label.dataset.at.split(" ").map(Number)).applyMatrix4(viewer.scene.matrixWorld).project(viewer.camera);
    // Near the edge the text stays inside.
    const half = 0.5 * label.offsetWidth;
    const x = Math.min(Math.max((0.5 + 0.5 * point.x) * pane.clientWidth, half), pane.clientWidth - half);
    label.style.left = x + "px";
    label.style.top = (0.5 - 0.5 * point.y) * pane.clientHeight + "px";
    const wanted = !mode || label.dataset.in === mode;
    label.style.visibility = wanted && point.z < 1 ? "visible" : "hidden";
  }
  requestAnimationFrame(follow);
}
follow();
