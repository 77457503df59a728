"""Files of DH rows: what they say, and the place of each fault."""

from __future__ import annotations

import copy
import json

import numpy as np
import pytest

from calib.errors import CalibError, FileError, MeasurementError, ModelError
from calib.example import paper_measurements
from calib.robot.dh_file import is_other_table, read_dh_robot, robot_json, robot_of_json
from calib.robot.dh_rows import DHRobot, DHRow, DHTable

HEADER = (
    "joint,theta [deg],d [mm],a [mm],alpha [deg],direction,offset [deg],lower [deg],upper [deg]"
)
ROWS = ("J1,0,400,25,-90,-1,10,-170,170", "J2,5,0,455,0,1,,-100,100")


@pytest.fixture
def written(tmp_path):
    """Writes lines to a file and reads its robot."""

    def read(*lines, name="arm.csv"):
        path = tmp_path / name
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")
        return read_dh_robot(path)

    return read


def test_a_table(written):
    robot = written("# robot: my arm", "# base: world", "# tip = hand", HEADER, *ROWS)
    assert (robot.name, robot.base, robot.tip) == ("my arm", "world", "hand")
    assert robot.table.convention == "standard"
    first, second = robot.table.rows
    deg = np.pi / 180
    assert first == DHRow(
        "J1", False, 0, 0.4, 0.025, -90 * deg, 0, -1, 10 * deg, -170 * deg, 170 * deg
    )
    assert second == DHRow("J2", False, 5 * deg, 0, 0.455, 0, 0, 1, 0, -100 * deg, 100 * deg)
    assert robot.coupling == {}
    assert [row.line for row in robot.table.rows] == [5, 6]  # after three comments and the header
    np.testing.assert_array_equal(robot.table.T_base_0, np.eye(4))


def test_names_and_links_of_a_table_without(written):
    robot = written("d [m];a [m];alpha [rad]", "0,5;0;1,5", "0;0,25;0", name="box.tsv")
    assert (robot.name, robot.base, robot.tip) == ("box", "base", "flange")
    assert robot.joint_names == ("joint_1", "joint_2")
    assert robot.table.rows[0] == DHRow("joint_1", False, 0.0, 0.5, 0.0, 1.5)


@pytest.mark.parametrize(
    ("lines", "convention"),
    [
        (["d [mm],a [mm],alpha [deg]", "1,2,3"], "standard"),
        (["d_i [mm],a_i [mm],alpha_i [deg]", "1,2,3"], "standard"),
        (["d [mm],a(i-1) [mm],alpha(i-1) [deg]", "1,2,3"], "modified"),
        (["d_i [mm],a_{i-1} [mm],α_i-1 [deg]", "1,2,3"], "modified"),
        (["d [mm],a [mm],alpha [deg],beta [deg]", "1,2,3,"], "hayati"),
        (["# convention: Craig", "d [mm],a [mm],alpha [deg]", "1,2,3"], "modified"),
        (["d [mm],a [mm],alpha [deg],convention", "1,2,3,hayati"], "hayati"),
        (["# convention: standard", "d [mm],a [mm],alpha [deg],convention", "1,2,3,"], "standard"),
    ],
)
def test_the_convention(written, lines, convention):
    robot = written(*lines)
    assert robot.table.convention == convention
    row = robot.table.rows[0]
    assert (row.d, row.a) == (1e-3, 2e-3)
    assert row.alpha == pytest.approx(np.radians(3))


def test_sliding_joints_and_units_in_cells(written):
    robot = written(
        "joint,type,d [mm],a [mm],alpha [deg],offset [mm],offset [deg],lower,upper",
        "lift,prismatic,10,0,0,5,,0,300 mm",
        "turn,R,0,0,90 ,,-90,-90 deg,1.5 rad",
    )
    lift, turn = robot.table.rows
    assert (lift.prismatic, lift.offset, lift.lower, lift.upper) == (True, 0.005, 0.0, 0.3)
    assert (turn.prismatic, turn.upper) == (False, 1.5)
    assert turn.offset == turn.lower == -np.pi / 2


def test_constant_poses(written):
    header = "joint,d [mm],a [mm],alpha [deg],x [mm],y [mm],z [mm],roll [deg],pitch [deg],yaw [deg]"
    robot = written(header, "base,,,,1,2,3,90,0,0", "J1,5,6,7,,,,,,", "tool,,,,,,4,,,90")
    T = robot.table.T_base_0
    np.testing.assert_allclose(T[:3, 3], [0.001, 0.002, 0.003])
    np.testing.assert_allclose(T[:3, :3], [[1, 0, 0], [0, 0, -1], [0, 1, 0]], atol=1e-15)
    T = robot.table.T_n_tip
    np.testing.assert_allclose(T[:3, 3], [0, 0, 0.004])
    np.testing.assert_allclose(T[:3, :3], [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-15)


def test_of_the_tables_of_a_file_the_last_state_is_read(written):
    lines = ["table,row,joint,d [mm],a [mm],alpha [deg]"]
    for table, d in (("before", 1), ("after", 2), ("change", 3)):
        lines += [f"{table},base,,,,", f"{table},1,base,{d},0,0", f"{table},tool,,,,"]
    with pytest.raises(MeasurementError, match="a constant pose needs the columns"):
        written(*lines)
    rows = [line for line in lines if ",base,," not in line and "tool" not in line]
    robot = written(*rows)
    assert robot.joint_names == ("base",)  # a name, for the column 'row' has the places
    assert robot.table.rows[0].d == 0.002


FAULTS = [
    (["# convention: denavit", HEADER, *ROWS], "'denavit' is not a convention"),
    (["d [mm],a(i-1) [mm],alpha [deg]", "1,2,3"], "two conventions"),
    (["d [mm],a(i-1) [mm],alpha(i-1) [deg],beta [deg]", "1,2,3,4"], "two conventions"),
    (["# convention: standard", "d [mm],a [mm],alpha [deg],beta [deg]", "1,2,3,4"], "two conv"),
    (["d [mm],a [mm],alpha [deg],convention", "1,2,3,craig", "1,2,3,hayati"], "two conventions"),
    (
        ["d [mm],a [mm],alpha [deg],convention", "1,2,3,odd"],
        r"line 2 \(row 1\), column 'conv.*'odd'",
    ),
    (["d [mm],alpha [deg]", "1,2"], "'a' is missing"),
    (
        ["d,a [mm],alpha [deg]", "7,2,3"],
        r"line 2.*column 'd': the number 7 has no unit.*'d \[mm\]'",
    ),
    (["d [deg],a [mm],alpha [deg]", "7,2,3"], r"column 'd \[deg\]': 'deg' is not a unit"),
    (["d [mm],a [mm],alpha [deg],dirction", "7,2,3,1"], "did you mean 'direction'"),
    (["d [mm],a [mm],alpha [deg],d [m]", "7,2,3,1"], r"another column 'd \[mm\]'"),
    (["d [mm],a [mm],alpha [deg],lower", "7,2,3,-9 mm"], "'-9 mm' is a length; an angle is wanted"),
    (
        [HEADER, ROWS[0], "J1,0,0,0,0,1,0,,"],
        r"line 3 \(row 2\), column 'joint': a second joint 'J1'",
    ),
    ([HEADER, "J1,0,x,0,0,1,0,,"], r"column 'd \[mm\]': 'x' is not a number"),
    ([HEADER, "J1,0,0,0,0,1,0,170,-170"], r"column 'upper \[deg\]': .*lower must be less"),
    ([HEADER, "J1,0,0,0,0,1,0,,170"], "has one limit"),
    (["joint,type,d [mm],a [mm],alpha [deg]", "J1,prismatic,1,2,3"], "slides and has no limits"),
    (["joint,type,d [mm],a [mm],alpha [deg]", "J1,round,1,2,3"], "'round' is not a type"),
    (["joint,coupling,d [mm],a [mm],alpha [deg]", "J1,1 * J9,1,2,3"], "column 'coupling'.*'J9'"),
    (["joint,coupling,d [mm],a [mm],alpha [deg]", "J1,1 * J1,1,2,3"], "the joint itself"),
    (["joint,d [mm],a [mm],alpha [deg],x [mm]", "J1,1,2,3,4"], "only the lines 'base' and 'tool'"),
    (["joint,d [mm],a [mm],alpha [deg],x [mm]", "J1,1,2,3,", "base,1,,,4"], "has no d"),
    (["joint,d [mm],a [mm],alpha [deg],x [mm]", "base,,,,1", "base,,,,4"], "a second line 'base'"),
    (["joint,d [mm],a [mm],alpha [deg],x [mm]", "base,,,,1"], "no row of a joint"),
    (["table,d [mm],a [mm],alpha [deg]", "then,1,2,3"], "'then' is not a table"),
    (["table,d [mm],a [mm],alpha [deg]", "before,1,2,3"], "no row of the table 'after', 'robot'"),
    (["# tip: link_1", HEADER, *ROWS], "'link_1' is empty or there twice"),
]


@pytest.mark.parametrize(("lines", "says"), FAULTS, ids=[says for _, says in FAULTS])
def test_faults_name_row_and_column(written, lines, says):
    with pytest.raises(CalibError, match=rf"arm\.csv.*{says}"):
        written(*lines)


def test_lengths_in_another_unit_than_the_heading_says(written):
    with pytest.raises(MeasurementError, match=r"column 'a'.*'a \[mm\]'"):
        written("d [m],a [m],alpha [deg]", "400,25,-90", "0,455,0", "0,35,-90")
    far = written("d [m],a [m],alpha [deg]", "0.4,0.025,-90", "36877,0.44,0", "-36873,0.03,-90")
    assert far.table.rows[1].d == 36877.0  # between nearly parallel axes


def test_other_files(written, tmp_path):
    with pytest.raises(MeasurementError, match="robot comes before the table"):
        read_dh_robot(paper_measurements())
    with pytest.raises(MeasurementError, match="does not exist"):
        read_dh_robot(tmp_path / "none.csv")
    (tmp_path / "result.json").write_text(json.dumps({"schema": 7}))
    with pytest.raises(FileError, match="'dh 1' is wanted"):
        read_dh_robot(tmp_path / "result.json")
    (tmp_path / "rows.json").write_text(json.dumps({"schema": "dh 1", "joints": []}))
    with pytest.raises(ModelError, match=r"rows\.json.*'after' is missing"):
        read_dh_robot(tmp_path / "rows.json")
    assert is_other_table(paper_measurements())
    written(HEADER, *ROWS)
    assert not is_other_table(tmp_path / "arm.csv")
    assert not is_other_table("robot.urdf")


DH_ROWS = (
    DHRow("j1", False, 0.1, 0.2, 0.3, 0.4, 0.05, -1, 0.5, -1.0, 2.0),
    DHRow("j2", True, 0.1, 0.2, 0.3, 0.4, 0.0, 1, 0.05, -0.1, 0.2),
    DHRow("j3"),
)
T = np.diag([-1.0, -1.0, 1.0, 1.0])
COUPLING = {"j1": {"j3": 0.25}, "j3": {"j1": -1.0}}


def test_a_robot_comes_back():
    robot = DHRobot(DHTable(DH_ROWS, T, np.eye(4), "hayati"), "arm", "b", "t", COUPLING)
    content = json.loads(json.dumps(robot_json(robot)))
    again = robot_of_json(content, "x.json")
    assert again.table.rows == DH_ROWS
    assert again.coupling == COUPLING
    assert (again.name, again.base, again.tip) == ("arm", "b", "t")
    np.testing.assert_array_equal(again.table.T_base_0, T)
    joint = content["joints"][0]
    assert (joint["factor"], joint["others"]) == (-1.0, {"j3": -0.25})  # as a controller adds them
    for key in ("others", "lower_rad", "upper_rad"):
        del joint[key]  # of an older file
    older = robot_of_json(content, "x.json")
    assert (older.table.rows[0].lower, "j1" in older.coupling) == (None, False)


@pytest.mark.parametrize(
    ("place", "value", "says"),
    [
        (("joints", 0, "driver"), "j2", "'j1' has no value of its own"),
        (("joints", 0, "factor"), 2.0, "'j1' has no value of its own"),
        (("after", "rows", 0, "d_m"), None, "another kind"),
        (("convention",), "denavit", "not a convention"),
        (("after",), None, "another kind"),
    ],
)
def test_what_is_damaged_is_named(place, value, says):
    content = copy.deepcopy(robot_json(DHRobot(DHTable(DH_ROWS, T, T, "hayati"))))
    inner = content
    for key in place[:-1]:
        inner = inner[key]
    inner[place[-1]] = value
    with pytest.raises(ModelError, match=rf"x\.json: .*{says}"):
        robot_of_json(content, "x.json")
