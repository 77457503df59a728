// The image of the step shown: its measured corners, and those that each robot predicts, displaced by a factor.
const images = table.images && {
  ...table.images,
  measured: floats(table.images.measured),
  nominal: floats(table.images.nominal),
  calibrated: floats(table.images.calibrated),
};

function drawImage() {
  const panel = element("image");
  if (!images || !panel) return;
  const [width, height] = images.sizes[state.row];
  const edge = 0.03 * width;
  const drawing = panel.querySelector("svg");
  drawing.replaceChildren();
  drawing.setAttribute("viewBox", `${-edge} ${-edge} ${width + 2 * edge} ${height + 2 * edge}`);
  svg(drawing, "rect", { x: -0.5, y: -0.5, width, height, fill: "#fff", stroke: "#5a6875", "stroke-width": width / 200 });
  for (let corner = images.starts[state.row]; corner < images.starts[state.row + 1]; corner++) {
    const [u, v] = [images.measured[2 * corner], images.measured[2 * corner + 1]];
    for (const who of names) {
      // The residual is measured minus predicted.
      const x2 = u - images.factor * images[who][2 * corner], y2 = v - images.factor * images[who][2 * corner + 1];
      svg(drawing, "line", { x1: u, y1: v, x2, y2, stroke: table.colours[who], "stroke-width": width / 200 });
      svg(drawing, "circle", { cx: x2, cy: y2, r: width / 130, fill: table.colours[who] });
    }
    svg(drawing, "circle", { cx: u, cy: v, r: width / 220, fill: table.colours.measured });
  }
  panel.querySelector("h2").textContent = table.labels[state.row];
  const number = images.starts[state.row + 1] - images.starts[state.row];
  panel.querySelector("p").textContent = `${width} \u00d7 ${height} px, ${number} corners: measured (dark), and predicted by each robot, displaced \u00d7 ${images.factor}.`;
}
