"""A corrected MJCF in words: what changed besides pos and orientation of bodies, and who has read it."""

from __future__ import annotations

from calib.errors import choices
from calib.robot.mjcf_write import WrittenMjcf


def mjcf_sentences(written: WrittenMjcf) -> list[str]:
    """Return what there is to say about a corrected MJCF besides its name, in sentences; mostly one."""
    by = (
        "calib and MuJoCo"
        if written.read_by_mujoco
        else "calib, without MuJoCo, which is not installed"
    )
    sentences = [f"Read back by {by}."]
    if len(written.paths) > 1:
        others = choices(path.name for path in written.paths[1:])
        sentences.append(f"It includes {others}, written beside it; keep them together.")
    if written.new_quats:
        sentences.append(
            "What stood there states no full orientation, so that there is a quat in its place: "
            f"{choices(written.new_quats)}."
        )
    if written.changed_joints:
        sentences.append(
            f"pos or axis changed too of {choices(written.changed_joints)}, whose placement no body holds."
        )
    if written.lacks_assets:
        sentences.append(
            "MuJoCo looks for meshes and textures beside the file: put it into the folder of the original."
        )
    return sentences
