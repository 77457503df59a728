"""Cameras and printed boards of a result: as the fit began with them, and as it estimated them.

A camera's numbers are those that the fit began with plus their changes. Of a board's print the mean of its errors of
scale along x and y makes the squares, and the markers in them, larger; sag and errors of single corners, which a
description of a board does not have, are parameters of the result only.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from calib.basics.arrays import Array
from calib.basics.values import ReadOnlyMapping, Value
from calib.boards.board import Board
from calib.camera import optics
from calib.camera.camera import UNKNOWN, Camera
from calib.camera.lenses import LENSES
from calib.data.cell import Cell
from calib.fit.estimate.fitting import Fitted
from calib.fit.registration.rows import Rows
from calib.fit.registration.setup import Setup
from calib.model.parameters import BOARD, CAMERA, Parameter
from calib.result.prediction import FittedModel


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ResultOptics(Value):
    """Cameras and printed boards of the images, before and after; all empty without images.

    Cameras by station and boards by target, with the same names as in the cell.
    """

    #: Cameras with the numbers that the fit began with
    nominal_cameras: Mapping[str, Camera] = field(default_factory=ReadOnlyMapping)
    #: Boards as given; those that were not given are missing
    nominal_boards: Mapping[str, Board] = field(default_factory=ReadOnlyMapping)
    #: Cameras with their numbers as estimated, and the standard deviations of these;
    #: `calib.camera.camera_file` writes them for ROS and OpenCV
    cameras: Mapping[str, Camera] = field(default_factory=ReadOnlyMapping)
    #: Boards with their squares as estimated: as given, times 1 plus the mean error of scale
    boards: Mapping[str, Board] = field(default_factory=ReadOnlyMapping)

    def given_to(self, cell: Cell) -> Cell:
        """Return a cell with the cameras and boards that the fit began with, if it gives none of its own."""
        return replace(
            cell,
            cameras=cell.cameras or self.nominal_cameras,
            boards=cell.boards or self.nominal_boards,
        )


def result_optics(fitted: Fitted, rows: Rows, geometry: FittedModel) -> ResultOptics:
    """Return cameras and boards as a fit began with them and as it estimated them.

    Args:
        fitted: The fit of the geometry.
        rows: All rows of the table.
        geometry: The fitted model.
    """
    cameras = ReadOnlyMapping(_nominal_cameras(fitted, rows))
    boards = ReadOnlyMapping(_nominal_boards(fitted, rows))
    return ResultOptics(
        nominal_cameras=cameras,
        nominal_boards=boards,
        cameras=_estimated_cameras(cameras, geometry),
        boards=_estimated_boards(boards, geometry),
    )


def _nominal_cameras(fitted: Fitted, rows: Rows) -> dict[str, Camera]:
    """Return the cameras of images with the numbers that a fit begins with: as given, or as the images tell them.

    They have their names in the cell. Numbers that were not given have a standard deviation of `UNKNOWN`.
    """
    given = fitted.task.cell.cameras
    values = rows.samples.optics
    result: dict[str, Camera] = {}
    for row, group, _ in _places(fitted.setup, rows):
        key = _key(group, given)
        if key is None or key in result or values is None:
            continue
        lens = LENSES[given[key].lens]
        start: Array = values[row, optics.INTRINSICS][: len(lens.names)]
        sigma = given[key].sigma
        if given[key].values is None:
            sigma = np.full(len(start), UNKNOWN)
        elif sigma is None:
            sigma = lens.default_sigma(start, given[key].width)
        result[key] = replace(given[key], values=start, sigma=sigma)
    return result


def _nominal_boards(fitted: Fitted, rows: Rows) -> dict[str, Board]:
    """Return the boards that images show, by their names in the cell; one that the cell does not have is left out."""
    given = fitted.task.cell.boards
    result: dict[str, Board] = {}
    for _, _, target in _places(fitted.setup, rows):
        key = _key(target, given)
        if key is not None:
            result.setdefault(key, given[key])
    return result


def _places(setup: Setup, rows: Rows) -> list[tuple[int, str, str]]:
    """Return of each station and target that images have the first row, and their names."""
    images = np.flatnonzero(rows.where(lambda kind: kind.optical))
    numbers = np.column_stack([rows.samples.frame, rows.samples.target])[images]
    pairs, first = np.unique(numbers, axis=0, return_index=True)
    return [
        (int(images[k]), setup.groups[frame], setup.targets[target])
        for (frame, target), k in zip(pairs.tolist(), first.tolist(), strict=True)
    ]


def _key(name: str, described: Mapping[str, object]) -> str | None:
    """Return what a cell calls the camera of a station, or the board of a target; None where it has none."""
    if name in described:
        return name
    return "" if "" in described else None


def _estimated_cameras(nominal: Mapping[str, Camera], model: FittedModel) -> Mapping[str, Camera]:
    """Return cameras with their numbers, and the standard deviations of these, as a fit estimated them.

    A number that was not estimated stays as it is, with its standard deviation; so does the standard deviation of one
    that a bound stopped.
    """
    stations = dict(zip(model.setup.places[0], model.setup.groups, strict=True))
    values = {key: np.array(camera.values) for key, camera in nominal.items()}
    sigma = {key: np.array(camera.sigma) for key, camera in nominal.items()}
    for k, parameter in _of_family(model, CAMERA):
        key = _key(stations[parameter.place], nominal)
        number = _column(parameter) - optics.INTRINSICS.start
        if key is not None:
            values[key][number] += model.x[k]
            std = model.parameters[k].std
            sigma[key][number] = std if np.isfinite(std) else sigma[key][number]
    cameras = {}
    for key, camera in nominal.items():
        cameras[key] = replace(camera, values=values[key], sigma=sigma[key])
    return ReadOnlyMapping(cameras)


def _estimated_boards(nominal: Mapping[str, Board], model: FittedModel) -> Mapping[str, Board]:
    """Return boards with squares and markers as large as estimated, and how well the scale is known now."""
    targets = dict(zip(model.setup.places[1], model.setup.targets, strict=True))
    scales: dict[str, list[int]] = {key: [] for key in nominal}
    for k, parameter in _of_family(model, BOARD):
        key = _key(targets[parameter.place], nominal)
        is_scale = optics.SCALE.start <= _column(parameter) < optics.SCALE.stop
        if key is not None and is_scale:
            scales[key].append(k)
    boards = {}
    for key, board in nominal.items():
        boards[key] = _scaled(board, scales[key], model)
    return ReadOnlyMapping(boards)


def _scaled(board: Board, numbers: Sequence[int], model: FittedModel) -> Board:
    """Return a board with its scale as estimated by the parameters of these indices, along x and along y, if any."""
    if not numbers:
        return board
    axes = optics.SCALE.stop - optics.SCALE.start
    factor = 1.0 + float(np.sum(model.x[list(numbers)])) / axes
    # The variance of the mean of the scales along both axes.
    std = float(np.sqrt(np.sum(model.covariance[np.ix_(numbers, numbers)]))) / axes
    return replace(
        board,
        square=board.square * factor,
        marker=board.marker * factor,
        sigma_scale=std if np.isfinite(std) else board.sigma_scale,
    )


def _of_family(model: FittedModel, family: str) -> Iterable[tuple[int, Parameter]]:
    """Yield index and parameter of each number of cameras, or of boards, that was estimated."""
    for k, parameter in model.kinematics.model.optical:
        if parameter.family == family:
            yield k, parameter


def _column(parameter: Parameter) -> int:
    """Return the column of optics that a parameter adds to."""
    assert parameter.optic is not None
    return parameter.optic
