"""What the words of ``calib simulate`` come to: a scenario and its poses."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from calib.errors import CalibError

if TYPE_CHECKING:
    from collections.abc import Mapping

    import numpy as np
    from numpy.typing import NDArray

    from calib.measure.cell import Cell
    from calib.measure.disturbances import Outliers
    from calib.measure.noise import TrackerNoise
    from calib.measure.scenario import Scenario
    from calib.model.robot import Robot

#: Poses, and poses to validate with, where nothing says how many.
_COUNT, _VALIDATION = 30, 10

#: Noise of an orientation about each axis, of a tracker's 6D probe [deg].
_PROBE_DEG = 0.01

#: How far outliers are off.
_OUTLIER = "5 mm"


@dataclass(frozen=True, slots=True)
class Asked:
    """The words of a call, as they were typed; `calib.cli.simulate` says what they mean."""

    poses: Path | None
    count: int | None
    validation: int | None
    visits: int
    seed: int
    sizes: str | None
    errors: tuple[str, ...]
    truth_robot: Path | None
    target_error: str | None
    noise: str | None
    repeatability: str | None
    angle_noise: str | None
    encoder: tuple[str, ...]
    outliers: str | None
    outlier_size: str | None
    moved_target: str | None
    drift: str | None


@dataclass(frozen=True, slots=True, eq=False)
class Prepared:
    """What the words of a call come to: what a single simulation, and a study of many, begin with.

    Attributes:
        scenario: The robot, the cell and what disturbs it.
        poses: shape (N, m), poses of a file; None: random ones.
        sets: The sets of these poses.
        count: Number of random poses, where there is no file.
        validation: Number of random poses to validate with, besides.
        seed: Of the random numbers.
    """

    scenario: Scenario
    poses: NDArray[np.float64] | None
    sets: tuple[str, ...]
    count: int
    validation: int
    seed: int

    def all_poses(self, seed: int) -> tuple[NDArray[np.float64], tuple[str, ...]]:
        """Poses, shape (N, m), and the set of each; random ones by the seed."""
        import numpy as np

        own, sets = self.poses, self.sets
        if own is None:
            own = self.scenario.random_poses(self.count, seed)
            sets = ("estimate",) * self.count
        extra = self.scenario.random_poses(self.validation, seed, validation=True)
        return np.concatenate([own, extra]), (*sets, *("validate",) * len(extra))


def checked_model(model: str | None) -> str | None:
    """Refuse ``auto``: a robot is wrong in something definite."""
    if model == "auto":
        message = (
            "--model auto is for calib fit; say in which errors the simulated robot is wrong, such as placement or "
            "dh+gain."
        )
        raise CalibError(message)
    return model


def with_tracker(cell: Cell, tracker: str | None) -> Cell:
    """The cell with its tracker where the command line says."""
    from calib.cli.surroundings_words import parse_tracker

    return cell if tracker is None else replace(cell, tracker=parse_tracker(tracker, cell.tracker))


def _noise(cell: Cell, noise: str | None, repeatability: str | None) -> TrackerNoise | None:
    """The noise that the command line says, else the cell's."""
    from calib.cli.simulate_words import parse_instrument, parse_size
    from calib.measure.noise import TrackerNoise
    from calib.measure.scenario import cell_noise

    own = None if repeatability is None else parse_size(repeatability, "--repeatability", "0.02 mm")
    if noise is not None:
        return parse_instrument(noise, own or 0.0)
    found = cell_noise(cell)
    if own is None:
        return found
    if not (own or found.constant or found.per_length):
        return None
    return TrackerNoise(found.constant, found.per_length, own)


def _scenario(robot: Robot, cell: Cell, asked: Asked) -> Scenario:
    """What the virtual cell is to be like."""
    import numpy as np

    from calib.cli import simulate_words as words
    from calib.cli.words import AUTO, parse_point
    from calib.measure.scenario import DEFAULT_MODEL, Scenario
    from calib.measure.truth import TARGET_ERROR
    from calib.model.error_model import error_model
    from calib.model.robot import Robot as RobotClass

    model = DEFAULT_MODEL if cell.model == AUTO else cell.model
    errors = words.parse_errors(asked.errors, error_model(robot, model, target=False).parameters)
    noise = _noise(cell, asked.noise, asked.repeatability)
    return Scenario(
        robot=robot,
        cell=cell,
        model=model,
        sizes=_sizes(cell, asked.sizes, named=bool(errors)),
        errors=errors,
        true_robot=None
        if asked.truth_robot is None
        else RobotClass.load(asked.truth_robot, robot.base, robot.tip, held=robot.held),
        target_error=TARGET_ERROR
        if asked.target_error is None
        else words.parse_size(asked.target_error, "--target-error"),
        noise=noise,
        sigma_angle=_sigma_angle(cell, asked.angle_noise, any_noise=noise is not None),
        encoder=words.parse_encoder(asked.encoder),
        outliers=_outliers(asked.outliers, asked.outlier_size),
        moved=None if asked.moved_target is None else words.parse_moved(asked.moved_target),
        drift=np.zeros(3) if asked.drift is None else parse_point(asked.drift, "--drift"),
        visits=asked.visits,
    )


def _outliers(number: str | None, size: str | None) -> Outliers | None:
    """Rows that are far off, if there are to be any."""
    from calib.cli.simulate_words import parse_outliers, parse_size

    if number is None:
        if size is not None:
            message = "--outlier-size says how far outliers are off; say how many there are, such as --outliers 3."
            raise CalibError(message)
        return None
    return parse_outliers(number, parse_size(size or _OUTLIER, "--outlier-size", _OUTLIER))


def _sigma_angle(cell: Cell, said: str | None, *, any_noise: bool) -> float:
    """The noise of an orientation: as said, the cell's, or a tracker's 6D probe's; none where there is no noise."""
    import math

    from calib import kinds
    from calib.cli.simulate_words import parse_angle

    if said is not None:
        if cell.kind is None or not kinds.get(cell.kind).angles:
            message = (
                "--angle-noise is the noise of orientations; they are measured with --kind pose."
            )
            raise CalibError(message)
        return parse_angle(said, "--angle-noise")
    if not any_noise:
        return 0.0
    return math.radians(_PROBE_DEG) if cell.sigma_angle is None else cell.sigma_angle


def _sizes(cell: Cell, sizes: str | None, *, named: bool) -> Mapping[str, float] | None:
    """The sizes of errors that are drawn: as said, none beside single errors, the cell's, or a typical arm's."""
    from calib.cli.simulate_words import parse_sizes
    from calib.families import FAMILIES

    if sizes is not None:
        return parse_sizes(sizes)
    if named:
        return None
    given = cell.priors.sizes == "given"
    return {f: cell.priors.of(f) for f in FAMILIES} if given else {}


def prepare(robot: Robot, cell: Cell, asked: Asked) -> Prepared:
    """The scenario with its poses.

    Raises:
        CalibError: Words that cannot be read, or that do not fit the robot or each other.
    """
    from calib.measure.pose_list import read_pose_list

    if asked.poses is not None and asked.count is not None:
        message = "--poses gives the poses, --count says how many are random; choose one."
        raise CalibError(message)
    scenario = _scenario(robot, cell, asked)
    if asked.poses is None:
        count = _COUNT if asked.count is None else asked.count
        extra = _VALIDATION if asked.validation is None else asked.validation
        return Prepared(scenario, None, (), count, extra, asked.seed)
    q, sets = read_pose_list(asked.poses, robot)
    return Prepared(scenario, q, sets, len(q), asked.validation or 0, asked.seed)
