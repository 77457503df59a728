"""A corrected MJCF in words names what changed besides bodies, and who has read it."""

from __future__ import annotations

from pathlib import Path

from calib.robot.mjcf_write import WrittenMjcf
from calib.show.mjcf_text import mjcf_sentences


def test_mostly_one_sentence_and_one_more_for_each_thing():
    plain = WrittenMjcf((Path("c.xml"),), (), (), lacks_assets=False, read_by_mujoco=True)
    assert len(mjcf_sentences(plain)) == 1
    full = WrittenMjcf(
        (Path("c.xml"), Path("c_arm.xml")),
        ("body 'a'",),
        ("j1", "j2"),
        lacks_assets=True,
        read_by_mujoco=False,
    )
    text = " ".join(mjcf_sentences(full))
    assert len(mjcf_sentences(full)) == 5
    for word in ("'c_arm.xml'", "body 'a'", "'j2'", "not installed", "meshes"):
        assert word in text
