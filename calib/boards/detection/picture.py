"""Pictures: named by files, folders and patterns as on a command line, read, and searched for all boards."""

from __future__ import annotations

import glob
import hashlib
import os
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from calib.basics.files import read_bytes
from calib.basics.values import ReadOnlyMapping, Value
from calib.boards.board import Board
from calib.boards.corners.markers import Markers, find_markers, no_markers
from calib.boards.detection.board_search import (
    FEW_CORNERS,
    NO_BOARD,
    BoardView,
    reason_of_nothing,
    search_board,
)
from calib.boards.detection.copies import Copy, as_it_is, further_copies
from calib.boards.opencv import opencv
from calib.errors import FileError, choices

# Files

#: Endings of pictures in a folder, in lower case.
ENDINGS = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")

#: Characters that make a name a pattern.
_PATTERN = re.compile(r"[*?\[]")

#: Numbers in a name; names are sorted by their values, as people do.
_NUMBER = re.compile(r"(\d+)")


@dataclass(frozen=True, slots=True)
class ImageFile(Value):
    """A picture on disk."""

    #: The file.
    path: Path
    #: Its name in tables: that of the file, with as many folders in front as make it unique.
    name: str
    #: The camera that took it; "" if that is not stated.
    camera: str = ""


def find_images(
    words: Sequence[str | Path], cameras: Mapping[str, str] | None = None
) -> tuple[ImageFile, ...]:
    """List the pictures that files, folders and patterns name, with unique names and their cameras.

    Args:
        words: Files, folders (all pictures in them), and patterns such as ``run/*.png``; ``**`` descends into folders.
        cameras: Names of cameras by the folders with their pictures, or by patterns of the pictures' names (``cam1_*``,
            with or without folders in front), "" for all other pictures. None: not stated.

    Returns:
        The pictures, each once, in the order of the words; those of a folder or pattern sorted, numbers by value.

    Raises:
        FileError: A file does not exist, a folder or pattern has no pictures, or a camera has none.
    """
    paths: dict[str, Path] = {}
    for word in words:
        for path in _named_by(word):
            paths.setdefault(os.path.realpath(path), path)
    unique = list(paths.values())
    stated = cameras or {}
    patterns = [word for word in stated if _PATTERN.search(word) and not Path(word).is_dir()]
    folders = {
        os.path.realpath(word): stated[word] for word in stated if word not in (*patterns, "")
    }
    of_others = stated.get("", "")
    images = []
    for path, name in zip(unique, _names(unique), strict=True):
        # A pattern that its name fits, otherwise the innermost of the folders that the picture is in.
        named = [stated[pattern] for pattern in patterns if path.match(pattern)]
        around = [str(folder) for folder in Path(os.path.realpath(path)).parents]
        named += [folders[folder] for folder in around if folder in folders]
        images.append(ImageFile(path, name, named[0] if named else of_others))
    without = set(stated.values()) - {image.camera for image in images}
    if without:
        raise FileError(
            f"There is no picture of the camera {choices(sorted(without))}; name its folder, one of those with the "
            'pictures, or a pattern of their names: --camera-name "NAME=FOLDER", --camera-name "NAME=cam1_*".'
        )
    return tuple(images)


def read_image(image: ImageFile) -> Any:  # noqa: ANN401  8 or 16 bits, which Array is not
    """Read a picture.

    Args:
        image: The file.

    Returns:
        Grey values as stored, 8 or 16 bits, or real numbers, shape (height, width): an orientation tag is ignored,
        since a camera's intrinsics refer to its sensor. None if the file is not a picture.

    Raises:
        FileError: The file cannot be read.
    """
    cv2 = opencv()
    data = np.frombuffer(read_bytes(image.path, "The picture"), dtype=np.uint8)
    if not len(data):
        return None
    flags = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION
    return cv2.imdecode(data, flags)


def _named_by(word: str | Path) -> list[Path]:
    """Return the files that a word names: one file, those of a folder by `ENDINGS`, or all that match a pattern.

    Those of a folder or a pattern are sorted, numbers in their names by value. Raises `FileError` if there is none.
    """
    path = Path(word)
    if path.is_dir():
        inside = [entry for entry in path.iterdir() if entry.suffix.lower() in ENDINGS]
        if not inside:
            raise FileError(
                f"The folder '{word}' has no picture ({choices(ENDINGS)}). For pictures in its subfolders give a "
                f'pattern, "{path}/**/*.png".'
            )
        return sorted(inside, key=_by_numbers)
    if path.exists() or not _PATTERN.search(str(word)):
        if not path.exists():
            raise FileError(f"The picture '{word}' does not exist; check the name and the folder.")
        return [path]
    matching = [Path(name) for name in glob.glob(str(word), recursive=True)]  # noqa: PTH207  absolute patterns
    files = [entry for entry in matching if entry.is_file()]
    if not files:
        raise FileError(f"No file matches '{word}'; check the pattern and the folder.")
    return sorted(files, key=_by_numbers)


def _by_numbers(path: Path) -> list[tuple[int, int, str]]:
    """Return a sorting key by which ``pose_2`` comes before ``pose_10``."""
    key = []
    for part in _NUMBER.split(str(path)):
        is_number = part.isdecimal()
        key.append((int(is_number), int(part) if is_number else 0, part))
    return key


def _names(paths: Iterable[Path]) -> list[str]:
    """Return the shortest unique name of each file: its own, or with folders in front."""
    parts = [Path(os.path.abspath(path)).parts for path in paths]  # noqa: PTH100  links keep their names
    names = [""] * len(parts)
    length = 1
    unnamed = set(range(len(parts)))
    while unnamed:
        ends = {k: "/".join(parts[k][-length:]) for k in unnamed}
        counts = Counter(ends.values())
        is_last = length >= max(len(parts[k]) for k in unnamed)
        for k, end in ends.items():
            if counts[end] == 1 or is_last:
                names[k] = end
                unnamed.discard(k)
        length += 1
    return names


# Pictures

#: The file is not a picture.
UNREADABLE = "unreadable"

#: The picture has another size than most of its camera's.
OTHER_SIZE = "other_size"

#: No row of joint values belongs to it.
NO_ROW = "no_row"

#: Reasons that another copy of the picture may take away.
_MAY_BE_BETTER = (NO_BOARD, FEW_CORNERS)

#: Longer side of a small copy [px].
_SMALL = 480

#: Quality of its JPEG, of 100.
_QUALITY = 70


@dataclass(frozen=True, slots=True)
class Search(Value):
    """Boards that pictures are searched for."""

    boards: tuple[Board, ...]
    #: Fewest corners of a board with which a picture is used.
    fewest: int
    #: True if OpenCV uses one thread, as beside other processes.
    single_thread: bool = False
    #: Names of boards that are sought in the picture as it is, quickly, and in no copy of it.
    quick: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Picture(Value):
    """A picture, and the boards found in it."""

    file: ImageFile
    #: Width and height [px]; zeros if it cannot be read.
    size: tuple[int, int] = (0, 0)
    #: Corners found of each board, in the order of the boards.
    views: tuple[BoardView, ...] = ()
    #: Why nothing of it is used; "" if something is, or if the reasons of the views say it.
    reason: str = ""
    #: The markers in it by their `Board.marker_kind`.
    markers: ReadOnlyMapping[str, Markers] = field(default_factory=ReadOnlyMapping)
    #: Hash of its grey values.
    sha256: str = ""
    #: A small copy as JPEG.
    small: bytes = b""

    @property
    def used(self) -> tuple[BoardView, ...]:
        """The views whose corners are used."""
        return () if self.reason else tuple(view for view in self.views if view.is_used)


def search_picture(search: Search, file: ImageFile) -> Picture:
    """Read a picture, search it for boards, and make a small copy of it for a page.

    Args:
        search: The boards.
        file: The picture.

    Returns:
        What was found, or why there is nothing.
    """
    cv2 = opencv()
    if search.single_thread:
        cv2.setNumThreads(1)
    try:
        image = read_image(file)
    except FileError:
        image = None
    if image is None:
        return Picture(file=file, reason=UNREADABLE)
    copy = as_it_is(image)
    markers, views = search_image(search, copy)
    scale = min(1.0, _SMALL / max(image.shape))
    size = (max(1, round(scale * image.shape[1])), max(1, round(scale * image.shape[0])))
    shown = cv2.resize(copy.image, size, interpolation=cv2.INTER_AREA)
    _, small = cv2.imencode(".jpg", shown, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
    return Picture(
        file=file,
        size=(image.shape[1], image.shape[0]),
        views=tuple(views),
        markers=ReadOnlyMapping(markers),
        sha256=hashlib.sha256(image.tobytes()).hexdigest(),
        small=bytes(small.tobytes()),
    )


def search_image(search: Search, copy: Copy) -> tuple[dict[str, Markers], list[BoardView]]:
    """Search a picture for boards, and if it does not show them also its copies.

    Args:
        search: The boards.
        copy: The picture as it is.

    Returns:
        The markers in the picture by their `Board.marker_kind`, and what it shows of each board.
    """
    markers, views = _search(search, copy, thorough=False)
    has_markers = any(board.markers and board.name not in search.quick for board in search.boards)
    if has_markers and not all(view.is_used and view.is_complete for view in views):
        markers, views = _search(search, copy, thorough=True)
    is_seen = any(view.is_used for view in views)
    for other in further_copies(copy, is_seen=is_seen, has_markers=has_markers):
        sought = [view for view in views if view.board not in search.quick]
        if not any(view.reason in _MAY_BE_BETTER or not view.is_complete for view in sought):
            break
        further, found = _search(search, other, thorough=True)
        if _corner_count(found) > _corner_count(views):
            markers, views = further, found
    if all(view.reason == NO_BOARD for view in views):
        views = [
            replace(
                view,
                reason=reason_of_nothing(copy.image, board, quick=board.name in search.quick),
            )
            for view, board in zip(views, search.boards, strict=True)
        ]
    return markers, views


def _corner_count(views: Sequence[BoardView]) -> int:
    """Return the number of corners that are used of all boards in a picture."""
    return sum(len(view.ids) for view in views if view.is_used)


def _search(
    search: Search, copy: Copy, *, thorough: bool
) -> tuple[dict[str, Markers], list[BoardView]]:
    """Return the markers in a copy by `Board.marker_kind`, and what it shows of each board, in the picture's pixels."""
    markers: dict[str, Markers] = {}
    views = []
    for board in search.boards:
        of_board = no_markers()
        if board.markers:
            if board.marker_kind not in markers:
                markers[board.marker_kind] = find_markers(
                    copy.image,
                    board.dictionary,
                    thorough=thorough,
                    enlarged=copy.enlarged,
                    border=board.border,
                )
            of_board = markers[board.marker_kind]
        quick = board.name in search.quick
        view = search_board(copy.image, board, of_board, search.fewest, grey=copy.grey, quick=quick)
        views.append(
            replace(
                view,
                pixels=copy.in_picture(view.pixels),
                sigma=copy.factor * view.sigma,
                rms=copy.factor * view.rms,
                copy=copy.code,
            )
        )
    in_picture = {
        name: Markers(found.ids, copy.in_picture(found.corners)) for name, found in markers.items()
    }
    return in_picture, views
