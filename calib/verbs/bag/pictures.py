"""Pictures at the stops of the arm, one of each camera, named so that ``calib detect`` finds their joint values.

A picture is a message of its own in the bag: of each stop the one nearest to its middle is taken, in a second pass that
reads the bag around the stops alone. Compressed pictures are written as they are.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from calib.basics.arrays import Array
from calib.basics.files import check_writable, csv_bytes, make_folder, write_atomically
from calib.basics.jobs import Progress
from calib.basics.values import Value
from calib.errors import MeasurementError
from calib.verbs.bag.bag_file import Bag
from calib.verbs.bag.messages import COMPRESSED_IMAGE, IMAGES, grey, stamp
from calib.verbs.bag.recording import SAME_CLOCK
from calib.verbs.bag.streams import JointStream
from calib.verbs.bag.table import Skipped

#: The table of joint values in the folder, as `calib detect` and `calib evaluate` look for it.
JOINTS = "joints.csv"

_SECOND = 1e-9
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
    from calib.boards.render import write_png

    by_name = {}
    for each in topics:
        topic = bag.topic(each.name, "--images")
        if topic.type not in IMAGES:
            raise MeasurementError(
                f"{bag.source}: '{topic.name}' of --images has messages of the type {topic.type}; pictures are read "
                f"from {' and '.join(IMAGES)}."
            )
        by_name[topic.name] = (each, topic.type)
    made = make_folder(folder)
    check_writable(made / JOINTS, overwrite=overwrite)
    has_cameras = any(each.camera for each in topics)
    units = ["mm" if name in sliding else "deg" for name in joints.names]
    head: list[object] = ["image", *(["group"] if has_cameras else [])]
    head += [f"{name} [{unit}]" for name, unit in zip(joints.names, units, strict=True)]
    lines = [head]
    skipped = []
    for number, (begin, end) in enumerate(spans, start=1):
        inside = (joints.times >= begin) & (joints.times <= end)
        if not inside.any():
            continue
        q = joints.q[inside].mean(axis=0)
        cells = [
            float(value * _MM if unit == "mm" else np.degrees(value))
            for value, unit in zip(q, units, strict=True)
        ]
        nearest = _nearest(bag, by_name, (begin, end), by_stamps=by_stamps)
        for name, (each, type_name) in by_name.items():
            if name not in nearest:
                skipped.append(Skipped(float(begin), float(end - begin), "no_image", name))
                continue
            message = nearest[name]
            stem = f"{each.camera}_{number:04d}" if each.camera else f"{number:04d}"
            if type_name == COMPRESSED_IMAGE:
                data = bytes(message.data)
                ending = next((e for start, e in _BEGINNINGS.items() if data.startswith(start)), "")
                if not ending:
                    raise MeasurementError(
                        f"{bag.source}: '{name}' has pictures of the format '{message.format}'; JPEG, PNG, BMP and "
                        "TIFF are read."
                    )
                file = write_atomically(made / f"{stem}{ending}", data, overwrite=overwrite)
            else:
                pixels = grey(message)
                if pixels is None:
                    raise MeasurementError(
                        f"{bag.source}: '{name}' has pictures of the encoding '{message.encoding}'; mono, rgb, bgr, "
                        "bayer and yuv422 are read."
                    )
                file = write_png(pixels, made / f"{stem}.png", overwrite=overwrite)
            lines.append([file.name, *([each.camera] if has_cameras else []), *cells])
        if progress is not None:
            progress(number, len(spans))
    if len(lines) > 1:
        write_atomically(made / JOINTS, csv_bytes(lines), overwrite=overwrite)
    return len(lines) - 1, skipped


def _nearest(
    bag: Bag, names: Collection[str], span: tuple[float, float], *, by_stamps: bool
) -> dict[str, Any]:
    """Return by topic the picture nearest to the middle of a stop, of those taken in it."""
    begin, end = span
    middle = 0.5 * (begin + end)
    best: dict[str, tuple[float, Any]] = {}
    # Pictures are received a little later than they are taken.
    for name, received, message in bag.messages(names, max(begin - _LATE, 0.0), end + _LATE):
        at = (received - bag.begin) * _SECOND
        stamped = (stamp(message.header) - bag.begin) * _SECOND
        if by_stamps and abs(stamped - at) < SAME_CLOCK:
            at = stamped
        off = abs(at - middle)
        if begin <= at <= end and (name not in best or off < best[name][0]):
            best[name] = (off, message)
    return {name: message for name, (_, message) in best.items()}


#: Pictures are looked for so much around a stop, by their time of receipt [s].
_LATE = 1.0
