"""What calibrations, results and plans refuse, in full: what was given, where, what is allowed, the fix."""

from __future__ import annotations

import json
import multiprocessing
import re
from concurrent.futures import Executor, Future
from pathlib import Path

import numpy as np
import pytest
from calib.identify.executors import WorkerDied
from calib.identify.processes import ProcessExecutor

from calib.design.forecast import forecast
from calib.errors import CalibError, FileError, ModelError, SolverError
from calib.identify.calibration import calibrate
from calib.identify.comparison import compare
from calib.identify.result_file import read_result
from calib.identify.solvers import levenberg_marquardt, paper_levenberg_marquardt
from calib.identify.uncertainty import bootstrap
from calib.measure.cell import Cell


def refused(kind: type[CalibError], text: str):
    """The whole message, as it is printed."""
    return pytest.raises(kind, match=f"^{re.escape(text)}$")


def test_a_path_where_a_robot_is_wanted(table):
    with refused(
        ModelError,
        "calibrate takes a Robot; 'ur3.urdf' was given. Read it with calib.Robot.load(...) or "
        "calib.Measurements.read(...).",
    ):
        calibrate("ur3.urdf", table)


def test_plans_for_several_set_ups(ur3):
    with refused(
        ModelError,
        "The cell has the set-ups 'A', 'B'; poses are planned for one set-up at a time. Give the one "
        "frame as frame_xyz_mm and frame_rpy_deg.",
    ):
        forecast(ur3, Cell(frames={"A": np.eye(4), "B": np.eye(4)}), np.zeros((10, 6)))


def test_a_target_that_a_result_has_not(default_result):
    with refused(ModelError, "There is no target 'probe'; there is 'target'."):
        default_result.predict(np.zeros((1, 6)), target="probe")


def test_more_samples_than_make_sense(default_result):
    with refused(
        CalibError,
        "A bootstrap of 1000000 samples was asked for; more than 100000 tell nothing new. Take 1000.",
    ):
        bootstrap(default_result, 10**6, seed=0)


def test_a_damped_step_that_is_not_unique():
    J = np.array([[1.0, 0.0], [1.0, 0.0]])
    with refused(
        SolverError,
        "The damped step has no unique solution: a parameter has no effect, and the damping is zero. "
        "Start with a damping above 0.",
    ):
        paper_levenberg_marquardt(lambda x: (J @ x - 1.0, J), np.zeros(2), mu=0.0)


def test_a_minimum_between_two_numbers():
    """The residual falls below 1, and jumps back up: steps are shortened until none is left."""

    def system(x):
        return (np.array([1.0 - 1e-3 * x[0]]) if x[0] <= 0.0 else np.array([2.0])), np.array(
            [[-1e-3]]
        )

    found = levenberg_marquardt(system, np.zeros(1), step_size=np.ones(1))
    assert (found.status, found.x) == ("converged", 0.0)
    assert found.message == "No step, however short, lowers the cost any further."


@pytest.fixture(scope="module")
def written(default_result, tmp_path_factory) -> Path:
    return default_result.write_json(tmp_path_factory.mktemp("result") / "r.json")


def changed(written: Path, folder: Path, change) -> Path:
    table = json.loads(written.read_text())
    change(table)
    path = folder / "r.json"
    path.write_text(json.dumps(table))
    return path


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda t: t["frames"]["targets"].clear(), "no set-ups or no targets"),
        (
            lambda t: t["robot"]["origins"][0].update(xyz_m=[0.0]),
            "three finite numbers expected, [0.0] found",
        ),
        (
            lambda t: t["robot"].update(held=[{"joint": "j", "value": "0"}]),
            "a finite number expected, '0' found",
        ),
        (lambda t: t["robot"].pop("base"), "'base' is missing"),
        (
            lambda t: t.update(robot=[]),
            "a value is of another kind: list indices must be integers or slices, not str",
        ),
        (lambda t: t["robot"].update(tip=6), "a text expected, 6 found"),
        (
            lambda t: t["covariance"][1].__setitem__(1, -2e-6),
            "'covariance[1][1]' is -2e-06, and no variance is below zero",
        ),
        (
            lambda t: t.update(covariance=[[1.0, 0.5], [0.25, 1.0]]),
            "'covariance[0][1]' is 0.5 and 'covariance[1][0]' 0.25, and the two are the same number",
        ),
        (
            lambda t: t.update(covariance=[[1.0, 2.0], [2.0, 1.0]]),
            "'covariance' has an eigenvalue below zero, which no covariance has",
        ),
        (
            lambda t: t["covariance"].pop(),
            "'covariance' has the shape (26, 27), and has as many rows as columns",
        ),
    ],
)
def test_a_damaged_result(written, tmp_path, change, said):
    path = changed(written, tmp_path, change)
    with refused(
        FileError,
        f"{path}: the result is incomplete or damaged ({said}). Write it again with 'calib fit --json'.",
    ):
        read_result(path)


def test_a_covariance_whose_correlation_is_beyond_all_numbers(written, tmp_path):
    tiny = [[1e-300, 1e200], [1e200, 1e-300]]
    path = changed(written, tmp_path, lambda t: t.update(covariance=tiny))
    with pytest.raises(FileError, match=r"'covariance' has a number that is too large"):
        read_result(path)


def test_a_covariance_with_a_number_that_is_none(written, tmp_path):
    path = changed(written, tmp_path, lambda t: t.update(covariance=[[12345]]))
    path.write_text(path.read_text().replace("12345", "1e999"))
    with pytest.raises(FileError, match=r"'covariance' has a number that is too large"):
        read_result(path)


def test_results_with_parameters_that_the_model_has_not(ur3, written, tmp_path):
    def change(table):
        for one in table["parameters"]:
            one["name"] = one["name"].replace("a2", "a9")

    other = changed(written, tmp_path, change)
    with refused(
        ModelError,
        "r.json has values for 'a9', 'alpha9', 'theta9', which the model 'paper' of this robot has "
        "not, or not in this order. Give the URDF that the result was made with.",
    ):
        compare(written, other, ur3)


class Dying(Executor):
    """Workers that end whenever they have something to do."""

    def submit(self, _fn, /, *_args, **_kwargs):
        future = Future()
        future.set_exception(WorkerDied("The process that worked on it has ended."))
        return future


def test_a_bootstrap_of_which_a_sample_is_lost(default_result):
    said = (
        r"^Sample \d+ of the bootstrap has no result\. The process that worked on it has ended\.$"
    )
    with pytest.raises(CalibError, match=said):
        bootstrap(default_result, 40, seed=0, executor=Dying())


class Ending(Executor):
    """Workers that are sent away with what they have been given."""

    def submit(self, _fn, /, *_args, **_kwargs):
        future = Future()
        future.cancel()
        future.set_running_or_notify_cancel()
        return future


def test_a_bootstrap_whose_executor_ends(default_result):
    with refused(
        CalibError,
        "The executor has dropped jobs that it was given: it was shut down, or the scheduler that it belongs to has "
        "ended. Start it again, and give the same command.",
    ):
        bootstrap(default_result, 40, seed=0, executor=Ending())


def test_a_script_that_its_own_workers_import(monkeypatch):
    # As it is while a new worker imports the script that made it.
    monkeypatch.setattr(multiprocessing.current_process(), "_inheriting", True, raising=False)
    with refused(
        CalibError,
        "In a script, what calls calib must stand behind 'if __name__ == \"__main__\":', for each worker imports the "
        "script.",
    ):
        ProcessExecutor(1)
