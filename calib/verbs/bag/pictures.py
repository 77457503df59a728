"""Pictures at the stops of the arm, one of each camera, named so that ``calib detect`` finds their joint values.

Of each stop the picture nearest to its middle is taken, in a second pass that decodes those at stops alone, and holds
one or two. Compressed pictures are written as they are.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from calib.basics.arrays import Array
from calib.basics.files import check_writable, csv_bytes, make_folder, write_atomically
from calib.basics.jobs import Progress
from calib.basics.values import Value
from calib.errors import MeasurementError
from calib.verbs.bag.bag_file import NANOSECOND, Bag
from calib.verbs.bag.messages import IMAGES, grey, stamp
from calib.verbs.bag.recording import SAME_CLOCK
from calib.verbs.bag.streams import JointStream
from calib.verbs.bag.table import Skipped

#: The table of joint values in the folder, as `calib detect` and `calib evaluate` look for it.
JOINTS = "joints.csv"

_MM = 1e3

#: How files of pictures begin, by the ending of their names.
_BEGINNINGS = {b"\xff\xd8\xff": ".jpg", b"\x89PNG": ".png", b"BM": ".bmp", b"II*\0": ".tif"}


@dataclass(frozen=True, slots=True)
class ImageTopic(Value):
    """A topic of pictures, as a call names it."""

    #: Name of the topic.
    name: str
    #: Name of the camera; empty: there is only one.
    camera: str

    @classmethod
    def parse(cls, text: str) -> ImageTopic:
        """Return the topic that a text names: ``[CAMERA=]TOPIC``."""
        camera, _, name = text.rpartition("=")
        return cls(name.strip(), camera.strip())


def write_pictures(
    bag: Bag,
    topics: Sequence[ImageTopic],
    joints: JointStream,
    spans: Array,
    folder: Path,
    *,
    by_stamps: bool = True,
    sliding: Collection[str] = (),
    overwrite: bool = False,
    progress: Progress | None = None,
) -> tuple[int, list[Skipped]]:
    """Write a picture of each camera at each stop, and the table of joint values.

    Args:
        bag: The bag.
        topics: Topics of pictures.
        joints: The joint values.
        spans: What is used of each stop, shape (S, 2) [s].
        folder: Where the files are written; made if it does not exist.
        by_stamps: Whether the time of a picture is its stamp, if that is on the recorder's clock; otherwise it is the
            time of receipt.
        sliding: Names of the joints that slide.
        overwrite: Whether existing files are replaced.
        progress: Called with the stops done and all stops; None: nothing is called.

    Returns:
        The number of pictures, and stops without one.

    Raises:
        MeasurementError: A topic has no pictures, or an encoding that is not one of pictures.
        FileError: A file exists, or cannot be written.
    """
    by_name = {}
    for each in topics:
        topic = bag.topic(each.name, "--images")
        if topic.type not in IMAGES:
            raise MeasurementError(
                f"{bag.source}: '{topic.name}' of --images has messages of the type {topic.type}; pictures are read "
                f"from {' and '.join(IMAGES)}."
            )
        by_name[topic.name] = each
    made = make_folder(folder)
    check_writable(made / JOINTS, overwrite=overwrite)
    has_cameras = any(each.camera for each in topics)
    units = ["mm" if name in sliding else "deg" for name in joints.names]
    head: list[object] = ["image", *(["group"] if has_cameras else [])]
    head += [f"{name} [{unit}]" for name, unit in zip(joints.names, units, strict=True)]
    lines = [head]
    skipped = []
    for number, nearest in enumerate(_nearest(bag, by_name, spans, by_stamps=by_stamps), start=1):
        begin, end = spans[number - 1]
        inside = (joints.times >= begin) & (joints.times <= end)
        if not inside.any():
            continue
        q = joints.q[inside].mean(axis=0)
        cells = [
            float(value * _MM if unit == "mm" else np.degrees(value))
            for value, unit in zip(q, units, strict=True)
        ]
        for name, each in by_name.items():
            if name not in nearest:
                skipped.append(Skipped(float(begin), float(end - begin), "no_image", name))
                continue
            stem = f"{each.camera}_{number:04d}" if each.camera else f"{number:04d}"
            data, ending = _file_of(nearest[name], f"{bag.source}: '{name}'")
            file = write_atomically(made / f"{stem}{ending}", data, overwrite=overwrite)
            lines.append([file.name, *([each.camera] if has_cameras else []), *cells])
        if progress is not None:
            progress(number, len(spans))
    if len(lines) > 1:
        write_atomically(made / JOINTS, csv_bytes(lines), overwrite=overwrite)
    return len(lines) - 1, skipped


def _file_of(message: Any, what: str) -> tuple[bytes, str]:  # noqa: ANN401
    """Return the contents of a picture's file and the ending of its name; MeasurementError if it is no picture."""
    from calib.boards.render import png_bytes

    if hasattr(message, "format"):
        data = bytes(message.data)
        for start, ending in _BEGINNINGS.items():
            if data.startswith(start):
                return data, ending
        raise MeasurementError(
            f"{what} has pictures of the format '{message.format}'; JPEG, PNG, BMP and TIFF are read."
        )
    pixels = grey(message)
    if pixels is None:
        raise MeasurementError(
            f"{what} has pictures of the encoding '{message.encoding}'; mono, rgb, bgr, bayer and yuv422 are read."
        )
    return png_bytes(pixels), ".png"


def _nearest(
    bag: Bag, names: Collection[str], spans: Array, *, by_stamps: bool
) -> Iterator[dict[str, Any]]:
    """Yield for each stop, by topic, the picture nearest to its middle, of those taken in it."""
    best: list[dict[str, tuple[float, Any]]] = [{} for _ in spans]
    done = 0
    # Pictures are received a little later than they are taken, and spans so widened may touch.
    wide = spans + np.array([0.0, _LATE])
    wide[:-1, 1] = np.minimum(wide[:-1, 1], wide[1:, 0])
    for name, received, message in bag.messages(names, wide):
        at = (received - bag.begin) * NANOSECOND
        while done < len(spans) and at > spans[done, 1] + _LATE:
            yield {topic: found for topic, (_, found) in best[done].items()}
            best[done] = {}
            done += 1
        stamped = (stamp(message.header) - bag.begin) * NANOSECOND
        if by_stamps and abs(stamped - at) < SAME_CLOCK:
            at = stamped
        stop = int(np.searchsorted(spans[:, 0], at, side="right")) - 1
        if stop < done or at > spans[stop, 1]:
            continue
        off = abs(at - float(spans[stop].mean()))
        if name not in best[stop] or off < best[stop][name][0]:
            best[stop][name] = (off, message)
    for each in best[done:]:
        yield {topic: found for topic, (_, found) in each.items()}


#: Pictures are received up to so much later than they are taken [s].
_LATE = 1.0
