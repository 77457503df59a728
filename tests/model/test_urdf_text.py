"""URDFs as people write them: encodings, line ends, names, comments; read, corrected and read again, bytes kept."""

from __future__ import annotations

import re
import socket
import time

import numpy as np
import pinocchio as pin
import pytest

from calib.errors import CalibError, UrdfError
from calib.measure.solid import read_solids
from calib.model.meshes import link_shapes
from calib.model.readback import check_written, random_joint_values
from calib.model.robot import Robot
from calib.model.tree_checks import DEEPEST, MOST_JOINTS, MOST_MOVING, check_same
from calib.model.urdf import Urdf

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


REFUSED: dict[str, tuple[bytes, str]] = {
    "UTF-16": (PLAIN.encode("utf-16"), "in UTF-16 or UTF-32; save it as UTF-8"),
    "UTF-16 declared": (LATIN.replace("iso-8859-1", "utf-16").encode(), "declaration is incorrect"),
    "latin-1 without a word": (PLAIN.replace('"one"', '"ä"').encode("latin-1"), "save it as UTF-8"),
    "an encoding of several bytes": (LATIN.replace("iso-8859-1", "gb18030").encode(), "encoding"),
    "NUL": (PLAIN.replace("one", "o\0e").encode(), "not XML"),
    "a control character": (PLAIN.replace("one", "o&#1;e").encode(), "not XML"),
    "half a character": (PLAIN.replace("one", "&#xD800;").encode(), "not XML"),
    "two roots": ((PLAIN + PLAIN.partition("\n")[2]).encode(), "junk after document element"),
    "an attribute twice": (PLAIN.replace("rpy=", 'xyz="1 1 1" rpy=').encode(), "duplicate attribute"),
    "an origin twice": (PLAIN.replace("<origin", "<origin/><origin").encode(), "has 2 <origin>; keep"),
    "a joint twice": (PLAIN.replace('"two"', '"one"').encode(), "a second joint 'one'"),
    "a link twice": (PLAIN.replace('link name="c"', 'link name="b"').encode(), "a second link 'b'"),
    "an entity of its own": (PLAIN.replace("one", "&x;").encode(), "undefined entity"),
    "digits of another script": (PLAIN.replace("0.1", "٠.١").encode(), "3 finite numbers wanted"),
    "a comma": (PLAIN.replace("0.1", "0,1").encode(), "3 finite numbers wanted"),
    "no space between": (PLAIN.replace("0 0 0.1", "0 0 0.1\u00a0").encode(), "3 finite numbers wanted"),
}  # fmt: skip


@pytest.mark.parametrize(("data", "words"), REFUSED.values(), ids=REFUSED)
def test_refused_with_a_word(data: bytes, words: str):
    with pytest.raises(UrdfError, match=words) as error:
        Urdf.from_bytes(data, "r.urdf")
    str(error.value).encode()  # a terminal can print it


def test_messages_are_short_and_printable_whatever_the_file_says():
    for value in ("1" * 500_000 + "x", "\u202e\x9b31m" * 1000, "- " * 100_000):
        with pytest.raises(UrdfError) as error:
            Urdf.from_bytes(PLAIN.replace("0 0 0.1", value).encode(), "r.urdf")
        text = str(error.value)
        assert 50 < len(text) < 10_000
        assert text.startswith("r.urdf, line 7: joint 'one': xyz of <origin> is '")
        assert text.endswith("wanted")
        assert not set("\u202e\x9b\x1b") & set(text)


def test_a_number_takes_time_with_its_length():
    start = time.process_time()
    for value in ("0" * 300_000 + "x", "9" * 300_000, "1." + "0" * 300_000 + "e"):
        with pytest.raises(UrdfError):
            Urdf.from_bytes(PLAIN.replace("0.1", value).encode(), "r.urdf")
    assert time.process_time() - start < 2.0


def test_a_prefix_that_is_not_declared():
    """As ROS reads it."""
    urdf = Urdf.from_bytes(PLAIN.replace("<link", "<sensor:camera/><link", 1).encode(), "r.urdf")
    assert len(read_solids(urdf).solids) == 1
    robot = Robot.from_urdf(urdf)
    q = random_joint_values(robot, 2)
    check_written(robot, robot.poses(q), q)


UNREAD = {
    "instructions inside": PLAIN.replace("<origin", "<?x y?><origin"),
    "tabs between numbers": PLAIN.replace("0 0 0.1", "0\t0\t0.1"),
}


@pytest.mark.parametrize("text", UNREAD.values(), ids=UNREAD)
def test_what_urdfdom_does_not_read_is_said_with_its_words(text: str):
    urdf = Urdf.from_bytes(text.encode(), "r.urdf")
    with pytest.raises(UrdfError, match=r"Pinocchio cannot build a model .*\((Unable|Error=XML)"):
        Robot.from_urdf(urdf)


def long_chain(count: int, kind: str, star: bool = False) -> bytes:
    lines = ['<robot name="r"><link name="l0"/>']
    for i in range(1, count + 1):
        parent = 0 if star else i - 1
        lines.append(
            f'<link name="l{i}"/><joint name="j{i}" type="{kind}"><parent link="l{parent}"/><child link="l{i}"/>'
            '<limit lower="-1" upper="1" effort="1" velocity="1"/></joint>'
        )
    return "\n".join([*lines, "</robot>"]).encode()


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (long_chain(MOST_JOINTS + 1, "fixed", star=True), "2,001 joints; 2,000 are the most"),
        (long_chain(DEEPEST + 1, "fixed"), "201 joints behind one another; 200 are the most"),
        (long_chain(MOST_MOVING + 1, "revolute"), "151 moving coordinates; 150 are the most"),
        (long_chain(26, "floating", star=True), "156 moving coordinates; 150 are the most"),
    ],
)
def test_trees_on_which_pinocchio_would_crash(data: bytes, words: str):
    """By recursion from some thousand joints on, by memory from some hundred moving ones."""
    urdf = Urdf.from_bytes(data, "r.urdf")
    with pytest.raises(UrdfError, match=words):
        Robot.from_urdf(urdf)


def test_a_urdf_that_pinocchio_reads_in_another_way():
    """The comparison itself: the model of one file against the elements of another."""
    urdf = Urdf.from_bytes(PLAIN.encode(), "r.urdf")
    for other in (PLAIN.replace("0 0 0.1", "0 0 0.2"), PLAIN.replace('"one"', '"other"')):
        with pytest.raises(UrdfError, match="reads this URDF in another way than it is written: '"):
            check_same(urdf, pin.buildModelFromXML(other))
    check_same(urdf, pin.buildModelFromXML(PLAIN))


def test_the_largest_tree_that_is_read():
    robot = Robot.from_urdf(Urdf.from_bytes(long_chain(MOST_MOVING, "revolute"), "r.urdf"))
    assert robot.poses(np.zeros(MOST_MOVING)).shape == (1, 4, 4)


def test_a_limit_that_is_missing_is_said_and_not_printed(capfd: pytest.CaptureFixture[str]):
    text = PLAIN.replace('<limit lower="-1" upper="1" effort="1" velocity="1"/>', "")
    with pytest.raises(CalibError, match="REVOLUTE but it does not specify limits"):
        Robot.from_urdf(Urdf.from_bytes(text.encode(), "r.urdf"))
    assert capfd.readouterr() == ("", "")


def test_yourdfpy_fetches_nothing_of_a_schema():
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.setblocking(False)
        place = f"http://127.0.0.1:{server.getsockname()[1]}/x.xsd"
        head = f'"r" xmlns:i="http://www.w3.org/2001/XMLSchema-instance" i:noNamespaceSchemaLocation="{place}">'
        text = PLAIN.replace('"r">', head).replace(
            "?>\n", f'?>\n<?xml-stylesheet href="{place}"?>\n', 1
        )
        robot = Robot.from_urdf(Urdf.from_bytes(text.encode(), "r.urdf"))
        q = random_joint_values(robot, 2)
        check_written(robot, robot.poses(q), q)
        with pytest.raises(BlockingIOError):
            server.accept()
