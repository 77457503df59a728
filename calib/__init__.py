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
    from calib.calibration import (
        Calibration as Calibration,
        Comparison as Comparison,
        calibrate as calibrate,
        compare as compare,
    )
    from calib.circle_points.survey import Survey as Survey, survey as survey
    from calib.circle_points.sweeps import Sweeps as Sweeps, read_sweeps as read_sweeps
    from calib.compensation.commands import Commands as Commands, compensate as compensate
    from calib.compensation.program import Program as Program
    from calib.data.cell import Cell as Cell, GroupDistance as GroupDistance, Priors as Priors
    from calib.data.measurements import Measurements as Measurements
    from calib.data.surroundings import (
        Box as Box,
        Reflector as Reflector,
        Tracker as Tracker,
        TrackerNoise as TrackerNoise,
    )
    from calib.design.forecast import forecast as forecast
    from calib.design.optimal import PlanRequest as PlanRequest
    from calib.design.plan import Plan as Plan, plan as plan
    from calib.design.region import Region as Region
    from calib.design.workspace import Density as Density, workspace as workspace
    from calib.errors import CalibError as CalibError
    from calib.fleets.fleet import (
        Fleet as Fleet,
        FleetOptions as FleetOptions,
        FleetRobot as FleetRobot,
        fleet as fleet,
    )
    from calib.formats.convert import convert as convert
    from calib.result.acceptance import Acceptance as Acceptance, acceptance as acceptance
    from calib.result.evaluation import Evaluation as Evaluation, evaluate as evaluate
    from calib.result.uncertainty import (
        bootstrap as bootstrap,
        profile_interval as profile_interval,
        workspace_uncertainty as workspace_uncertainty,
    )
    from calib.robot.robot import Robot as Robot
    from calib.robot.torques import Payload as Payload
    from calib.simulation.scenario import Scenario as Scenario, simulate as simulate
    from calib.viewer.live import view as view

from calib.version import __version__ as __version__

#: Where each public name is defined.
_NAMES = {
    "calib.circle_points.survey": "Survey survey",
    "calib.circle_points.sweeps": "Sweeps read_sweeps",
    "calib.calibration": "Calibration Comparison calibrate compare",
    "calib.compensation.commands": "Commands compensate",
    "calib.compensation.program": "Program",
    "calib.design.forecast": "forecast",
    "calib.design.optimal": "PlanRequest",
    "calib.design.plan": "Plan plan",
    "calib.design.region": "Region",
    "calib.design.workspace": "Density workspace",
    "calib.errors": "CalibError",
    "calib.fleets.fleet": "Fleet FleetOptions FleetRobot fleet",
    "calib.formats.convert": "convert",
    "calib.result.acceptance": "Acceptance acceptance",
    "calib.result.evaluation": "Evaluation evaluate",
    "calib.result.uncertainty": "bootstrap profile_interval workspace_uncertainty",
    "calib.data.cell": "Cell GroupDistance Priors",
    "calib.data.measurements": "Measurements",
    "calib.data.surroundings": "Box Reflector Tracker TrackerNoise",
    "calib.robot.robot": "Robot",
    "calib.robot.torques": "Payload",
    "calib.simulation.scenario": "Scenario simulate",
    "calib.viewer.live": "view",
}
#: Modules that a user adds a row to.
_REGISTRIES = {"families": "calib.model.families", "kinds": "calib.data.kinds"}

_MODULES = {name: module for module, names in _NAMES.items() for name in names.split()}

__all__ = sorted(_MODULES)


def __getattr__(name: str) -> Any:  # noqa: ANN401  any public name
    """Import a public name on first use."""
    if name in _REGISTRIES:
        return importlib.import_module(_REGISTRIES[name])
    if name not in _MODULES:
        raise AttributeError(f"module 'calib' has no attribute '{name}'")
    return getattr(importlib.import_module(_MODULES[name]), name)


def __dir__() -> list[str]:
    """The public names."""
    return sorted([*__all__, "__version__"])
