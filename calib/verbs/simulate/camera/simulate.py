"""Simulate pictures of a printed board, from a scenario to the table of corners."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike

from calib.basics.arguments import check_names, check_whole
from calib.boards.board import Board
from calib.camera.camera import Camera
from calib.data.columns import SETS
from calib.errors import CalibError, ModelError, choices
from calib.verbs.simulate.camera.cell import draw_camera_cell
from calib.verbs.simulate.camera.equipment import usual_board, usual_camera
from calib.verbs.simulate.camera.pictures import PIXEL, Pictures, take_pictures
from calib.verbs.simulate.scenario import Scenario

Described = TypeVar("Described", Camera, Board)


def simulate_pictures(
    scenario: Scenario,
    count: int = 30,
    validation: int = 10,
    seed: int = 0,
    poses: ArrayLike | None = None,
    sets: tuple[str, ...] = (),
) -> Pictures:
    """Simulate pictures that a camera on one link of a robot takes of a board on another.

    Args:
        scenario: Its robot's base is the link that carries the camera, the tip the one that carries the board; its
            cell's kind is ``"pixel"``, and camera and board are the cell's, or usual ones.
        count: Number of pictures to estimate from.
        validation: Number of pictures to validate with.
        seed: The same seed gives the same pictures.
        poses: shape (n, m), poses in place of those from which the camera sees the board [rad] or [m]; None: ``count``
            of these.
        sets: The set of each of them; (): all to estimate from.

    Returns:
        The pictures, with the table of corners and the truth.

    Raises:
        CalibError: A scenario of another kind or with disturbances that pictures do not have, or a board that is not
            seen.
        ModelError: Poses that are none of this robot, or sets that do not fit.
    """
    for name, value in (("count", count), ("validation", validation), ("seed", seed)):
        check_whole(name, value, 0)
    check_names("sets", sets)
    _check(scenario)
    cell = draw_camera_cell(scenario, camera_of(scenario), board_of(scenario), seed)
    q = cell.views(count, seed) if poses is None else scenario.robot.columns(poses, "poses")
    if sets and (poses is None or len(sets) != len(q)):
        raise ModelError(
            f"The argument 'sets' has {len(sets)} names; it must be one for each of 'poses'."
        )
    further = cell.views(validation, seed, validation=True)
    estimate, validate = SETS
    all_sets = (sets or (estimate,) * len(q)) + (validate,) * len(further)
    return take_pictures(cell, np.concatenate([q, further]), seed, all_sets)


def camera_of(scenario: Scenario) -> Camera:
    """Return the camera that a scenario's cell states, or the usual one; `CalibError` for several."""
    return _only(scenario.cell.cameras, "cameras") or usual_camera()


def board_of(scenario: Scenario) -> Board:
    """Return the board that a scenario's cell describes, or a usual one; `CalibError` for several."""
    return _only(scenario.cell.boards, "boards") or usual_board(scenario.robot)


def _only(described: Mapping[str, Described], what: str) -> Described | None:
    """Return the one camera or board that is described; None without one, `CalibError` for several."""
    if len(described) > 1:
        raise CalibError(
            f"The cell has the {what} {choices(described)}; pictures are simulated with one of each."
        )
    return next(iter(described.values()), None)


def _check(scenario: Scenario) -> None:
    """Refuse a scenario of another kind, and disturbances that pictures do not have; raises `CalibError`."""
    if scenario.kind.name != PIXEL:
        raise CalibError(
            f"Pictures are simulated of a cell of the kind '{PIXEL}'; this one is of the kind '{scenario.kind.name}'."
        )
    is_given = {
        "visits": scenario.visits > 1,
        "moved_row": scenario.moved is not None,
        "drift_mm": bool(scenario.drift.any()),
    }
    given = [name for name, is_there in is_given.items() if is_there]
    if given:
        raise CalibError(f"Pictures are simulated without {choices(given)} of [simulation].")
