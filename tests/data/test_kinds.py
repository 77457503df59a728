"""The registry of kinds: its rows, and a kind that is added from outside."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import calib
from calib.data import kinds
from calib.data.cell import TrackerNoise
from calib.data.kinds import Kind, Reading, get, names, register
from calib.errors import ArgumentError, CalibError, MeasurementError
from calib.verbs.inspect.inspection import inspect
from calib.verbs.plan.plan_file import write_plan


def line_distance(T):
    return np.hypot(T[:, 0, 3], T[:, 1, 3])[:, None]


def line_derivative(_measured, T, twists):
    across = T[:, :2, 3] / line_distance(T)
    return np.einsum("ni,nip->np", across, twists[:, :2])[:, None]


LINE = Kind(
    name="line",
    words="distance of the target from a line",
    units=("m",),
    readings=(Reading("line_distance", "length", positive=True),),
    measure=line_distance,
    derivative=line_derivative,
    directions=("x", "y", "rx", "ry"),
    own_frame=True,
    own_axes=True,
    fewest=5,
)

#: Angles of the target's z axis against the frame's, about x and y: what an inclinometer reads.
TILT = Kind(
    name="tilt",
    words="tilt of the target",
    units=("rad", "rad"),
    readings=(Reading("tilt_x", "angle"), Reading("tilt_y", "angle")),
    measure=lambda T: np.stack([-T[:, 1, 2], T[:, 0, 2]], axis=1),
    derivative=lambda _, T, twists: np.stack(
        [
            -(twists[:, 5] * T[:, 0, 2, None] - twists[:, 3] * T[:, 2, 2, None]),
            twists[:, 4] * T[:, 2, 2, None] - twists[:, 5] * T[:, 1, 2, None],
        ],
        axis=1,
    ),
    directions=("rx", "ry"),
)


@pytest.fixture
def own(monkeypatch):
    """Two kinds from outside, registered for one test."""
    monkeypatch.setattr(kinds, "_KINDS", dict(kinds._KINDS))
    register(LINE)
    register(TILT)


def poses(count, seed=0):
    T = np.tile(np.eye(4), (count, 1, 1))
    T[:, :3, :3] = Rotation.random(count, random_state=seed).as_matrix()
    T[:, :3, 3] = np.random.default_rng(seed).uniform(-1.0, 1.0, (count, 3))
    return T


def moved(T, twist):
    """Poses moved by a small twist along the frame's axes."""
    result = T.copy()
    result[..., :3, :3] = Rotation.from_rotvec(twist[3:]).as_matrix() @ T[..., :3, :3]
    result[..., :3, 3] += twist[:3]
    return result


@pytest.mark.usefixtures("own")
@pytest.mark.parametrize(
    ("name", "size"),
    [
        ("point", 3),
        ("pose", 12),
        ("distance", 1),
        ("pair", 1),
        ("fixed", 0),
        ("plane", 0),
        ("face", 0),
        ("clasp", 0),
        ("line", 1),
        ("tilt", 2),
    ],
)
def test_a_row_has_as_many_numbers_as_its_instrument_reads(name, size):
    """A point is three numbers, a rotation matrix nine; a socket and a plane read none."""
    kind, T = get(name), poses(6)
    if kind.paired:
        T = np.stack([T, poses(6, 1)], axis=1)
    assert kind.size == size
    if kind.measure is not None and size:
        assert kind.measure(T).shape == (6, size)


@pytest.mark.usefixtures("own")
@pytest.mark.parametrize(
    ("name", "measures_length", "free", "coordinates"),
    [
        ("point", True, True, True),
        ("pose", True, True, True),
        ("distance", True, True, False),
        ("pair", True, False, False),
        ("fixed", False, False, True),
        ("plane", False, False, False),
        ("face", False, False, False),
        ("clasp", False, False, True),
        ("line", True, True, False),
        ("tilt", False, True, False),
    ],
)
def test_what_a_row_says_of_lengths_and_places(name, measures_length, free, coordinates):
    """A socket and a plane know no unit of length and hold the target; a pair takes two rows."""
    kind = get(name)
    assert kind.measures_length == measures_length
    assert kind.free == free
    assert kind.coordinates == coordinates


#: Normals, and the least turns that bring them, or their opposites, to z.
PLANES = {
    "slope": ([0.0, 0.6, 0.8], [[1.0, 0.0, 0.0], [0.0, 0.8, -0.6], [0.0, 0.6, 0.8]]),
    "overhang": ([0.0, 0.8, -0.6], [[1.0, 0.0, 0.0], [0.0, -0.6, -0.8], [0.0, 0.8, -0.6]]),
    "wall": ([1.0, 0.0, 0.0], [[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]),
    "floor": ([0.0, 0.0, 1.0], np.eye(3)),
}


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("case", PLANES)
def test_a_planes_frame_is_as_near_to_the_base_as_can_be(case, side):
    """Whichever side its normal was on, however its frame stood in it: by a fit, and settled after another."""
    normal, turn = PLANES[case]
    expected = np.eye(4)
    expected[:3, :3], expected[2, 3] = turn, -0.3
    kind, along_plane = get("plane"), np.eye(4)
    along_plane[:3, :3] = Rotation.from_euler("z", 1.1).as_matrix()
    along_plane[:2, 3] = 0.4, -0.7
    over = np.diag([1.0, side, side, 1.0])
    np.testing.assert_allclose(kind.settle(over @ along_plane @ expected), expected, atol=1e-14)
    in_plane = np.random.default_rng(1).uniform(-1.0, 1.0, (6, 2))
    points = 0.3 * np.array(normal) + in_plane @ np.array(turn)[:2]
    found = kind.locate(points, np.zeros((6, 0)), np.eye(4))
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_sockets_and_anchors_are_found_in_frames_turned_as_they_are():
    place, points = np.array([0.3, -0.2, 0.6]), poses(8)[:, :3, 3]
    guess = poses(1, 3)[0]
    expected = guess.copy()
    expected[:3, 3] = -guess[:3, :3] @ place
    lengths = np.linalg.norm(points - place, axis=1)[:, None]
    anchor = get("distance").locate(points, lengths, guess)
    np.testing.assert_allclose(anchor, expected, atol=1e-12)
    around = place + np.array([[0.1, 0.0, 0.0], [-0.1, 0.2, 0.0], [0.0, -0.2, 0.0]])
    socket = get("fixed").locate(around, np.zeros((3, 0)), guess)
    np.testing.assert_allclose(socket, expected, atol=1e-14)


def test_a_face_has_its_height_and_tilts_whichever_side_its_axis_points_to():
    kind, T = get("face"), poses(1)
    T[0, :3, 3] = 0.5, -0.4, 2e-3
    for side in (1.0, -1.0):
        # By 3 deg about x, then by any turn of the face about its axis.
        T[0, :3, :3] = Rotation.from_euler("x", 3.0, degrees=True).as_matrix()
        T[0, :3, :3] = T[0, :3, :3] @ Rotation.from_euler("z", 70.0, degrees=True).as_matrix()
        T[0, :3, :3] = T[0, :3, :3] @ np.diag([1.0, side, side])
        tilt = np.sin(np.deg2rad(3.0))
        residual = kind.residual_of(np.zeros((1, 0)), T)
        np.testing.assert_allclose(residual, [[-2e-3, -tilt, 0.0]], atol=1e-15)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_plane_is_found_from_the_faces_on_it_even_from_one_place(side):
    rng = np.random.default_rng(3)
    expected = np.eye(4)
    expected[:3, :3], expected[2, 3] = PLANES["slope"][1], -0.3
    on_plane = np.tile(np.eye(4), (3, 1, 1))
    turns = Rotation.from_euler("z", rng.uniform(-3.0, 3.0, (3, 1))).as_matrix()
    on_plane[:, :3, :3] = turns @ np.diag([1.0, side, side])
    on_plane[:, :2, 3] = 0.2, -0.1
    found = get("face").locate(np.linalg.inv(expected) @ on_plane, np.zeros((3, 0)), np.eye(4))
    np.testing.assert_allclose(found, expected, atol=1e-14)


def test_a_clasp_is_found_where_the_hand_is_on_average():
    kind, T = get("clasp"), poses(1)
    spread = [moved(T, sign * twist)[0] for twist in 1e-3 * np.eye(6) for sign in (1.0, -1.0)]
    frame = kind.locate(np.array(spread), np.zeros((12, 0)), np.eye(4))
    np.testing.assert_allclose(frame @ T[0], np.eye(4), atol=1e-9)
    assert kind.vector_units == ("m", "rad")


@pytest.mark.usefixtures("own")
@pytest.mark.parametrize(
    "name",
    ["point", "pose", "distance", "pair", "fixed", "plane", "face", "clasp", "line", "tilt"],
)
def test_derivatives_against_differences_and_what_is_measured_has_no_residual(name):
    kind, T = get(name), poses(6)
    if kind.paired:
        T = np.stack([T, poses(6, 1)], axis=1)
    measured = np.zeros((6, kind.size))
    if kind.measure is not None:
        measured = kind.measure(T)
        np.testing.assert_allclose(kind.residual_of(measured, T), 0.0, atol=1e-14)
        measured = measured + 1e-3
        if kind.orientation:
            measured[:, 3:] = poses(6, 2)[:, :3, :3].reshape(-1, 9)
    twists = np.broadcast_to(np.eye(6), (6, 6, 6))
    if kind.paired:  # the first of both rows moves
        twists = np.stack([twists, np.zeros((6, 6, 6))], axis=1)
    found = kind.derivative(measured, T, twists)
    assert found.shape == (6, len(kind.units), 6)
    for k in range(6):
        step = 1e-6 * np.eye(6)[k]
        ends = [T.copy(), T.copy()]
        for end, sign in zip(ends, (1.0, -1.0), strict=True):
            if kind.paired:
                end[:, 0] = moved(T[:, 0], sign * step)
            else:
                end[:] = moved(T, sign * step)
        high, low = (kind.residual_of(measured, end) for end in ends)
        np.testing.assert_allclose(found[:, :, k], (low - high) / 2e-6, atol=1e-8)


@pytest.mark.usefixtures("own")
def test_a_name_is_given_once():
    before = names()
    angle = Reading("line_distance", "angle")
    wire = replace(LINE, name="wire", units=("rad",), readings=(angle,))
    for kind, named in ((LINE, "'line'"), (wire, "'line_distance'")):
        with pytest.raises(CalibError, match=named):
            register(kind)
    assert names() == before
    for change, fault in (
        ({"measure": None}, "needs 'residual' or 'measure'"),
        ({"units": ()}, "needs 'units'"),
        ({"orientation": True}, "needs 'position' too"),
        ({"units": ("mm",)}, "has 'mm' among its units; allowed are 'm', 'rad'"),
        ({"position": True}, "its first three units are those of x, y and z"),
        ({"units": ("m", "m")}, "units 'm', 'm' for the measured numbers .'line_distance'."),
        ({"units": ("px",)}, "unit 'px', of the quantity 'pixel', for 'line_distance'"),
        ({"position": True, "orientation": True, "units": ("m",) * 3}, "cannot be subtracted"),
    ):
        with pytest.raises(CalibError, match=fault):
            replace(LINE, **change)
    with pytest.raises(MeasurementError, match=r"no kind of measurement 'lines' .* 'line', 'tilt'"):
        get("lines")


@pytest.mark.parametrize(("quantity", "hint"), [("px", "'px' is a unit of 'pixel'"), ("mass", "")])
def test_a_reading_of_an_unknown_quantity_is_refused(quantity, hint):
    with pytest.raises(
        CalibError, match=f"'u' has the quantity '{quantity}'; allowed are"
    ) as caught:
        Reading("u", quantity)
    assert hint in str(caught.value)


@pytest.mark.usefixtures("own")
def test_a_kind_with_a_wrong_function_is_not_registered():
    before = names()
    with pytest.raises(CalibError, match="'edge': 'derivative' does not agree"):
        register(replace(LINE, name="edge", derivative=lambda *given: -line_derivative(*given)))
    with pytest.raises(ArgumentError, match="'kind'"):
        register("edge")
    assert names() == before


@pytest.mark.usefixtures("own")
def test_tables_of_kinds_from_outside(tmp_path):
    path = tmp_path / "data.csv"
    path.write_text("a [deg],line_distance [mm]\n1,500\n2,\n3,510\n4,1\n5,2\n6,3\n")
    m = calib.Measurements.read(path)
    assert (set(m.kinds), m.unmeasured) == ({"line"}, (2,))
    np.testing.assert_allclose(m.readings["line_distance"][:2], [0.5, 0.51])
    path.write_text("a [deg],line_distance [mm]\n1,500\n")
    with pytest.raises(MeasurementError, match="it takes 5 rows or more"):
        calib.Measurements.read(path)
    for header, cell, says in (
        ("line_distance", "500", "no unit"),
        ("line_distance [deg]", "500", "not a unit of length"),
        ("line_distance [m]", "500", "further from the origin than 100 m"),
        ("line_distance [mm]", "-300", "'line_distance' is -0.3; .* a number from 1e-15"),
        ("line_distance [mm]", "five", "line 2 .row 1., column 'line_distance .mm.'"),
    ):
        path.write_text(f"a [deg],{header}\n1,{cell}\n")
        with pytest.raises(MeasurementError, match=says):
            calib.Measurements.read(path)
    header = "kind,a [deg],x [mm],y [mm],z [mm],line_distance [mm],tilt_x [deg],tilt_y [mrad],group"
    rows = [f"line,{i},,,,{500 + i},,,edge" for i in range(5)]
    path.write_text("\n".join([header, *rows, "point,1,100,200,300,,,,", "tilt,2,,,,,3,-4,"]))
    m = calib.Measurements.read(path)
    m.write(tmp_path / "again.csv")
    again = calib.Measurements.read(tmp_path / "again.csv")
    assert again.kinds == m.kinds == ("line",) * 5 + ("point", "tilt")
    for name in ("line_distance", "tilt_x", "tilt_y"):
        np.testing.assert_array_equal(again.readings[name], m.readings[name])
    np.testing.assert_allclose(m.readings["tilt_x"][-1], np.deg2rad(3.0))
    assert m.select(m.of_kind("point")).readings == {}


@pytest.mark.slow
@pytest.mark.usefixtures("own")
@pytest.mark.parametrize("count", [60, 2000])
def test_a_kind_from_outside_is_simulated_fitted_and_cross_validated(ur3, count):
    line = np.array([[0, 1, 0, 0.2], [0, 0, 1, 0.6], [1, 0, 0, 0], [0, 0, 0, 1.0]])
    cell = calib.Cell(target=[0.05, 0.05, 0.05], kind="line", T_frame_base=line, model="zeros")
    scenario = calib.Scenario(ur3, cell=cell, model="zeros", noise=TrackerNoise(2e-5, 0, 0))
    virtual = scenario.draw(seed=1)
    data = virtual.measure(scenario.random_poses(count, seed=1), seed=1).measurements
    result = calib.calibrate(ur3, data, cell=cell)
    assert result.errors["calibrated"]["estimation"]["m"].rms == pytest.approx(2e-5, rel=0.3)
    assert (
        result.cross_validation.errors["m"].rms
        < 0.1 * result.trust.nominal_cross_validation.errors["m"].rms
    )
    for p in result.parameters:
        if p.name.endswith(".zero") and p.identifiable:
            assert abs(p.value - virtual.truth.value(p.name)) < 4.5 * p.std


@pytest.mark.usefixtures("own")
def test_rows_of_angles_alone_stand_beside_points(ur3):
    """An inclinometer tells angles: with points of the tracker it has a noise of its own."""
    scenario = calib.Scenario(ur3, cell=calib.Cell(target=[0.05, 0.05, 0.05]), model="zeros")
    virtual = scenario.draw(seed=3)
    q = scenario.random_poses(80, seed=3)
    points = virtual.measure(q[:60], seed=3).measurements
    noise = np.random.default_rng(4).normal(0.0, 1e-4, (20, 2))
    tilts = TILT.measure(virtual.truth.poses(q[60:])) + noise
    kinds_ = ("point",) * 60 + ("tilt",) * 20
    nowhere, empty = np.full((20, 3), np.nan), np.full(60, np.nan)
    data = calib.Measurements(
        points.joint_names,
        np.vstack([points.joints, q[60:]]),
        np.vstack([points.points, nowhere]),
        kinds=kinds_,
        readings={
            "tilt_x": np.r_[empty, tilts[:, 0]],
            "tilt_y": np.r_[empty, tilts[:, 1]],
        },
    )
    result = calib.calibrate(ur3, data, cell=replace(scenario.cell, model="zeros"), validate=False)
    assert result.rows.residual_calibrated[60:, :2].std() == pytest.approx(1e-4, rel=0.4)
    assert np.all(np.isfinite(result.rows.residual_calibrated[result.rows.channels.used]))


@pytest.mark.slow
@pytest.mark.usefixtures("own")
def test_poses_are_inspected_and_planned_for_a_kind_from_outside(ur3, tmp_path):
    line = np.array([[0, 1, 0, 0.2], [0, 0, 1, 0.6], [1, 0, 0, 0], [0, 0, 0, 1.0]])
    cell = calib.Cell(target=[0.05, 0.05, 0.05], kind="line", T_frame_base=line, model="zeros")
    observability = inspect(ur3, cell).observability
    assert 0 < observability.rank < observability.columns
    found = calib.plan(ur3, cell, calib.PlanRequest(12, 0, candidates=200))
    written = write_plan(found, tmp_path / "plan.csv").read_text().splitlines()
    assert "line_distance [mm],expected line_distance [mm]" in written[0]
    T = np.tile(np.eye(4), (12, 1, 1))
    T[:, :3, 3] = found.expected[:, 0]
    expected = [float(row.split(",")[-1]) for row in written[1:]]
    np.testing.assert_allclose(expected, 1e3 * line_distance(T)[:, 0], atol=1e-3)
