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
    import calib.basics.plugins as _plugins
    import calib.model.parameter_sets as _models
    import calib.verbs.convert.convert as _formats
    from calib.boards.board import Board as Board
    from calib.boards.detection.detect import detect as detect
    from calib.camera.camera import Camera as Camera
    from calib.data import kinds as kinds
    from calib.data.cell import Cell as Cell
    from calib.data.forms.column_options import ColumnOptions as ColumnOptions
    from calib.data.measurements import Measurements as Measurements
    from calib.data.surroundings import TrackerNoise as TrackerNoise
    from calib.errors import CalibError as CalibError
    from calib.model import families as families
    from calib.numerics import solvers as solvers
    from calib.result.calibrate import calibrate as calibrate
    from calib.result.calibration import Calibration as Calibration
    from calib.robot.dh_rows import DHRow as DHRow
    from calib.robot.robot import Robot as Robot
    from calib.verbs.bag.bag import bag as bag
    from calib.verbs.base_frame.base_frame import base_frame as base_frame
    from calib.verbs.calibrate.again import Again as Again, again as again
    from calib.verbs.calibrate.uncertainty import bootstrap as bootstrap
    from calib.verbs.certificate.certificate import (
        Certificate as Certificate,
        certificate as certificate,
    )
    from calib.verbs.check.check import CheckResult as CheckResult, check as check
    from calib.verbs.check.poses import check_poses as check_poses, further_poses as further_poses
    from calib.verbs.compare.comparison import Comparison as Comparison, compare as compare
    from calib.verbs.compare.trend import RobotTrend as RobotTrend, trend as trend
    from calib.verbs.compensate.commands import Commands as Commands
    from calib.verbs.compensate.compensate import compensate as compensate
    from calib.verbs.compensate.robot_program import Program as Program
    from calib.verbs.convert.convert import convert as convert
    from calib.verbs.evaluate.acceptance import Acceptance as Acceptance, acceptance as acceptance
    from calib.verbs.evaluate.evaluation import Evaluation as Evaluation, evaluate as evaluate
    from calib.verbs.fleet.fleet import fleet as fleet
    from calib.verbs.history.history import History as History, history as history
    from calib.verbs.inspect.inspection import inspect as inspect
    from calib.verbs.joints.joint_table import joints as joints
    from calib.verbs.measure.aim import Aim as Aim
    from calib.verbs.measure.devices import controllers as controllers, readers as readers
    from calib.verbs.measure.session import Session as Session
    from calib.verbs.measure.stop import Row as Row
    from calib.verbs.plan.choice import PlanRequest as PlanRequest
    from calib.verbs.plan.plan import Plan as Plan, plan as plan
    from calib.verbs.simulate.scenario import Scenario as Scenario, simulate as simulate
    from calib.verbs.view.robots_page import view as view
    from calib.verbs.workspace.region import Region as Region
    from calib.verbs.workspace.workspace import workspace as workspace

    formats = _formats
    models = _models
    plugins = _plugins

from calib.version import __version__ as __version__

#: Where each public name is defined; the functions have the names of the command line's verbs.
_NAMES = {
    "calib.result.calibration": "Calibration",
    "calib.result.calibrate": "calibrate",
    "calib.verbs.certificate.certificate": "Certificate certificate",
    "calib.verbs.check.check": "CheckResult check",
    "calib.verbs.check.poses": "check_poses further_poses",
    "calib.verbs.compare.comparison": "Comparison compare",
    "calib.verbs.compare.trend": "RobotTrend trend",
    "calib.verbs.evaluate.evaluation": "Evaluation evaluate",
    "calib.boards.board": "Board",
    "calib.camera.camera": "Camera",
    "calib.verbs.bag.bag": "bag",
    "calib.verbs.base_frame.base_frame": "base_frame",
    "calib.verbs.compensate.commands": "Commands",
    "calib.verbs.compensate.compensate": "compensate",
    "calib.verbs.compensate.robot_program": "Program",
    "calib.verbs.convert.convert": "convert",
    "calib.data.cell": "Cell",
    "calib.data.forms.column_options": "ColumnOptions",
    "calib.data.measurements": "Measurements",
    "calib.verbs.plan.choice": "PlanRequest",
    "calib.data.surroundings": "TrackerNoise",
    "calib.verbs.workspace.region": "Region",
    "calib.verbs.workspace.workspace": "workspace",
    "calib.errors": "CalibError",
    "calib.verbs.inspect.inspection": "inspect",
    "calib.verbs.joints.joint_table": "joints",
    "calib.verbs.fleet.fleet": "fleet",
    "calib.verbs.history.history": "History history",
    "calib.verbs.measure.aim": "Aim",
    "calib.verbs.measure.session": "Session",
    "calib.verbs.measure.stop": "Row",
    "calib.verbs.plan.plan": "Plan plan",
    "calib.verbs.evaluate.acceptance": "Acceptance acceptance",
    "calib.verbs.calibrate.again": "Again again",
    "calib.verbs.calibrate.uncertainty": "bootstrap",
    "calib.robot.dh_rows": "DHRow",
    "calib.robot.robot": "Robot",
    "calib.verbs.simulate.scenario": "Scenario simulate",
    "calib.verbs.view.robots_page": "view",
    "calib.boards.detection.detect": "detect",
}
#: Modules by which a user extends calib: a registry each, by its name in `calib.plugins.WORDS`, and plugins.
_EXTENSIONS = {
    "controllers": "calib.verbs.measure.devices.controllers",
    "families": "calib.model.families",
    "formats": "calib.verbs.convert.convert",
    "kinds": "calib.data.kinds",
    "models": "calib.model.parameter_sets",
    "plugins": "calib.basics.plugins",
    "readers": "calib.verbs.measure.devices.readers",
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
