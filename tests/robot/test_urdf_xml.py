"""URDFs as people write them: encodings, line ends, names, comments; read, corrected and read again, bytes kept."""

from __future__ import annotations

import re
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest

from calib.errors import UrdfError
from calib.robot.meshes import link_shapes
from calib.robot.ranges import random_joint_values
from calib.robot.readback import check_written
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf
from calib.verbs.plan.solids import read_solids

PLAIN = """<?xml version="1.0"?>
<robot name="r">
  <link name="a"/>
  <link name="b"><visual><geometry><box size="1 2 3"/></geometry></visual></link>
  <link name="c"/>
  <joint name="one" type="revolute">
    <origin xyz="0 0 0.1" rpy="0 1.5707963267948966 0"/>
    <parent link="a"/><child link="b"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="1" effort="1" velocity="1"/>
  </joint>
  <joint name="two" type="fixed"><parent link="b"/><child link="c"/></joint>
</robot>
"""
LATIN = PLAIN.replace('version="1.0"', 'version="1.0" encoding="iso-8859-1"')
FAKE = '<joint name="one"><origin xyz="9 9 9"/></joint>'

READ: dict[str, bytes] = {
    "plain": PLAIN.encode(),
    "no declaration": PLAIN.partition("\n")[2].encode(),
    "byte order mark": b"\xef\xbb\xbf" + PLAIN.encode(),
    "CRLF": PLAIN.replace("\n", "\r\n").encode(),
    "lone CR": PLAIN.replace("\n", "\r").encode(),
    "mixed line ends": PLAIN.replace("\n", "\r\n", 5).encode(),
    "one line": PLAIN.partition("\n")[2].replace("\n", " ").encode(),
    "line break in a tag": PLAIN.replace(' rpy="', "\n\t\trpy = '").replace("66 0\"", "66 0'").encode(),
    "latin-1": LATIN.replace('"one"', '"gelenk ä"').encode("latin-1"),
    "windows-1252": LATIN.replace("iso-8859-1", "windows-1252").replace('"a"', '"€"').encode("cp1252"),
    "us-ascii": LATIN.replace("iso-8859-1", "us-ascii").encode(),
    "non-ASCII names": PLAIN.replace('"b"', '"手首 é"').replace('"one"', '"сустав 🤖"').encode(),
    "spaces in names": PLAIN.replace('"b"', '" b  c "').replace('"one"', '"joint one"').encode(),
    "entities in names": PLAIN.replace('"b"', '"&lt;b&gt; &amp; &quot;c&apos;&#233;"').encode(),
    "signs of XML in names": PLAIN.replace('"b"', "'b > \"c\"'").encode(),
    "entities in numbers": PLAIN.replace("0 0 0.1", "&#48; &#x30; 0&#46;1").encode(),
    "comments": PLAIN.replace("<origin", f"<!-- {FAKE} > --><origin").encode(),
    "CDATA": PLAIN.replace("<origin", f"<gazebo><![CDATA[{FAKE} ]] > ]]></gazebo><origin").encode(),
    "instructions": PLAIN.replace("<robot", '<?x <origin xyz="9 9 9"/> ?><robot').encode(),
    "a prefix": PLAIN.replace('"r">', '"r" xmlns:g="u"><g:joint name="one"/>').encode(),
    "a namespace of its own": PLAIN.replace("<origin", '<x xmlns="y"><origin xyz="9 9 9"/></x><origin').encode(),
    "a default namespace": PLAIN.replace('"r">', '"r" xmlns="http://example.org/robot">').encode(),
    "a property of xacro that is not used":
        PLAIN.replace('"r">', '"r" xmlns:xacro="xacro"><xacro:property name="w" value=".2"/>').encode(),
    "text around": PLAIN.replace("<origin", "some text <origin").encode() + b"<!-- end -->\n",
    "no origin": PLAIN.replace('<origin xyz="0 0 0.1" rpy="0 1.5707963267948966 0"/>', "").encode(),
    "an open origin": PLAIN.replace('66 0"/>', '66 0" ><!-- > --></origin >').encode(),
    "numbers of all kinds": PLAIN.replace("0 0 0.1", " +1e-1  -.5 0.").encode(),
}  # fmt: skip


@pytest.mark.parametrize("data", READ.values(), ids=READ)
def test_read_corrected_and_read_again(data: bytes):
    urdf = Urdf.from_bytes(data, "r.urdf")
    assert urdf.with_origins({j.name: j.T_parent_joint for j in urdf.joints}).data == data
    assert [s.sizes for s in link_shapes(urdf, "visual")] == [(1.0, 2.0, 3.0)]
    robot = Robot.from_urdf(urdf, tip=urdf.links[2])
    rng = np.random.default_rng(len(data))
    placements = np.array(robot.placements)
    placements[:, :3, 3] += 1e-3 * rng.normal(size=(2, 3))
    placements[:, :3, :3] = placements[:, :3, :3] @ pin.exp3(1e-2 * rng.normal(size=3))
    moved = robot.with_placements(placements)
    q = random_joint_values(robot, 3)
    check_written(moved, moved.poses(q), q)
    # Without the tags that were written, everything else is as it was, byte for byte.
    tag = re.compile(rb"\s*<origin\s[^>]*>")

    def others(text: bytes) -> bytes:
        kept = re.sub(
            rb"<!--.*?-->|<!\[CDATA\[.*?\]\]>|<\?x.*?\?>|<x .*?</x>", b"", text, flags=re.DOTALL
        )
        return tag.sub(b"", kept)

    assert others(moved.urdf.data) == others(data)
    assert moved.urdf.data.count(b"9 9 9") == data.count(b"9 9 9")


def test_a_prefix_that_is_not_declared():
    """As ROS reads it."""
    urdf = Urdf.from_bytes(PLAIN.replace("<link", "<sensor:camera/><link", 1).encode(), "r.urdf")
    assert len(read_solids(urdf)[0]) == 1
    robot = Robot.from_urdf(urdf)
    q = random_joint_values(robot, 2)
    check_written(robot, robot.poses(q), q)


def test_blanks_before_the_declaration_go_after_it():
    """As XML wants it, and other lines keep their numbers."""
    declaration, rest = '<?xml version="1.0"?>', PLAIN.removeprefix('<?xml version="1.0"?>')
    late = Urdf.from_bytes(f"\n\r\n {declaration}{rest}".encode(), "r.urdf")
    assert late.data == f"{declaration}\n\r\n {rest}".encode()
    ElementTree.fromstring(late.data)
    with pytest.raises(UrdfError, match="line 3"):
        Urdf.from_bytes(f"\n{declaration}\n<robot".encode(), "r.urdf")


# The verdict that a corrected URDF states

#: What XML makes hard: two hyphens, its own signs, a letter that not every encoding has, a line end, no character.
HARD = "do not use (other_base): try --base base <&>é手\n\x01 -"


@pytest.mark.parametrize("case", READ)
def test_a_verdict_is_a_comment_before_the_robot_and_changes_no_other_byte(case):
    plain = Urdf.from_bytes(READ[case], "r.urdf")
    urdf = plain.with_comments(run="", verdict=HARD)
    at = urdf.data.index(b"<!-- calib verdict: do not use (other_base): try - -base base ")
    head, end = plain.data[:at], urdf.data.index(b"-->", at) + 3
    assert b"<robot" not in head
    assert plain.data.startswith(head)
    line_end = b"\r\n" if b"\r\n" in plain.data else b"\n"
    assert urdf.data[end:] == line_end + plain.data[at:]
    assert urdf.with_comments(run="", verdict="") == plain
    assert plain.verdict == ""
    assert [(j.name, j.child) for j in urdf.joints] == [(j.name, j.child) for j in plain.joints]


def test_a_verdict_is_replaced_and_read_back():
    urdf = Urdf.from_bytes(PLAIN.encode(), "r.urdf").with_comments(
        run="", verdict="do not use (no_better): Worse."
    )
    assert urdf.verdict == "do not use (no_better): Worse."
    again = urdf.with_comments(run="", verdict="do not use (too_few): Measure more.")
    assert again.verdict == "do not use (too_few): Measure more."
    assert again.data.count(b"calib verdict") == 1
    assert again.with_comments(run="", verdict=again.verdict) == again
    moved = again.with_origins({"one": np.eye(4)})
    assert moved.verdict == again.verdict
    # Pinocchio and calib read it as before.
    robot = Robot.from_urdf(again, "a", "c")
    q = random_joint_values(robot)
    given = Robot.from_urdf(urdf.with_comments(run="", verdict=""), "a", "c")
    check_written(robot, given.poses(q), q)


def test_other_comments_state_no_verdict():
    text = PLAIN.replace(
        "<robot", "<!-- verdict: do not use --><!-- see calib verdict: use --><robot"
    )
    assert Urdf.from_bytes(text.encode(), "r.urdf").verdict == ""
