"""Jobs in any executor: the same results to the bit, workers that die, executors that end, versions that differ."""

from __future__ import annotations

import os
import pickle
import re
import signal
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pytest
import threadpoolctl

from calib.errors import CalibError
from calib.identify import executors
from calib.identify.dask_executor import DaskExecutor, dask_executor
from calib.identify.executors import (
    Lost,
    WorkerDied,
    batch_size,
    check_versions,
    one_thread,
    run,
    versions,
    worker_count,
)
from calib.identify.processes import process_executor
from calib.identify.uncertainty import bootstrap
from tests.cli.test_study import is_alive, until
from tests.identify.dask_cluster import scheduler

MATRIX = np.random.default_rng(1).normal(size=(300, 300))


def squared(shared, item):
    """The sum of a product, whose last bits hang on the order of the sums."""
    return (shared * item) @ shared.T @ (shared[:, 0] / item)


def deadly(shared, item):
    if item == shared:
        os.kill(os.getpid(), signal.SIGKILL)
    return item


def once_deadly(shared, item):
    if item == 3 and not Path(shared).exists():
        Path(shared).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return item


def wrong(shared, item):
    raise (CalibError if item else ValueError)(f"{shared} {item}")


class Untold(Exception):
    def __init__(self, one, two):
        super().__init__(f"{one}{two}")


def untold(shared, item):
    raise Untold(shared, item)


def nap(_, item):
    time.sleep(item)
    return os.getpid()


def threads(*_):
    return [pool["num_threads"] for pool in threadpoolctl.threadpool_info()]


def collected(found):
    return [result for _, result in sorted(found, key=lambda pair: pair[0])]


@pytest.fixture(scope="module")
def processes():
    with process_executor(2) as executor:
        yield executor


def test_the_same_bits_everywhere(processes):
    items = [1.0 + k / 7 for k in range(9)]
    # A transposed view and one with steps: what a job sees is laid out as in another process.
    for shared in (MATRIX, MATRIX.T, MATRIX[::2, ::3]):
        here = collected(run(squared, shared, items))
        assert len(here) == 9
        with ThreadPoolExecutor(3) as pool, ProcessPoolExecutor(1, get_context("spawn")) as spawned:
            others = [pool, processes] if shared is not MATRIX else [pool, processes, spawned]
            for executor in others:
                for batch in (1, 4):
                    there = collected(run(squared, shared, items, executor, batch=batch))
                    assert [x.tobytes() for x in there] == [x.tobytes() for x in here]


def test_a_job_has_one_thread_and_the_caller_gets_its_own_back(processes):
    before = threads(0, 0)
    with threadpoolctl.threadpool_limits(2):
        assert max(threads(0, 0)) == 2
        for executor in (None, processes):
            ((_, seen),) = run(threads, 0, [0], executor)
            assert set(seen) == {1}
        with one_thread():
            assert set(threads(0, 0)) == {1}
        assert max(threads(0, 0)) == 2
    assert threads(0, 0) == before


def test_items_are_taken_as_they_are_needed(processes):
    taken = []

    def items():
        for k in range(100):
            taken.append(k)
            yield k

    running = run(deadly, -1, items(), processes, batch=2)
    assert next(running)[1] in range(100)
    assert len(taken) <= 14
    running.close()


def test_a_bootstrap_is_the_same_in_processes(default_result, processes):
    here, there = (bootstrap(default_result, 60, 1, executor=e) for e in (None, processes))
    assert here.x.tobytes() == there.x.tobytes()
    assert (here.measured_rms, here.stopped) == (there.measured_rms, there.stopped)
    told = []
    bootstrap(default_result, 40, 1, lambda *count: told.append(count), processes)
    assert told == [(k, 40) for k in range(1, 41)]


class Lossy(ThreadPoolExecutor):
    """Loses whatever it is given."""

    def submit(self, *_):
        return super().submit(lose)


def lose():
    raise WorkerDied("why")


def test_a_sample_that_is_lost_ends_the_bootstrap(default_result):
    with (
        Lossy(1) as lossy,
        pytest.raises(CalibError, match=r"Sample \d of the boot.* no result\. why"),
    ):
        bootstrap(default_result, 40, 0, executor=lossy)


def test_a_job_that_kills_its_worker_is_lost_alone(processes):
    found = collected(run(deadly, 5, range(12), processes, batch=4))
    assert [x for x in found if not isinstance(x, Lost)] == [x for x in range(12) if x != 5]
    assert isinstance(found[5], Lost)
    assert (
        "has ended, and so has the next one: killed by SIGKILL and killed by SIGKILL"
        in found[5].reason
    )
    assert collected(run(deadly, -1, range(4), processes)) == [0, 1, 2, 3]


def test_a_worker_that_is_killed_once_costs_nothing(processes, tmp_path):
    assert collected(run(once_deadly, str(tmp_path / "done"), range(8), processes)) == [*range(8)]
    assert (tmp_path / "done").exists()


def test_errors_come_from_where_they_were_raised(processes):
    for executor in (None, processes):
        with pytest.raises(CalibError, match="here 1"):
            list(run(wrong, "here", [1], executor))
        with pytest.raises(ValueError, match="here 0"):
            list(run(wrong, "here", [0], executor))
    # This one cannot be unpickled.
    with pytest.raises(RuntimeError, match="Untold: ab"):
        list(run(untold, "a", ["b"], processes))


def test_interrupted_it_ends_its_workers_at_once():
    began = time.monotonic()
    workers = []
    with pytest.raises(KeyboardInterrupt):
        interrupted(workers)
    assert time.monotonic() - began < 20.0
    until(lambda: not any(map(is_alive, workers)))


def interrupted(workers):
    with process_executor(2) as executor:
        for _ in run(nap, 0, [0.0, *[60.0] * 5], executor):
            until(lambda: len(executor._processes) == 2)
            workers += [process.pid for process in executor._processes]
            raise KeyboardInterrupt


def test_there_are_no_more_workers_than_jobs():
    with process_executor(8) as executor:
        assert len(executor._threads) == 0
        assert sorted(executor.map(abs, [-1, -2])) == [1, 2]
        assert 1 <= len(executor._processes) <= 2
        for k in range(20):
            assert executor.submit(abs, k).result() == k
        assert len(executor._threads) <= 8


@pytest.mark.skipif(sys.platform != "linux", reason="workers come from a server there")
def test_a_run_that_is_killed_leaves_no_temporary_folder(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(
        "import time\n"
        "from calib.identify.processes import process_executor\n"
        "if __name__ == '__main__':\n"
        "    with process_executor(2) as executor:\n"
        "        executor.submit(abs, -1).result()\n"
        "        print('ready', flush=True)\n"
        "        time.sleep(60.0)\n"
    )
    place = tmp_path / "t"
    place.mkdir()
    run = subprocess.Popen(
        [sys.executable, script], env={**os.environ, "TMPDIR": str(place)}, stdout=subprocess.PIPE
    )
    try:
        assert run.stdout.readline() == b"ready\n"
        assert len([*place.glob("pymp-*")]) == 1
    finally:
        run.kill()
        run.communicate()
    until(lambda: not [*place.iterdir()])


def test_an_executor_that_has_ended_is_told():
    with process_executor(1) as executor:
        pass
    with pytest.raises(CalibError, match=r"takes no jobs any more \(this executor was shut down\)"):
        list(run(deadly, -1, [1], executor))
    with ProcessPoolExecutor(1, get_context("spawn")) as executor:
        for _ in range(2):  # under way, and when the next is sent
            with pytest.raises(CalibError, match=r"process_executor starts a new process instead"):
                list(run(deadly, 1, [1], executor))


def test_no_workers_are_refused():
    with pytest.raises(CalibError, match="0 worker processes were asked for; it takes 1 or more"):
        process_executor(0)


def test_a_script_without_its_guard_is_told_so(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(
        "from calib.identify.executors import run\n"
        "from calib.identify.processes import process_executor\n"
        "from tests.identify.test_executors import deadly\n"
        "with process_executor(1) as executor:\n"
        "    print(list(run(deadly, -1, [1], executor)))\n"
    )
    done = subprocess.run(
        [sys.executable, str(script)],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(p or "." for p in sys.path)},
        capture_output=True, encoding="utf-8", timeout=60, check=False,
    )  # fmt: skip
    assert done.returncode == 1
    assert "No worker process can be started (exit code 1)" in done.stderr
    assert 'if __name__ == "__main__":' in done.stderr


def test_batches_leave_every_worker_some():
    with ThreadPoolExecutor(4) as four:
        assert [batch_size(n, four) for n in (1, 47, 100, 1000, 10**6)] == [1, 1, 2, 20, 50]
        assert (worker_count(four), worker_count(None), worker_count(object())) == (4, 1, 4)


def test_other_versions_are_refused():
    check_versions(versions(), "Here")
    others = [(name, "0.1" if name == "numpy" else version) for name, version in versions()]
    with pytest.raises(
        CalibError, match=r"^There has other versions: numpy 0\.1 there and [\d.]+ here\."
    ):
        check_versions(others, "There")
    with pytest.raises(CalibError, match="calib missing there"):
        check_versions([], "There")
    call = executors._Call(b"", (), tuple(others))
    with pytest.raises(CalibError, match="The process that sends jobs has other versions"):
        executors._do(pickle.loads(pickle.dumps(call)))
    assert executors._version("no-such-package") == "missing"


@pytest.mark.parametrize(
    "address", ["", "localhost", "tcp://localhost", "http://host:8786", "tcp://h:port"]
)
def test_what_is_no_address_of_dask_is_refused(address):
    with (
        pytest.raises(CalibError, match="is no address of a Dask scheduler"),
        dask_executor(address),
    ):
        pass


def test_dask_is_an_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with (
        pytest.raises(CalibError, match=r"pip install 'calib\[dask\]'"),
        dask_executor("tcp://h:1"),
    ):
        pass


def test_no_scheduler_answers_in_bounded_time():
    began = time.monotonic()
    with (
        pytest.raises(CalibError, match=r"No Dask scheduler answers at tcp://127\.0\.0\.1:1 "),
        dask_executor("tcp://127.0.0.1:1", timeout=0.5),
    ):
        pass
    assert time.monotonic() - began < 5.0


def test_dask_does_the_same_to_the_bit_and_outlives_its_workers():
    """One scheduler for all of it: to start one takes seconds."""
    with scheduler() as dask:
        with pytest.raises(CalibError, match=r"has no workers\. Start some: 'dask worker tcp://"):
            connect(dask.address, timeout=2.0)
        for before, said in (
            (
                "import sys; sys.modules['calib'] = None",
                r"cannot be asked for its versions \(.*calib",
            ),
            (
                "import calib; calib.__version__ = '0'",
                r"The Dask worker tcp://.* versions: calib 0 there",
            ),
        ):
            dask.worker(before)
            with pytest.raises(CalibError, match=said):
                connect(dask.address)
            dask.kill_workers()

        first = dask.worker()
        dask.worker()
        connect(dask.address)
        with dask_executor(dask.address, timeout=3.0) as executor:
            until(lambda: executor._count() == 2)
            items = [1.0 + k / 7 for k in range(9)]
            here = collected(run(squared, MATRIX, items))
            there = collected(run(squared, MATRIX, items, executor, batch=2))
            assert [x.tobytes() for x in there] == [x.tobytes() for x in here]

            running = run(nap, 0, [0.05] * 30, executor)
            next(running)
            first.kill()
            assert len(list(running)) == 29
            with pytest.raises(CalibError, match="here 1"):
                list(run(wrong, "here", [1], executor))
            executor.check()

            dask.worker()
            (lost,) = collected(run(deadly, 1, [1], executor))
            assert isinstance(lost, Lost)
            assert lost.reason.startswith(
                "The Dask workers that worked on it have ended, one after the"
            )
            until(lambda: executor._count() == 0)
            executor._patience, executor._asked = -1.0, float("-inf")
            assert executor.workers == 1
            with pytest.raises(CalibError, match=r"has had no workers for -1 s\. Start some"):
                executor.check()
            dask.kill()
            with pytest.raises(
                CalibError, match=r"The executor has dropped jobs|does not answer any"
            ):
                list(run(nap, 0, [0.0], executor))


def connect(address, timeout=60.0):
    with dask_executor(address, timeout):
        pass


class _Gone:
    """A client whose scheduler has ended."""

    def get_executor(self, *, pure: bool) -> None:
        assert not pure

    def nthreads(self) -> None:
        raise OSError("Timed out trying to connect")


def test_a_scheduler_that_is_gone_is_told_by_its_address():
    said = (
        "The Dask scheduler at tcp://there:1 does not answer any more (Timed out trying to connect). Start it again, "
        "and give the same command."
    )
    with pytest.raises(CalibError, match=re.escape(said)):
        DaskExecutor(_Gone(), "tcp://there:1").check()
