"""Cameras and printed boards of a result: as the fit began with them, and as it estimated them.

A camera's numbers are those that the fit began with plus their changes. Of a board's print the mean of its errors of
scale along its axes makes the squares, and the markers in them, or the tags of a body, larger; sag and errors of single
corners, which a description of a board does not have, are parameters of the result only.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from calib.basics.arrays import Array
from calib.basics.values import ReadOnlyMapping, Value
from calib.boards.board import Board
from calib.boards.bodies import tag_of_corners
from calib.camera import optics
from calib.camera.camera import UNKNOWN, Camera
from calib.camera.lenses import LENSES
from calib.fit.estimate.fitting import Fitted
from calib.fit.registration.rows import Rows
from calib.model.error_model import BOARD, CAMERA, Parameter
from calib.result.fitted_model import FittedModel


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


def result_optics(fitted: Fitted, rows: Rows, geometry: FittedModel) -> ResultOptics:
    """Return cameras and boards as a fit began with them and as it estimated them.

    Args:
        fitted: The fit of the geometry.
        rows: All rows of the table; those that are not corners in images do not count.
        geometry: The fitted model of the same fit.

    Returns:
        Of the cameras and boards that the images show and the cell describes, those that the fit began with and those
        that it estimated, by the names of the cell; all empty without images.
    """
    given, setup, values = fitted.task.cell, fitted.setup, rows.samples.internals
    cameras: dict[str, Camera] = {}
    boards: dict[str, Board] = {}
    images = np.flatnonzero(rows.is_image)
    numbers = np.column_stack([rows.samples.frame, rows.samples.target])[images]
    places, first = np.unique(numbers, axis=0, return_index=True)
    for (frame, target), row in zip(places.tolist(), images[first].tolist(), strict=True):
        station = _key(setup.groups[frame], given.cameras)
        if station is not None and station not in cameras and values is not None:
            # With the numbers that the fit begins with: as given, or as the images determine them.
            camera = given.cameras[station]
            lens = LENSES[camera.lens]
            start: Array = values[row, optics.intrinsic_columns(lens)]
            sigma = camera.sigma
            if camera.values is None:
                sigma = np.full(len(start), UNKNOWN)
            elif sigma is None:
                sigma = lens.default_sigma(start, camera.width)
            cameras[station] = replace(camera, values=start, sigma=sigma, start=None)
        name = _key(setup.targets[target], given.boards)
        if name is not None:
            boards.setdefault(name, given.boards[name])
    return ResultOptics(
        nominal_cameras=ReadOnlyMapping(cameras),
        nominal_boards=ReadOnlyMapping(boards),
        cameras=_estimated_cameras(cameras, geometry),
        boards=_estimated_boards(boards, geometry),
    )


def _key(name: str, described: Mapping[str, object]) -> str | None:
    """Return the key of a station's camera, or of a target's board, among those that a cell describes.

    It is the name itself or ``""``, that of all others; None if neither is described.
    """
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
    for k, parameter, column in _estimated_numbers(model, CAMERA):
        key = _key(stations[parameter.place], nominal)
        if key is not None:
            columns = optics.intrinsic_columns(LENSES[nominal[key].lens])
            number = int(np.flatnonzero(columns == column)[0])
            values[key][number] += model.x[k]
            std = model.parameters[k].std
            sigma[key][number] = std if np.isfinite(std) else sigma[key][number]
    cameras = {}
    for key, camera in nominal.items():
        cameras[key] = replace(camera, values=values[key], sigma=sigma[key])
    return ReadOnlyMapping(cameras)


def _estimated_boards(nominal: Mapping[str, Board], model: FittedModel) -> Mapping[str, Board]:
    """Return boards with squares, markers and tags [m] as large as estimated, and the std of their scale.

    A board whose scale was not estimated stays as it is.
    """
    targets = dict(zip(model.setup.places[1], model.setup.targets, strict=True))
    scales: dict[str, list[int]] = {key: [] for key in nominal}
    for k, parameter, column in _estimated_numbers(model, BOARD):
        key = _key(targets[parameter.place], nominal)
        if key is not None and column in optics.SCALE:
            scales[key].append(k)

    boards = {}
    for key, board in nominal.items():
        numbers = scales[key]
        boards[key] = board
        if numbers:
            axes = len(numbers)
            factor = 1.0 + float(np.sum(model.x[numbers])) / axes
            # The variance of the mean of the scales along the axes.
            std = float(np.sqrt(np.sum(model.covariance[np.ix_(numbers, numbers)]))) / axes
            boards[key] = replace(
                board,
                square=board.square * factor,
                marker=board.marker * factor,
                tags=tuple(
                    tag_of_corners(number, factor * np.array(corners))
                    for number, corners in board.tags
                ),
                sigma_scale=std if np.isfinite(std) else board.sigma_scale,
            )
    return ReadOnlyMapping(boards)


def _estimated_numbers(model: FittedModel, family: str) -> Iterator[tuple[int, Parameter, int]]:
    """Yield each estimated number of cameras, or of boards, by the family: index in x, parameter, column of the optics.

    Columns are those of `calib.camera.optics`.
    """
    for k, parameter in model.kinematics.model.internals:
        if parameter.family == family:
            assert parameter.internal is not None
            yield k, parameter, parameter.internal
