"""calib: kinematic calibration of robot arms. URDF in, corrected URDF out.

    robot = calib.Robot.load("robot.urdf", base="base", tip="tool0")
    data = calib.Measurements.read("data.csv", robot.joint_names)
    result = calib.calibrate(robot, data)
    print(result.summary())
    result.write_urdf("corrected.urdf")

Names are imported when they are first used, so that ``calib --help`` need not load a robotics library.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import calib.formats as _formats
    import calib.plugins as _plugins
    from calib.calibration import (
        Calibration as Calibration,
        Comparison as Comparison,
        Evaluation as Evaluation,
        calibrate as calibrate,
        compare as compare,
        evaluate as evaluate,
    )
    from calib.camera.board import Board as Board
    from calib.camera.camera import Camera as Camera
    from calib.circle_points.survey import base_frame as base_frame
    from calib.compensation.commands import Commands as Commands, compensate as compensate
    from calib.compensation.program import Program as Program
    from calib.conversion import convert as convert
    from calib.data import kinds as kinds
    from calib.data.cell import Cell as Cell
    from calib.data.forms.column_options import ColumnOptions as ColumnOptions
    from calib.data.measurements import Measurements as Measurements
    from calib.data.surroundings import TrackerNoise as TrackerNoise
    from calib.design.choice import PlanRequest as PlanRequest
    from calib.diagnosis.inspection import inspect as inspect
    from calib.errors import CalibError as CalibError
    from calib.fleets.tables import fleet as fleet
    from calib.model import error_model, families as families
    from calib.numerics import solvers as solvers
    from calib.planning import Plan as Plan, plan as plan
    from calib.regions.region import Region as Region
    from calib.regions.workspace import workspace as workspace
    from calib.result.acceptance import Acceptance as Acceptance, acceptance as acceptance
    from calib.result.uncertainty import bootstrap as bootstrap
    from calib.robot.dh.rows import DHRow as DHRow
    from calib.robot.robot import Robot as Robot
    from calib.simulation.scenario import Scenario as Scenario, simulate as simulate
    from calib.viewer.live import view as view
    from calib.vision.detection.detect import detect as detect

    formats = _formats
    models = error_model
    plugins = _plugins

from calib.version import __version__ as __version__

#: Where each public name is defined; the functions have the names of the command line's verbs.
_NAMES = {
    "calib.calibration": "Calibration Comparison Evaluation calibrate compare evaluate",
    "calib.camera.board": "Board",
    "calib.camera.camera": "Camera",
    "calib.circle_points.survey": "base_frame",
    "calib.compensation.commands": "Commands compensate",
    "calib.compensation.program": "Program",
    "calib.conversion": "convert",
    "calib.data.cell": "Cell",
    "calib.data.forms.column_options": "ColumnOptions",
    "calib.data.measurements": "Measurements",
    "calib.design.choice": "PlanRequest",
    "calib.data.surroundings": "TrackerNoise",
    "calib.regions.region": "Region",
    "calib.regions.workspace": "workspace",
    "calib.errors": "CalibError",
    "calib.diagnosis.inspection": "inspect",
    "calib.fleets.tables": "fleet",
    "calib.planning": "Plan plan",
    "calib.result.acceptance": "Acceptance acceptance",
    "calib.result.uncertainty": "bootstrap",
    "calib.robot.dh.rows": "DHRow",
    "calib.robot.robot": "Robot",
    "calib.simulation.scenario": "Scenario simulate",
    "calib.viewer.live": "view",
    "calib.vision.detection.detect": "detect",
}
#: Modules by which a user extends calib: a registry each, by its name in `calib.plugins.WORDS`, and plugins.
_EXTENSIONS = {
    "families": "calib.model.families",
    "formats": "calib.formats",
    "kinds": "calib.data.kinds",
    "models": "calib.model.error_model",
    "plugins": "calib.plugins",
    "solvers": "calib.numerics.solvers",
}

_MODULES = {name: module for module, names in _NAMES.items() for name in names.split()}

__all__ = sorted([*_MODULES, *_EXTENSIONS])


def __getattr__(name: str) -> Any:  # noqa: ANN401  any public name
    """Import a public name on first use."""
    if name in _EXTENSIONS:
        return importlib.import_module(_EXTENSIONS[name])
    if name not in _MODULES:
        raise AttributeError(f"module 'calib' has no attribute '{name}'")
    return getattr(importlib.import_module(_MODULES[name]), name)


def __dir__() -> list[str]:
    """The public names."""
    return sorted([*__all__, "__version__"])
