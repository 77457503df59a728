"""The readers of robots for `fuzz.py`: URDF, xacro, meshes, the files of Universal Robots, origins."""

from __future__ import annotations

import functools
import importlib.metadata
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import numpy as np
from fuzzing import Reader, as_file

from calib.compensate.conversion_source import Asked, read_source
from calib.compensate.dh_tables import dh_tables
from calib.compensate.origins_file import parse_origins, write_origins
from calib.compensate.universal_robots import read_ur_conf, read_ur_yaml, write_ur_yaml
from calib.compensate.ur_conf import read_nominal
from calib.compensate.ur_dh import COLUMNS
from calib.compensate.ur_models import ur_robot
from calib.errors import CalibError
from calib.measure.solid import read_solids
from calib.model.meshes import link_shapes
from calib.model.readback import check_written, random_joint_values
from calib.model.robot import Robot
from calib.model.urdf import Urdf
from calib.model.xacro_file import read_xacro
from calib.model.yaml_file import parse_yaml, yaml_keys
from calib.show.visuals import read_visuals

_URDF = Path(__file__).resolve().parents[1] / "urdf"

#: Larger files take the time of many cases.
_LARGEST_URDF, _LARGEST_MESH = 45_000, 60_000

_SMALL = b"""<?xml version="1.0"?>
<robot name="two" xmlns:xacro="http://www.ros.org/wiki/xacro">
  <!-- two joints -->
  <link name="a"><visual><origin xyz="1 2 3" rpy="0 0 1"/><geometry><mesh filename="package://p/a.stl" scale="1 1 1"/>
    </geometry></visual><inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>
    <collision><geometry><box size="1 2 3"/></geometry></collision></link>
  <link name="b"><visual><geometry><cylinder radius="0.1" length="1"/></geometry></visual></link>
  <link name='c'><collision><geometry><sphere radius="0.1"/></geometry></collision></link>
  <joint name="one" type="revolute"><parent link="a"/><child link="b"/><origin xyz="0 0 0.1" rpy="0 1.57 0"/>
    <axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
  <joint name="two" type="prismatic">
    <origin
      xyz='0.1 0 0'/>
    <parent link="b"/><child link="c"/><axis xyz="1 0 0"/><limit lower="0" upper="1" effort="1" velocity="1"/>
    <mimic joint="one" multiplier="0.5" offset="0.1"/></joint>
</robot>
"""

_XACRO = b"""<?xml version="1.0"?>
<robot name="x" xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:arg name="size" default="0.2"/>
  <xacro:property name="l" value="$(arg size)"/>
  <xacro:property name="table" value="${dict(a=1, b=[1, 2, 3])}"/>
  <xacro:macro name="arm" params="name parent:=base *origin **rest k:=^|1.0">
    <link name="${name}"/>
    <joint name="${name}_joint" type="revolute"><xacro:insert_block name="origin"/>
      <parent link="${parent}"/><child link="${name}"/><axis xyz="0 0 ${k * 1}"/>
      <limit lower="${-pi/2}" upper="${radians(90)}" effort="1" velocity="1"/></joint>
    <xacro:insert_block name="rest"/>
  </xacro:macro>
  <link name="base"/>
  <xacro:arm name="one" k="1.0"><origin xyz="0 0 ${l + 0.1}" rpy="0 ${sin(1)} 0"/>
    <rest><link name="u"/></rest></xacro:arm>
  <xacro:if value="${len(table['b']) == 3}"><xacro:arm name="two" parent="one">
    <origin xyz="0 0 ${table['a']}"/><rest/></xacro:arm></xacro:if>
  <xacro:unless value="false"><joint name="f" type="fixed"><parent link="two"/><child link="u"/></joint></xacro:unless>
</robot>
"""

_XACRO_TOKENS = (
    *(
        b"${xacro.load_yaml('/etc/hostname')}",
        b"${open('/etc/hostname').read()}",
        b"${().__class__}",
    ),
    *(
        b"$(find calib)",
        b"$(env HOME)",
        b"$(cwd)",
        b"$(eval 1+1)",
        b"$(dirname)",
        b"$(anon x)",
        b"${9**9**9}",
    ),
    *(
        b"${'a'*10**9}",
        b"${range(10**9)}",
        b"${list(range(10**8))}",
        b"${[0]*10**9}",
        b"${1<<10**9}",
    ),
    *(b'<xacro:include filename="/etc/passwd"/>', b'<xacro:include filename="robot.urdf.xacro"/>'),
    *(
        b'<xacro:include filename="*"/>',
        b"${name}",
        b"${python}",
        b"${xacro.__dict__}",
        b"${lambda: 1}",
    ),
    *(
        b'<xacro:macro name="arm"><xacro:arm/></xacro:macro>',
        b'<xacro:property name="l" value="${l}"/>',
    ),
)

_XML_TOKENS = (
    b'<!DOCTYPE robot [<!ENTITY x SYSTEM "file:///etc/hostname">]>',
    b'<!DOCTYPE r [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;">]>',
    b'<?xml version="1.0" encoding="latin-1"?>',
    b'<?xml version="1.1" encoding="utf-16"?>',
    *(
        b"planar",
        b"floating",
        b"continuous",
        b"fixed",
        b"mimic",
        b"origin",
        b"joint",
        b"link",
        b"transmission",
    ),
    *(
        b"xyz",
        b"rpy",
        b"robot",
        b"mesh",
        b"filename",
        b"package://",
        b'<mimic joint="one"/>',
        b"<link/>",
        b"<joint/>",
    ),
)

_CONF = """\
[mounting]
delta_theta = {theta} # rad
delta_a = {a}
delta_d = {d}
delta_alpha={alpha}
joint_checksum = [ 0xb84e3393, 0xb858ac7b, 0x3948d4db, 0xa6e947f5, 0xa6e1a65c, 0xa6fdfb5d]
calibration_status = 2 # 0 == notInitialized / 2 == Linearised
"""

_URCONTROL = b"""\
[Hardware]
controller = 5
[DH]
a = [0.00000, -0.42500, -0.39220, 0.00000, 0.00000, 0.0000] # m
d = [0.1625, 0.00000, 0.00000, 0.1333, 0.0997, 0.0996]
alpha = [ 1.570796327, 0, 0, 1.570796327, -1.570796327, 0 ]
q_home_offset = [0, -1.570796327, 0, -1.570796327, 0, 0]
[Tool]
tcp_pose = [0, 0, 0, 0, 0, 0]
"""

_YAML_TOKENS = (
    *(
        b"kinematics:",
        b"origins:",
        b"hash:",
        b"shoulder:",
        b"x:",
        b"xyz:",
        b"rpy:",
        b"!degrees 1",
        b"!radians 1",
    ),
    *(
        b"{<<: *x}",
        b"&x",
        b"!!binary aa",
        b"!!set {a}",
        b"!!timestamp 2020-01-01",
        b"2020-99-99",
        b"1:60:60",
        b"0o7",
    ),
    *(
        b"---",
        b"...",
        b"%YAML 9.9",
        b"%TAG ! x",
        b"? [a]",
        b"~",
        b".nan",
        b".inf",
        b"? {a: b}\n: c",
        b"!!int x",
    ),
)

_OBJ = b"""mtllib ../../../etc/passwd
o part
v 0 0 0
v 1 0 0
v 0 1 0
v 0 0 1
vn 0 0 1
vt 0 0
usemtl a
f 1 2 3
f 1/1/1 2/1/1 4/1/1
usemtl b
f 2//1 3//1 4//1
f 1 3 4
"""

_STL = b"""solid a
facet normal 0 0 1
outer loop
vertex 0 0 0
vertex 1 0 0
vertex 0 1 0
endloop
endfacet
endsolid a
"""


def _example(ending: str, largest: int, *, count: int = 40) -> list[bytes]:
    """Files of example-robot-data, the small ones, of many robots."""
    files = importlib.metadata.files("example-robot-data") or []
    paths = sorted(Path(str(f.locate())) for f in files if f.name.lower().endswith(ending))
    small = [path for path in paths if path.is_file() and 0 < path.stat().st_size <= largest]
    step = max(1, len(small) // count)
    return [path.read_bytes() for path in small[::step]]


def _urdfs() -> list[bytes]:
    """Whole robots, and a small one several times: most mutations of a large file hit nothing of interest."""
    own = [path.read_bytes() for path in sorted(_URDF.glob("*.urdf"))]
    return [*[_SMALL] * 20, *own, *_example(".urdf", _LARGEST_URDF)]


def _read_urdf(data: bytes) -> None:
    """Tree, chain, poses, shapes; an origin changed and the whole read again."""
    urdf = Urdf.from_bytes(data, "robot.urdf")
    list(link_shapes(urdf, "visual"))
    list(link_shapes(urdf, "collision"))
    robot = Robot.from_urdf(urdf)
    robot.poses(np.zeros(len(robot.joint_names)))
    placements = robot.placements.copy()
    movable = [i for i, carrier in enumerate(robot.carriers) if carrier is not None]
    placements[movable, 0, 3] += 1e-4
    robot.with_placements(placements)


def _write_urdf(data: bytes) -> None:
    """What is written, read back by Pinocchio and yourdfpy."""
    robot = Robot.from_urdf(Urdf.from_bytes(data, "robot.urdf"))
    q = random_joint_values(robot, 2)
    check_written(robot, robot.poses(q), q)


def _draw_urdf(data: bytes) -> None:
    """Its shapes, as drawn and as solids for collisions."""
    urdf = Urdf.from_bytes(data, "robot.urdf")
    read_visuals(urdf)
    read_solids(urdf)


def _read_xacro(data: bytes) -> None:
    """A xacro flattened and read."""
    with as_file(data, "robot.urdf.xacro") as path:
        read_xacro(path)


def _read_included(data: bytes) -> None:
    """A xacro that includes the file."""
    head = b'<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:include filename="part.xacro"/></robot>'
    with as_file(head, "robot.urdf.xacro") as path:
        (path.parent / "part.xacro").write_bytes(data)
        read_xacro(path)


def _read_loaded(data: bytes) -> None:
    """A xacro that takes its numbers from the file."""
    with as_file(data, "ur3_origins.yaml") as path:
        xacro = path.with_name("ur3_from_origins.urdf.xacro")
        xacro.write_bytes((_URDF / xacro.name).read_bytes())
        read_xacro(xacro)


@functools.cache
def _ur5e() -> Robot:
    """A bare arm."""
    return ur_robot("UR5e")


@functools.cache
def _ur3() -> Robot:
    """The demo's arm."""
    return Robot.load(_URDF / "ur3.urdf", "base", "tool0")


def _read_conf(data: bytes) -> None:
    """A calibration.conf on an arm."""
    with as_file(data, "calibration.conf") as path:
        read_ur_conf(path, model="UR5e")


def _read_urcontrol(data: bytes) -> None:
    """A urcontrol.conf."""
    with as_file(data, "urcontrol.conf") as path:
        read_nominal(path)


def _read_ur_yaml(data: bytes) -> None:
    """A kinematics.yaml on an arm."""
    with as_file(data, "kinematics.yaml") as path:
        read_ur_yaml(path, model="UR5e")


def _read_origins(data: bytes) -> None:
    """An origins file on its robot, then as a table of DH rows."""
    robot = parse_origins(data, "origins.yaml").applied_to(_ur3())
    dh_tables(robot, _ur3())


def _read_yaml(data: bytes) -> None:
    """YAML whatever is in it; its keys too, of which the tags are left alone."""
    try:
        yaml_keys(data, "a.yaml", "file")
    except CalibError:
        parse_yaml(data, "a.yaml", "file")
        raise
    parse_yaml(data, "a.yaml", "file")


def _convert(ending: str) -> Callable[[bytes], None]:
    """What calib convert reads under that ending."""

    def read(data: bytes) -> None:
        asked = Asked(robot=str(_URDF / "ur3.urdf"), base="base", tip="tool0")
        with as_file(data, f"source{ending}") as path:
            read_source(str(path), asked)

    return read


def _mesh(ending: str) -> Callable[[bytes], None]:
    """A link with a mesh: drawn, and as a solid."""
    text = (
        f'<robot name="m"><link name="a"><visual><geometry><mesh filename="m{ending}"/></geometry></visual></link>'
        '<link name="b"/><joint name="j" type="fixed"><parent link="a"/><child link="b"/></joint></robot>'
    ).encode()

    def read(data: bytes) -> None:
        with as_file(data, f"m{ending}") as path:
            urdf = Urdf.from_bytes(text, "m.urdf", path.with_name("m.urdf"))
            read_visuals(urdf)
            read_solids(urdf)

    return read


def _confs() -> list[bytes]:
    """Files of controllers, with made-up deltas."""
    rng = np.random.default_rng(0)
    confs = []
    for size in (0.0, 1e-5, 1e-4):
        values = {k: [float(v) for v in size * rng.normal(size=6)] for k in COLUMNS}
        confs.append(_CONF.format(**values).encode())
    return confs


def _ur_yamls() -> list[bytes]:
    """A kinematics.yaml as calib writes it."""
    with as_file(b"", "x") as path:
        arm = _ur5e()
        write_ur_yaml(arm, arm, path.with_name("k.yaml"), hash="calib_1")
        return [path.with_name("k.yaml").read_bytes()]


def _origins() -> list[bytes]:
    """Origins files."""
    with as_file(b"", "x") as path:
        write_origins(_ur3(), path.with_name("o.yaml"))
        written = path.with_name("o.yaml").read_bytes()
    return [written, *(p.read_bytes() for p in sorted(_URDF.glob("*.yaml")))]


def _meshes(ending: str, *more: bytes) -> Callable[[], Sequence[bytes]]:
    """Meshes of example-robot-data."""
    return lambda: [*more * 3, *_example(ending, _LARGEST_MESH, count=8)]


def _exported(kind: str) -> Callable[[], Sequence[bytes]]:
    """A ball and a box, as trimesh writes them."""

    def files() -> list[bytes]:
        import trimesh

        shapes = (trimesh.creation.icosphere(1), trimesh.creation.box((1, 2, 3)))
        written = [shape.export(file_type=kind) for shape in shapes]
        return [text.encode() if isinstance(text, str) else text for text in written]

    return files


def _all(*lists: Callable[[], Iterable[bytes]]) -> Callable[[], list[bytes]]:
    """Files of several kinds."""
    return lambda: [data for files in lists for data in files()]


READERS = {
    reader.name: reader
    for reader in (
        Reader("urdf", _read_urdf, _urdfs, _XML_TOKENS),
        Reader("urdf-written", _write_urdf, lambda: [_SMALL], _XML_TOKENS),
        Reader("urdf-drawn", _draw_urdf, lambda: [_SMALL], _XML_TOKENS),
        Reader("xacro", _read_xacro, lambda: [_XACRO], (*_XACRO_TOKENS, *_XML_TOKENS)),
        Reader("xacro-included", _read_included, lambda: [_XACRO], (*_XACRO_TOKENS, *_XML_TOKENS)),
        Reader("xacro-yaml", _read_loaded, _origins, _YAML_TOKENS),
        Reader("yaml", _read_yaml, _all(_origins, _ur_yamls), _YAML_TOKENS),
        Reader("origins", _read_origins, _origins, _YAML_TOKENS),
        Reader("ur-yaml", _read_ur_yaml, _ur_yamls, _YAML_TOKENS),
        Reader("ur-conf", _read_conf, _confs, (b"[DH]", b"[mounting]", b"delta_d", b"[", b"]")),
        Reader("urcontrol", _read_urcontrol, lambda: [_URCONTROL], (b"[DH]", b"theta", b"[", b"]")),
        Reader("convert-yaml", _convert(".yaml"), _all(_origins, _ur_yamls), _YAML_TOKENS),
        Reader("mesh-stl", _mesh(".stl"), _meshes(".stl", _STL)),
        Reader("mesh-obj", _mesh(".obj"), _meshes(".obj", _OBJ)),
        Reader("mesh-dae", _mesh(".dae"), _meshes(".dae"), _XML_TOKENS),
        *(Reader(f"mesh-{k}", _mesh(f".{k}"), _exported(k)) for k in ("ply", "off", "glb")),
    )
}
