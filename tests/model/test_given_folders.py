"""No file of another place is read, and nothing is fetched, whatever a description names."""

from __future__ import annotations

import os
import re
import socket
from pathlib import Path

import pytest

from calib.errors import CalibError, UrdfError
from calib.measure.solid import read_solids
from calib.model.given_folders import GivenFolders, own_folder
from calib.model.meshes import find_mesh, mesh_folders
from calib.model.robot import Robot
from calib.model.urdf import Urdf
from calib.model.xacro_file import read_xacro
from calib.show.visuals import read_visuals

MANIFEST = "<package><name>arm</name></package>"
STL = """solid a
facet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet
endsolid a
"""
HEAD = '<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">\n'
BODY = """<link name="a"/><link name="b"/>
<joint name="j" type="revolute"><parent link="a"/><child link="b"/><origin xyz="0 0 0.5"/>
<limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>
"""


def robot(mesh: str) -> str:
    shape = f'<visual><geometry><mesh filename="{mesh}"/></geometry></visual>'
    return (HEAD + BODY).replace('<link name="b"/>', f'<link name="b">{shape}</link>')


@pytest.fixture
def places(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A package with a URDF and a mesh, a mesh and a text beside it, and links out of it."""
    monkeypatch.delenv("ROS_PACKAGE_PATH", raising=False)
    monkeypatch.delenv("AMENT_PREFIX_PATH", raising=False)
    package = tmp_path / "ws" / "arm"
    for folder in (package / "urdf", package / "meshes", tmp_path / "secret"):
        folder.mkdir(parents=True)
    (package / "package.xml").write_text(MANIFEST)
    for name in (package / "meshes/m.stl", package / "urdf/m.stl", tmp_path / "secret/m.stl"):
        name.write_text(STL)
    (tmp_path / "secret" / "k.yaml").write_text("h: 0.5\n")
    (tmp_path / "secret" / "k.xacro").write_text(f"{HEAD}<link name='secret'/></robot>")
    (package / "meshes" / "link.stl").symlink_to(tmp_path / "secret" / "m.stl")
    (package / "urdf" / "link.yaml").symlink_to(tmp_path / "secret" / "k.yaml")
    return package


INSIDE = ["m.stl", "../meshes/m.stl", "package://arm/meshes/m.stl", "file://{package}/meshes/m.stl"]
INSIDE += ["{package}/meshes/m.stl", "package://arm/urdf/../meshes/m.stl", "model://arm/urdf/m.stl"]
OUTSIDE = [
    "../../../secret/m.stl",
    "package://arm/../../secret/m.stl",
    "package://../../secret/m.stl",
]
OUTSIDE += [
    "file://{secret}/m.stl",
    "{secret}/m.stl",
    "../meshes/link.stl",
    "model://../../secret/m.stl",
]
OUTSIDE += ["package://arm/meshes/link.stl", "package://./../../secret/m.stl"]
OUTSIDE += [
    "package://../../../../../../../../etc/passwd",
    "file:///etc/passwd",
    "/etc/passwd",
    "/dev/zero",
]


@pytest.mark.parametrize("name", INSIDE)
def test_meshes_of_the_own_package(places: Path, name: str):
    path = places / "urdf" / "r.urdf"
    path.write_text(robot(name.format(package=places)))
    urdf = Urdf.read(path)
    assert len(read_solids(urdf).solids) == 1
    assert read_visuals(urdf)[1] == ()


@pytest.mark.parametrize("name", OUTSIDE)
def test_meshes_of_other_places(places: Path, name: str):
    path = places / "urdf" / "r.urdf"
    path.write_text(robot(name.format(secret=places.parents[1] / "secret")))
    urdf = Urdf.read(path)
    outside = "lies outside the URDF's own folder and its ROS packages"
    words = outside if "secret" in name else "lies outside|was not found"
    with pytest.raises(UrdfError, match=words):
        read_solids(urdf)
    (warning,) = read_visuals(urdf)[1]
    assert re.search(words, warning)


def test_folders_of_the_user_are_given_with_their_links(places: Path, monkeypatch):
    path = places / "urdf" / "r.urdf"
    path.write_text(robot("package://arm/meshes/link.stl"))
    urdf = Urdf.read(path)
    assert find_mesh("package://arm/meshes/link.stl", mesh_folders(urdf)) is None
    named = mesh_folders(urdf, [places.parent])
    assert find_mesh("package://arm/meshes/link.stl", named) == places / "meshes/link.stl"
    assert find_mesh("package://arm/../../secret/m.stl", named) is None
    assert find_mesh(f"{places.parents[1]}/secret/m.stl", named) is None
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(places.parents[1] / "secret"))
    assert find_mesh(f"{places.parents[1]}/secret/m.stl", mesh_folders(urdf)) is not None


def test_the_own_folder(places: Path, tmp_path: Path):
    assert own_folder(places / "urdf" / "r.urdf") == Path(os.path.realpath(places))
    (tmp_path / "robots").mkdir()
    assert own_folder(tmp_path / "robots" / "r.urdf") == Path(os.path.realpath(tmp_path))
    assert own_folder(tmp_path / "r.urdf") == Path(os.path.realpath(tmp_path))
    assert own_folder(Path("/urdf/r.urdf")) == Path("/urdf")  # not the whole disk
    assert not GivenFolders((tmp_path,)).hold(Path("a\0b"))


def test_http_is_not_asked(places: Path):
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.setblocking(False)
        path = places / "urdf" / "r.urdf"
        address = f"http://127.0.0.1:{server.getsockname()[1]}/m.stl"
        path.write_text(robot(address))
        urdf = Urdf.read(path)
        assert "was not found" in read_visuals(urdf)[1][0]
        with pytest.raises(UrdfError, match="was not found"):
            read_solids(urdf)
        with pytest.raises(BlockingIOError):
            server.accept()


# Entities, on every way into a program

ENTITIES = {
    "file": '<!DOCTYPE robot [<!ENTITY x SYSTEM "file:///etc/hostname">]>',
    "http": '<!DOCTYPE robot [<!ENTITY x SYSTEM "http://127.0.0.1:{port}/x">]>',
    "outer": '<!DOCTYPE robot SYSTEM "http://127.0.0.1:{port}/x.dtd" [<!ENTITY x "1">]>',
    "parameter": '<!DOCTYPE robot [<!ENTITY % p SYSTEM "http://127.0.0.1:{port}/x"> %p; <!ENTITY x "1">]>',
    "laughs": "<!DOCTYPE robot [<!ENTITY a0 'ha'>"
    + "".join(f"<!ENTITY a{i} '{f'&a{i - 1};' * 10}'>" for i in range(1, 10))
    + "<!ENTITY x '&a9;'>]>",
    "blow-up": f"<!DOCTYPE robot [<!ENTITY y '{'a' * 50_000}'><!ENTITY x '{'&y;' * 1000}'>]>",
}


@pytest.mark.parametrize("kind", ENTITIES)
@pytest.mark.parametrize("way", ["urdf", "attribute", "xacro", "included", "mesh"])
def test_entities_are_refused_and_nothing_is_fetched(tmp_path: Path, way: str, kind: str):
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.setblocking(False)
        head = ENTITIES[kind].replace("{port}", str(server.getsockname()[1]))
        text = f"{head}\n{HEAD}<gazebo>&x;</gazebo>{BODY}"
        if way == "attribute":
            text = f"{head}\n{(HEAD + BODY).replace('0 0 0.5', '0 0 &x;')}"
        path = tmp_path / ("r.urdf" if way in ("urdf", "attribute") else "r.urdf.xacro")
        path.write_text(text)
        if way == "included":
            (tmp_path / "part.xacro").write_text(text)
            path.write_text(f'{HEAD}<xacro:include filename="part.xacro"/>{BODY}')
        if way == "mesh":
            path = tmp_path / "r.urdf"
            path.write_text(robot("m.dae"))
            (tmp_path / "m.dae").write_text(f"{head}<COLLADA><asset>&x;</asset></COLLADA>")
        with pytest.raises(CalibError, match="<!DOCTYPE>") as error:
            read_solids(Robot.load(str(path)).urdf)
        hostname = Path("/etc/hostname")
        if hostname.is_file() and len(secret := hostname.read_text().strip()) > 3:
            assert secret not in str(error.value)
        with pytest.raises(BlockingIOError):
            server.accept()


# Xacro


@pytest.mark.parametrize(
    "text",
    [
        '<xacro:include filename="../../../secret/k.xacro"/>',
        '<xacro:include filename="{secret}/k.xacro"/>',
        '<xacro:include filename="{secret}/*.xacro"/>',
        '<xacro:include filename="../../../*/k.xacro"/>',
        '<xacro:include filename="$(find arm)/../../secret/k.xacro"/>',
        "<gazebo x=\"${{xacro.load_yaml('{secret}/k.yaml')}}\"/>",
        "<gazebo x=\"${{xacro.load_yaml('link.yaml')}}\"/>",
        "<gazebo x=\"${{load_yaml('/etc/passwd')}}\"/>",
        '<xacro:include filename="/dev/zero"/>',
    ],
)
def test_a_xacro_reads_only_files_that_it_was_given(places: Path, text: str):
    path = places / "urdf" / "r.urdf.xacro"
    path.write_text(HEAD + text.format(secret=places.parents[1] / "secret") + BODY)
    with pytest.raises(UrdfError, match="lies outside the folder and the ROS package of the xacro"):
        read_xacro(path)


def test_a_file_given_as_an_argument_is_read(places: Path):
    path = places / "urdf" / "r.urdf.xacro"
    load = '<xacro:arg name="f" default="none.yaml"/><xacro:property name="f" value="$(arg f)"/>'
    path.write_text(f"{HEAD}{load}<gazebo x=\"${{xacro.load_yaml(f)['h']}}\"/>{BODY}")
    secret = places.parents[1] / "secret" / "k.yaml"
    assert b'x="0.5"' in read_xacro(f"{path} f:={secret}").data
    with pytest.raises(UrdfError, match="lies outside"):
        read_xacro(f"{path} f:=/etc/../etc/./nothing.yaml")


def test_folders_far_away_are_no_packages(places: Path, tmp_path: Path):
    """Without a package.xml a folder is a package above the file, and beside the next few above it, not anywhere."""
    deep = places / "urdf" / "a" / "b"
    deep.mkdir(parents=True)
    near = places / "urdf" / "near"
    near.mkdir()
    for folder in (near, tmp_path / "secret"):
        (folder / "k.yaml").write_text("h: 0.5\n")
        (folder / "m.stl").write_text(STL)
    path = deep / "r.urdf.xacro"
    for name, words in (("near", ""), ("secret", "no ROS package"), ("etc", "no ROS package")):
        load = f"<gazebo x=\"${{xacro.load_yaml('$(find {name})/k.yaml')}}\"/>"
        path.write_text(HEAD + load + BODY)
        if words:
            with pytest.raises(UrdfError, match=words):
                read_xacro(path)
        else:
            assert b"0.5" in read_xacro(path).data
        (deep / "r.urdf").write_text(robot(f"package://{name}/m.stl"))
        urdf = Urdf.read(deep / "r.urdf")
        assert bool(find_mesh(f"package://{name}/m.stl", mesh_folders(urdf))) is not bool(words)


def test_a_whole_disk_is_not_given_by_an_argument(places: Path):
    path = places / "urdf" / "r.urdf.xacro"
    ns = '<xacro:arg name="ns" default=""/><gazebo x="${xacro.load_yaml(\'/etc/passwd\')}"/>'
    path.write_text(f"{HEAD}{ns}{BODY}")
    with pytest.raises(UrdfError, match="lies outside"):
        read_xacro(f"{path} ns:=/")
