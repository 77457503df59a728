"""Calibrate a fleet on a Dask cluster, here of two processes on this computer, and find the odd robot."""

from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import ExitStack
from multiprocessing import get_context

import calib

COUNT = 8


def tables(robot: calib.Robot, cell: calib.Cell) -> dict[str, calib.Measurements]:
    """Measure virtual robots that were set well at the factory; the shoulder of the fifth was hit."""
    small = {"length": 0.1e-3, "angle": 0.5e-3, "zero": 0.5e-3}  # [m], [rad], [rad]
    measured = {}
    for k in range(1, COUNT + 1):
        hit = (("shoulder_lift_joint.rz", 20e-3),) if k == 5 else ()
        scenario = calib.Scenario(robot, cell, sizes=small, errors=hit)
        q = scenario.random_poses(30, seed=k)
        measured[f"SN-{k}"] = scenario.draw(seed=k).measure(q, seed=k).measurements
    return measured


def start_workers(stack: ExitStack) -> Executor:
    """Start two workers: Dask's, or plain processes where it is not installed. The stack ends them."""
    try:
        import dask
        from distributed import Client, LocalCluster
    except ImportError:
        print("Dask is not installed (pip install 'robot-calib[dask]'): two processes do the work.")
        return stack.enter_context(ProcessPoolExecutor(2, mp_context=get_context("spawn")))
    dask.config.set({"temporary-directory": "."})  # default: the system's folder for such files
    cluster = LocalCluster(  # type: ignore[no-untyped-call]
        n_workers=2, threads_per_worker=1, dashboard_address=None
    )
    client = Client(stack.enter_context(cluster))  # type: ignore[no-untyped-call]
    executor: Executor = stack.enter_context(client).get_executor()
    return executor  # of a real cluster: Client("tcp://192.168.0.10:8786").get_executor()


if __name__ == "__main__":  # workers import this file
    robot = calib.Robot.load("ur3", base="base", tip="tool0")
    cell = calib.Cell(estimate_frame=True, model="placement")
    with ExitStack() as stack:
        workers = start_workers(stack)
        data = tables(robot, cell)
        fleet = calib.fleet(robot, data, "results", cell=cell, executor=workers, reports=False)
    for row in fleet.rows:
        before, after = 1e3 * row.nominal_rms["m"], 1e3 * row.held_out_rms["m"]
        print(f"{row.name}: {row.verdict}, {before:.2f} mm rms, calibrated {after:.3f} mm held out")
    for outlier in fleet.outliers:
        print(f"unlike the others: {outlier.name}: {outlier.text}")
    assert all(row.held_out_rms["m"] < 0.1e-3 for row in fleet.rows)
    assert {outlier.name for outlier in fleet.outliers} == {"SN-5"}
