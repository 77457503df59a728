"use strict";
const viewer = new MeshCat.Viewer(document.getElementById("meshcat-pane"));
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

// Narrower than the 16:9 that the camera was placed for: step back.
function stepBack() {
  const narrow = 16 / 9 / (window.innerWidth / window.innerHeight);
  if (narrow > 1) viewer.camera.position.multiplyScalar(narrow);
}
stepBack();

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

// Labels stay below their robots; one that stands for another arrangement of them is hidden.
const labels = [...document.querySelectorAll(".label")];
const point = new MeshCat.THREE.Vector3();
function follow() {
  const mode = document.body.dataset.mode;
  for (const label of labels) {
    viewer.scene.updateMatrixWorld();
    point.fromArray(label.dataset.at.split(" ").map(Number)).applyMatrix4(viewer.scene.matrixWorld).project(viewer.camera);
    label.style.left = (0.5 + 0.5 * point.x) * window.innerWidth + "px";
    label.style.top = (0.5 - 0.5 * point.y) * window.innerHeight + "px";
    const wanted = !mode || label.dataset.in === mode;
    label.style.visibility = wanted && point.z < 1 ? "visible" : "hidden";
  }
  requestAnimationFrame(follow);
}
follow();
