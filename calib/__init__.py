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
    from calib.base_frame.survey import Survey, survey
    from calib.base_frame.sweeps import Sweeps, read_sweeps
    from calib.calibration import Calibration, Comparison, calibrate, compare
    from calib.compensate.commands import Commands, commands
    from calib.compensate.program import Program
    from calib.design.forecast import forecast
    from calib.design.plan import Plan, plan
    from calib.design.region import Region
    from calib.design.workspace import Density, sample_workspace
    from calib.errors import CalibError
    from calib.fleets.fleet import Fleet, FleetOptions, FleetRobot, fleet
    from calib.identify.acceptance import Acceptance, acceptance
    from calib.identify.evaluation import Evaluation, evaluate
    from calib.identify.uncertainty import bootstrap, profile_interval, workspace_uncertainty
    from calib.measure.cell import Cell, GroupDistance, Priors
    from calib.measure.measurements import Measurements
    from calib.measure.surroundings import Box, Reflector, Tracker, TrackerNoise
    from calib.model.robot import Robot
    from calib.model.torques import Payload
    from calib.show.live import show
    from calib.simulate.scenario import Scenario
    from calib.simulate.study import Study, Trials, study

from calib.version import __version__ as __version__

__all__ = [
    "Acceptance",
    "Box",
    "CalibError",
    "Calibration",
    "Cell",
    "Commands",
    "Comparison",
    "Density",
    "Evaluation",
    "Fleet",
    "FleetOptions",
    "FleetRobot",
    "GroupDistance",
    "Measurements",
    "Payload",
    "Plan",
    "Priors",
    "Program",
    "Reflector",
    "Region",
    "Robot",
    "Scenario",
    "Study",
    "Survey",
    "Sweeps",
    "Tracker",
    "TrackerNoise",
    "Trials",
    "acceptance",
    "bootstrap",
    "calibrate",
    "commands",
    "compare",
    "evaluate",
    "fleet",
    "forecast",
    "plan",
    "profile_interval",
    "read_sweeps",
    "sample_workspace",
    "show",
    "study",
    "survey",
    "workspace_uncertainty",
]

_MODULES = {
    "Acceptance": "calib.identify.acceptance",
    "Box": "calib.measure.surroundings",
    "CalibError": "calib.errors",
    "Calibration": "calib.calibration",
    "Cell": "calib.measure.cell",
    "Commands": "calib.compensate.commands",
    "Comparison": "calib.calibration",
    "Density": "calib.design.workspace",
    "Evaluation": "calib.identify.evaluation",
    "Fleet": "calib.fleets.fleet",
    "FleetOptions": "calib.fleets.fleet",
    "FleetRobot": "calib.fleets.fleet",
    "GroupDistance": "calib.measure.cell",
    "Measurements": "calib.measure.measurements",
    "Payload": "calib.model.torques",
    "Plan": "calib.design.plan",
    "Priors": "calib.measure.cell",
    "Program": "calib.compensate.program",
    "Reflector": "calib.measure.surroundings",
    "Region": "calib.design.region",
    "Robot": "calib.model.robot",
    "Scenario": "calib.simulate.scenario",
    "Study": "calib.simulate.study",
    "Survey": "calib.base_frame.survey",
    "Sweeps": "calib.base_frame.sweeps",
    "Tracker": "calib.measure.surroundings",
    "TrackerNoise": "calib.measure.surroundings",
    "Trials": "calib.simulate.study",
    "acceptance": "calib.identify.acceptance",
    "bootstrap": "calib.identify.uncertainty",
    "calibrate": "calib.calibration",
    "commands": "calib.compensate.commands",
    "compare": "calib.calibration",
    "evaluate": "calib.identify.evaluation",
    "fleet": "calib.fleets.fleet",
    "forecast": "calib.design.forecast",
    "plan": "calib.design.plan",
    "profile_interval": "calib.identify.uncertainty",
    "read_sweeps": "calib.base_frame.sweeps",
    "sample_workspace": "calib.design.workspace",
    "study": "calib.simulate.study",
    "survey": "calib.base_frame.survey",
    "workspace_uncertainty": "calib.identify.uncertainty",
}


def __getattr__(name: str) -> Any:  # noqa: ANN401  any public name
    """Import a public name on first use."""
    if name in ("families", "kinds"):
        return importlib.import_module(f"calib.{name}")
    if name == "show":
        return importlib.import_module("calib.show")  # a folder that can be called
    if name not in _MODULES:
        raise AttributeError(f"module 'calib' has no attribute '{name}'")
    return getattr(importlib.import_module(_MODULES[name]), name)


def __dir__() -> list[str]:
    """The public names."""
    return sorted([*__all__, "__version__"])
