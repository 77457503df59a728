"""What xacros, YAML files, meshes and trees that would take all time or memory are refused for."""

from __future__ import annotations

import os
import pty
import re
import subprocess
import sys
import time
from pathlib import Path

import pytest

from calib.errors import CalibError, FileError, UrdfError
from calib.model.mesh_files import MeshFault, read_triangles
from calib.model.robot import Robot, read_urdf
from calib.model.urdf import Urdf
from calib.model.yaml_file import LIMIT_BYTES, parse_yaml

ROBOT = """<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">
<link name="a"/><link name="b"/>
<joint name="j" type="fixed"><parent link="a"/><child link="b"/><origin xyz="0 0 {}"/></joint>
</robot>
"""

#: Expressions, and what is wrong with each.
EXPRESSIONS = {
    "[0] @ [1]": "the operation MatMult is not read in a xacro's expression",
    "'%.*f' % (9, 1)": "'*' as a width of '%' is not read in a xacro's expression",
    "'%*d' % (9, 1)": "'*' as a width of '%' is not read in a xacro's expression",
    "list(map(xacro.load_yaml, [1]))": "map, filter, sorted, min and max take a lambda, or a function such as",
    "list(map(None, [1]))": "'NoneType' object is not callable",
    "[0 for i in range(2000) for j in range(2000)]": "the file takes more steps than that of any robot; it is not",
    "[x for x in 5]": "'int' object is not iterable",
    "9 ** 99999": "it makes a value of 399,996 bits, and 4,096 are the most",
    "(a := 1)": "'(a := 1)' is not read in a xacro's expression",
    "b'1'": "b'1' is not read in a xacro's expression",
    "[0 for a[0] in [1]]": "'a[0]' is not read in a xacro's expression",
    "-" * 9000 + "1": "it is nested too deeply",
    "__import__": "Use of invalid name(s): __import__",
    "(1).__class__": "Use of invalid name(s): __class__",
    "1[0]": "int has no elements",
    "len.a": "'.a' of builtin_function_or_method is not read in a xacro's expression",
    "[1](2)": "'[1]' is no function that a xacro may call",
    "[x async for x in [1]]": "'async' is not read in a xacro's expression",
    "(lambda *a: 1)(2)": "a lambda has plain arguments in a xacro's expression",
    "(lambda a, b: 1)(2)": "the function takes 2 arguments",
    "1 + " * 6000 + "1": "an expression of 24,001 characters; 20,000 are the most",
}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for name in ("AMENT_PREFIX_PATH", "ROS_PACKAGE_PATH"):
        monkeypatch.delenv(name, raising=False)
    return tmp_path


def refused(folder: Path, text: str) -> str:
    """What is said of a xacro: its line, and one line of text."""
    path = folder / "r.urdf.xacro"
    path.write_text(text)
    with pytest.raises(CalibError) as raised:
        read_urdf(path)
    said = str(raised.value)
    assert said.startswith("r.urdf.xacro")
    assert "\n" not in said
    return said


@pytest.mark.parametrize(("expression", "said"), EXPRESSIONS.items())
def test_expressions_that_are_not_worked_out(folder: Path, expression: str, said: str):
    assert said in refused(folder, ROBOT.format("${" + expression + "}"))


def test_a_text_with_more_than_values_in_its_fields(folder: Path):
    text = '<xacro:property name="p" value="{0.real}"/>\n<joint'
    said = "the field '0.real' of format is not read in a xacro's expression"
    assert said in refused(folder, ROBOT.format("${p.format(1)}").replace("<joint", text, 1))


def test_a_xacro_with_a_document_type(folder: Path):
    said = (
        "a <!DOCTYPE> declaration has no place in a xacro, and entities are not expanded; delete it"
    )
    assert said in refused(folder, '<!DOCTYPE robot [<!ENTITY a "1">]>\n' + ROBOT.format("&a;"))


def test_a_xacro_with_a_text_that_is_longer_than_any(folder: Path):
    said = "a text of 300,004 characters; 200,000 are the most in a xacro"
    assert said in refused(folder, ROBOT.format(300_000 * "1"))


def test_a_xacro_of_elements_in_one_another(folder: Path):
    deep = "<a>" * 300 + "</a>" * 300
    said = "elements, or 200 in one another; no xacro has"
    assert said in refused(folder, ROBOT.format(0).replace("</robot>", deep + "</robot>"))


def test_a_folder_that_a_xacro_reads(folder: Path):
    (folder / "k.yaml").mkdir()
    said = f"'{folder}/k.yaml' is no file"
    assert said in refused(folder, ROBOT.format("${xacro.load_yaml('k.yaml')['h']}"))


def test_a_yaml_file_of_a_xacro_that_is_larger_than_any(folder: Path):
    (folder / "k.yaml").write_text("h: 0.5 #" + 1_000_000 * " ")
    said = f"'{folder}/k.yaml' is larger than 1,000,000 bytes, the most that is read"
    assert said in refused(folder, ROBOT.format("${xacro.load_yaml('k.yaml')['h']}"))


def test_a_yaml_file_of_another_folder(folder: Path, tmp_path_factory):
    other = tmp_path_factory.mktemp("other") / "k.yaml"
    other.write_text("h: 0.5")
    said = f"'{other}' lies outside the folder and the ROS package of the xacro; name it as an argument, or its folder"
    assert said in refused(folder, ROBOT.format(f"${{xacro.load_yaml('{other}')['h']}}"))


def test_yaml_files_that_are_larger_than_any():
    with pytest.raises(FileError) as raised:
        parse_yaml(b"#" * (LIMIT_BYTES + 1), "o.yaml", "origins file")
    assert str(raised.value) == (
        f"o.yaml: this origins file has {LIMIT_BYTES + 1:,} bytes, and {LIMIT_BYTES:,} are the most that is read; "
        "check that it is the right file"
    )


def test_yaml_files_whose_aliases_grow(folder: Path):
    grown = "a0: &a0 [1, 1]\n" + "".join(
        f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9)}]\n" for k in range(1, 9)
    )
    (folder / "k.yaml").write_text(grown)
    said = refused(folder, ROBOT.format("${xacro.load_yaml('k.yaml')['a0'][0]}"))
    assert "its aliases stand for more than 200,000 values, or for themselves" in said


TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\n"
DAE = """<COLLADA><library_geometries><geometry id="g"><mesh>
<source id="s"><float_array>0 0 0 1 0 0 0 1 0</float_array>
<technique_common><accessor stride="3"/></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#s"/></vertices>
<triangles><input semantic="VERTEX" source="#v" offset="0"/><p>0 1 2</p></triangles>
</mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="w">
<node id="n"><instance_geometry url="#g"/></node></visual_scene></library_visual_scenes></COLLADA>
"""


def test_the_meshes_that_are_changed_below_are_read(tmp_path: Path):
    for name, text in (("m.obj", TRIANGLE + "f 1 2 3\n"), ("m.dae", DAE)):
        (tmp_path / name).write_text(text)
        vertices, faces = read_triangles(tmp_path / name)
        assert (len(vertices), len(faces)) == (3, 1)


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("m.fbx", "", "is of a kind that is not read; save it as one of .stl"),
        ("m.obj", TRIANGLE + "f 1 2 9\n", "has faces of vertices that it does not have"),
        (
            "m.dae",
            DAE.replace('stride="3"', 'stride="2"'),
            "has vertices without three coordinates",
        ),
        (
            "m.dae",
            DAE.replace('<instance_geometry url="#g"/>', '<instance_node url="#n"/>'),
            "has nodes that hold one another, or too many of them",
        ),
        ("m.dae", DAE.replace('<instance_geometry url="#g"/>', ""), "is empty"),
        ("m.stl", "solid without any triangle\n", "cannot be read"),
        ("m.dae", "<a>" * 300 + "</a>" * 300, "elements, or more than 100 in one another"),
    ],
)
def test_meshes_that_are_none(tmp_path: Path, name: str, text: str, said: str):
    (tmp_path / name).write_text(text)
    with pytest.raises(MeshFault, match=re.escape(said)):
        read_triangles(tmp_path / name)


def test_a_mesh_of_more_triangles_than_are_shown(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("calib.model.mesh_files.MOST_TRIANGLES", 1)
    (tmp_path / "m.obj").write_text(TRIANGLE + "f 1 2 3\nf 3 2 1\n")
    with pytest.raises(MeshFault, match=r"has 2 triangles, more than 1$"):
        read_triangles(tmp_path / "m.obj")
    monkeypatch.setattr("calib.model.mesh_dae._MOST", 3)
    (tmp_path / "m.dae").write_text(DAE)
    with pytest.raises(MeshFault, match=r"has more than 3 triangles$"):
        read_triangles(tmp_path / "m.dae")


@pytest.mark.parametrize(
    ("name", "text", "limit", "said"),
    [
        ("m.dae", DAE, "mesh_dae._LIMIT_TEXT", "is larger than 9 bytes"),
        ("m.obj", TRIANGLE, "mesh_files.LIMIT_TEXT", "cannot be read"),
        ("m.stl", "solid m\nfacet\n", "mesh_files.LIMIT_TEXT", "cannot be read"),
        ("m.off", "OFF\n3 1 0\n", "mesh_files.LIMIT_TEXT", "cannot be read"),
    ],
)
def test_texts_that_are_larger_than_any_mesh(tmp_path, monkeypatch, name, text, limit, said):
    monkeypatch.setattr(f"calib.model.{limit}", 9)
    (tmp_path / name).write_text(text)
    with pytest.raises(MeshFault, match=f"^{said}$"):
        read_triangles(tmp_path / name)


def test_a_terminal_that_nobody_types_a_file_into():
    terminal, theirs = pty.openpty()
    code = "from calib.model.files import read_bytes; read_bytes('-', 'table', 9)"
    done = subprocess.run(
        [sys.executable, "-c", code], stdin=theirs, stderr=subprocess.PIPE, text=True, timeout=60
    )
    os.close(theirs)
    os.close(terminal)
    assert "FileError: table '-' is the terminal; name a file" in done.stderr


def test_trees_that_are_no_robots():
    links = "".join(f'<link name="l{k}"/>' for k in range(202))
    joints = "".join(
        f'<joint name="j{k}" type="fixed"><parent link="l{k}"/><child link="l{k + 1}"/></joint>'
        for k in range(201)
    )
    urdf = Urdf.from_bytes(f'<robot name="r">{links}{joints}</robot>'.encode(), "deep.urdf")
    with pytest.raises(UrdfError) as raised:
        Robot.from_urdf(urdf)
    assert str(raised.value) == (
        "deep.urdf has 201 joints behind one another; 200 are the most that a robot may have here. Leave out what does "
        "not carry the arm."
    )


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="a system without named pipes")
def test_a_pipe_that_a_xacro_includes(folder: Path):
    os.mkfifo(folder / "more.xacro")
    included = '<xacro:include filename="more.xacro"/></robot>'
    path = folder / "r.urdf.xacro"
    path.write_text(ROBOT.format(0).replace("</robot>", included))
    with pytest.raises(UrdfError, match=r"more\.xacro, included by .*more\.xacro' is no file"):
        Robot.load(path)


@pytest.mark.parametrize(
    "expression",
    [
        "[[0]*10000]*10000",
        "[['a'*10000]*1000]*100",
        "[2**2000]*100000",
        "str([2**2000]*100000)",
        "'%s' % [['a'*10000]*1000]",
    ],
)
def test_a_value_whose_text_would_be_too_long(folder: Path, expression: str):
    began = time.process_time()
    said = refused(folder, ROBOT.format("1${" + expression + "}"))
    assert re.search("it makes a value of [0-9,]+ characters|takes more steps than", said)
    assert time.process_time() - began < 3.0
