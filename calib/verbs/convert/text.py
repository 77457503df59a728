"""A conversion as `calib convert` prints it: what was read, displacement of the tip, limits of the file's format."""

from __future__ import annotations

import numpy as np

from calib.robot.ranges import spread_poses
from calib.show.lines import deg, fill, mm
from calib.show.robot_sentences import coupling_sentence
from calib.verbs.convert.convert import FORMATS
from calib.verbs.convert.format import Conversion, Source


def text(conversion: Conversion, name: str) -> str:
    """Word a conversion.

    Args:
        conversion: The conversion.
        name: The file that was read.

    Returns:
        What was read, its verdict, the displacement of the tip, what the format says of itself, notes, and the file
        written, in lines of 100 columns.
    """
    row = FORMATS[conversion.format]
    source = conversion.source
    robot = source.robot
    parts = [f"Read: {name}", source.kind]
    if source.model:
        parts.append(source.model.name)
    if source.hash:
        parts.append(source.hash)
    parts += [f"'{robot.base}' to '{robot.tip}'", f"{len(robot.joints)} joints"]
    sentences = [f"{', '.join(parts)}. {coupling_sentence(robot)}".rstrip()]
    if conversion.against:
        sentences.append(f"Verdict on {name}: {conversion.against}")
    elif source.verdict is not None:
        sentences.append(f"Verdict on {name}: {source.verdict.use}")
    elif source.kind == "result":
        sentences.append(f"Verdict on {name}: none, the result was not validated.")
    displacement = _displacement(source) if row.has_chain else ""
    if displacement:
        sentences.append(displacement)

    paragraphs = [fill(sentence) for sentence in sentences]
    if row.describe is not None:
        paragraphs += row.describe(conversion)
    notes = [note.text for note in (*source.notes, *conversion.notes)]
    paragraphs += [
        fill(note) for note in dict.fromkeys(notes)
    ]  # reader and writer may say the same
    paragraphs.append(fill(f"Written: {conversion.path}, {row.what}."))
    if row.command is not None:
        paragraphs.append(row.command(conversion))
    return "\n\n".join(paragraphs)


def _displacement(source: Source) -> str:
    """Word the displacement of the tip from that of the nominal robot, over the joint limits; empty for rows alone."""
    if source.nominal is None and source.kind == "rows":
        return ""
    if source.nominal is None:
        return "The distance from its nominal robot is not known; --robot names that robot."
    if source.robot is source.nominal:
        return "Read as a nominal robot: there is no calibration to compare it with."
    q = spread_poses(source.nominal)
    difference = source.robot.poses(q)[:, :3] - source.nominal.poses(q)[:, :3]
    lengths = np.linalg.norm(difference[:, :, 3], axis=1)
    # The Frobenius norm of a difference of rotations is sqrt(8) sin(angle / 2).
    sines = np.linalg.norm(difference[:, :, :3], axis=(1, 2)) / np.sqrt(8.0)
    angles = 2.0 * np.arcsin(np.clip(sines, 0.0, 1.0))
    far = f"{mm(lengths.mean())} mm (mean) and at most {mm(lengths.max())} mm"
    turned = f"{deg(angles.mean())} deg (mean) and at most {deg(angles.max())} deg"
    return (
        f"In '{source.robot.base}', over the joint limits, '{source.robot.tip}' lies {far} from its place on the "
        f"nominal robot, rotated by {turned}."
    )
