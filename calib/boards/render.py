"""Pictures of a printed board as a camera takes them.

Each sample of the picture, several a pixel along x and along y, is traced backwards: through the lens to a ray, along
it to the board's surface, and from there to the pattern. This place on the pattern is smooth, so it is computed for
every second pixel and interpolated linearly. A pixel's value is the mean of its samples, lit unevenly, out of focus and
with noise.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

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

#: Samples of a pixel along x, and along y.
_SAMPLES = 3

#: Distance of the pixels for which the place on the pattern is computed [px].
_STEP = 2

#: Points on each side of the sheet's outline.
_OUTLINE = 25

#: Margin around the sheet's outline within which pixels are drawn [px].
_AROUND = 4.0

#: Largest texture, along its longer side [px].
_LARGEST_TEXTURE = 6000

#: Place in the texture of a ray that misses the board: far outside of it [px].
_NOWHERE = -1e6

#: Iterations that intersect a ray with a sagging board; each gains two digits or more.
_ROUNDS = 5

#: Patches of the background along the picture's width.
_CLOUDS = 24


@dataclass(frozen=True, slots=True, kw_only=True)
class Scene(Value):
    """Paper, ink, light and background of a picture. Grey values are from 0 (black) to 255."""

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


@dataclass(frozen=True, slots=True, eq=False)
class _Sheet:
    """A printed board in front of a camera."""

    printed: Print
    camera: Camera
    #: Pose of the board in the camera, shape (4, 4) [m].
    T_camera_board: Array
    #: Width of the white margin around the pattern [m].
    margin: float

    def outline(self) -> Array:
        """Return points along the edges of the sheet in the camera, shape (n, 3) [m]."""
        width, height = self.printed.board.size
        x = np.linspace(-self.margin, width + self.margin, _OUTLINE)
        y = np.linspace(-self.margin, height + self.margin, _OUTLINE)
        along_x = np.concatenate([x, x, np.full_like(y, x[0]), np.full_like(y, x[-1])])
        along_y = np.concatenate([np.full_like(x, y[0]), np.full_like(x, y[-1]), y, y])
        points = self.printed.points(along_x, along_y)
        return np.asarray(in_camera(self.T_camera_board[None], points)[0])

    def window(self) -> tuple[slice, slice] | None:
        """Return the rows and columns of the picture that show the sheet; None if the sheet is not seen."""
        camera = self.camera
        outline = self.outline()
        if (outline[:, 2] <= NEAREST).all():
            return None
        pixels = project(camera, outline)
        if not in_image(pixels, (camera.width, camera.height), 0.0).all():
            # Outside the picture a lens may map the outline anywhere: draw everywhere.
            return slice(0, camera.height), slice(0, camera.width)
        low = np.floor(np.maximum(pixels.min(axis=0) - _AROUND, 0.0)).astype(int)
        high = np.ceil(pixels.max(axis=0) + _AROUND).astype(int) + 1
        right, bottom = np.minimum(high, [camera.width, camera.height]).tolist()
        left, top = low.tolist()
        return slice(top, bottom), slice(left, right)

    def sample_size(self) -> float:
        """Return the width [m] on the board that one of the `_SAMPLES` samples along a pixel's side covers.

        It is that at the point of the sheet's outline, with its margin, which is nearest to the camera.
        """
        K, _ = camera_matrix(self.camera)
        focal_length = float(max(K[0, 0], K[1, 1]))
        nearest = max(float(np.linalg.norm(self.outline(), axis=1).min()), NEAREST)
        return nearest / (focal_length * _SAMPLES)

    def place(self, pixels: Array, drawn: Texture) -> Array:
        """Return the column and row in a texture that pixels (n, 2) [px] of the picture show, shape (n, 2) [px].

        Each pixel's ray is followed to the surface and from there to the pattern; one that misses is far outside.
        """
        directions_in_camera = rays(self.camera, pixels)
        T_board_camera = rigid_inverse(self.T_camera_board)
        directions = directions_in_camera @ T_board_camera[:3, :3].T
        origin = T_board_camera[:3, 3]
        # A ray hits the board if it approaches its plane, and from the side of its face.
        hits = directions[:, 2] * np.sign(-origin[2]) > 1e-9
        steepness = np.where(hits, directions[:, 2], 1.0)
        height = np.zeros(len(pixels))
        xy = np.zeros((len(pixels), 2))
        for _ in range(_ROUNDS if any(self.printed.warp) else 1):
            length = (height - origin[2]) / steepness
            xy = (origin[:2] + length[:, None] * directions[:, :2]) / self.printed.scale
            height = self.printed.surface(*self._within(xy))
        designed = xy - self.printed.displacement(*self._within(xy))
        return np.where(hits[:, None], drawn.place(designed), _NOWHERE)

    def _within(self, xy: Array) -> tuple[Array, Array]:
        """Return x and y of points (n, 2) [m], those outside the sheet moved onto its edge."""
        width, height = self.printed.board.size
        x = np.clip(xy[:, 0], -self.margin, width + self.margin)
        y = np.clip(xy[:, 1], -self.margin, height + self.margin)
        return x, y


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
    """Render the picture that a camera takes of a printed board.

    Args:
        printed: The board.
        camera: The camera, whose intrinsics are known.
        T_camera_board: Pose of the board in the camera, shape (4, 4) [m].
        scene: Paper, ink, light and background.
        blur: Standard deviation of the blur [px].
        noise: Standard deviation of each pixel's grey value.
        seed: Seed or generator of background, light and noise.

    Returns:
        Grey values, shape (height, width), uint8. The centre of the pixel [0, 0] is at (0, 0).

    Raises:
        CalibError: The camera's intrinsics are not known, OpenCV is not installed or lacks the board's dictionary.
    """
    cv2 = opencv()
    rng = np.random.default_rng(seed)

    # The background is uneven in patches.
    patches = (max(2, round(_CLOUDS * camera.height / camera.width)), _CLOUDS)
    coarse = rng.standard_normal(patches).astype(np.float32)
    clouds = cv2.resize(coarse, (camera.width, camera.height), interpolation=cv2.INTER_CUBIC)
    background = np.asarray(scene.background + scene.clouds * clouds, dtype=np.float32)

    # The light is 1 at one end of the picture, and less towards the other.
    direction = rng.uniform(0.0, 2.0 * np.pi)
    x = np.linspace(-1.0, 1.0, camera.width) * np.cos(direction)
    y = np.linspace(-1.0, 1.0, camera.height) * np.sin(direction)
    way = x + y[:, None]
    light = 1.0 - scene.shade * (way - way.min()) / np.ptp(way)

    sheet = _Sheet(printed, camera, T_camera_board, scene.margin * printed.board.square)
    picture = _draw_sheet(background, sheet, scene) * light.astype(np.float32)
    if blur > 0.0:
        picture = cv2.GaussianBlur(picture, (0, 0), blur)
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
        FileError: The file exists and is not to be overwritten, or cannot be written.
        CalibError: OpenCV is not installed, or cannot encode the picture.
    """
    return write_atomically(path, png_bytes(image), overwrite=overwrite)


def png_bytes(image: Image) -> bytes:
    """Return a picture as the contents of a PNG file.

    Args:
        image: Grey values, shape (h, w), uint8.

    Raises:
        CalibError: OpenCV is not installed, or cannot encode the picture.
    """
    is_done, data = opencv().imencode(".png", image)
    if not is_done:
        raise CalibError("OpenCV cannot encode the picture as PNG.")
    return bytes(data.tobytes())


def _draw_sheet(picture: NDArray[np.float32], sheet: _Sheet, scene: Scene) -> NDArray[np.float32]:
    """Return a picture, grey values (height, width), with the sheet drawn in front of it, without light and noise."""
    window = sheet.window()
    if window is None:
        return picture
    cv2 = opencv()
    board = sheet.printed.board
    longest = max(board.size) + 2.0 * sheet.margin
    drawn = texture(board, max(sheet.sample_size(), longest / _LARGEST_TEXTURE), sheet.margin)

    # The place in the texture of each sample of the window. They are computed at the centres of blocks of pixels, with
    # one block more than the window has on every side, and enlarged by OpenCV, which keeps the centres where they are.
    top, left = window[0].start, window[1].start
    height, width = window[0].stop - top, window[1].stop - left
    block_columns = -(-width // _STEP) + 2
    block_rows = -(-height // _STEP) + 2
    u = left + _STEP * (np.arange(block_columns) - 1.0) + (_STEP - 1) / 2.0
    v = top + _STEP * (np.arange(block_rows) - 1.0) + (_STEP - 1) / 2.0
    grid = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    of_blocks = sheet.place(grid, drawn).reshape(block_rows, block_columns, 2)
    finer = _STEP * _SAMPLES
    enlarged = cv2.resize(
        of_blocks.astype(np.float32),
        (block_columns * finer, block_rows * finer),
        interpolation=cv2.INTER_LINEAR,
    )
    # Cut the additional blocks off again.
    inside_y = slice(finer, finer + height * _SAMPLES)
    inside_x = slice(finer, finer + width * _SAMPLES)
    places = np.asarray(enlarged[inside_y, inside_x])

    # The second layer is the sheet itself, so that its edges are as smooth as the pattern's.
    ink = drawn.white[:, ::-1] if sheet.printed.mirrored else drawn.white
    levels = np.rint(255.0 * ink).astype(np.uint8)
    layers = np.dstack([levels, np.full_like(levels, 255)])
    samples = cv2.remap(layers, places, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
    means = cv2.resize(samples, (width, height), interpolation=cv2.INTER_AREA)
    white, share = np.moveaxis(means.astype(np.float32) / 255.0, -1, 0)

    grey = scene.black * share + (scene.white - scene.black) * white
    result: NDArray[np.float32] = picture.copy()
    result[window] = grey + (1.0 - share) * picture[window]
    return result
