"""The readers of tables, cells and results for `fuzz.py`: CSV, lists of points, TOML, JSON."""

from __future__ import annotations

import contextlib
import functools
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

from fuzzing import Reader, as_file

import calib
from calib.compensate.program import Program
from calib.errors import CalibError
from calib.identify.compared import Compared
from calib.identify.result_file import read_result
from calib.measure.cell import Cell
from calib.measure.measurements import Measurements
from calib.measure.plan_file import read_taken
from calib.measure.points_file import read_points
from calib.measure.pose_list import read_pose_list
from calib.measure.region_file import RegionFile
from calib.measure.row_points import read_rows
from calib.measure.sweeps import read_sweeps
from calib.measure.truth_file import read_truth
from calib.model.robot import Robot

_ROOT = Path(__file__).resolve().parents[1]
_UR3 = _ROOT / "calib" / "data" / "ur3_leica.csv"
_JOINTS = [
    f"{name}_joint"
    for name in ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
]
_HEADER = ",".join(f"{name} [deg]" for name in _JOINTS)
_ANGLES = ("1.5,-90,20,3,4,5", "-20.25,-80,30,-3,4e0,-5", "7,-70,40,3,-4,15", "70,-60,50,33,-4,5")


def _table(header: str, *tails: str) -> bytes:
    """A table with the joint values of `_ANGLES`, and other cells behind them."""
    rows = (f"{_ANGLES[i % 4]},{tail}" for i, tail in enumerate(tails))
    return "\n".join([f"{_HEADER},{header}", *rows, ""]).encode()


_POINTS = ("100.5,200,300", "-149.02,-207.50,742.60", "10,20,30", "1,222,-333.25")
_PLAIN = _table("x [mm],y [mm],z [mm]", *_POINTS)
_QUATERNIONS = ("0,0,0,1", "0,0.6,0,0.8", "1,0,0,0", "0.5,0.5,-0.5,-0.5")

_TABLES = (
    _PLAIN,
    b"\n".join(_UR3.read_bytes().splitlines()[:12]) + b"\n",
    _PLAIN.replace(b",", b";").replace(b".", b","),
    b"# by hand\n\n" + _PLAIN.replace(b",", b"\t").replace(b"\n", b"\r\n"),
    _table(
        "x [mm],y [mm],z [mm],qx,qy,qz,qw,sigma [mm],sigma_angle [deg],target,group",
        *(f'{p},{q},0.1,0.05,"upper",morning' for p, q in zip(_POINTS, _QUATERNIONS, strict=True)),
    ),
    _table(
        "x [mm],y [mm],z [mm],rx [rad],ry [rad],rz [rad]",
        *(f"{p},0.1,-0.2,{i}" for i, p in enumerate(_POINTS)),
    ),
    _table("distance [mm],pair", "100,a", ",a", "200,b", ",b"),
    _table("distance [m],set", "0.5,estimate", "0.7,validate", "0.9,estimate"),
    _table(
        "kind,group,x [mm],y [mm],z [mm],distance [mm],pair,row",
        *("fixed,a,,,,,,1", "fixed,a,,,,,,2", "point,,1,2,300,,,3", "pair,,,,,50,k,4"),
        *("pair,,,,,50,k,5", "distance,b,,,,70,,6", *(f"plane,c,,,,,,{7 + i}" for i in range(4))),
    ),
    _table("x [mm],y [mm],z [mm],elbow_joint.torque [Nm]", *(f"{p},1.5" for p in _POINTS)),
)

_LISTS = (
    b"# Units: mm\nP1 100.0 200.0 300.0\nP2 110.0 210.0 310.0\nP3 -1 2e2 3.5\n",
    b"Units: inches\nA::Main::P1, 1.0, 2.0, 3.0, 0.01\nA::Main::P2, 4.0, 5.0, 6.0, 0.02\n",
    b"name;x [mm];y [mm];z [mm]\nP1;1,5;2,5;300,5\nP2;4,5;5,5;6,5\n",
    b"# Unit: m\r\n1\t0.1\t0.2\t0.3\r\n2\t0.4\t0.5\t0.6\r\n",
    b"Collection,Group,Point,X (mm),Y (mm),Z (mm)\nA,Main,P1,100,200,300\nA,Main,P2,110,210,310\n",
    "\ufeffpoint x y z\n# unit mm\nP1 1 2 3\nP2 4 5 600\n".encode("utf-16-le"),
)

_SWEEPS = (
    b"sweep,x [mm],y [mm],z [mm],sigma [mm]\n"
    + b"".join(
        b"%s,%d,%d.5,%d,0.1\n" % (word, 100 * k, 200 - k, 300)
        for word in (b"plane", b"joint 1", b"2")
        for k in range(4)
    ),
    _table("sweep,x [mm],y [mm],z [mm],row", *(f"joint 1,{p},{i}" for i, p in enumerate(_POINTS))),
)

_LISTED_SWEEPS = tuple(
    sign.join(
        f"{word}_{k}{{0}}{100 * k}{{0}}{200 - k}.5{{0}}300\n" for word in words for k in range(3)
    )
    .format(separator)
    .encode()
    for words, sign, separator in (
        (("plane", "joint1", "joint2"), "", " "),
        (("A::plane::", "A::joint 2::"), "# mm\n", ";"),
    )
)

_PROGRAMS = (
    (_HEADER + "\n" + "\n".join(_ANGLES) + "\n").encode(),
    b"name,x [mm],y [mm],z [mm],qx,qy,qz,qw\na,100,200,300,0,0,0,1\nb,110,210,310,0,0.6,0,0.8\n",
    b"x [m];y [m];z [m];roll [deg];pitch [deg];yaw [deg]\n0,1;0,2;0,3;1;2;3\n0,2;0,2;0,3;1;2;3\n",
    _table("x [mm],y [mm],z [mm],rx [rad],ry [rad],rz [rad]", *(f"{p},0,1,2" for p in _POINTS)),
)

_TABLE_WORDS = (
    *(b"[mm]", b"[deg]", b"[rad]", b"[m]", b"[]", b"[mm", b"]", b"row", b"set", b"kind", b"target"),
    *(b"group", b"pair", b"point", b"sigma", b"sigma_angle", b"distance", b"x", b"y", b"z"),
    *(b"qx", b"rx", b"estimate", b"validate", b"pose", b"plane", b"fixed", b"sweep", b"status"),
    *(b"expected x", b"elbow_joint", b"elbow_joint.torque", b"correction position", b"-"),
    *(b";", b"\t", b'"', b'""', b'"a\nb"', b" 1", b"1 ", b"\xc2\xa01", b"1e-400", b"1,234.5"),
)


def _file(function: Callable[[Path], object], name: str) -> Callable[[bytes], object]:
    """A reader of bytes out of a reader of a file."""

    def read(data: bytes) -> object:
        with as_file(data, name) as path:
            return function(path)

    return read


@functools.cache
def _ur3() -> Robot:
    """The robot that the tables are of."""
    return Robot.load(str(_ROOT / "urdf" / "ur3.urdf"), "base", "tool0")


def _measured(path: Path) -> None:
    """A table as `calib fit` reads it, and once more without knowing the robot."""
    with contextlib.suppress(CalibError):
        _written_back(Measurements.read(path), path)
    _written_back(Measurements.read(path, _ur3().joint_names), path)


def _written_back(table: Measurements, path: Path) -> None:
    """What was read is written, and read again."""
    other = path.with_name("again.csv")
    try:
        table.write(other, overwrite=True)
    finally:
        other.unlink(missing_ok=True)


def _matched(data: bytes) -> object:
    """A list of points alone, and beside a table that names them."""
    beside = _HEADER + ",point\n" + "".join(f"{a},P{i + 1}\n" for i, a in enumerate(_ANGLES[:3]))
    with as_file(data, "points.txt") as path:
        found = read_points(path, None)
        table = path.with_name("table.csv")
        table.write_text(beside)
        Measurements.read(table, points=path)
    return found


def _listed_sweeps(path: Path) -> object:
    """Sweeps out of a list of points."""
    return read_sweeps(points=path, points_unit="mm", joint_names=_ur3().joint_names)


def _poses(path: Path) -> None:
    """A plan as other commands take it: as poses, as taken, as rows without a measurement."""
    for function in (read_pose_list, read_taken):
        with contextlib.suppress(CalibError):
            function(path, _ur3())
    read_rows(path, _ur3())


def _cells() -> Sequence[bytes]:
    """The cell files of docs/cell.md."""
    text = (_ROOT / "docs" / "cell.md").read_text(encoding="utf-8")
    return [block.encode() for block in re.findall(r"```toml\n(.*?)```", text, re.DOTALL)]


def _results() -> Sequence[bytes]:
    """Results of the UR3's table: one with a larger model, one without."""
    with tempfile.TemporaryDirectory() as folder:
        found = []
        table = Measurements.read(_UR3, _ur3().joint_names)
        for k, model in enumerate(("dh", "dh+gain")):
            path = Path(folder) / f"{k}.json"
            calib.calibrate(_ur3(), table, model=model).write_json(path)
            found.append(path.read_bytes())
    return found


def _made(name: str, *words: str) -> bytes:
    """What a command of calib writes into the file of that name."""
    with tempfile.TemporaryDirectory() as folder:
        call = [str(Path(sys.executable).with_name("calib")), *words]
        subprocess.run(call, check=True, cwd=folder, stdout=subprocess.DEVNULL)
        return (Path(folder) / name).read_bytes()


def _regions() -> Sequence[bytes]:
    """Regions of few voxels."""
    arm = ("workspace", str(_ROOT / "urdf" / "ur3.urdf"), "--samples", "5000", "-o", "a.json")
    box = ("--within", "-300 -300 0 to 300 300 300 mm")
    return [_made("a.json", *arm), _made("a.json", *arm, *box)]


def _truths() -> Sequence[bytes]:
    """The truths of small simulated tables."""
    arm = (
        "simulate",
        str(_ROOT / "urdf" / "ur3.urdf"),
        "--base",
        "base",
        "--tip",
        "tool0",
        "-o",
        "t.csv",
    )
    more = ("--outliers", "1", "--payload", "2 kg")
    few = ("--count", "5", "--validation", "0", "--truth", "a.json")
    return [_made("a.json", *arm, *few), _made("a.json", *arm, *few, *more)]


_CELL_WORDS = (
    *(b"target", b"frame", b"known", b"estimate", b"boxes", b"frames", b"ties", b"bounds", b"held"),
    *(b"payload", b"true", b"[[a]]", b"[a.b]", b"1979-05-27", b'"0.5 mm"', b'"1e999 mm"', b"0x1F"),
    *(b"nan", b"inf", b"-inf", b"{}", b"[]", b'"*"', b'"frame_x[a]"', b'"1 mrad"'),
)
_JSON_WORDS = (
    *(b"null", b"true", b"false", b"{}", b"[]", b'""', b"NaN", b"Infinity", b"1e400", b"-1"),
    *(b"[[]]", b"[null]", b'"\\ud800"', b'"schema"', b"1" * 400, b"1.5", b"[1, 2, 3]"),
)

READERS = {
    reader.name: reader
    for reader in (
        Reader("measurements", _file(_measured, "table.csv"), lambda: _TABLES, _TABLE_WORDS),
        Reader("points", _matched, lambda: _LISTS, _TABLE_WORDS),
        Reader("sweeps", _file(read_sweeps, "sweeps.csv"), lambda: _SWEEPS, _TABLE_WORDS),
        Reader(
            "sweep-points", _file(_listed_sweeps, "p.txt"), lambda: _LISTED_SWEEPS, _TABLE_WORDS
        ),
        Reader("plans", _file(_poses, "plan.csv"), lambda: _TABLES, _TABLE_WORDS),
        Reader(
            "programs",
            _file(lambda path: Program.read(path, _ur3()), "program.csv"),
            lambda: _PROGRAMS,
            _TABLE_WORDS,
        ),
        Reader("cells", _file(Cell.read, "cell.toml"), _cells, _CELL_WORDS),
        Reader("results", _file(read_result, "result.json"), _results, _JSON_WORDS),
        Reader(
            "comparisons",
            _file(lambda path: Compared.of(path, "a"), "result.json"),
            _results,
            _JSON_WORDS,
        ),
        Reader("regions", _file(RegionFile.read, "region.json"), _regions, _JSON_WORDS),
        Reader(
            "truths",
            _file(lambda path: read_truth(path, _ur3()), "truth.json"),
            _truths,
            _JSON_WORDS,
        ),
    )
}
