"""What a notebook shows of a calibration: a line, a table, figures, and the robot in 3-D; here as files."""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import calib
from calib.example import PAPER_TARGET, paper_measurements, paper_urdf

# The UR3 of a paper, which comes with calib: 35 points of a laser tracker.
robot = calib.Robot.load(paper_urdf(), base="base", tip="tool0")
data = calib.Measurements.read(paper_measurements(), robot.joint_names)
result = calib.calibrate(robot, data, cell=calib.Cell(target=np.array(PAPER_TARGET)))

# `result` as the last line of a notebook's cell shows this table; a terminal shows the line.
print(result)
html = result._repr_html_()
Path("table.html").write_text(html, encoding="utf-8")

# The report's figures: as the last line of a notebook's cell result.plot("points") shows one.
for name in result.figures:
    result.plot(name).savefig(f"{name}.png")
    assert Path(f"{name}.png").read_bytes().startswith(b"\x89PNG")
print(f"figures: {', '.join(result.figures)}")

# A figure of one's own: everything that is drawn is an array of the result.
error = 1e3 * np.linalg.norm(result.rows.residual_calibrated, axis=1)  # of each row [mm]
figure = Figure(figsize=(6, 3), layout="constrained")
axes = figure.subplots()
axes.bar(result.rows.numbers, error)
axes.set(xlabel="row", ylabel="position error [mm]")
figure.savefig("own_figure.png", dpi=100)
worst = result.rows.numbers[int(np.argmax(error))]
print(f"own figure: the largest error is {error.max():.2f} mm, in row {worst}")
assert worst in [outlier.row for outlier in result.rows.outliers]

# The robot before and after, with the error of each row as an arrow: a page that needs no network.
# calib.view(result) alone opens the same page in the browser.
page = calib.view(result, path="view.html")
print(f"3-D page: {page}")
assert page.stat().st_size > 100_000
assert "use" in html
