"""Internals of the instruments of a table: as they are before the fit, and what is estimated of them.

Cameras have internals (`calib.camera.optics`): those of the lens, and of the print of the board that they look at.
Trackers and other gauges have none. For another instrument that has some, `initial_internals` gives its rows theirs.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from calib.basics.arrays import Array, Integers, Mask, numbered, read_only
from calib.boards.board import BODY, Board
from calib.camera import optics
from calib.camera.camera import Camera
from calib.camera.initial_intrinsics import initial_intrinsics
from calib.camera.lenses import LENSES
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.errors import MeasurementError
from calib.model.error_model import BOARD, CAMERA, Parameter
from calib.model.internals import InternalUnknown

#: Standard deviation of what is not known of a lens: of a focal length or the centre [px], and of a distortion.
_WIDE = {"px": 1e4, "1": 10.0}

#: The fewest images that must see a corner for its own error on the print to be estimated.
_FEWEST_IMAGES = 2

#: Places of corners that differ by less, as a share of a square, are the same.
_ALIKE = 1e-3

#: Squares of all distances below this are of a single corner [m^2].
_NO_EXTENT = 1e-12

#: Corners so far outside of the image are of another size of images, as a share of the width.
_BESIDE = 0.01

#: A board of which nothing is given: how well it is known, by its defaults.
_UNKNOWN_BOARD = Board(pattern="chessboard", columns=3, rows=3, square=0.03)


@dataclass(frozen=True, slots=True)
class _Owner:
    """The camera or the board that unknowns are of."""

    #: What a cell calls it; "" for one without a name
    key: str
    #: Its name in those of parameters; "" for the only one
    name: str
    #: Its number, from 0
    number: int
    #: Place of its first station or target in the error model
    place: str
    #: Numbers of its stations or targets
    members: tuple[int, ...]


def initial_internals(
    measurements: Measurements,
    cell: Cell,
    stations: Mapping[str, str],
    targets: Mapping[str, str],
    pose: Integers,
) -> tuple[Array | None, tuple[InternalUnknown, ...]]:
    """Return the internals by which readings are predicted before the fit, and those that the fit estimates.

    Args:
        measurements: Table of N rows.
        cell: Cameras and boards as given.
        stations: The table's stations by name, each with the place of its frame in the error model.
        targets: The table's targets by name, each with its place in the error model.
        pose: shape (N,), number of the robot's pose at each row.

    Returns:
        shape (N, c), zero in rows of instruments without internals; None if no instrument has any. And the
        unknowns, camera by camera, then board by board.

    Raises:
        MeasurementError: Nothing says how large the images of a camera are, or corners or intrinsics are of images of
            another size.
    """
    is_image = measurements.is_image
    if not np.any(is_image):
        return None, ()
    assert measurements.board_points is not None
    points = measurements.board_points
    pixels = np.column_stack([measurements.reading("u"), measurements.reading("v")])
    frame = numbered(measurements.groups, tuple(stations))
    target = numbered(measurements.targets, tuple(targets))
    corner_names, corner = number_corners(measurements)
    # A view is what one station sees of a target at one pose.
    _, view = np.unique(np.column_stack([pose, frame, target]), axis=0, return_inverse=True)
    view = view.reshape(-1)

    values = np.zeros((len(measurements), optics.COUNT))
    unknowns: list[InternalUnknown] = []
    for owner in _owners(stations, frame[is_image], cell.cameras):
        rows = is_image & np.isin(frame, owner.members)
        camera = cell.cameras.get(owner.key)
        if camera is None:
            of_group = f" of '{owner.key}'" if owner.key else ""
            raise MeasurementError(
                f"{measurements.source or 'Measurements'}: nothing is known of the camera{of_group}. Give its "
                "intrinsics (--camera camera_info.yaml), or the size of its images alone (--camera 1280x720): then the "
                "images tell the rest."
            )
        _check_size(camera, pixels, rows, measurements)
        values[rows], of_lens = _camera_numbers(
            camera, owner, points[rows], pixels[rows], view[rows]
        )
        unknowns += of_lens

    for owner in _owners(targets, target[is_image], cell.boards):
        rows = is_image & np.isin(target, owner.members)
        on_board = points[rows]
        board = cell.boards.get(owner.key)
        if board is None:
            # The extent of a board of which nothing is given is that of the corners seen.
            least = on_board.min(axis=0)
            most = on_board.max(axis=0)
            centre = (least + most) / 2.0
            width, height = np.maximum(most - least, 1e-6)[:2].tolist()
        else:
            names = [corner_names[k] for k in corner[rows].tolist()]
            _check_squares(board, names, on_board, measurements)
            centre = board.centre
            width, height = board.size
        values[rows, optics.POINT] = on_board
        values[rows, optics.ACROSS] = optics.across(on_board, centre, (width, height))
        values[rows, optics.CORNER] = corner[rows]
        values[rows, optics.BOARD] = owner.number
        is_flat = not np.any(on_board[:, 2]) if board is None else board.pattern != BODY
        unknowns += _board_unknowns(
            board or _UNKNOWN_BOARD, owner, corner_names, corner[rows], is_flat=is_flat
        )
    return read_only(values), tuple(unknowns)


def with_starts(cell: Cell, measurements: Measurements, internals: Array | None) -> Cell:
    """Return the cell with cameras of unknown intrinsics that say where a fit of them begins.

    Args:
        cell: The cell as given.
        measurements: Table of N rows.
        internals: shape (N, c), the internals of these rows before the fit; None if no instrument has any.
    """
    if internals is None:
        return cell
    groups = np.array(measurements.groups)
    cameras = dict(cell.cameras)
    for name, camera in cell.cameras.items():
        of_camera = groups == name if name else ~np.isin(groups, list(cell.cameras))
        rows = np.flatnonzero(measurements.is_image & of_camera)
        if camera.values is None and len(rows):
            columns = optics.intrinsic_columns(LENSES[camera.lens])
            cameras[name] = replace(camera, start=read_only(internals[rows[0], columns]))
    return replace(cell, cameras=cameras)


def _owners(
    place_by_name: Mapping[str, str],
    numbers: Integers,
    described: Mapping[str, object],
) -> list[_Owner]:
    """Group the stations that occur, by the numbers of n rows, (n,), by their camera, or targets by their board.

    ``place_by_name`` has all stations or targets with their places in the error model, in the order of their numbers,
    and ``described`` the cameras or boards of the cell.
    One that is described without a name is that of all that have none of their own: a camera that was moved to several
    stations, or a board that was moved to several places.
    """
    names = list(place_by_name)
    places = list(place_by_name.values())
    members: dict[str, list[int]] = {}
    for number in np.unique(numbers).tolist():
        name = names[number]
        if name not in described and "" in described:
            name = ""
        members.setdefault(name, []).append(number)
    result = []
    for number, (key, of_key) in enumerate(members.items()):
        name = key if len(members) > 1 else ""
        result.append(_Owner(key, name, number, places[of_key[0]], tuple(of_key)))
    return result


def number_corners(measurements: Measurements) -> tuple[tuple[str, ...], Integers]:
    """Return the names of all corners, and the number of each row's corner among them, shape (N,).

    A corner without a name in the table is named by its place on the board, in millimetres.
    """
    names = list(measurements.corners)
    if measurements.board_points is not None:
        for i, point in enumerate(1e3 * measurements.board_points):
            if not names[i] and np.isfinite(point[0]):
                # Those of a flat board have no third coordinate.
                place = point if point[2] else point[:2]
                names[i] = "/".join(f"{coordinate:.3g}" for coordinate in place)
    if all(name.isdecimal() for name in names):
        # Corners of all tables of a board have the same numbers, in whatever order they are.
        last = max(map(int, names), default=-1)
        return tuple(str(k) for k in range(last + 1)), np.array([int(name) for name in names])
    present = tuple(sorted(set(names)))
    return present, numbered(names, present)


def _check_size(camera: Camera, pixels: Array, rows: Mask, measurements: Measurements) -> None:
    """Refuse corners, (N, 2) [px], outside of the images of a camera's rows, (N,), and intrinsics for other images."""
    source = measurements.source or "Measurements"
    size = np.array([camera.width, camera.height])
    beyond = np.maximum(-pixels, pixels - size)
    outside = rows & np.any(beyond > _BESIDE * camera.width, axis=1)
    if np.any(outside):
        first = int(np.argmax(outside))
        u, v = pixels[first]
        raise MeasurementError(
            f"{source}, row {measurements.rows[first]}: the corner at u = {u:.1f}, v = {v:.1f} px is outside of images "
            f"of {camera.width} x {camera.height}, the size given of the camera. Give the size of the images in which "
            "the corners were found, and intrinsics of that resolution."
        )
    likely = camera.likely_size
    if likely is not None:
        assert camera.values is not None
        u, v = camera.values[2:4]
        raise MeasurementError(
            f"{source}: the lens's centre cx = {u:.1f}, cy = {v:.1f} px is that of images of about {likely[0]} x "
            f"{likely[1]}, and not of {camera.width} x {camera.height}. Give the intrinsics of this resolution, or the "
            f"size alone (--camera {camera.width}x{camera.height}): then the images tell the rest."
        )


def _check_squares(
    board: Board, names: list[str], points: Array, measurements: Measurements
) -> None:
    """Refuse a table whose n named corners of a board, (n, 3) [m], lie further apart, or nearer, by one factor."""
    corners = board.corners
    if not all(name.isdecimal() and int(name) < len(corners) for name in names):
        return  # the names are not those of calib: they may be of other places
    designed = corners[[int(name) for name in names]]
    far_designed = np.linalg.norm(designed - designed.mean(axis=0), axis=1)
    far = np.linalg.norm(points - points.mean(axis=0), axis=1)
    extent = float(far_designed @ far_designed)
    if extent < _NO_EXTENT:
        return  # always the same corner
    factor = float(far @ far_designed) / extent
    square, what = board.square, "squares"
    if board.pattern == BODY:
        square, what = float(np.linalg.norm(board.corners[1] - board.corners[0])), "tags"
    are_alike = np.allclose(far, factor * far_designed, rtol=0.0, atol=_ALIKE * square)
    if are_alike and abs(factor - 1.0) > _ALIKE:
        raise MeasurementError(
            f"{measurements.source or 'Measurements'}: its corners are those of {what} of "
            f"{1e3 * factor * square:.4g} mm, and the board is described with {1e3 * square:.4g} mm. After "
            "a change of the description run calib detect again, or give the board as it was described before."
        )


def _camera_numbers(
    camera: Camera, owner: _Owner, points: Array, pixels: Array, view: Integers
) -> tuple[Array, list[InternalUnknown]]:
    """Return the numbers of a camera's n rows before the fit, (n, `optics.COUNT`), and the unknowns of its lens.

    The rows show corners of boards as designed, (n, 3) [m], at pixels, (n, 2) [px], in numbered views, (n,).
    """
    lens = LENSES[camera.lens]
    widest = np.array([_WIDE[unit] for unit in lens.units])
    start = camera.start if camera.values is None else camera.values
    if start is None:
        views = []
        for number in np.unique(view).tolist():
            of_view = view == number
            views.append((points[of_view], pixels[of_view]))
        start = initial_intrinsics(camera, views)
    if camera.values is None:
        sigma = widest
    elif camera.sigma is None:
        sigma = lens.default_sigma(start, camera.width)
    else:
        sigma = np.minimum(camera.sigma, widest)
    values = np.zeros((len(points), optics.COUNT))
    columns = optics.intrinsic_columns(lens)
    values[:, columns] = start
    values[:, optics.CAMERA] = owner.number
    values[:, optics.LENS] = list(LENSES).index(camera.lens)
    unknowns = []
    for k in np.flatnonzero(sigma > 0.0).tolist():
        parameter = _parameter(lens.names[k], lens.units[k], owner, CAMERA, int(columns[k]))
        parameter = replace(parameter, nominal=float(start[k]))
        unknowns.append(InternalUnknown(parameter, 0.0, float(sigma[k])))
    return values, unknowns


def _board_unknowns(
    board: Board,
    owner: _Owner,
    corner_names: tuple[str, ...],
    corner: Integers,
    *,
    is_flat: bool,
) -> list[InternalUnknown]:
    """Return the unknowns of a board: the scale and the flatness of the print, and its corners' places.

    The board's n rows show corners by their numbers, (n,), among all names. The corners of a flat board are off in its
    plane, and it sags; those of a body are off along all axes.
    """
    result = []
    axes = "xy" if is_flat else "xyz"
    for k, axis in enumerate(axes):
        if board.sigma_scale > 0.0:
            scale = _parameter(f"board_scale_{axis}", "1", owner, BOARD, optics.SCALE[k])
            result.append(InternalUnknown(scale, 0.0, board.sigma_scale))
        if is_flat and board.sigma_warp > 0.0:
            sag = _parameter(f"board_sag_{axis}", "m", owner, BOARD, optics.WARP.start + k)
            result.append(InternalUnknown(sag, 0.0, board.sigma_warp))
    if board.sigma_corner > 0.0:
        count = np.bincount(corner, minlength=len(corner_names))
        for number in np.flatnonzero(count >= _FEWEST_IMAGES).tolist():
            for k, axis in enumerate(axes):
                name = f"corner_{corner_names[number]}_{axis}"
                offset = _parameter(name, "m", owner, BOARD, optics.OFFSET[k], number)
                result.append(InternalUnknown(offset, 0.0, board.sigma_corner))
    return result


def _parameter(
    name: str, unit: str, owner: _Owner, family: str, column: int, corner: int | None = None
) -> Parameter:
    """Return the parameter of a number of a camera or board: ``"fx[left]"``.

    It adds to a column of `calib.camera.optics`, at one corner, by its number, or at all (None).
    """
    samples = [(optics.CAMERA if family == CAMERA else optics.BOARD, owner.number)]
    if corner is not None:
        samples.append((optics.CORNER, corner))
    return Parameter(
        name=f"{name}[{owner.name}]" if owner.name else name,
        unit=unit,
        place=owner.place,
        direction=read_only(np.zeros(6)),
        family=family,
        internal=column,
        samples=tuple(samples),
    )
