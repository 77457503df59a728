from __future__ import annotations

import difflib
import hashlib
import re
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, strategies as st

from calib.errors import FileError, UrdfError
from calib.robot.urdf import Urdf
from tests.places import ROOT
from tests.robot.shared import SOME_AND_SLOWLY_ALL

OUR_UR3 = ROOT / "urdf" / "ur3.urdf"

TWO_LINKS = (
    '<robot name="r">\n'
    '  <link name="a"/>\n'
    '  <link name="b"/>\n'
    '  <joint name="j" type="revolute">\n'
    '    <parent link="a"/>\n'
    '    <child link="b"/>\n'
    "    {origin}\n"
    '    <axis xyz="0 0 2"/>\n'
    '    <limit effort="1" velocity="1"/>\n'
    "  </joint>\n"
    "</robot>\n"
)
PLAIN = TWO_LINKS.format(origin='<origin xyz="1 2 3" rpy="0.1 0.2 0.3"/>')


def parse(text: str | bytes) -> Urdf:
    return Urdf.from_bytes(text.encode() if isinstance(text, str) else text, "r.urdf")


def pose(xyz: object = (0, 0, 0), rpy: object = (0, 0, 0)) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3] = pin.rpy.rpyToMatrix(*np.asarray(rpy, dtype=float))
    T[:3, 3] = xyz
    return T


def robot(*joints: str, links: str = "ab", root: str = '<robot name="r">') -> str:
    tags = "".join(f'<link name="{link}"/>' for link in links)
    return f"{root}{tags}{''.join(joints)}</robot>"


def joint(
    name: str = "j", parent: str = "a", child: str = "b", more: str = "", kind="fixed"
) -> str:
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f"{more}</joint>"
    )


# --- reading -----------------------------------------------------------------------------------


def test_reads_what_the_file_states():
    urdf = parse(PLAIN)
    (j,) = urdf.joints
    assert (urdf.name, urdf.source, urdf.path, urdf.links, urdf.root) == (
        "r",
        "r.urdf",
        None,
        ("a", "b"),
        "a",
    )
    assert (j.name, j.type, j.parent, j.child, j.mimic, j.lower, j.upper) == (
        "j",
        "revolute",
        "a",
        "b",
        None,
        None,
        None,
    )
    np.testing.assert_array_equal(j.xyz, [1, 2, 3])
    np.testing.assert_array_equal(j.rpy, [0.1, 0.2, 0.3])
    np.testing.assert_array_equal(j.axis, [0, 0, 1])
    np.testing.assert_allclose(j.T_parent_joint, pose([1, 2, 3], [0.1, 0.2, 0.3]), atol=0)
    assert urdf.sha256 == hashlib.sha256(PLAIN.encode()).hexdigest()
    assert urdf.joint("j") is j


def test_numbers_in_every_form_of_xml():
    more = '<origin rpy=" 1e-3\n +.5\t-2.E0 " xyz="1.0&#x20;0 -0"/><axis xyz="3 0 4"/>'
    more += '<limit lower="-1" upper=" 2.5 " effort="1" velocity="0"/><mimic joint="k"/>'
    text = robot(joint(more=more, kind="revolute"), joint("k", "b", "c"), links="abc")
    j = parse(text).joints[0]
    np.testing.assert_array_equal(j.rpy, [1e-3, 0.5, -2])
    np.testing.assert_array_equal(j.xyz, [1, 0, 0])
    np.testing.assert_allclose(j.axis, [0.6, 0, 0.8], atol=1e-16)
    assert (j.lower, j.upper, j.mimic) == (-1.0, 2.5, "k")
    assert (j.mimic_multiplier, j.mimic_offset) == (1.0, 0.0)


TREE = robot(
    joint("j1", "w", "a"),
    joint("j2", "a", "b"),
    joint("j3", "a", "c"),
    joint("j4", "c", "d"),
    links="wabcd",
)


def test_chain_goes_through_the_nearest_common_ancestor():
    urdf = parse(TREE)
    assert urdf.root == "w"
    assert urdf.chain("w", "d") == ((), ("j1", "j3", "j4"))
    assert urdf.chain("d", "w") == (("j1", "j3", "j4"), ())
    assert urdf.chain("b", "d") == (("j2",), ("j3", "j4"))
    assert urdf.chain("d", "d") == ((), ())
    assert urdf.chain("c", "d") == ((), ("j4",))


# --- refusing ----------------------------------------------------------------------------------

REFUSED = {
    "empty": ("", "r.urdf is empty; a URDF is wanted"),
    "unclosed": (
        "<robot>\n <link></robot>",
        "r.urdf is not XML: mismatched tag, line 2, column 10",
    ),
    "sdf": ("<sdf version='1.7'/>", "line 1: the outermost element is <sdf>, it looks like SDF"),
    "xacro macro": (
        robot('\n<xacro:macro name="m"/>', joint()),
        "r.urdf, line 2: 'xacro:macro' belongs to xacro, not URDF; expand it first: xacro "
        "robot.urdf.xacro > robot.urdf",
    ),
    "xacro number": (
        robot(joint(more='<origin xyz="0 0 ${d1}"/>')),
        "joint 'j': xyz of <origin> is '0 0 ${d1}', 3 finite numbers wanted; this is xacro, expand",
    ),
    "no joint": (robot(), "line 1: <robot> has no <joint>"),
    "joint twice": (
        robot(joint(), "\n" + joint(child="c"), links="abc"),
        "line 2: a second joint 'j', the first is in line 1; rename one",
    ),
    "no such link": (
        robot(joint(child="arm_lnk"), '<link name="arm_link"/>'),
        "joint 'j' names the link 'arm_lnk', which does not exist (did you mean 'arm_link'?)",
    ),
    "closed loop": (
        robot(joint(), joint("k", "a", "c"), joint("l", "c", "b"), links="abc"),
        "link 'b' is the child of both 'j' and 'l'; a URDF is a tree",
    ),
    "two roots": (robot(joint(), links="abc"), "r.urdf has 2 root links: 'a', 'c'; join them"),
    "type": (
        robot(joint(kind="hinge")),
        "joint 'j' has the type 'hinge'; the types are 'revolute'",
    ),
    "word": (
        robot("\n" + joint(more='\n<origin rpy="0 zero 0"/>')),
        "r.urdf, line 3: joint 'j': rpy of <origin> is '0 zero 0', 3 finite numbers wanted",
    ),
    "axis": (
        robot(joint(kind="revolute", more='<axis xyz="0 0 0"/>')),
        """joint 'j': the axis is zero; give its direction, xyz="0 0 1" for example""",
    ),
    "not latin": (
        b"<robot>\xe9</robot>",
        "line 1, column 8; mend the file there, and save it as UTF-8",
    ),
    "utf-16": (robot(joint()).encode("utf-16"), "r.urdf is in UTF-16 or UTF-32; save it as UTF-8"),
}


@pytest.mark.parametrize(("text", "wanted"), REFUSED.values(), ids=REFUSED)
def test_refuses(text: str | bytes, wanted: str):
    with pytest.raises(UrdfError, match=re.escape(wanted)):
        parse(text)


@given(st.binary(max_size=60) | st.text("<>/ab='\" \n&;!-[]?", max_size=60).map(str.encode))
def test_nothing_but_a_urdf_error_comes_out_of_junk(data: bytes):
    with pytest.raises(UrdfError):
        parse(data)


# --- writing -----------------------------------------------------------------------------------

ORIGINS = {
    "plain": ('<origin xyz="1 2 3" rpy="0 0 0"/>', '<origin xyz="1.0 2.0 4.5" rpy="0 0 0"/>'),
    "others": (
        '<origin note="xyz=\'9\'" xyz="1 2 3" a:xyz="0 0 0" c=">/"/>',
        '<origin note="xyz=\'9\'" xyz="1.0 2.0 4.5" a:xyz="0 0 0" c=">/"/>',
    ),
    "added": ('<origin rpy="0 0 0"/>', '<origin rpy="0 0 0" xyz="1.0 2.0 4.5"/>'),
    "empty": ("<origin/>", '<origin xyz="1.0 2.0 4.5"/>'),
}


@pytest.mark.parametrize(("before", "after"), ORIGINS.values(), ids=ORIGINS)
@pytest.mark.parametrize("line_end", ["\n", "\r\n"])
def test_only_the_value_changes(before: str, after: str, line_end: str):
    template = TWO_LINKS.replace("<robot ", '<robot xmlns:a="urn:a" ')
    old, new = (template.format(origin=o).replace("\n", line_end) for o in (before, after))
    urdf = parse(old)
    moved = urdf.with_origins({"j": pose([1, 2, 4.5])})
    assert moved.data == new.encode()
    np.testing.assert_array_equal(moved.joint("j").xyz, [1, 2, 4.5])
    assert urdf.data == old.encode()
    assert urdf.with_origins({"j": urdf.joint("j").T_parent_joint}) is urdf


def test_rounding_is_no_change_and_more_is():
    urdf = parse(PLAIN)
    T = urdf.joint("j").T_parent_joint
    through_quaternion = T.copy()
    through_quaternion[:3, :3] = pin.Quaternion(T[:3, :3]).toRotationMatrix()
    assert urdf.with_origins({"j": through_quaternion}) is urdf
    moved = T.copy()
    moved[0, 3] += 1e-13
    assert urdf.with_origins({"j": moved}).joint("j").xyz[0] == moved[0, 3]
    assert b"-0.0" not in urdf.with_origins({"j": pose([-0.0, -0.0, -0.0])}).data


@pytest.mark.parametrize("line_end", ["\n", "\r\n"])
def test_a_missing_origin_is_added_in_the_style_of_the_file(line_end: str):
    lines = '<robot>\n\t<link name="a"/><link name="b"/>\n\t<joint name="j" type="fixed">{}\n'
    lines += '\t\t<parent link="a"/>\n\t\t<child link="b"/>\n\t</joint>\n</robot>'
    lines = lines.replace("\n", line_end)
    new = f'{line_end}\t\t<origin xyz="1.0 2.0 3.0" rpy="0.0 0.0 0.0"/>'
    moved = parse(lines.format("")).with_origins({"j": pose([1, 2, 3])})
    assert moved.data == lines.format(new).encode()
    flat = robot(joint())
    moved = parse(flat).with_origins({"j": pose([1, 2, 3])})
    assert moved.data == flat.replace('d">', 'd">' + new.strip()).encode()


@pytest.mark.parametrize(
    "encoding", ["utf-8", "utf-8-sig", "iso-8859-1", "windows-1252", "iso-8859-5"]
)
def test_other_encodings_are_kept(encoding: str):
    letters = "щж" if encoding == "iso-8859-5" else "é°ß"
    declared = encoding.removesuffix("-sig")
    head = f'<?xml version="1.0" encoding="{declared}"?>\n<!-- {letters * 9} -->\n'
    text = (head + PLAIN).replace('"a"', f'"{letters}"').replace('"j"', f'"{letters}j"')
    urdf = parse(text.encode(encoding))
    assert urdf.links == (letters, "b")
    assert urdf.data.decode(urdf.encoding) == text
    moved = urdf.with_origins({f"{letters}j": pose([1, 2, 4], [0.1, 0.2, 0.3])})
    assert moved.data == text.replace("1 2 3", "1.0 2.0 4.0").encode(encoding)
    linked = moved.with_link("tool €ж", letters, np.eye(4))
    assert linked.links == (letters, "b", "tool €ж")
    assert linked.joints[-1].parent == letters


def test_rotations_near_gimbal_lock_survive_the_file():
    rng = np.random.default_rng(1)
    urdf = parse(PLAIN)
    for k in range(400):
        off = rng.normal() * 10.0 ** rng.integers(-17, 0) * (k % 5 > 0)
        R = pin.rpy.rpyToMatrix(
            *rng.uniform(-4, 4, 1), (-1) ** k * (np.pi / 2 + off), rng.uniform(-4, 4)
        )
        T = pose()
        T[:3, :3] = R @ pin.exp3(rng.normal(size=3) * 10.0 ** rng.integers(-17, 0))
        moved = urdf.with_origins({"j": T})
        np.testing.assert_allclose(moved.joint("j").T_parent_joint, T, atol=4e-15, rtol=0)
        if k < 40:
            model = pin.buildModelFromXML(moved.data.decode())
            np.testing.assert_allclose(model.jointPlacements[1].homogeneous, T, atol=4e-15, rtol=0)


# --- adding a link -----------------------------------------------------------------------------


@pytest.mark.parametrize("line_end", ["\n", "\r\n"])
def test_a_link_is_added_in_the_style_of_the_file(line_end: str):
    text = PLAIN.replace("\n", line_end)
    linked = parse(text).with_link("calib_target", "b", pose([0.5, 0, 0]))
    new = (
        '  <link name="calib_target"/>\n'
        '  <joint name="calib_target_joint" type="fixed">\n'
        '    <parent link="b"/>\n'
        '    <child link="calib_target"/>\n'
        '    <origin xyz="0.5 0.0 0.0" rpy="0.0 0.0 0.0"/>\n'
        "  </joint>\n"
    ).replace("\n", line_end)
    assert linked.data == text.replace("</robot>", new + "</robot>").encode()
    assert linked.chain("a", "calib_target") == ((), ("j", "calib_target_joint"))
    np.testing.assert_array_equal(linked.joint("calib_target_joint").xyz, [0.5, 0, 0])


@pytest.mark.parametrize(
    "text",
    [
        robot(joint()),
        robot(joint()).replace("</robot>", "\n</robot>"),
        PLAIN.replace("  ", "\t"),
        PLAIN.replace("  ", ""),
        PLAIN.replace("\n</robot>", "</robot>"),
        PLAIN.replace("\n</robot>", "<!-- end -->\n\n   </robot ><!-- </robot> -->"),
    ],
)
def test_a_link_fits_into_any_layout(text: str):
    linked = parse(text).with_link('it\'s <"new"> & é', "a", pose(rpy=[1, 2, 3]))
    assert linked.links == ("a", "b", 'it\'s <"new"> & é')
    removed = [
        step[2] for step in difflib.ndiff(text, linked.data.decode()) if step.startswith("-")
    ]
    assert removed == []
    np.testing.assert_allclose(linked.joints[-1].T_parent_joint, pose(rpy=[1, 2, 3]), atol=1e-15)


# --- files -------------------------------------------------------------------------------------


def test_write_and_read_again(tmp_path: Path):
    urdf = Urdf.read(OUR_UR3)
    assert (urdf.path, urdf.source) == (OUR_UR3, "ur3.urdf")
    path = urdf.write(tmp_path / "copy.urdf")
    assert path.read_bytes() == OUR_UR3.read_bytes()
    assert Urdf.read(str(path)) == urdf
    with pytest.raises(FileError, match="exists already"):
        urdf.write(path)
    urdf.write(path, overwrite=True)


# --- the robots of example-robot-data ----------------------------------------------------------


def masked(urdf: Urdf) -> bytes:
    """The bytes without the robot's joint origins, found by other means than the parser's."""
    name = "|".join(re.escape(joint.name) for joint in urdf.joints)
    start = re.compile(
        rf'<joint\b[^>]*\bname\s*=\s*"({name})"[^>]*>.*?</joint>'.encode(), re.DOTALL
    )
    tag = re.compile(rb"\s*<origin\b[^>]*?(/>|>\s*</origin>)")
    return start.sub(lambda match: tag.sub(b"", match[0]), urdf.data)


def read_independently(data: bytes) -> dict[str, list[float]]:
    """xyz and rpy of every joint of the robot, by xml.etree."""
    found = {}
    for element in ET.fromstring(data).findall("joint"):
        origin = element.find("origin")
        values = {} if origin is None else origin.attrib
        words = f"{values.get('xyz', '0 0 0')} {values.get('rpy', '0 0 0')}".split()
        found[element.attrib["name"]] = [float(word) for word in words]
    return found


@pytest.mark.parametrize("path", SOME_AND_SLOWLY_ALL)
def test_every_robot(path: Path):
    urdf = Urdf.read(path)
    numbers = read_independently(urdf.data)
    assert list(numbers) == [joint.name for joint in urdf.joints]
    for j in urdf.joints:
        np.testing.assert_array_equal([*j.xyz, *j.rpy], numbers[j.name])
    assert urdf.with_origins({j.name: j.T_parent_joint for j in urdf.joints}) is urdf

    rng = np.random.default_rng(len(urdf.data))
    origins = {
        j.name: j.T_parent_joint @ pin.exp6(rng.normal(size=6) * 1e-2).homogeneous
        for j in urdf.joints
    }
    moved = urdf.with_origins(origins)
    assert masked(moved) == masked(urdf)
    written = read_independently(moved.data)
    for name, T in origins.items():
        values = written[name]
        np.testing.assert_allclose(pose(values[:3], values[3:]), T, atol=1e-14, rtol=0)
