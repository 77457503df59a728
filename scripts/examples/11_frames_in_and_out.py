"""A frame of pandas goes in, frames come out: rows with their errors, parameters, covariance; polars does as well."""

import pandas as pd

import calib
from calib.example import paper_measurements, paper_urdf

# However a frame came about: its columns are called as those of a table file, with their units.
frame = pd.read_csv(paper_measurements())
measured, fresh = frame.head(30), frame.tail(5).drop(columns="set")

# The robot is a path, and the setup is told in the words of the command line.
result = calib.calibrate(
    paper_urdf(), measured, base="base", tip="tool0", target="-70 70 22.5 mm", model="dh"
)
assert result.verdict is not None
print(f"verdict: {result.verdict.use}")

rows = result.to_frame()
worst = rows.nlargest(3, "calibrated error [mm]")
print(worst[["row", "nominal error [mm]", "calibrated error [mm]"]].round(2).to_string(index=False))

parameters = result.to_frame("parameters").set_index("name")
known = parameters[parameters["identifiable"]]
print(f"{len(known)} of {len(parameters)} parameters are known by themselves:")
print(", ".join(known.index))
alpha2 = result.parameter("alpha2")
print(f"alpha2 changed by {1e3 * alpha2.delta:.2f} mrad, standard deviation {1e3 * alpha2.std:.2f}")
covariance = result.to_frame("covariance")
assert abs(covariance.loc["alpha2", "alpha2"] ** 0.5 / alpha2.std - 1.0) < 1e-3

# The calibrated robot on rows that the fit has not seen, and a figure of the report.
unseen = calib.evaluate(paper_urdf(), fresh, calibration=result)
print(f"five rows measured afterwards: {1e3 * unseen.errors['all']['m'].rms:.2f} mm rms")
print(unseen.to_frame()[["row", "error [mm]"]].round(2).to_string(index=False))
result.plot("errors-by-pose").savefig("errors-by-pose.png")

# With other names of columns, `Measurements.of` takes what --columns takes; and the table as a frame of polars.
renamed = measured.rename(columns={"x [mm]": "X"})
table = calib.Measurements.of(renamed, columns={"X": "x [mm]"})
assert table.to_frame("polars").height == len(table) == 30
