"""Which robots, poses, targets and errors are shown."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
import trimesh

from calib.calibration import calibrate
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.example import PAPER_TARGET
from calib.result.calibration_file import read_result
from calib.robot.meshes import mesh_folders
from calib.robot.ranges import column_ranges, random_joint_values
from calib.robot.robot import Robot, rigid_inverse
from calib.text.verdict import reason_text
from calib.viewer.page import puppets
from calib.viewer.view import (
    MOST_ROWS,
    Puppet,
    View,
    creased,
    read_visuals,
    root_poses,
    translation,
    view_of,
    view_of_result,
    view_of_robots,
)
from tests.hard_cases import made, many_rows, with_rows


@pytest.fixture(scope="module")
def result():
    return made("paper")


@pytest.fixture(scope="module")
def stored(result, tmp_path_factory):
    """The result as its file has it."""
    return read_result(result.write_json(tmp_path_factory.mktemp("stored") / "result.json"))


def distances(view: View) -> np.ndarray:
    """From measured to predicted target in the picture, shape (2, N)."""
    return np.linalg.norm(view.measured - view.predicted, axis=2)


def test_predictions_are_those_of_the_robots_in_one_base(ur3, disturb):
    q = np.linspace(-1, 1, 12).reshape(2, 6)
    target = translation([0.0, 0.02, 0.1])
    other = disturb(ur3)
    view = View(ur3, other, q, T_base_nominal=translation([0.001, 0, 0]), nominal_target=target)
    wanted = (ur3.poses(q) @ target)[:, :3, 3] + [0.001, 0, 0]
    np.testing.assert_allclose(view.predicted, [wanted, other.poses(q)[:, :3, 3]], atol=1e-15)
    assert (view.labels, view.kinds) == (("pose 1", "pose 2"), ("pose",) * 2)
    assert not view.measures
    assert list(View(ur3, None, q).robots) == ["nominal"]


def test_of_many_rows_an_even_choice_is_shown_with_the_flagged_ones():
    c = many_rows(6000)
    view = view_of(c)
    assert 300 < len(view.q) <= MOST_ROWS
    assert view.rows == 6000
    flagged = {f"row {one.row}" for one in (*c.outliers, *c.suspects)}
    assert flagged
    assert {n for n, k in zip(view.labels, view.kinds, strict=True) if k == "flagged"} == flagged
    numbers = [int(label.removeprefix("row ")) for label in view.labels]
    assert max(np.diff(numbers)) < 20
    np.testing.assert_array_equal(view.q, c.measurements.joints[np.array(numbers) - 1])
    np.testing.assert_allclose(distances(view), view.errors, atol=1e-12)
    assert view.kinds[view.start] == "validation"


def test_every_row_is_a_pose_and_the_worst_one_held_back_is_shown_first(result):
    view = view_of(result)
    assert view.labels == tuple(f"row {row}" for row in range(1, 36))
    assert view.labels[view.start] == "row 35"
    assert [view.labels[n] for n in range(35) if view.kinds[n] == "flagged"] == ["row 11", "row 14"]
    assert view.kinds[30:] == ("validation",) * 5
    np.testing.assert_allclose(view.nominal_target[:, :3, 3], np.tile(PAPER_TARGET, (35, 1)))
    np.testing.assert_array_equal(view.calibrated_target[3, :3, 3], result.target)
    assert (view.verdict, view.note) == ("use", reason_text(result.verdict.reasons[0]))
    assert not len(view.instruments)  # measured in the base itself
    np.testing.assert_allclose(distances(view), view.errors, atol=1e-12)
    for k, who in enumerate(("nominal", "calibrated")):
        rms = np.sqrt(np.mean(view.errors[k, 30:] ** 2))
        assert rms == pytest.approx(result.errors[who]["validation"].rms, abs=1e-12)


def test_measured_points_are_shown_in_the_base_frame_and_the_tracker_where_it_stands(result):
    T = translation([2.0, -1.0, 0.4])
    T[:3, :3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    moved = replace(result.measurements, points=result.measurements.points @ T[:3, :3].T + T[:3, 3])
    setup = result.setup.placed(T[None], result.setup.T_tip_target)
    view = view_of(with_rows(replace(result, setup=setup), moved))
    np.testing.assert_allclose(view.measured, result.measurements.points, atol=1e-12)
    np.testing.assert_allclose(view.instruments, [np.linalg.inv(T)], atol=1e-12)


def test_errors_in_the_picture_are_those_of_the_tables_when_the_frame_is_found(result):
    cell = Cell(estimate_frame=True)
    found = calibrate(result.nominal, result.measurements, cell=cell, validate=False)
    view = view_of(found)
    off = np.linalg.norm(found.residual_nominal, axis=1)
    np.testing.assert_allclose(distances(view)[0], off, atol=1e-12)
    # Each of the two finds the tracker elsewhere: without that, the number would be another.
    elsewhere = distances(replace(view, T_base_nominal=np.eye(4)))[0]
    assert np.abs(elsewhere - off).max() > 1e-4
    assert len(view.instruments) == 1


def test_the_target_and_set_up_of_the_row_are_shown(ur3):
    q = random_joint_values(ur3, 60, 3)
    T = ur3.poses(q)
    points = T[:, :3, :3] @ PAPER_TARGET + T[:, :3, 3]
    frames = {"near": np.eye(4), "far": translation([2.0, 1.0, 0.5])}
    frames["far"][:3, :3] = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    far = np.arange(60) >= 30
    seen = np.where(far[:, None], points @ frames["far"][:3, :3].T + frames["far"][:3, 3], points)
    table = Measurements(
        joint_names=ur3.joint_names,
        joints=q,
        points=seen,
        groups=tuple("far" if f else "near" for f in far),
        targets=tuple("one" if k % 2 else "two" for k in range(60)),
    )
    found = calibrate(ur3, table, cell=Cell(frames=frames, model="zeros"), validate=False)
    view = view_of(found)
    np.testing.assert_allclose(view.measured, points, atol=1e-9)
    for row in (0, 1):
        t = found.setup.targets.index(table.targets[row])
        np.testing.assert_array_equal(view.calibrated_target[row], found.setup.T_tip_target[t])
    np.testing.assert_allclose(view.instruments, [np.linalg.inv(frames["far"])], atol=1e-12)


def test_one_robot_moves_one_joint_after_the_other(gantry):
    view = view_of_robots(gantry)
    moved = np.abs(view.q - view.q[0]) > 1e-12
    assert moved.sum(axis=1).max() == 1
    ranges = column_ranges(gantry)
    np.testing.assert_allclose(np.stack([view.q.min(axis=0), view.q.max(axis=0)], axis=1), ranges)
    assert f"x at {1e3 * ranges[0, 0]:.4g} mm" in view.labels
    assert f"c at {np.degrees(ranges[2, 1]):.4g} deg" in view.labels


def test_robots_and_a_table_show_what_evaluate_says(result):
    alone = view_of_robots(result.nominal, None, result.measurements, cells=[result.cell])
    assert (alone.title, alone.calibrated) == ("ur3", None)
    np.testing.assert_allclose(alone.errors[0], view_of(result).errors[0])
    both = view_of_robots(
        result.nominal, result.robot, result.measurements, cells=[result.cell] * 2
    )
    np.testing.assert_allclose(distances(both), both.errors, atol=1e-12)
    assert both.labels[both.start] == "row 35"
    assert [name for name, _ in both.names] == ["Nominal", "Calibrated"]


def test_a_stored_result_shows_the_errors_of_the_fit_from_either_robot(result, stored):
    shown = view_of_result(stored, result.nominal, result.measurements)
    fresh = view_of(result)
    np.testing.assert_allclose(shown.errors, fresh.errors, atol=1e-9)
    assert (shown.kinds, shown.start, shown.note) == (fresh.kinds, fresh.start, fresh.note)
    other = view_of_result(stored, result.robot, result.measurements)
    np.testing.assert_allclose(shown.predicted, other.predicted, atol=1e-9)
    # Row numbers of another table mean other rows.
    another = replace(result.measurements, sha256="0")
    assert "flagged" not in view_of_result(stored, result.nominal, another).kinds


def test_targets_without_a_table_are_the_result_s_or_the_cell_s(result, stored):
    of_result = view_of_result(stored, result.nominal)
    np.testing.assert_allclose(of_result.calibrated_target[0, :3, 3], result.target, atol=1e-12)
    cell = Cell().with_target([0.1, 0.2, 0.3])
    for view in (
        view_of_result(stored, result.nominal, cell=cell, known=("frame",)),
        view_of_robots(result.nominal, cells=[cell]),
    ):
        np.testing.assert_allclose(view.nominal_target[0, :3, 3], [0.1, 0.2, 0.3])
    assert not view_of_robots(result.nominal).nominal_target[0, :3, 3].any()


#: The corners of a unit cube and its twelve triangles.
CUBE = np.array(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij")).reshape(3, -1).T.astype(float)
CUBE_FACES = np.array(
    [
        [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
        [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
    ]
)  # fmt: skip


def obj(vertices, faces) -> str:
    lines = ["v {:.6f} {:.6f} {:.6f}".format(*v) for v in vertices]
    return "\n".join(lines + ["f {} {} {}".format(*f) for f in np.asarray(faces) + 1])


def test_meshes_that_are_missing_or_empty(with_mesh, tmp_path):
    urdf, file = with_mesh("../m.obj"), tmp_path / "m.obj"
    visuals, (warning,) = read_visuals(urdf)
    assert warning == "link 'a': the mesh '../m.obj' was not found; a simple shape stands for it"
    assert visuals[0].mesh is None
    assert len(visuals[1].mesh[1]) == 12  # a box
    file.write_text("no mesh")
    visuals, (warning,) = read_visuals(urdf)
    assert visuals[0].mesh is None
    assert warning.endswith("; a simple shape stands for it")
    file = tmp_path / "there.obj"
    file.write_text(obj(CUBE, CUBE_FACES))
    visuals, warnings = read_visuals(with_mesh("../there.obj"))
    assert warnings == ()
    np.testing.assert_array_equal(np.ptp(visuals[0].mesh[0], axis=0), 2)  # the scale


def test_simple_shapes_and_their_origins(with_mesh, tmp_path):
    (tmp_path / "t.obj").write_text(obj(CUBE, CUBE_FACES))
    more = """
      <visual><origin xyz="1 2 3" rpy="0 0 1.5707963267948966"/><geometry><sphere radius="0.2"/></geometry></visual>
      <visual><geometry><cylinder radius="0.2" length="0.5"/></geometry></visual>
      <visual><geometry><capsule radius="0.2" length="0.5"/></geometry></visual>
      <visual><geometry><box size="1 0 1"/></geometry></visual>
      <visual><geometry><cone/></geometry></visual>"""
    visuals, warnings = read_visuals(with_mesh("../t.obj", more))
    meshes = [v.mesh for v in visuals[1:]]
    sizes = [None if mesh is None else np.ptp(mesh[0], axis=0) for mesh in meshes]
    for size, wanted in zip(sizes[:3], [[0.4] * 3, [0.4, 0.4, 0.5], [0.4, 0.4, 0.5]], strict=True):
        np.testing.assert_allclose(size, wanted, rtol=1e-3)
    assert sizes[3:5] == [None, None]
    assert warnings == ("link 'a': a visual has no geometry that can be drawn",)
    expected = [[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]]
    np.testing.assert_allclose(visuals[1].T_link_shape, expected, atol=1e-15)


def test_vertices_are_doubled_on_edges_only():
    vertices, faces = creased(CUBE, CUBE_FACES)
    assert len(vertices) == 24  # each corner once for each of its three sides
    np.testing.assert_array_equal(vertices[faces], CUBE[CUBE_FACES])
    ball = trimesh.creation.icosphere(3)
    assert len(creased(ball.vertices, ball.faces)[0]) == len(ball.vertices)  # it has no crease


PANDA = [0.3, -0.5, 0.2, -2.0, 0.1, 1.8, 0.6]


def link_poses(robot: Robot, q) -> dict[str, np.ndarray]:
    """T_base_link of every link."""
    at = root_poses(robot, np.array(q)[None])
    return {link: rigid_inverse(at[robot.base][0]) @ T[0] for link, T in at.items()}


def alone(robot: Robot, q) -> Puppet:
    """One robot in its base."""
    q = np.atleast_2d(q)
    eye = np.broadcast_to(np.eye(4), (len(q), 4, 4))
    return Puppet.of(robot, q, read_visuals(robot.urdf)[0], eye, np.eye(4))


def test_visuals_stand_where_pinocchio_puts_them(panda):
    text = panda.urdf.data.decode()
    model = pin.buildModelFromXML(text)
    folders = [str(folder) for folder in mesh_folders(panda.urdf)]
    geometry = pin.buildGeomFromUrdfString(
        model, text, pin.GeometryType.VISUAL, package_dirs=folders
    )
    placed = geometry.createData()
    configuration = pin.neutral(model)
    configuration[:7] = PANDA
    pin.updateGeometryPlacements(model, model.createData(), geometry, placed, configuration)
    puppet = alone(panda, PANDA)
    names = [f"{puppet.links[mover]}_0" for mover, _, _ in puppet.parts]
    assert names == [o.name for o in geometry.geometryObjects]
    for (mover, _, T_mover_shape), T in zip(puppet.parts, placed.oMg, strict=True):
        at = puppet.poses[0, mover] @ T_mover_shape
        np.testing.assert_allclose(at, T.homogeneous, atol=1e-12)


def test_links_without_shapes_are_sticks(gantry, with_mesh):
    puppet = alone(gantry, [[0.0, 0.0, 0.0], [1.5, 0.0, 0.0]])
    assert puppet.links == tuple(gantry.urdf.links)
    joints = {(j.parent, j.child) for j in gantry.urdf.joints}
    assert {(puppet.links[a], puppet.links[b]) for a, b in puppet.rods} == joints
    at = [puppet.links.index(link) for link in ("rail", "bridge")]
    lengths = [np.linalg.norm(np.subtract(*puppet.poses[n, at, :3, 3])) for n in (0, 1)]
    np.testing.assert_allclose(lengths, [0.5, np.hypot(0.5, 1.5)])
    puppet = alone(Robot.from_urdf(with_mesh("gone.stl")), [0.0])
    assert len(puppet.parts) == 1  # the box
    assert [tuple(puppet.links[k] for k in rod) for rod in puppet.rods] == [("a", "b")]


@pytest.mark.parametrize("name", ["gantry", "fingers"])
def test_every_mover_is_where_the_robot_s_forward_kinematics_put_it(request, disturb, name):
    robot = request.getfixturevalue(name)
    other = disturb(robot)
    q = np.random.default_rng(2).uniform(-0.5, 0.5, (2, len(robot.joint_names)))
    shift = translation([0.01, -0.02, 0.03])
    view = View(robot, other, q, T_base_nominal=shift, nominal_target=translation([0, 0.1, 0.2]))
    shown = puppets(view, {who: read_visuals(one.urdf)[0] for who, one in view.robots.items()})
    for who, one, T_scene_base in (("nominal", robot, shift), ("calibrated", other, np.eye(4))):
        puppet = shown[who]
        for n in range(2):
            poses, tip = link_poses(one, q[n]), one.poses(q[n])[0]
            wanted = [T_scene_base @ T for T in (*(poses[k] for k in puppet.links), np.eye(4), tip)]
            np.testing.assert_allclose(puppet.poses[n, :-1], wanted, atol=1e-12)
        np.testing.assert_allclose(
            puppet.poses[:, -1, :3, 3], view.predicted[int(who != "nominal")]
        )
