"""Forecasts and uncertainties of real calibrations against rows that the fit did not see.

    python scripts/real_sets_study.py FOLDER -o draws.jsonl

FOLDER holds the sets of `SETS`, a folder each; those that are not there are left out. Each set is divided by random
draws into fitted and fresh rows. The rule, made before any result was seen: whole poses; half of them are fitted, at
most 100; all other rows are fresh. Rows that a set holds back (``validate``, or by its text) are neither.

Printed for each set, and as the mean over sets:

- the share of draws whose forecast rms error is within 10 % and within 25 % of that of the fresh rows, outliers aside
  (`calib.uncertainty.forecast`), and of those in whose 90 % interval it is;
- what chance alone allows: the same shares for as many poses drawn from the errors of all fresh rows of the set, if
  their true rms is forecast (known), and if it is forecast by as many poses as were held out (drawn);
- leaving each set out: the share in an interval that is widened, and shifted, by what the other sets show;
- the share of fresh rows whose residual is within the expanded uncertainty of the prediction.

Draws are kept in a file, so that the study can be interrupted and continued.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import ndtri
from studies import print_table, show_progress, study_parser

from calib.basics.arrays import Array, Integers, Mask
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.data.surroundings import GroupDistance
from calib.result.calibrate import calibrate
from calib.result.calibration import Calibration
from calib.uncertainty.coverage import covered_length
from calib.uncertainty.forecast import LEVEL, FreshError, forecast, held_out_at_poses

#: The most poses that are fitted.
MOST_FITTED = 100

#: Seed of the first draw.
FIRST_SEED = 0

#: Sets of rows that chance is drawn for.
_CHANCES = 4000

#: Joint values that are the same pose [rad] or [m].
_SAME_POSE = 9

#: Models of a result: that of the URDF, and the one that predicts best.
MODELS = ("urdf", "best")


@dataclass(frozen=True)
class RealSet:
    """One set of real measurements, and how it is read."""

    #: URDF, or a name; a file is relative to the folder, as the table
    robot: str
    table: str
    #: Options of `calib.calibrate`: base, tip, frame
    options: Mapping[str, Any] = field(default_factory=dict)
    columns: Mapping[str, str] | None = None
    kind: str | None = None
    #: Cell file
    cell: str | None = None
    #: Distances between sockets
    distances: tuple[GroupDistance, ...] = ()
    #: Joints that slide; the table then has columns NAME_joint
    sliding: tuple[str, ...] = ()
    #: Rows, of the table in an order drawn with seed 1, that are not held back; None: all
    first: int | None = None


_PLACES = {"placement": "group", "socket": "group"}
_PLATE = (GroupDistance("*/0", "*/1", length=0.05, sigma=1e-4),)
_LIFT = ("torso_lift_joint",)
_TRACKED = {"base": "base", "tip": "tool0", "frame": "estimate"}

SETS = {
    "fr3_camera": RealSet(
        "fr3_camera/robot.urdf",
        "fr3_camera/measurements.csv",
        {"base": "panda_link0", "tip": "panda_link8", "frame": "estimate"},
    ),
    "franka_charuco": RealSet(
        "panda",
        "franka_charuco/pnp_poses.csv",
        {"base": "panda_link8", "tip": "panda_link0", "frame": "estimate"},
    ),
    "holiday_panda": RealSet(
        "holiday_panda/robot.urdf",
        "holiday_panda/measurements.csv",
        {"tip": "ball_link"},
        kind="fixed",
        cell="holiday_panda/cell.toml",
    ),
    "ipa_ur10 C": RealSet("ur10", "ipa_ur10/series_C.csv", _TRACKED, first=1800),
    "ipa_ur10 D": RealSet("ur10", "ipa_ur10/series_D.csv", _TRACKED),
    "mukca kuka_14": RealSet(
        "mukca_sockets/robot_iiwa14.urdf",
        "mukca_sockets/kuka_14.csv",
        {"tip": "ball_link"},
        _PLACES,
        kind="fixed",
        distances=_PLATE,
    ),
    "mukca panda_2": RealSet(
        "mukca_sockets/robot_panda.urdf",
        "mukca_sockets/panda_2.csv",
        {"tip": "ball_link"},
        _PLACES,
        kind="fixed",
        distances=_PLATE,
    ),
    "positioner": RealSet(
        "positioner/robot.urdf",
        "positioner/measurements.csv",
        {"frame": "estimate"},
        {"set": "-"},
    ),
    "talos_table": RealSet(
        "talos_table_right/robot.urdf",
        "talos_table_right/measurements_3points.csv",
        kind="plane",
        cell="talos_table_right/cell.toml",
    ),
    "tiago_mocap": RealSet(
        "tiago_mocap/robot.urdf",
        "tiago_mocap/measurements_pose.csv",
        {"tip": "arm_7_link", "frame": "estimate"},
        sliding=_LIFT,
    ),
    "tiago_pro July": RealSet(
        "tiago_pro/robot.urdf",
        "tiago_pro/session_0702_points.csv",
        {"frame": "estimate"},
        sliding=_LIFT,
    ),
    "tiago_pro August": RealSet(
        "tiago_pro/robot.urdf",
        "tiago_pro/session_0805_poses.csv",
        {"frame": "estimate"},
        sliding=_LIFT,
    ),
    "ur5e_factory": RealSet(
        "ur5e_factory/robot.urdf",
        "ur5e_factory/measurements.csv",
        {"base": "base", "tip": "tool0"},
        {"set": "-"},
    ),
}


# Draws


def read_set(folder: Path, name: str) -> tuple[str, Measurements, Cell]:
    """Read the robot's path or name, the rows that are not held back, and the cell of a set."""
    real = SETS[name]
    joints = types = None
    if real.sliding:
        head = (folder / real.table).read_text(encoding="utf-8").splitlines()[0]
        joints = re.findall(r"(\w+_joint) \[", head)
        types = dict.fromkeys(real.sliding, "prismatic")
    table = Measurements.read(folder / real.table, joints, types, real.columns, real.kind)
    if real.first is not None:
        kept = np.zeros(len(table), dtype=bool)
        # The order in which the set's text names its test rows.
        kept[np.random.RandomState(1).permutation(len(table))[: real.first]] = True
        table = table.select(kept)
    table = table.select(table.estimation)
    cell = Cell() if real.cell is None else Cell.read(folder / real.cell)
    robot = str(folder / real.robot) if real.robot.endswith(".urdf") else real.robot
    return robot, table, replace(cell, distances=real.distances or cell.distances)


def drawn_rows(table: Measurements, seed: int) -> tuple[Mask, Integers]:
    """Draw the rows to fit, a mask (N,), by the rule above; return them with the pose of each row, (N,)."""
    _, pose = np.unique(np.round(table.joints, _SAME_POSE), axis=0, return_inverse=True)
    pose = pose.reshape(-1)
    count = int(pose.max()) + 1
    order = np.random.default_rng(seed).permutation(count)
    return np.isin(pose, order[: min(MOST_FITTED, count // 2)]), pose


def run_draw(folder: Path, name: str, seed: int) -> dict[str, Any]:
    """Calibrate with the fitted rows of one draw, and predict the fresh ones."""
    robot, table, cell = read_set(folder, name)
    fitted, pose = drawn_rows(table, seed)
    sets = tuple("estimate" if is_fitted else "validate" for is_fitted in fitted)
    result = calibrate(robot, replace(table, sets=sets), cell=cell, **SETS[name].options)
    fresh = result.rows.validation
    chosen = np.isin(table.rows, np.array(result.rows.numbers)[fresh])
    record: dict[str, Any] = {"set": name, "seed": seed, "fitted": int(np.sum(fitted))}
    record["poses"] = pose[chosen].tolist()
    for model in MODELS:
        best = model == "best"
        residual = result.rows.residual_calibrated
        if best and result.non_geometric is not None:
            residual = result.non_geometric.residual
        record[model] = _figures(result, table.select(chosen), residual[fresh], best=best)
    return record


def _figures(
    result: Calibration, table: Measurements, residual: Array, *, best: bool
) -> dict[str, Any]:
    """Return the forecast, the errors of fresh and of held-out rows, and the uncertainty at the fresh ones."""
    rows = result.rows
    found = forecast(result, non_geometric=best)
    validation = held_out_at_poses(result, non_geometric=best)
    if found is None or validation is None:
        raise RuntimeError("The result was not cross-validated.")
    channels = rows.channels.select(rows.estimation)
    return {
        "model": result.part(non_geometric=best).model.name,
        "forecast": {
            "unit": found.unit,
            "rows": found.rows,
            "rms": found.rms,
            "freedom": found.freedom,
            "freedom_of_row": found.freedom_of_row,
            "shared": found.shared,
            "outliers": found.outliers,
            "held_out": found.held_out,
        },
        "errors": _listed(rows.channels.select(rows.validation).norms(residual, "m")),
        "held_out": _listed(channels.norms(validation.residual, "m")),
        "held_out_poses": validation.poses.tolist(),
        "flagged": rows.flagged[rows.estimation].tolist(),
        "before": _without_outliers(result, best=best),
        "U": _listed(_uncertainty(result, table, best=best)),
    }


def _without_outliers(result: Calibration, *, best: bool) -> tuple[float, float]:
    """Return what was forecast before: the held-out rms error without flagged rows, and the expected error [m]."""
    part = result.part(non_geometric=best)
    assert part.cross_validation is not None
    return part.cross_validation.errors_without_outliers["m"].rms, part.new_point[0]


def _uncertainty(result: Calibration, table: Measurements, *, best: bool) -> Array:
    """Return the length that the residual of each fresh row should stay below, shape (n,) [m]."""
    limit = np.full(len(table), np.nan)
    groups, targets = np.array(table.groups), np.array(table.targets)
    names = result.nominal.joint_names
    q, moves = table.joints_for(names), table.moves_for(names)
    for group, target in sorted(set(zip(table.groups, table.targets, strict=True))):
        of_place = (groups == group) & (targets == target)
        known = result.uncertainty(
            q[of_place], target=target, group=group, non_geometric=best, moves=moves[of_place]
        )
        # A plane shows errors along its normal alone, the third axis of its frame.
        along = slice(2, 3) if table.kinds[0] == "plane" else slice(0, 3)
        covariance = known.covariance[:, along, along]
        square = covered_length(covariance, known.position_freedom) ** 2
        if known.separated:
            noise = result.noise.sigma_given.get("m", 0.0) ** 2 * np.eye(covariance.shape[1])
            square = square + covered_length(noise[None], np.array([np.inf])) ** 2
        limit[of_place] = np.sqrt(square)
    return limit


def _listed(values: Array) -> list[float]:
    """Return numbers with seven digits, for the file."""
    return [float(f"{value:.7g}") for value in values]


# Figures


def _compared(draw: dict[str, Any], model: str) -> tuple[float, float, float, float]:
    """Return a draw's fresh over forecast rms error, its probability, and its share of outliers, fresh and held out."""
    figures = draw[model]
    found = FreshError(**figures["forecast"])
    fresh = found.compared(figures["errors"])
    ratio = fresh.rms / fresh.forecast.rms
    return ratio, fresh.probability, fresh.outliers / len(figures["errors"]), found.outliers


def within(ratios: Array, share: float) -> float:
    """Return how many forecasts (the inverse of fresh over forecast) are within a share of the fresh error."""
    return float(np.mean(np.abs(1.0 / ratios - 1.0) <= share))


def by_chance(draws: list[dict[str, Any]], model: str) -> tuple[Array, Array]:
    """Draw fresh over forecast rms errors by chance alone: of a known rms, and of one from as many held-out poses."""
    pooled = []
    fresh_poses, held_out_poses = [], []
    for draw in draws:
        found = FreshError(**draw[model]["forecast"])
        errors = np.array(draw[model]["errors"])
        kept = errors <= replace(found, rows=float(len(errors))).limit
        _, pose = np.unique(np.array(draw["poses"])[kept], return_inverse=True)
        by_pose = np.bincount(pose, errors[kept] ** 2) / np.bincount(pose)
        pooled.append(by_pose / by_pose.mean())
        fresh_poses.append(len(by_pose))
        held_out_poses.append(len(np.unique(draw[model]["held_out_poses"])))
    squares = np.concatenate(pooled)
    rng = np.random.default_rng(1)

    def means(count: int) -> Array:
        """Return the means of so many squares, shape (draws,)."""
        return np.array([rng.choice(squares, count).mean() for _ in range(_CHANCES)])

    fresh = means(int(np.median(fresh_poses)))
    held_out = means(int(np.median(held_out_poses)))
    return np.sqrt(fresh), np.sqrt(fresh / held_out)


def left_out(scores: dict[str, Array], name: str) -> tuple[float, float]:
    """Return mean and spread of the normal scores of the other sets, each set counting alike."""
    others = [values for other, values in scores.items() if other != name]
    mean = float(np.mean([np.mean(values) for values in others]))
    square = float(np.mean([np.mean((values - mean) ** 2) for values in others]))
    return mean, np.sqrt(square)


def print_figures(draws: list[dict[str, Any]], model: str) -> None:
    """Print the tables of one model."""
    by_set: dict[str, list[dict[str, Any]]] = {}
    for draw in draws:
        by_set.setdefault(draw["set"], []).append(draw)
    compared = {
        name: np.array([_compared(draw, model) for draw in of_set])
        for name, of_set in by_set.items()
    }
    scores = {
        name: ndtri(np.clip(found[:, 1], 1e-9, 1.0 - 1e-9)) for name, found in compared.items()
    }
    bound = ndtri(0.5 + LEVEL / 2.0)
    rows = []
    total = []
    for name, of_set in by_set.items():
        ratios, places = compared[name][:, 0], compared[name][:, 1]
        known, drawn = by_chance(of_set, model)
        mean, spread = left_out(scores, name) if len(by_set) > 1 else (0.0, 1.0)
        old = np.array([d[model]["before"] for d in of_set])
        all_rms = np.array([np.sqrt(np.mean(np.square(d[model]["errors"]))) for d in of_set])
        errors = np.concatenate([d[model]["errors"] for d in of_set])
        limits = np.concatenate([d[model]["U"] for d in of_set])
        kept = np.concatenate([_kept(d, model) for d in of_set])
        figures = [
            within(ratios, 0.10),
            within(ratios, 0.25),
            within(known, 0.10),
            within(known, 0.25),
            within(drawn, 0.10),
            within(drawn, 0.25),
            float(np.mean(np.abs(places - 0.5) <= LEVEL / 2.0)),
            float(np.mean(np.abs(scores[name] - mean) <= bound * spread)),
            within(all_rms / old[:, 0], 0.10),
            within(all_rms / old[:, 0], 0.25),
            float(np.mean(errors <= limits)),
            float(np.mean((errors <= limits)[kept])),
        ]
        total.append(figures)
        bias = float(np.median(np.log(ratios)))
        counts = f"{of_set[0]['fitted']}/{int(np.median([len(d['poses']) for d in of_set]))}"
        rows.append([name, len(of_set), counts, f"{100.0 * bias:+.0f}", *_percent(figures)])
    rows.append(["mean of sets", len(draws), "", "", *_percent(np.mean(total, axis=0))])
    enough = [k for k, figures in enumerate(total) if figures[4] >= 0.60 and figures[5] >= 0.90]
    if enough:
        chosen = np.mean([total[k] for k in enough], axis=0)
        rows.append(["of which chance allows the bar", len(enough), "", "", *_percent(chosen)])
    print(f"\nModel: {model}\n")
    titles = [
        "set",
        "draws",
        "fitted/fresh rows",
        "bias %",
        "10 %",
        "25 %",
        "known 10 %",
        "known 25 %",
    ]
    titles += ["drawn 10 %", "drawn 25 %", "in 90 % interval", "the same, left out"]
    titles += ["before 10 %", "before 25 %", "U holds", "U holds without outliers"]
    print_table(titles, rows)


def _kept(draw: dict[str, Any], model: str) -> Mask:
    """Return which fresh rows are no outliers."""
    errors = np.array(draw[model]["errors"])
    found = FreshError(**draw[model]["forecast"])
    return np.asarray(errors <= replace(found, rows=float(len(errors))).limit)


def _percent(shares: Any) -> Iterator[str]:  # noqa: ANN401
    """Yield shares in per cent."""
    for share in shares:
        yield f"{100.0 * share:.0f}"


def main() -> None:
    """Run the draws that are missing, and print the tables of all."""
    parser = study_parser(__doc__)
    parser.add_argument("folder", type=Path, help="folder of the sets")
    parser.add_argument("-o", "--output", type=Path, required=True, help="file of the draws")
    parser.add_argument("--draws", type=int, default=10, help="draws of each set (default: 10)")
    parser.add_argument("--seed", type=int, default=FIRST_SEED, help="of the first draw")
    parser.add_argument("--only", default="", help="sets whose names match this expression")
    options = parser.parse_args()
    draws = []
    if options.output.exists():
        draws = [json.loads(line) for line in options.output.read_text("utf-8").splitlines()]
    names = [
        n for n in SETS if re.search(options.only, n) and (options.folder / SETS[n].table).exists()
    ]
    done = {(draw["set"], draw["seed"]) for draw in draws}
    seeds = range(options.seed, options.seed + options.draws)
    missing = [(name, seed) for seed in seeds for name in names if (name, seed) not in done]
    for name, seed in show_progress(missing, "draws"):
        draw = run_draw(options.folder, name, seed)
        with options.output.open("a", encoding="utf-8") as file:
            file.write(json.dumps(draw) + "\n")
        draws.append(draw)
    draws = [draw for draw in draws if draw["set"] in names and draw["seed"] in seeds]
    draws.sort(key=lambda draw: (draw["set"], draw["seed"]))
    for model in MODELS:
        print_figures(draws, model)


if __name__ == "__main__":
    main()
