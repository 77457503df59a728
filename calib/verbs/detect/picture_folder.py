"""A folder of pictures instead of a table: its corners are found, and joined with the joint values in the folder."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from calib.errors import CalibError

if TYPE_CHECKING:
    from calib.boards.board import Board
    from calib.camera.camera import Camera

#: The table of joint values in a folder of pictures.
JOINTS = "joints.csv"


@contextmanager
def table_of(
    data: Path, boards: Sequence[Board], cameras: Sequence[Camera], *, quiet: bool
) -> Iterator[Path]:
    """Yield a table: the one given, or that of the corners in the pictures of a folder.

    Args:
        data: A table, or a folder with pictures and a table of joint values, `JOINTS`.
        boards: The boards that the pictures may show.
        cameras: The cameras that may have taken them; none: any.
        quiet: True to print nothing.

    Yields:
        Path of a table; a table of corners exists only until the context ends.

    Raises:
        CalibError: The folder has no joint values, no board is described, no corner was found, or a picture does not
            have the image size of any of the cameras.
    """
    if not data.is_dir():
        yield data
        return
    table = _find_corners(data, boards, cameras, quiet=quiet)
    with TemporaryDirectory() as folder:
        path = Path(folder) / f"{data.name}.csv"
        path.write_bytes(table)
        yield path


def _find_corners(
    folder: Path, boards: Sequence[Board], cameras: Sequence[Camera], *, quiet: bool
) -> bytes:
    """Find the corners in the pictures of a folder, print what was found unless quiet, and return their table as CSV.

    It raises `CalibError` as `table_of` says; without cameras, pictures may have any size.
    """
    from calib.boards.detection.detect import detect
    from calib.boards.detection.picture import find_images
    from calib.cli.executor import executor_of
    from calib.cli.terminal import progress_bar, say
    from calib.verbs.detect.corner_table import corner_table, with_cameras, with_rows_only
    from calib.verbs.detect.matching import match, read_joint_table
    from calib.verbs.detect.text import detection_text

    if not (folder / JOINTS).exists():
        raise CalibError(
            f"'{folder}' is a folder of pictures without a table of joint values, '{JOINTS}' with a column 'image'. "
            "Put it there, or give the table that calib detect wrote."
        )
    if not boards:
        raise CalibError(
            f"'{folder}' is a folder of pictures: state which board they show, --board board.toml."
        )
    # All pictures of the folder are used, those marked for validation too.
    joints = read_joint_table(folder / JOINTS, {}, None).without("set")
    files = find_images([str(folder)], {})
    matches = match(joints, files)
    with (
        executor_of(None, None, len(files)) as executor,
        progress_bar("pictures", quiet=quiet) as progress,
    ):
        if progress is not None:
            progress(0, len(files))
        found = detect(with_cameras(files, matches), boards, executor=executor, progress=progress)
    detection = with_rows_only(found, matches)
    lines = detection_text(detection, joints, matches)
    if not detection.corner_count:
        raise CalibError("\n".join([f"No corner can be used in '{folder}'.", *lines]))
    sizes = {(camera.width, camera.height) for camera in cameras}
    for picture in detection.used:
        if sizes and picture.size not in sizes:
            given = " or ".join(f"{width} x {height}" for width, height in sorted(sizes))
            raise CalibError(
                f"'{picture.file.path}' has {picture.size[0]} x {picture.size[1]} pixels, and the camera's images have "
                f"{given}. Give pictures of this size, as the camera took them: intrinsics hold for one resolution."
            )
    if not quiet:
        say("\n".join([*lines, ""]))
    return corner_table(detection, joints, matches)
