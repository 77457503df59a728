"""Where a true arm goes by a program, simulated with Pinocchio and a controller's own inverse kinematics."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pinocchio as pin

from calib.robot.robot import Robot
from calib.verbs.compensate.programs.correction import CorrectedProgram, corrected
from calib.verbs.compensate.programs.nominal_values import nominal_values
from calib.verbs.compensate.programs.program_file import Move, ProgramFile, Target


class Arm:
    """An arm by Pinocchio, from its URDF."""

    def __init__(self, robot: Robot, folder: Path, name: str) -> None:
        path = folder / name
        robot.urdf.write(path, overwrite=True)
        self.model = pin.buildModelFromUrdf(str(path))
        self.data = self.model.createData()
        self.base, self.tip = (self.model.getFrameId(link) for link in (robot.base, robot.tip))

    def pose(self, q: np.ndarray) -> pin.SE3:
        """T_base_tip."""
        pin.framesForwardKinematics(self.model, self.data, q)
        return self.data.oMf[self.base].actInv(self.data.oMf[self.tip])

    def joints_near(self, T_base_tip: pin.SE3, q: np.ndarray) -> np.ndarray:
        """Joint values of a pose, by Newton's method from others."""
        for _ in range(50):
            error = pin.log6(self.pose(q).actInv(T_base_tip)).vector
            if np.linalg.norm(error) < 1e-12:
                break
            pin.computeJointJacobians(self.model, self.data, q)
            pin.updateFramePlacements(self.model, self.data)
            J = pin.getFrameJacobian(self.model, self.data, self.tip, pin.LOCAL)
            q = q + np.linalg.lstsq(J, error, rcond=None)[0]
        return q


def misses(
    read: Callable[[Path], ProgramFile],
    folder: Path,
    name: str,
    nominal: Robot,
    true: Robot,
    pose: Callable[[np.ndarray], pin.SE3],
    start: Mapping[str, float] | None = None,
) -> tuple[CorrectedProgram, np.ndarray]:
    """The corrected program, and how far the true tool ends from each motion's pose: before and after, (N, 2) [m].

    ``folder`` has the program of a name and all that belongs to it, and gets the new one. ``pose`` makes a pose of the
    numbers of a target in SI units.
    """
    path = folder / name
    program = read(path)
    done = corrected(program, nominal, true, start=start)
    for text in done.texts:
        text.path.write_bytes(text.text.encode("latin-1"))
    again = read(path)
    assert motions(again) == motions(program)
    of_nominal, of_true = Arm(nominal, folder, "nominal.urdf"), Arm(true, folder, "true.urdf")
    q_nominal = nominal_values(nominal, program, start).q
    result = np.full((len(program.moves), 2), np.nan)
    for i, (move, moved) in enumerate(zip(program.moves, again.moves, strict=True)):
        old, new = program.targets[move.target], again.targets[moved.target]
        if old.convention is None:
            q_old, q_new = values(old), values(new)
            wanted = of_nominal.pose(q_old)
        else:
            wanted = tip_pose(move, pose(values(old)))
            q_old = of_nominal.joints_near(wanted, q_nominal[i])
            np.testing.assert_allclose(q_old, q_nominal[i], atol=1e-5)
            q_new = of_nominal.joints_near(tip_pose(moved, pose(values(new))), q_nominal[i])
        T_tip_tool = pin.SE3(np.eye(4) if move.T_tip_tool is None else move.T_tip_tool)
        goal = (wanted * T_tip_tool).translation
        for k, q in enumerate((q_old, q_new)):
            result[i, k] = np.linalg.norm((of_true.pose(q) * T_tip_tool).translation - goal)
    return done, result


def tip_pose(move: Move, T_frame_tool: pin.SE3) -> pin.SE3:
    """T_base_tip of a motion to a pose."""
    return pin.SE3(move.T_base_frame) * T_frame_tool * pin.SE3(move.T_tip_tool).inverse()


def values(target: Target) -> np.ndarray:
    """The numbers of a target in SI units."""
    return np.array([number.value for number in target.numbers]) * target.scales


def is_unchanged(
    program: ProgramFile, nominal: Robot, start: Mapping[str, float] | None = None
) -> bool:
    """Whether the texts stay as they are if the true robot is the nominal one."""
    return not any(corrected(program, nominal, nominal, start=start).changed)


def motions(program: ProgramFile) -> list[tuple[int, str, str]]:
    """Line, motion and name of the target of each motion."""
    return [(m.line, m.motion, program.targets[m.target].name) for m in program.moves]


def left(program: ProgramFile) -> list[tuple[int, str]]:
    """Line and code of all that is left, by line."""
    return sorted((item.line, item.code) for item in program.left)
