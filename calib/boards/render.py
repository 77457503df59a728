"""Pictures of a printed board as a camera takes them.

Each sample of the picture, several a pixel along x and along y, is followed backwards: through the lens to a ray, along
it to the board's surface, and there to the pattern. The place on the pattern is computed for every second pixel and is
linear between: it is smooth. The mean of a pixel's samples, lit unevenly, out of focus and with noise, is its value.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from calib.basics.arrays import Array, rigid_inverse
from calib.basics.files import write_atomically
from calib.basics.values import Value
from calib.boards.drawing import Texture, texture
from calib.boards.opencv import opencv
from calib.boards.printed import Print
from calib.boards.project import NEAREST, Camera, camera_matrix, in_camera, in_image, project, rays
from calib.errors import CalibError

Image = NDArray[np.uint8]

#: Samples of a pixel along x, and as many along y.
_SAMPLES = 3

#: Every so many pixels the place on the pattern is computed.
_STEP = 2

#: Points of the sheet's outline on each of its sides.
_OUTLINE = 25

#: Pixels around the sheet's outline that are drawn with it [px].
_AROUND = 4.0

#: Most pixels of the pattern's picture along its longer side.
_LARGEST_TEXTURE = 6000

#: Place on the pattern of a ray that misses it, far outside of any picture [px].
_NOWHERE = -1e6

#: Rounds of the search for the ray's end on a sagging board: each gains two digits or more.
_ROUNDS = 5

#: Cells of the background's texture along the picture's width.
_CLOUDS = 24


@dataclass(frozen=True, slots=True, kw_only=True)
class Scene(Value):
    """Paper, ink, light and background of a picture. Grey values are from 0, black, to 255."""

    #: Grey value of the paper.
    white: float = 215.0
    #: Grey value of the ink.
    black: float = 25.0
    #: Mean grey value of the background.
    background: float = 110.0
    #: Standard deviation of its grey value from place to place.
    clouds: float = 12.0
    #: Light lost from the brightest end of the picture to the darkest, as a share.
    shade: float = 0.25
    #: Width of the white margin around the pattern, in squares.
    margin: float = 0.5


#: The usual scene.
USUAL_SCENE = Scene()


class _Region(NamedTuple):
    """A part of the picture [px]: the first column and row, and how many of each."""

    left: int
    top: int
    width: int
    height: int

    @property
    def slices(self) -> tuple[slice, slice]:
        """Rows and columns of the picture."""
        rows = slice(self.top, self.top + self.height)
        columns = slice(self.left, self.left + self.width)
        return rows, columns


@dataclass(frozen=True, slots=True, eq=False)
class _Sheet:
    """A printed board before a camera."""

    printed: Print
    camera: Camera
    #: Pose of the board in the camera, shape (4, 4) [m].
    T_camera_board: Array
    #: Width of the white margin around the pattern [m].
    margin: float


def render(
    printed: Print,
    camera: Camera,
    T_camera_board: Array,
    *,
    scene: Scene = USUAL_SCENE,
    blur: float = 0.0,
    noise: float = 1.5,
    seed: int | np.random.Generator = 0,
) -> Image:
    """Draw what a camera sees of a printed board.

    Args:
        printed: The board.
        camera: The camera, whose numbers are known.
        T_camera_board: Pose of the board in the camera, shape (4, 4) [m].
        scene: Paper, ink, light and background.
        blur: Standard deviation of the blur [px].
        noise: Standard deviation of each pixel's grey value.
        seed: Of background, light and noise, or where their random numbers come from.

    Returns:
        Grey values, shape (height, width), uint8. The centre of the pixel [0, 0] is at (0, 0).

    Raises:
        CalibError: The camera's numbers are not known, OpenCV is not there or does not have the board's dictionary.
    """
    rng = np.random.default_rng(seed)
    sheet = _Sheet(printed, camera, T_camera_board, scene.margin * printed.board.square)
    background = _background(camera, scene, rng)
    light = _light(camera, scene, rng)
    picture = _with_sheet(background, sheet, scene) * light
    if blur > 0.0:
        picture = opencv().GaussianBlur(picture, (0, 0), blur)
    grains = rng.standard_normal(picture.shape, dtype=np.float32)
    levels: Array = np.rint(picture + noise * grains)
    return np.asarray(np.clip(levels, 0, 255), dtype=np.uint8)


def write_png(image: Image, path: str | os.PathLike[str], *, overwrite: bool = False) -> Path:
    """Write a picture as PNG, whole or not at all.

    Args:
        image: Grey values, shape (h, w), uint8.
        path: The file.
        overwrite: False to refuse a file that exists.

    Returns:
        The path.

    Raises:
        FileError: It exists and is not to be overwritten, or cannot be written.
        CalibError: OpenCV is not there, or makes no PNG of it.
    """
    is_done, data = opencv().imencode(".png", image)
    if not is_done:
        raise CalibError(f"OpenCV makes no PNG of the picture for '{os.fspath(path)}'.")
    return write_atomically(path, data.tobytes(), overwrite=overwrite)


def _background(camera: Camera, scene: Scene, rng: np.random.Generator) -> NDArray[np.float32]:
    """Draw the background: grey, uneven in patches, shape (height, width)."""
    rows = max(2, round(_CLOUDS * camera.height / camera.width))
    coarse = rng.standard_normal((rows, _CLOUDS)).astype(np.float32)
    size = (camera.width, camera.height)
    cv2 = opencv()
    clouds = cv2.resize(coarse, size, interpolation=cv2.INTER_CUBIC)
    return np.asarray(scene.background + scene.clouds * clouds, dtype=np.float32)


def _light(camera: Camera, scene: Scene, rng: np.random.Generator) -> NDArray[np.float32]:
    """Draw the light: 1 at one end of the picture, less towards the other, shape (height, width)."""
    direction = rng.uniform(0.0, 2.0 * np.pi)
    x = np.linspace(-1.0, 1.0, camera.width) * np.cos(direction)
    y = np.linspace(-1.0, 1.0, camera.height) * np.sin(direction)
    way = x + y[:, None]
    return np.asarray(1.0 - scene.shade * (way - way.min()) / np.ptp(way), dtype=np.float32)


def _with_sheet(picture: NDArray[np.float32], sheet: _Sheet, scene: Scene) -> NDArray[np.float32]:
    """Return a picture (height, width) with the sheet before it."""
    region = _region_of(sheet)
    if region is None:
        return picture
    white, share = _pattern(sheet, region)
    ink = scene.black * share + (scene.white - scene.black) * white
    drawn: NDArray[np.float32] = picture.copy()
    drawn[region.slices] = ink + (1.0 - share) * picture[region.slices]
    return drawn


def _region_of(sheet: _Sheet) -> _Region | None:
    """Return the part of the picture that shows the sheet; None: it is not seen.

    Where a part of the outline is not in the picture, that is all of it: lenses do strange things outside.
    """
    camera = sheet.camera
    outline = in_camera(sheet.T_camera_board[None], _outline(sheet))[0]
    if (outline[:, 2] <= NEAREST).all():
        return None
    pixels = project(camera, outline)
    if not in_image(camera, pixels, 0.0).all():
        return _Region(0, 0, camera.width, camera.height)
    low = np.floor(np.maximum(pixels.min(axis=0) - _AROUND, 0.0)).astype(int)
    high = np.ceil(pixels.max(axis=0) + _AROUND).astype(int) + 1
    high = np.minimum(high, [camera.width, camera.height])
    left, top = low.tolist()
    width, height = (high - low).tolist()
    return _Region(left, top, width, height)


def _outline(sheet: _Sheet) -> Array:
    """Return points along the edges of the sheet, in the board's frame, shape (n, 3) [m]."""
    width, height = sheet.printed.board.size
    margin = sheet.margin
    x = np.linspace(-margin, width + margin, _OUTLINE)
    y = np.linspace(-margin, height + margin, _OUTLINE)
    along_x = np.concatenate([x, x, np.full_like(y, x[0]), np.full_like(y, x[-1])])
    along_y = np.concatenate([np.full_like(x, y[0]), np.full_like(x, y[-1]), y, y])
    return sheet.printed.points(along_x, along_y)


def _pattern(sheet: _Sheet, region: _Region) -> tuple[Array, Array]:
    """Draw the sheet in a part of the picture.

    Args:
        sheet: The sheet and the camera.
        region: The part.

    Returns:
        The share of white in each pixel, and that of the sheet, shape (height, width) of the part.
    """
    cv2 = opencv()
    drawn = texture(sheet.printed.board, _texture_pixel(sheet), sheet.margin)
    places = _places(sheet, region, drawn)
    ink = drawn.white[:, ::-1] if sheet.printed.mirrored else drawn.white
    levels = np.rint(255.0 * ink).astype(np.uint8)
    # The second layer is the sheet itself, so that its edges are as smooth as the pattern's.
    layers = np.dstack([levels, np.full_like(levels, 255)])
    samples = cv2.remap(layers, places, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
    size = (region.width, region.height)
    means = cv2.resize(samples, size, interpolation=cv2.INTER_AREA)
    white, share = np.moveaxis(means.astype(np.float32) / 255.0, -1, 0)
    return white, share


def _texture_pixel(sheet: _Sheet) -> float:
    """Return the side of the texture's pixels: what a sample covers where the board is nearest [m]."""
    K, _ = camera_matrix(sheet.camera)
    focal_length = float(max(K[0, 0], K[1, 1]))
    outline = in_camera(sheet.T_camera_board[None], _outline(sheet))[0]
    nearest = max(float(np.linalg.norm(outline, axis=1).min()), NEAREST)
    longest = max(sheet.printed.board.size) + 2.0 * sheet.margin
    return max(nearest / (focal_length * _SAMPLES), longest / _LARGEST_TEXTURE)


def _places(sheet: _Sheet, region: _Region, drawn: Texture) -> NDArray[np.float32]:
    """Return where each sample of a part of the picture lies in the texture.

    The grid's points are the centres of blocks of `_STEP` pixels, one block more on every side than the part has:
    where OpenCV enlarges a picture, its pixels keep their centres.

    Args:
        sheet: The sheet and the camera.
        region: The part.
        drawn: The texture.

    Returns:
        Column and row, shape (height, width, 2) of the samples, several a pixel [px].
    """
    cv2 = opencv()
    columns = -(-region.width // _STEP) + 2
    rows = -(-region.height // _STEP) + 2
    u = region.left + _STEP * (np.arange(columns) - 1.0) + (_STEP - 1) / 2.0
    v = region.top + _STEP * (np.arange(rows) - 1.0) + (_STEP - 1) / 2.0
    grid = np.stack(np.meshgrid(u, v), axis=-1)
    places = _places_of(sheet, grid.reshape(-1, 2), drawn).reshape(rows, columns, 2)
    finer = _STEP * _SAMPLES
    size = (columns * finer, rows * finer)
    samples = cv2.resize(places.astype(np.float32), size, interpolation=cv2.INTER_LINEAR)
    # The block around the part is cut off again.
    inside_y = slice(finer, finer + region.height * _SAMPLES)
    inside_x = slice(finer, finer + region.width * _SAMPLES)
    return np.asarray(samples[inside_y, inside_x])


def _places_of(sheet: _Sheet, pixels: Array, drawn: Texture) -> Array:
    """Return where pixels lie in the texture: along the ray through the lens, to the surface, to the pattern.

    Args:
        sheet: The sheet and the camera.
        pixels: shape (n, 2) [px].
        drawn: The texture.

    Returns:
        Column and row, shape (n, 2) [px].
    """
    directions_in_camera = rays(sheet.camera, pixels)
    T_board_camera = rigid_inverse(sheet.T_camera_board)
    directions = directions_in_camera @ T_board_camera[:3, :3].T
    origin = T_board_camera[:3, 3]
    # A ray that does not come down on the board's face, or comes from below, ends nowhere.
    hits = directions[:, 2] * np.sign(-origin[2]) > 1e-9
    steepness = np.where(hits, directions[:, 2], 1.0)
    height = np.zeros(len(pixels))
    xy = np.zeros((len(pixels), 2))
    for _ in range(_ROUNDS if any(sheet.printed.warp) else 1):
        length = (height - origin[2]) / steepness
        xy = (origin[:2] + length[:, None] * directions[:, :2]) / sheet.printed.scale
        height = sheet.printed.surface(*_on_sheet(sheet, xy))
    designed = xy - sheet.printed.displacement(*_on_sheet(sheet, xy))
    return np.where(hits[:, None], drawn.place(designed), _NOWHERE)


def _on_sheet(sheet: _Sheet, xy: Array) -> tuple[Array, Array]:
    """Return x and y of points (n, 2) [m], moved onto the sheet's edge where they are outside: there it ends."""
    width, height = sheet.printed.board.size
    margin = sheet.margin
    x = np.clip(xy[:, 0], -margin, width + margin)
    y = np.clip(xy[:, 1], -margin, height + margin)
    return x, y
