"""What calib and other programs answer to the same input: one number for each, the largest difference.

`scripts/validation_table.py` prints them as the table of docs/verification.md, and `test_comparisons.py` asserts the
limits.
"""

from __future__ import annotations

import functools
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import lmfit
import mujoco
import numpy as np
import pinocchio as pin
import scipy
from scipy.optimize import curve_fit, least_squares
from scipy.spatial.transform import Rotation

import calib.example
from calib.basics.arrays import Array
from calib.camera.board_pose import board_pose
from calib.camera.initial_intrinsics import Bundle, refine_bundle
from calib.camera.lenses import LENSES
from calib.data.cell import Cell, Priors
from calib.data.measurements import Measurements
from calib.model.kinematics import Kinematics, Samples
from calib.model.parameter_sets import error_model
from calib.numerics.solvers import levenberg_marquardt
from calib.result.calibrate import calibrate
from calib.result.calibration import Calibration
from calib.robot.robot import Robot
from tests.camera.lens_values import VALUES
from tests.camera.test_board_pose import POINTS, pose
from tests.camera.test_lenses import by_opencv, points
from tests.model.test_kinematics import (
    CHAINS,
    finite_x,
    pose as pose_of_seed,
    some_load,
    some_q,
    twists_by_differences,
)
from tests.robot.mujoco_truth import MODELS, Truth
from tests.robot.test_kernel import by_pinocchio, seen
from tests.validation.nist_sets import NistSet, digits, read_sets

_ANSWERS = Path(__file__).with_name("answers")


@dataclass(frozen=True)
class Comparison:
    """One number of calib beside that of another program."""

    #: What is compared, on which input
    what: str
    #: The other program and its function
    program: str
    #: Of the figure, "" for a relative one
    unit: str
    #: The most that it may be
    limit: float
    #: Computes it: the largest difference
    figure: Callable[[], float]


COMPARISONS: list[Comparison] = []


def compared(
    what: str, program: str, limit: float, unit: str = ""
) -> Callable[[Callable[[], float]], Callable[[], float]]:
    """Add a function that computes a figure to `COMPARISONS`."""

    def add(figure: Callable[[], float]) -> Callable[[], float]:
        COMPARISONS.append(Comparison(what, program, unit, limit, figure))
        return figure

    return add


# Least squares


def nist_by_calib(one: NistSet, x0: Array) -> tuple[Array, str]:
    """Return x and the status by calib's Levenberg-Marquardt, with steps no longer than the start."""
    found = levenberg_marquardt(
        one.system(),
        x0,
        step_size=np.abs(x0),
        step_tolerance=1e-13,
        tolerance=0.0,
        longest_step=1.0,
        iterations=10000,
    )
    return found.x, found.status


def nist_by_scipy(one: NistSet, x0: Array, method: str) -> tuple[Array, str]:
    """Return x and the status by SciPy's `least_squares`, to its least tolerances."""
    system = one.system()
    try:
        found = least_squares(
            lambda b: system(b)[0],
            x0,
            jac=lambda b: system(b)[1],
            method=method,
            x_scale=np.abs(x0),
            ftol=3e-16,
            xtol=3e-16,
            gtol=3e-16,
            max_nfev=10000,
        )
    except ValueError:  # a residual that is not finite
        return np.full(len(x0), np.nan), "stopped"
    return found.x, "converged" if found.status > 0 else "stopped"


def nist_by_lmfit(one: NistSet, x0: Array) -> tuple[Array, str]:
    """Return x and the status by lmfit's `minimize` (MINPACK), to its least tolerances."""
    system = one.system()
    parameters = lmfit.Parameters()
    for k, value in enumerate(x0):
        parameters.add(f"b{k + 1}", value=value)

    def of(p: lmfit.Parameters) -> Array:
        return np.array(list(p.valuesdict().values()))

    try:
        found = lmfit.minimize(
            lambda p: system(of(p))[0],
            parameters,
            Dfun=lambda p: system(of(p))[1],
            ftol=3e-16,
            xtol=3e-16,
            gtol=0.0,
            max_nfev=10000,
            nan_policy="propagate",
        )
    except ValueError:
        return np.full(len(x0), np.nan), "stopped"
    return of(found.params), "converged" if found.success else "stopped"


#: Programs that solve the sets of NIST: a set and a start -> x and status.
NIST_SOLVERS: dict[str, Callable[[NistSet, Array], tuple[Array, str]]] = {
    "calib `levenberg_marquardt`": nist_by_calib,
    "SciPy `least_squares`, trf": lambda one, x0: nist_by_scipy(one, x0, "trf"),
    "SciPy `least_squares`, lm (MINPACK)": lambda one, x0: nist_by_scipy(one, x0, "lm"),
    "lmfit `minimize` (MINPACK)": nist_by_lmfit,
}


@dataclass(frozen=True)
class NistScore:
    """What a program reached of the 27 sets of NIST from both starts."""

    #: Cases with 8 digits of the certified values
    values: int
    #: Cases that also have 6 digits of the certified standard deviations
    errors: int
    #: Cases that it calls converged, with fewer than 4 digits
    wrong: int


def nist_score(program: str) -> NistScore:
    """Return what a program of `NIST_SOLVERS` reaches."""
    values = errors = wrong = 0
    for one in read_sets().values():
        for x0 in one.starts:
            with np.errstate(all="ignore"):
                x, status = NIST_SOLVERS[program](one, x0)
            reached = digits(x, one.certified)
            values += reached >= 8.0
            wrong += status == "converged" and reached < 4.0
            errors += (
                reached >= 8.0 and digits(one.standard_errors(x), one.standard_deviations) >= 6.0
            )
    return NistScore(values, errors, wrong)


@functools.cache
def paper_zeros() -> Calibration:
    """Return the paper's UR3 with its joint zeros fitted, without priors and robust weights."""
    robot = Robot.load(calib.example.paper_urdf(), base="base", tip="tool0")
    table = Measurements.read(calib.example.paper_measurements())
    cell = Cell(priors=Priors("off"))
    return calibrate(robot, table, cell=cell, model="zeros", robust=False, validate=False)


#: The parameters of that fit which the rows determine: the first five zeros, and the height of the target on the axis
#: of the last joint.
_DETERMINED = (0, 1, 2, 3, 4, 8)


@functools.cache
def paper_zeros_elsewhere() -> tuple[Array, Array, float]:
    """Return the same fit by `curve_fit` on Pinocchio's kinematics: parameters (8,), covariance and noise [m]."""
    model = pin.buildModelFromUrdf(str(calib.example.paper_urdf()))
    data = model.createData()
    base, tool = model.getFrameId("base"), model.getFrameId("tool0")
    table = Measurements.read(calib.example.paper_measurements())
    fitted = np.array([name == "estimate" for name in table.sets])
    measured = table.points[fitted]

    def predicted(_: object, *x: float) -> Array:
        # The last joint turns the target about its axis, which its position in the tool does as well.
        zeros, target = np.array([*x[:5], 0.0]), np.array(x[5:])
        places = []
        for q in table.joints[fitted]:
            pin.framesForwardKinematics(model, data, q + zeros)
            places.append((data.oMf[base].inverse() * data.oMf[tool]).act(target))
        return np.ravel(places)

    x0 = np.array([0.0, 0.0, 0.0, 0.0, 0.0, -0.07, 0.07, 0.022])
    x, covariance = curve_fit(
        predicted, None, measured.ravel(), p0=x0, ftol=1e-15, xtol=1e-15, gtol=1e-15
    )
    residual = measured.ravel() - predicted(None, *x)
    noise = float(np.sqrt(residual @ residual / (len(residual) - len(x))))
    return x, covariance, noise


@compared(
    "Joint zeros of the paper's UR3 without priors: corrections, in their standard deviations",
    "SciPy `curve_fit` on Pinocchio's kinematics",
    1e-4,
)
def zeros_of_the_paper() -> float:
    """Largest difference over its standard deviation."""
    mine = paper_zeros().parameters
    x, covariance, _ = paper_zeros_elsewhere()
    ours = np.array([mine[k].value for k in _DETERMINED])
    theirs = x[[0, 1, 2, 3, 4, 7]]
    std = np.sqrt(np.diag(covariance))[[0, 1, 2, 3, 4, 7]]
    return float(np.max(np.abs(ours - theirs) / std))


@compared(
    "The same fit: standard deviations over the noise, relative",
    "SciPy `curve_fit` on Pinocchio's kinematics",
    1e-4,
)
def standard_deviations_of_the_paper() -> float:
    """Largest relative difference."""
    mine, noise = paper_zeros().parameters, paper_zeros().noise.sigma["m"]
    _, covariance, their_noise = paper_zeros_elsewhere()
    ours = np.array([mine[k].std for k in _DETERMINED]) / noise
    theirs = np.sqrt(np.diag(covariance))[[0, 1, 2, 3, 4, 7]] / their_noise
    return float(np.max(np.abs(ours / theirs - 1.0)))


@compared(
    "The same fit: noise, relative (calib's has a weak prior about the instrument's)",
    "SciPy `curve_fit` on Pinocchio's kinematics",
    1e-2,
)
def noise_of_the_paper() -> float:
    """The relative difference."""
    _, _, theirs = paper_zeros_elsewhere()
    return abs(paper_zeros().noise.sigma["m"] / theirs - 1.0)


# Cameras


def _matrix(values: Array) -> Array:
    """Return the camera matrix of intrinsics."""
    fx, fy, cx, cy = values[:4]
    return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


@compared("Images of 200 points by each of the four lenses", "OpenCV `projectPoints`", 1e-9, "px")
def projections() -> float:
    """Largest difference of a coordinate."""
    P = points()
    return max(
        float(
            np.abs(LENSES[name].project(P, VALUES[name]) - by_opencv(name, P, VALUES[name])).max()
        )
        for name in LENSES
    )


@compared("Rays of their pixels", "OpenCV `undistortPoints`", 1e-9)
def rays() -> float:
    """Largest difference of x/z, y/z; of points within 35 degrees, where OpenCV's iteration has ended."""
    P = points()
    P = P[np.hypot(P[:, 0], P[:, 1]) < 0.7 * P[:, 2]]
    worst = 0.0
    for name, lens in LENSES.items():
        values = VALUES[name]
        pixels = lens.project(P, values)
        K, coefficients = _matrix(values), values[4:]
        criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 1000, 1e-15)
        if name == "fisheye":
            theirs = cv2.fisheye.undistortPoints(
                pixels[:, None], K, coefficients, criteria=criteria
            )
        else:
            theirs = cv2.undistortPoints(pixels[:, None], K, coefficients, criteria=criteria)
        ours = lens.undistort(pixels, values)[:, :2]
        worst = max(worst, float(np.abs(ours - theirs[:, 0]).max()))
    return worst


def _views() -> list[tuple[Array, Array]]:
    """Return 20 poses of a chessboard, and the images of its corners with noise of 0.3 px."""
    rng = np.random.default_rng(11)
    views = []
    for seed in range(20):
        T = pose(0.6, seed)
        pixels = LENSES["pinhole"].project(POINTS @ T[:3, :3].T + T[:3, 3], VALUES["pinhole"])
        views.append((T, pixels + rng.normal(scale=0.3, size=pixels.shape)))
    return views


@functools.cache
def _board_poses() -> tuple[float, float]:
    """Return the largest differences of 20 boards' poses: positions [m], and rotations [rad]."""
    values = VALUES["pinhole"]
    K = _matrix(values)
    places, turns = [], []
    for _, pixels in _views():
        _, r, t = cv2.solvePnP(POINTS, pixels, K, values[4:])
        criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 1000, 1e-15)
        r, t = cv2.solvePnPRefineLM(POINTS, pixels, K, values[4:], r, t, criteria)
        found = board_pose(POINTS, pixels, LENSES["pinhole"], values)
        assert found is not None
        T = found.T_camera_board
        places.append(np.linalg.norm(T[:3, 3] - t[:, 0]))
        between = Rotation.from_matrix(T[:3, :3]).inv() * Rotation.from_rotvec(r[:, 0])
        turns.append(between.magnitude())
    return float(max(places)), float(max(turns))


@compared(
    "Positions of 20 boards, corners with noise of 0.3 px", "OpenCV `solvePnPRefineLM`", 1e-7, "m"
)
def positions_of_boards() -> float:
    """Largest distance."""
    return _board_poses()[0]


@compared("Their orientations", "OpenCV `solvePnPRefineLM`", 1e-6, "rad")
def orientations_of_boards() -> float:
    """Largest angle."""
    return _board_poses()[1]


@compared(
    "Focal lengths and centre by these views alone, in their standard deviations",
    "OpenCV `calibrateCameraExtended`",
    1e-2,
)
def intrinsics() -> float:
    """Largest difference over its standard deviation; priors as wide as if there were none."""
    views, start = _views(), VALUES["pinhole"]
    corners = [(POINTS, pixels) for _, pixels in views]
    bundle = Bundle(LENSES["pinhole"], start, np.full(len(start), 1e6))
    ours = refine_bundle(bundle, start, corners, [T for T, _ in views], 100)
    assert ours is not None
    _, K, _, _, _, std, _, _ = cv2.calibrateCameraExtended(
        [POINTS.astype(np.float32)] * len(views),
        [pixels.astype(np.float32)[:, None] for _, pixels in views],
        (1280, 720),
        _matrix(start),
        start[4:].copy(),
        flags=cv2.CALIB_USE_INTRINSIC_GUESS,
        criteria=(cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 500, 1e-15),
    )
    theirs = np.array([K[0, 0], K[1, 1], K[0, 2], K[1, 2]])
    return float(np.max(np.abs(ours.values[:4] - theirs) / std[:4, 0]))


# Hand-eye


@functools.cache
def hand_eye(data: str) -> Calibration:
    """Return calib's fit of frames alone to the pose pairs that OpenCV 4 was given, ``"exact"`` or ``"noisy"``."""
    pairs = json.loads((_ANSWERS / "hand_eye_opencv4.json").read_text(encoding="utf-8"))
    robot = Robot.load("panda", base="panda_link8", tip="panda_link0")
    T = np.array(pairs["T_camera_board"][data])
    # The hand is the chain's root: its joint values come in the order of that chain.
    order = [robot.joint_names.index(f"panda_joint{k + 1}") for k in range(7)]
    q = np.empty((len(T), 7))
    q[:, order] = np.array(pairs["q"])
    table = Measurements(
        joint_names=robot.joint_names,
        joints=q,
        points=T[:, :3, 3],
        rotations=T[:, :3, :3],
        kinds=("pose",) * len(T),
    )
    cell = Cell(estimate_frame=True)
    return calibrate(robot, table, cell=cell, model="frames", robust=False, validate=False)


def _hand_eye_answers(data: str) -> Array:
    """Return T_hand_camera by each of OpenCV's seven methods, (7, 4, 4)."""
    pairs = json.loads((_ANSWERS / "hand_eye_opencv4.json").read_text(encoding="utf-8"))
    return np.array(list(pairs["T_hand_camera"][data].values()))


@compared(
    "Camera on a Panda's hand by 20 exact pairs of poses: T_hand_camera by calib's frames",
    "OpenCV 4 `calibrateHandEye` (5 methods), `calibrateRobotWorldHandEye` (2)",
    1e-8,
)
def hand_eye_of_exact_poses() -> float:
    """Largest difference of an element [m or 1]."""
    T = np.linalg.inv(hand_eye("exact").setup.T_frame_base[0])
    return float(np.abs(_hand_eye_answers("exact") - T).max())


@compared(
    "The same with noise of 0.2 mm and 0.5 mrad: the camera's place, in its standard uncertainties by calib",
    "OpenCV 4, the nearest of the seven",
    1.0,
)
def hand_eye_of_noisy_poses() -> float:
    """Distance to the nearest of the seven answers over the standard deviation of the position."""
    fit = hand_eye("noisy")
    T = np.linalg.inv(fit.setup.T_frame_base[0])
    distances = np.linalg.norm(_hand_eye_answers("noisy")[:, :3, 3] - T[:3, 3], axis=1)
    std = np.array(
        [one.std for one in fit.parameters if one.name.startswith("frame_") and one.unit == "m"]
    )
    return float(distances.min() / np.linalg.norm(std))


# Robots


def _robots() -> dict[str, Robot]:
    """Return serial arms, a gripper's finger, heads to hands through a torso, with their names."""
    names: dict[str, tuple[str, str | None, str | None]] = {
        "ur3": ("ur3", "base_link", "tool0"),
        "panda": ("panda", "panda_link0", "panda_link8"),
        **CHAINS,
    }
    return {name: Robot.load(*ends) for name, ends in names.items()}


@functools.cache
def _by_regressor() -> tuple[float, float]:
    """Return the largest differences of poses [m or 1], and of Jacobians' columns relative to their norms."""
    poses, columns = 0.0, 0.0
    for robot in _robots().values():
        for sets in ("hayati", "placement"):
            kinematics, samples = seen(
                robot, f"{sets}+gain+eccentricity+compliance+gravity", 48, 30
            )
            x = np.random.default_rng(5).normal(0.0, 1e-3, len(kinematics.model))
            their_poses, their_twists = by_pinocchio(kinematics, x, samples)
            our_poses, our_twists = kinematics.twists(x, samples)
            poses = max(poses, float(np.abs(our_poses - their_poses).max()))
            norms = np.linalg.norm(their_twists, axis=(0, 1))
            off = np.linalg.norm(our_twists - their_twists, axis=(0, 1))
            columns = max(columns, float(np.max(off / np.maximum(norms, 1e-9))))
    return poses, columns


@compared("Forward kinematics of eleven chains with errors in all placements", "Pinocchio", 1e-13)
def forward_kinematics() -> float:
    """Largest difference of an element [m or 1]."""
    return _by_regressor()[0]


@compared(
    "Their Jacobians by all parameters, geometric and of the families gain, eccentricity, compliance and gravity",
    "Pinocchio `computeJointKinematicRegressor`",
    1e-11,
)
def jacobians() -> float:
    """Largest difference of a column relative to its norm."""
    return _by_regressor()[1]


#: Families behind the name of a parameter set, all there are.
_ALL_FAMILIES = "+gain+eccentricity+harmonic_2+lost_motion+creep+compliance+gravity"


@compared(
    "Jacobians of a Panda's DH parameters and all families of its joints' state",
    "differences of its poses, with Pinocchio's logarithm",
    1e-7,
)
def jacobians_by_differences() -> float:
    """Largest difference of a column relative to its norm."""
    robot = Robot.load("panda", base="panda_link0", tip="panda_link8")
    model = error_model(robot, "dh" + _ALL_FAMILIES, frame=True, rotation=True)
    kinematics = Kinematics(robot, model, pose_of_seed(1, 2.0), pose_of_seed(2, 0.3))
    moves = np.random.default_rng(7).uniform(-1.0, 1.0, (3, 7))
    samples = Samples.at(some_q(robot), some_load(robot), moves)
    x = 0.1 * finite_x(model)
    _, twists = kinematics.twists(x, samples)
    worst = 0.0
    for k, parameter in enumerate(model.parameters):
        step = 0.05 if parameter.unit == "rad/Nm" else 1.0
        expected = twists_by_differences(lambda x: kinematics.poses(x, samples), x, k, step)
        norm = max(float(np.linalg.norm(expected)), 1e-3)
        worst = max(worst, float(np.linalg.norm(twists[:, :, k] - expected)) / norm)
    return worst


@compared(
    "Poses of the tips of nine MJCF models at 30 joint values each", "MuJoCo `mj_kinematics`", 1e-12
)
def mjcf() -> float:
    """Largest difference of an element [m or 1]."""
    worst = 0.0
    for path in sorted(MODELS.glob("*.xml")):
        if path.stem == "beside":  # two arms, of which a tip has to be named
            continue
        robot, truth = Robot.load(path), Truth(path)
        names = list(robot.joint_names)
        q = np.random.default_rng(48).uniform(-2.0, 2.0, (30, len(names)))
        theirs = truth.poses(names, q, robot.base, robot.tip)
        worst = max(worst, float(np.abs(robot.poses(q) - theirs).max()))
    return worst


def versions() -> dict[str, str]:
    """Return the programs' versions by name."""
    return {
        "SciPy": scipy.__version__,
        "lmfit": lmfit.__version__,
        "OpenCV": cv2.__version__,
        "Pinocchio": pin.__version__,
        "MuJoCo": mujoco.__version__,
    }
