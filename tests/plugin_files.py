"""A plugin file of tests, and the registries as they were before the tests that load it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import calib.basics.plugins as plugins
from calib.data.cell import Cell  # noqa: F401  with the registries below it
from calib.verbs.convert.convert import FORMATS  # noqa: F401  a registry of a verb
from calib.verbs.measure.devices import controllers, readers  # noqa: F401  the last registries

#: A family, a kind, a solver, a parameter set, a format, a reader and a controller.
SOURCE = """
import numpy as np

from calib.data import kinds
from calib.verbs.convert import convert
from calib.model import families, parameter_sets
from calib.model.error_model import Parameter
from calib.numerics import solvers
from calib.verbs.measure.devices import controllers, readers


def measure(T):
    return np.hypot(T[:, 0, 3], T[:, 1, 3])[:, None]


def derivative(_measured, T, twists):
    perpendicular = T[:, :2, 3] / np.maximum(measure(T), 1e-12)
    return np.einsum("ni,nip->np", perpendicular, twists[:, :2])[:, None]


def twin(system, x, step_size, step_tolerance):
    return solvers.levenberg_marquardt(system, x, step_size, step_tolerance)


def shoulder(robot):
    place, unit = robot.joints[1].name, np.eye(6)
    return [Parameter("lift", "m", place, unit[2], "length")]


def write_names(source, path, options):
    path.write_text(" ".join(source.robot.joint_names))
    return ()


kinds.register(
    kinds.Kind(
        name="edge",
        words="distance of the target from a line",
        units=("m",),
        readings=(kinds.Reading("edge_distance", "length", positive=True),),
        measure=measure,
        derivative=derivative,
        directions=("x", "y", "rx", "ry"),
        own_frame=True,
        own_axes=True,
        fewest=5,
    )
)
sin2 = families.Factor("sin2", lambda s: np.sin(2 * s.q), slope=lambda s: 2 * np.cos(2 * s.q))
families.register(
    families.Family(name="ripple", unit=families.RAD, prior=1e-3, typical=1e-3, factors=(sin2,))
)
solvers.register("twin", twin)
parameter_sets.register("shoulder", shoulder)
convert.register("names", convert.Format("names of the joints", (".txt",), write_names))


class Gauge:
    def __init__(self, argument, context):
        self.value = float(argument)

    def read(self, timeout=None):
        return readers.Reading.of({"edge_distance [mm]": self.value})

    def joints(self):
        return np.full(6, self.value)

    def close(self):
        pass


readers.register("gauge", readers.Reader("a gauge", Gauge))
controllers.register("statue", controllers.Controller("a robot that never moves", Gauge))
"""

#: A cell that needs the plugin: distances from a line along the base's x axis.
CELL = """
plugins = ["my_plugin.py"]
base = "base"
tip = "tool0"
kind = "edge"
model = "zeros+ripple"
target_mm = [50, 50, 50]
prior_ripple_mrad = 2
frame_xyz_mm = [200, 600, 0]
frame_rpy_deg = [90, 0, 90]
"""


@contextmanager
def registries_kept() -> Iterator[None]:
    """Take out of the registries, in the end, what the block has registered."""
    before = {what: dict(entries) for what, entries in plugins._REGISTRIES.items()}
    count = len(plugins.loaded())
    assert before.keys() == plugins.WORDS.keys()
    try:
        yield
    finally:
        plugins._restore(before, count)


def write_plugin(folder: Path, source: str = SOURCE, name: str = "my_plugin.py") -> Path:
    """Write a plugin's file."""
    path = folder / name
    path.write_text(source, encoding="utf-8")
    return path


def write_distribution(folder: Path, module: str) -> None:
    """Write an installed distribution, 'line-gauge', whose entry point 'edges' names a module as a plugin."""
    info = folder / "line_gauge-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: line-gauge\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(f"[calib.plugins]\nedges = {module}\n")
