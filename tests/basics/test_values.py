"""Values, results and registered things after pickling, copying, and in other processes: equal to the last bit."""

from __future__ import annotations

import copy
import multiprocessing
import pickle
import subprocess
import sys
from collections.abc import Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, fields, is_dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import calib
from calib.basics.arrays import read_only
from calib.basics.values import ReadOnlyMapping, Value, one_line, packed
from calib.data import kinds
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.data.surroundings import Box, Tracker
from calib.errors import ModelError
from calib.model.families import FAMILIES, ONE, Factor, Family, JointState, factor_of
from calib.result.calibration import Calibration
from calib.robot.robot import Robot
from calib.verbs.compare.comparison import compare
from calib.verbs.compensate.compensate import compensate
from calib.verbs.compensate.robot_program import Program
from calib.verbs.evaluate.evaluation import evaluate
from calib.verbs.plan.choice import PlanRequest
from calib.verbs.plan.plan import plan
from calib.verbs.simulate.scenario import Scenario, simulate
from calib.verbs.workspace.region import Density

MADE = (
    "robot", "measurements", "cell", "calibration", "non_geometric", "of_rows", "evaluation", "comparison", "program",
    "commands", "plan", "region", "scenario", "simulated",
)  # fmt: skip


def parts(value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Every leaf that a value holds, by its place; an array as its bits, type, shape, and whether it is read-only."""
    if isinstance(value, np.ndarray):
        yield path, (value.tobytes(), value.dtype, value.shape, value.flags.writeable)
        return
    inside = held(value)
    if inside is None:
        yield path, value.hex() if isinstance(value, float) else value
        return
    yield path, (type(value), tuple(inside))
    for name, entry in inside.items():
        yield from parts(entry, f"{path}.{name}")


def held(value: Any) -> Mapping[Any, Any] | None:
    """What a value holds, by name or number; None: it holds nothing."""
    if is_dataclass(value):
        names = [field.name for field in fields(value)]
        kept_to_be_quick = ("_last", "_cache")
        return {name: getattr(value, name) for name in names if name not in kept_to_be_quick}
    if isinstance(value, Mapping):
        return value
    if isinstance(value, partial):
        return {"function": value.func, "args": value.args, "keywords": value.keywords}
    return dict(enumerate(value)) if isinstance(value, (tuple, list)) else None


@pytest.fixture(scope="module")
def made(
    ur3: Robot, table: Measurements, default_result: Calibration, calibrated
) -> dict[str, Any]:
    """One of each value that users hold."""
    box = Box("table", np.array([1.0, 0.1, 0.5]), np.eye(4))
    cell = Cell(
        target=np.array([0.07, -0.07, 0.0225]),
        targets={"a": (0.0, 0.0, 0.1)},
        frames={"station": np.eye(4)},
        boxes=(box,),
        tracker=Tracker(np.array([3.0, 0.0, 0.0])),
    )
    arm = Cell(target=cell.target, model="dh")
    scenario = Scenario(ur3, arm, sizes={"length": 1e-3})
    small = PlanRequest(count=20, validation=2, candidates=100)
    program = Program.of_joints(table.joints[:3])
    _, bent = calibrated("compliance")
    points = np.random.default_rng(0).normal(size=(500, 3))
    return {
        "robot": ur3,
        "measurements": table,
        "cell": cell,
        "calibration": default_result,
        "non_geometric": bent,
        "of_rows": calibrated("mixed")[1],
        "evaluation": evaluate(ur3, table, arm),
        "comparison": compare(default_result, default_result),
        "program": program,
        "commands": compensate(
            bent, Program.of_joints(bent.fit.measurements.joints[:3]), accept=True
        ),
        "plan": plan(ur3, arm, small, collisions=None),
        "region": Density.of(points, 0.5).region(),
        "scenario": scenario,
        "simulated": simulate(scenario, 5, 0),
    }


@pytest.mark.parametrize("name", MADE)
@pytest.mark.parametrize(
    "again", [lambda v: pickle.loads(pickle.dumps(v)), copy.deepcopy], ids=["pickle", "deepcopy"]
)
def test_a_value_comes_back_equal_to_the_last_bit_and_read_only(made, name, again):
    value = made[name]
    here, there = dict(parts(value)), dict(parts(again(value)))
    assert {
        place: (here[place], there.get(place)) for place in here if here[place] != there.get(place)
    } == {}
    assert here.keys() == there.keys()


@pytest.mark.parametrize("name", MADE)
def test_what_a_user_reads_of_a_value_cannot_be_written_to(made, name):
    again = pickle.loads(pickle.dumps(made[name]))
    for field in fields(again):
        array = getattr(again, field.name)
        assert not (isinstance(array, np.ndarray) and array.flags.writeable), field.name


@pytest.mark.parametrize("name", MADE)
def test_a_value_is_shown_in_one_line(made, name):
    text = repr(made[name])
    assert "\n" not in text
    assert len(text) <= 120


def test_a_shallow_copy_of_a_value_is_the_value(made):
    for value in made.values():
        assert copy.copy(value) is value


def test_a_robot_is_pickled_without_models_of_pinocchio(made):
    made["robot"].poses(made["measurements"].joints)
    assert len(pickle.dumps(made["robot"])) < 50_000
    assert b"pinocchio" not in pickle.dumps(made["robot"])


def test_one_robot_in_many_places_is_pickled_once(made):
    result = made["calibration"]
    again = pickle.loads(pickle.dumps(result))
    assert result.nominal is result.geometry.kinematics.robot
    assert again.nominal is again.geometry.kinematics.robot
    assert again.fit.geometry.kinematics.robot is again.nominal


def test_a_result_can_be_evaluated_and_written_after_pickling(made, tmp_path: Path):
    result = made["calibration"]
    again = pickle.loads(pickle.dumps(result))
    assert again.summary() == result.summary()
    here = result.write_json(tmp_path / "here.json").read_bytes()
    assert again.write_json(tmp_path / "there.json").read_bytes() == here
    q = result.fit.measurements.joints
    assert np.array_equal(again.predict_poses(q), result.predict_poses(q))


def _predicted(calibration: Calibration, q: np.ndarray) -> np.ndarray:
    """What a worker predicts."""
    return calibration.predict_poses(q)


@pytest.mark.slow
def test_a_thousand_predictions_in_two_processes_are_those_made_here(made):
    result = made["non_geometric"]
    q = np.random.default_rng(1).uniform(-2.0, 2.0, size=(1000, 6))
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(2, mp_context=context) as executor:
        batches = list(executor.map(partial(_predicted, result), np.split(q, 20)))
    assert np.array_equal(np.concatenate(batches), result.predict_poses(q))


# What is registered


def test_kinds_and_families_are_pickled_by_their_names():
    for name in kinds.names():
        assert pickle.loads(pickle.dumps(kinds.get(name))) is kinds.get(name)
    for family in FAMILIES.values():
        assert pickle.loads(pickle.dumps(family)) is family
        for factor in family.factors:
            assert pickle.loads(pickle.dumps(factor)) == factor
    named = factor_of("gravity[elbow_joint]")
    assert pickle.loads(pickle.dumps(named)) == named
    assert b"elbow_joint" in pickle.dumps(named)


REGISTER = """
import sys
from calib.data import kinds
from calib.data.kinds import Kind, Reading
for name in {order}:
    x = dict(units=("m",), derivative=lambda m, T, t: t[:, :1], measure=lambda T: T[:, :1, 3])
    x["readings"] = (Reading(name),)
    kinds.register(Kind(name=name, words=name, **x))
"""


@pytest.mark.slow
def test_a_kind_is_the_right_one_in_a_process_that_registered_in_another_order(tmp_path: Path):
    file = tmp_path / "kind.pickle"
    write = f"import pickle\npickle.dump(kinds.get('b'), open({str(file)!r}, 'wb'))"
    read = f"import pickle\nprint(pickle.load(open({str(file)!r}, 'rb')).name)"
    root = Path(calib.__file__).parents[1]
    command = partial(subprocess.run, capture_output=True, text=True, check=True, cwd=root)
    command([sys.executable, "-c", REGISTER.format(order=["a", "b"]) + write])
    there = command([sys.executable, "-c", REGISTER.format(order=["b", "a"]) + read])
    assert there.stdout.strip() == "b"


def _twice(state: JointState) -> np.ndarray:
    return 2.0 * state.q


def test_what_is_not_registered_is_pickled_by_its_values():
    factor = Factor("twice", _twice, None)
    family = Family("own", ONE, 1e-3, 1e-3, (factor,))
    assert pickle.loads(pickle.dumps(family)) == family


def test_a_factor_that_the_reading_process_lacks_is_named():
    with pytest.raises(ModelError, match="'twice'"):
        factor_of("twice")


# The helper


@dataclass(frozen=True, slots=True, eq=False)
class Plain:
    """A frozen dataclass that is no value of its own."""

    array: np.ndarray


@dataclass(frozen=True, slots=True, eq=False)
class Held(Value):
    """A value with arrays in all places."""

    array: np.ndarray
    scratch: np.ndarray
    inner: tuple[Plain, ...]
    mapping: Mapping[str, np.ndarray]
    table: dict[str, np.ndarray]


def test_read_only_arrays_stay_so_wherever_they_are_and_others_do_not():
    one = read_only(np.arange(3.0))
    held = Held(one, np.zeros(2), (Plain(one),), ReadOnlyMapping({"a": one}), {"a": one})
    for again in (pickle.loads(pickle.dumps(held)), copy.deepcopy(held)):
        assert dict(parts(again)) == dict(parts(held))
        assert again.scratch.flags.writeable
        assert again.inner[0].array is again.array  # one array stays one
        with pytest.raises(ValueError, match="read-only"):
            again.mapping["a"][0] = 1.0


def test_what_has_no_read_only_array_is_pickled_as_it_is():
    for value in (1.0, "a", (1, 2), {"a": (1,)}, [read_only([1.0])], Plain(np.zeros(1))):
        assert packed(value) is value


def test_a_mapping_has_the_entries_in_their_order():
    mapping = ReadOnlyMapping({"b": 1, "a": 2})
    assert mapping["a"] == 2
    assert list(mapping) == ["b", "a"]
    assert len(mapping) == 2
    assert mapping == {"a": 2, "b": 1}
    assert ReadOnlyMapping() == {}


def test_a_mapping_cannot_be_changed_not_even_through_what_it_was_made_of():
    entries = {"a": 1}
    mapping = ReadOnlyMapping(entries)
    entries["a"] = 2
    assert mapping["a"] == 1
    with pytest.raises(TypeError):
        mapping["a"] = 2  # type: ignore[index]


def test_a_mapping_pickled_and_deep_copied_is_equal_and_of_its_own():
    mapping = ReadOnlyMapping({"a": [1.0]})
    for again in (pickle.loads(pickle.dumps(mapping)), copy.deepcopy(mapping)):
        assert type(again) is ReadOnlyMapping
        assert again == mapping
        assert again["a"] is not mapping["a"]


def test_parts_that_are_empty_are_left_out():
    assert one_line("Fleet", "3 robots", "", "0 failed") == "Fleet(3 robots, 0 failed)"
    assert one_line("Cell") == "Cell()"


def test_a_line_is_one_and_not_too_long():
    line = one_line("Robot", "a\nb" * 99)
    assert len(line) == 120
    assert "\n" not in line
    assert line.endswith("...)")
