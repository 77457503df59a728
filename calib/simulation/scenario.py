"""A virtual cell: a robot whose errors are known is measured, and everything that disturbs a measurement is known too.

    measured = T_frame_target(q) + drift + robot's repeatability + instrument's noise + outliers

A `Scenario`, from Python or from words, says what cells are to be like; a seed draws a `VirtualCell` out of it, which
measures any poses. See docs/simulation.md.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import astuple, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

import calib.data.kinds as registry
from calib.data.cell import Cell, TrackerNoise
from calib.data.cell_file import DEGREES, MM, POINT, TEXT, Field, numbers, read_table, read_toml
from calib.data.columns import SETS
from calib.data.kinds import Kind
from calib.data.measurements import Measurements
from calib.errors import CalibError, choices
from calib.files import write_atomically
from calib.json_files import json_bytes
from calib.model.error_model import error_model
from calib.model.families import unit_of
from calib.model.parameters import ErrorModel
from calib.robot.ranges import joint_ranges
from calib.robot.robot import Robot, read_only
from calib.simulation.truth import (
    NONE,
    TARGET_ERROR,
    Encoder,
    MovedTarget,
    Outliers,
    Truth,
    draw_truth,
    sizes_of,
    stream,
)
from calib.units import LENGTH, Array, parse_amount, parse_noise

Rows = NDArray[np.int_]

#: Where the tracker stands if nothing says so, in the base [m].
DEFAULT_TRACKER = read_only((3.0, 0.0, 0.0))

#: The set of errors where the cell leaves the choice to the data.
DEFAULT_MODEL = "placement"


@dataclass(frozen=True, slots=True, eq=False)
class Scenario:
    """What virtual cells are to be like, before anything is drawn."""

    robot: Robot  #: The nominal robot
    #: Targets, frames, tracker, payload, gravity, kind, and limits of single errors
    cell: Cell = field(default_factory=Cell)
    model: str = DEFAULT_MODEL  #: In which errors the robot is wrong, see `draw_truth`
    #: Standard deviations of the errors that are drawn; None: none is
    sizes: Mapping[str, float] | None = field(default_factory=dict)
    errors: tuple[tuple[str, float], ...] = ()  #: Names and values of single errors
    true_robot: Robot | None = None  #: The true geometry, if it is given
    #: How far targets sit from where they are said to, standard deviation [m]
    target_error: float = TARGET_ERROR
    #: Of one coordinate, by the distance from the tracker; None: none. The repeatability in it displaces all targets
    #: of one stop alike; of the kind ``distance`` the distance is that from the anchor
    noise: TrackerNoise | None = field(default_factory=TrackerNoise)
    sigma_angle: float = 0.0  #: Standard deviation of a measured orientation about one axis [rad]
    encoder: Encoder = field(default_factory=Encoder)  #: Steps of the joint values
    outliers: Outliers | None = None  #: Rows that are far off; None: none
    moved: MovedTarget | None = None  #: A target that moves; None: none
    #: shape (3,), how far the instrument, or the base, drifts from the first row to the last, along the measurement
    #: frame's axes, evenly [m]
    drift: Array = field(default_factory=lambda: np.zeros(3))
    visits: int = 1  #: How often the tour of all poses is made

    def __post_init__(self) -> None:
        """Refuse a kind that cannot be simulated, and numbers that are none."""
        if self.kind.measure is None:
            free = [name for name in registry.names() if registry.get(name).measure is not None]
            raise CalibError(
                f"Measurements of the kind '{self.kind.name}' cannot be simulated; choose one of {choices(free)}."
            )
        object.__setattr__(self, "drift", read_only(self.drift))

    @property
    def kind(self) -> Kind:
        """What is measured: the cell's kind, or points."""
        return registry.get(self.cell.kind or "point")

    @property
    def tracker(self) -> Array | None:
        """Where the tracker stands in the base, shape (3,), [m]; None: at the origin of its frame.

        That is the cell's tracker; or where measurements are in the base frame, 3 m away along its x axis.
        """
        cell = self.cell
        if cell.tracker is not None:
            return cell.tracker.position
        elsewhere = cell.frames or cell.T_frame_base is not None or cell.estimate_frame
        return None if elsewhere else DEFAULT_TRACKER

    def draw(self, seed: int) -> VirtualCell:
        """A virtual cell with the errors of this seed."""
        truth = draw_truth(
            self.robot,
            self.model,
            self.sizes,
            seed,
            cell=self.cell,
            errors=dict(self.errors),
            true_robot=self.true_robot,
            target_error=self.target_error,
        )
        return VirtualCell(self, truth)

    def random_poses(self, count: int, seed: int, *, validation: bool = False) -> Array:
        """Joint values anywhere inside the limits, or the cell's ranges, shape (count, m), [rad] or [m]."""
        low, high = joint_ranges(self.robot, self.cell.ranges).T
        rng = stream(seed, "validation poses" if validation else "poses")
        return np.asarray(low + (high - low) * rng.uniform(size=(count, len(low))))

    def poses(
        self,
        seed: int,
        count: int = 30,
        validation: int = 0,
        given: Array | None = None,
        sets: tuple[str, ...] = (),
    ) -> tuple[Array, tuple[str, ...]]:
        """Where the robot is measured, shape (N, m), [rad] or [m], and the set of each pose.

        ``count`` random poses, or those ``given``, shape (n, m), of these ``sets``, () for all to estimate from; and
        random ones besides, to validate with.
        """
        q = self.random_poses(count, seed) if given is None else given
        extra = self.random_poses(validation, seed, validation=True)
        words = (sets or (SETS[0],) * len(q)) + (SETS[1],) * len(extra)
        return np.concatenate([q, extra]), words


@dataclass(frozen=True, slots=True, eq=False)
class Simulated:
    """What a virtual cell measured, and what was true of it."""

    measurements: Measurements  #: The table, as `calib calibrate` reads it
    truth: Truth  #: The robot, the targets and the frames
    #: shape (R, m), where the joints really stood in each row, before their own errors [rad] or [m]
    q: Array
    #: shape (R, 4, 4), true poses of the targets, the moved one's included [m]
    T_frame_target: Array
    sigma: Array  #: shape (R,), standard deviation of the noise of one coordinate or length [m]
    #: shape (R, 3), how far outliers are displaced [m]; zero in other rows. Of lengths the first column says how much
    #: longer they are
    outliers: Array
    moved: NDArray[np.bool_]  #: shape (R,), which rows found the target moved
    seed: int  #: Of the random numbers

    @property
    def points(self) -> Array:
        """True positions of the targets in the measurement frame, shape (R, 3), [m]."""
        return self.T_frame_target[:, :3, 3]

    @property
    def outlier_rows(self) -> tuple[int, ...]:
        """The row numbers of the outliers."""
        return tuple(self.measurements.rows[i] for i in np.flatnonzero(self.outliers.any(axis=1)))


@dataclass(frozen=True, slots=True, eq=False)
class VirtualCell:
    """A robot with known errors, and an instrument that measures it."""

    scenario: Scenario  #: What is measured, and what disturbs it
    truth: Truth  #: The robot, the targets and the frames

    def measure(self, q: ArrayLike, seed: int = 0, sets: Sequence[str] | None = None) -> Simulated:
        """Measure every target at every pose q, shape (N, m), [rad] or [m], that the robot is sent to.

        The poses are dealt out among the set-ups in turn; with several visits the whole tour is made again. ``sets``
        has for each pose ``"estimate"`` or ``"validate"``; default all to estimate from.
        """
        scenario, truth, robot = self.scenario, self.truth, self.truth.nominal
        kind, noise = scenario.kind, scenario.noise
        q = np.atleast_2d(np.asarray(q, dtype=np.float64))
        robot.chain_values(q)  # refuses what are no values of these joints
        sets = (SETS[0],) * len(q) if sets is None else tuple(sets)
        # All targets at each stop, one tour of the poses after the other: what each row is of.
        route, number = np.tile(np.arange(len(q)), scenario.visits), len(truth.targets)
        stop = np.repeat(np.arange(len(route)), number)
        pose, target = route[stop], np.tile(np.arange(number), len(route))
        group = pose % len(truth.groups)
        words, names = tuple(sets[i] for i in pose), tuple(truth.targets[t] for t in target)
        partner = _partners(sets, pose, number) if kind.paired else None

        sliding = [joint.type == "prismatic" for joint in robot.inputs]
        stood, read = scenario.encoder.measure(q[route], sliding, seed)
        placed, moved = truth.T_tip_target[target].copy(), np.zeros(len(names), dtype=np.bool_)
        if scenario.moved is not None:
            moved = scenario.moved.rows(names)
            placed[moved, :3, 3] += scenario.moved.by
        T = truth.T_frame_base[group] @ truth.tip_poses(stood)[stop] @ placed
        drift = np.linspace(0.0, 1.0, len(stop))[:, None] * scenario.drift
        repeatability = 0.0 if noise is None else noise.repeatability
        stops = repeatability * stream(seed, "robot noise").standard_normal((len(route), 3))
        instrument = self._instrument(T, group, partner)
        outliers = self._outliers(words, partner, seed)
        apart = stream(seed, "tracker noise").standard_normal((len(T), 3)) * instrument[:, None]
        apart = apart + outliers
        seen = T.copy()
        seen[:, :3, 3] += drift + stops[stop]
        pairs = [""] * len(T)
        if partner is not None:
            first = np.flatnonzero(np.arange(len(T)) < partner)
            for k, i in enumerate(first, start=1):
                pairs[i] = pairs[partner[i]] = f"pair {k}"
        table = Measurements(
            joint_names=robot.joint_names,
            joints=read[stop],
            sets=words,
            targets=names,
            groups=tuple(truth.groups[g] for g in group),
            kinds=(kind.name,) * len(words),
            prismatic=tuple(n for n, s in zip(robot.joint_names, sliding, strict=True) if s),
            pairs=tuple(pairs),
            **Measurements.columns_of(kind, self._read(T, seen, apart, partner, seed)),
        )
        return Simulated(
            measurements=table,
            truth=truth,
            q=read_only(stood[stop]),
            T_frame_target=read_only(T),
            sigma=read_only(np.hypot(instrument, np.sqrt(1.0 + kind.paired) * repeatability)),
            outliers=read_only(outliers),
            moved=moved,
            seed=int(seed),
        )

    def _instrument(self, T: Array, group: Rows, partner: Rows | None) -> Array:
        """Standard deviation of the instrument alone, shape (R,), [m]."""
        noise, kind, tracker = self.scenario.noise, self.scenario.kind, self.scenario.tracker
        if noise is None:
            return np.zeros(len(T))
        distance = np.linalg.norm(T[:, :3, 3], axis=1)
        lengths = [i for i, one in enumerate(kind.readings) if one.quantity == "length"]
        if lengths and not kind.position:  # the instrument is what the length is measured from
            assert kind.measure is not None
            distance = np.abs(kind.measure(_seen(T, partner))[:, lengths[0]])
        elif tracker is not None:
            T_frame_base = self.truth.T_frame_base[group]
            place = T_frame_base[:, :3, :3] @ tracker + T_frame_base[:, :3, 3]
            distance = np.linalg.norm(T[:, :3, 3] - place, axis=1)
        return np.asarray(noise.constant + noise.per_length * distance)

    def _outliers(self, sets: Sequence[str], partner: Rows | None, seed: int) -> Array:
        """How far each row's measurement is displaced, shape (R, 3), [m]; of a pair that of its first row."""
        result, outliers = np.zeros((len(sets), 3)), self.scenario.outliers
        if outliers is None:
            return result
        first = [i for i in range(len(sets)) if partner is None or i < partner[i]]
        chosen = outliers.choose([i for i in first if sets[i] == SETS[0]], seed)
        v = stream(seed, "outlier directions").standard_normal(result.shape)
        v /= np.linalg.norm(v, axis=1, keepdims=True)
        if not self.scenario.kind.position:
            v = np.sign(v) * (1.0, 0.0, 0.0)
        result[chosen] = outliers.size * v[chosen]
        return result

    def _read(self, T: Array, seen: Array, apart: Array, partner: Rows | None, seed: int) -> Array:
        """What the instrument reads in each row, as `calib.data.kinds.Kind` says, shape (R, k).

        ``seen`` are the true poses T with drift and the robot's own noise, ``apart`` (R, 3) is the instrument's noise
        with outliers [m]; of lengths its first columns count.
        """
        kind = self.scenario.kind
        assert kind.measure is not None
        result = np.array(kind.measure(_seen(seen, partner)))
        if kind.position:
            result[:, :3] += apart
        turn = stream(seed, "angle noise").standard_normal((len(T), 3)) * self.scenario.sigma_angle
        if kind.orientation:
            R = Rotation.from_rotvec(turn).as_matrix() @ T[:, :3, :3]
            result[:, 3:12] = R.reshape(-1, 9)
        if partner is not None:  # both rows of a pair hold the one reading
            apart = apart[np.minimum(np.arange(len(apart)), partner)]
        for k, one in enumerate(kind.readings, start=kind.size - len(kind.readings)):
            result[:, k] += (apart if one.quantity == "length" else turn)[:, k % 3]
            if one.positive:  # what noise would make negative is seen from the other side
                result[:, k] = np.abs(result[:, k])
        return result


def simulate(
    scenario: Scenario,
    count: int = 30,
    validation: int = 10,
    seed: int = 0,
    poses: Array | None = None,
    sets: tuple[str, ...] = (),
) -> Simulated:
    """Measurements of a robot whose errors are drawn by the seed, with the truth; arguments as for `Scenario.poses`."""
    q, words = scenario.poses(seed, count, validation, poses, sets)
    return scenario.draw(seed).measure(q, seed, words)


def _partners(sets: Sequence[str], pose: Rows, targets: int) -> Rows:
    """The other row of each row's pair, shape (R,): consecutive poses of one set, the same target, the same tour."""
    other = np.arange(len(sets))
    for name in SETS:
        chosen = [i for i, word in enumerate(sets) if word == name]
        if len(chosen) % 2:
            raise CalibError(f"Pairs need an even number of poses; {len(chosen)} are to '{name}'.")
        other[chosen[::2]], other[chosen[1::2]] = chosen[1::2], chosen[::2]
    return np.asarray(np.arange(len(pose)) + (other[pose] - pose) * targets)


def _seen(T: Array, partner: Rows | None) -> Array:
    """Poses as a kind looks at them, shape (R, 4, 4), of a paired kind (R, 2, 4, 4)."""
    return T if partner is None else np.stack([T, T[partner]], axis=1)


#: The keys of ``[simulation]`` in a cell file.
FIELDS: Mapping[str, Field] = {
    "visits": Field("visits", numbers(1)),
    "encoder_deg": Field("angle", DEGREES),
    "encoder_mm": Field("length", MM),
    "outlier_size_mm": Field("size", MM),
    "drift_mm": Field("drift", POINT),
    "moved_row": Field("row", numbers(1)),
    "moved_mm": Field("by", POINT),
    "moved_target": Field("target", TEXT),
}

#: Noise of an orientation about each axis, of a tracker's 6D probe [rad].
_PROBE = float(np.radians(0.01))


def read_scenario(
    robot: Robot,
    cell: Cell,
    path: Path | None = None,
    *,
    sizes: str | None = None,
    error: Iterable[str] | None = None,
    noise: str | None = None,
    outliers: str | None = None,
    truth_robot: Path | None = None,
    target_error: str | None = None,
) -> Scenario:
    """The scenario of a robot and a cell, with what the command line and ``[simulation]`` in the cell file add."""
    more: dict[str, Any] = {}
    if path is not None:
        table = read_toml(path).get("simulation", {})
        more = read_table(table, FIELDS, f"[simulation] of {path}")
    model = DEFAULT_MODEL if cell.model == "auto" else cell.model
    whole = error_model(robot, model, target=False, gravity=cell.gravity)
    errors = tuple(_named_errors(error or (), whole))
    moved = None
    if "row" in more or "by" in more:
        by = more.get("by", np.zeros(3))
        moved = MovedTarget(int(more.get("row", 1)), by, more.get("target"))
    true_robot = None
    if truth_robot is not None:
        true_robot = Robot.load(truth_robot, robot.base, robot.tip, held=robot.held)
    found, sigma_angle = noise_of(cell, noise), cell.sigma_angle
    return Scenario(
        robot=robot,
        cell=cell,
        model=model,
        sizes=sizes_of(cell, sizes, named=bool(errors)),
        errors=errors,
        true_robot=true_robot,
        target_error=TARGET_ERROR
        if target_error is None
        else parse_amount(target_error, "--target-error", LENGTH, "1 mm"),
        noise=found,
        sigma_angle=0.0 if found is None else _PROBE if sigma_angle is None else sigma_angle,
        encoder=Encoder(more.get("angle", 0.0), more.get("length", 0.0)),
        outliers=None
        if outliers is None
        else Outliers.parse(outliers, more.get("size", Outliers().size)),
        moved=moved,
        drift=more.get("drift", np.zeros(3)),
        visits=int(more.get("visits", 1)),
    )


def _named_errors(pairs: Iterable[str], model: ErrorModel) -> Iterator[tuple[str, float]]:
    """Single errors, ``elbow_joint.rx=2 mrad`` each, in the units of the parameters."""
    for pair in dict.fromkeys(pairs):
        name, _, value = (part.strip() for part in pair.rpartition("="))
        unit = unit_of(model.parameters[model.index(name)].unit)
        yield name, parse_amount(value, "--error", unit.quantity, unit.example, signed=True)


def noise_of(cell: Cell, text: str | None) -> TrackerNoise | None:
    """The noise as said, ``15 um + 6 um/m``, ``0.05 mm`` or ``none``, else the cell's; None: none at all."""
    if text is not None:
        constant, per_length = (0.0, 0.0) if text == NONE else parse_noise(text, "--noise")
        return TrackerNoise(constant, per_length, 0.0) if constant or per_length else None
    found = TrackerNoise() if cell.tracker is None else cell.tracker.noise
    return found if cell.sigma is None else TrackerNoise(cell.sigma, 0.0, 0.0)


#: The truth file's kind and version.
SCHEMA = "truth 1"

#: The keys of a noise and of a row in it.
_NOISE = ("constant_m", "per_length_m_per_m", "repeatability_m")
_ROW = ("row", "target", "group", "joints", "xyz_m", "sigma_m")


def write_truth(
    scenario: Scenario, made: Simulated, path: str | Path, *, overwrite: bool = False
) -> Path:
    """Write what was true of a simulated table, as JSON in SI units; docs/simulation.md describes the keys.

    It is complete: with the nominal URDF alone, true positions follow from it.
    """
    truth, table, robot = made.truth, made.measurements, made.truth.nominal
    model, noise, moved = truth.model, scenario.noise, scenario.moved
    targets = zip(truth.targets, truth.T_tip_target, truth.said_T_tip_target, strict=True)
    set_ups = zip(truth.groups, truth.T_frame_base, strict=True)
    parameters = zip(model.parameters, truth.x, strict=True)
    terms = list(zip(model.terms, model.values(truth.x), model.mixing, strict=True))
    rows = zip(
        table.rows, table.targets, table.groups, made.q, made.points, made.sigma, strict=True
    )
    content = {
        "schema": SCHEMA,
        "seed": made.seed,
        "robot": {
            "name": robot.name,
            "urdf_sha256": robot.urdf.sha256,
            "base": robot.base,
            "tip": robot.tip,
            "joints": robot.joint_names,
            "held": [{"joint": name, "value": value} for name, value in sorted(robot.held.items())],
        },
        "model": {
            "set": model.name,
            "ties": [
                {"name": term.name, "other": model.names[leader], "factor": row[leader]}
                for term, _, row in terms
                if term.name not in model.names
                for leader in [int(np.argmax(np.abs(row)))]
            ],
        },
        "parameters": [{"name": p.name, "unit": p.unit, "value": x} for p, x in parameters],
        "displacements": [
            {"name": t.name, "place": t.place, "twist": t.direction, "value": value}
            | {"times": t.factor.name if t.factor else ""}
            for t, value, _ in terms
        ],
        "origins": [{"joint": n, **_place(T)} for n, T in sorted(truth.robot.origins().items())],
        "targets": [{"target": n, **_place(T), **_place(said, "said_")} for n, T, said in targets],
        "set_ups": [{"group": n, **_place(T, "frame_base_")} for n, T in set_ups],
        "payload": truth.payload and {"mass_kg": truth.payload.mass, "com_m": truth.payload.com},
        "gravity_m_s2": truth.gravity,
        "instrument": {
            "kind": scenario.kind.name,
            "noise": noise and dict(zip(_NOISE, astuple(noise), strict=True)),
            "sigma_angle_rad": scenario.sigma_angle,
            "tracker_base_xyz_m": scenario.tracker,
            "encoder_step_rad": scenario.encoder.angle,
            "encoder_step_m": scenario.encoder.length,
            "visits": scenario.visits,
        },
        "events": {
            "outliers": [
                {"row": table.rows[i], "displacement_m": made.outliers[i]}
                for i in np.flatnonzero(made.outliers.any(axis=1))
            ],
            "moved_target": moved
            and {"from_row": moved.row, "target": moved.target, "displacement_m": moved.by},
            "drift_m": scenario.drift,
        },
        "rows": [dict(zip(_ROW, row, strict=True)) for row in rows],
    }
    return write_atomically(path, json_bytes(content), overwrite=overwrite)


def _place(T: NDArray[np.float64], prefix: str = "") -> dict[str, Any]:
    """A pose, [m], and roll, pitch, yaw about fixed axes x, y, z [rad]."""
    rpy = pin.rpy.matrixToRpy(np.ascontiguousarray(T[:3, :3]))
    return {f"{prefix}xyz_m": T[:3, 3], f"{prefix}rpy_rad": rpy}
