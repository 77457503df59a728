"""The mount's origin alone is changed, and the optical frame comes out where it was wanted, by other readers too."""

from __future__ import annotations

import contextlib
import difflib
import io
import itertools

import numpy as np
import pinocchio as pin
import pytest
import yourdfpy
from scipy.spatial.transform import Rotation

from calib.errors import UrdfError
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf, robot_data_urdfs
from calib.verbs.convert import fixed_frames
from calib.verbs.convert.fixed_frames import (
    check_fixed_frame,
    fixed_pose,
    mount_joint,
    moved_along,
    with_fixed_link,
    with_moved_mount,
)
from tests.verbs.convert.camera_arms import CAMERA, T_TOOL_OPTICAL, pose, urdf_with_camera

MOUNT = "camera_mount_joint"
OPTICAL = "color_optical"


def by_pinocchio(urdf: Urdf, link: str, frame: str) -> np.ndarray:
    model = pin.buildModelFromXML(urdf.data.decode())
    data = model.createData()
    q = pin.randomConfiguration(model, -np.ones(model.nq), np.ones(model.nq))
    pin.framesForwardKinematics(model, data, q)
    poses = [data.oMf[model.getFrameId(name, pin.FrameType.BODY)] for name in (link, frame)]
    return (poses[0].inverse() * poses[1]).homogeneous


def by_yourdfpy(urdf: Urdf, link: str, frame: str) -> np.ndarray:
    model = yourdfpy.URDF.load(
        io.BytesIO(urdf.data),
        build_scene_graph=True,
        load_meshes=False,
        load_collision_meshes=False,
    )
    return model.get_transform(frame, link)


def changed_lines(before: Urdf, after: Urdf) -> list[str]:
    lines = difflib.ndiff(before.data.decode().splitlines(), after.data.decode().splitlines())
    return [line for line in lines if line[0] in "+-"]


@pytest.mark.parametrize("joint", [MOUNT, "camera_body_joint", "color_optical_joint"])
def test_the_optical_frame_comes_out_exactly_and_one_line_changes(joint):
    before = urdf_with_camera()
    after = with_moved_mount(before, "tool0", OPTICAL, joint, T_TOOL_OPTICAL)
    for read in (by_pinocchio, by_yourdfpy):
        T = read(after, "tool0", OPTICAL)
        np.testing.assert_allclose(T, T_TOOL_OPTICAL, rtol=0, atol=1e-9)
    removed, added = changed_lines(before, after)
    assert (removed[0], added[0]) == ("-", "+")
    others = {j.name for j in before.joints} - {joint}
    for name in others:
        np.testing.assert_array_equal(
            before.joint(name).T_parent_joint, after.joint(name).T_parent_joint
        )


def test_what_hangs_below_the_mount_is_kept_and_goes_along():
    """The optical frame is not the mount: 34 mm lie between them here."""
    before = urdf_with_camera()
    after = with_moved_mount(before, "tool0", OPTICAL, MOUNT, T_TOOL_OPTICAL)
    T = by_pinocchio(after, "camera_mount", OPTICAL)
    body = Rotation.from_euler("xyz", [0.0, 0.02, 0.0])
    optical = Rotation.from_euler("xyz", [-1.57079632679, 0.0, -1.57079632679])
    np.testing.assert_allclose(T[:3, 3], [0.034, 0.001, -0.012], rtol=0, atol=1e-15)
    np.testing.assert_allclose(T[:3, :3], (body * optical).as_matrix(), rtol=0, atol=1e-15)
    assert moved_along(after, MOUNT, OPTICAL) == ("depth_optical",)
    assert moved_along(after, MOUNT, "depth_optical") == (OPTICAL,)
    assert moved_along(after, "color_optical_joint", OPTICAL) == ()


def test_quotes_and_spaces_of_the_origin_stay():
    T = pose(0.25, 0.0, 0.0, 0.0, 0.0, 0.0)
    after = with_moved_mount(urdf_with_camera(), "camera_body", OPTICAL, "color_optical_joint", T)
    line = '    <origin rpy="0.0 0.0 0.0" xyz="0.25 0.0 0.0"/>'
    assert line in after.data.decode().splitlines()
    mounted = with_moved_mount(urdf_with_camera(), "tool0", "camera_mount", MOUNT, T)
    assert "    <origin  rpy='0.0 0.0 0.0' xyz='0.25 0.0 0.0' />" in mounted.data.decode()


def test_a_joint_without_origin_gets_one():
    text = urdf_with_camera().data.decode()
    origin = "    <origin  rpy='0 -1.5707963 0' xyz='0.05 0 0.03' />\n"
    bare = Urdf.from_bytes(text.replace(origin, "").encode(), "bare.urdf")
    after = with_moved_mount(bare, "tool0", OPTICAL, MOUNT, T_TOOL_OPTICAL)
    T = by_yourdfpy(after, "tool0", OPTICAL)
    np.testing.assert_allclose(T, T_TOOL_OPTICAL, rtol=0, atol=1e-9)


def test_any_rotation_comes_out_a_right_angle_of_pitch_too():
    rng = np.random.default_rng(1)
    turns = [rng.normal(size=3) for _ in range(5)]
    turns += [Rotation.from_euler("ZYX", [a, s * np.pi / 2, 0.3]).as_rotvec() for a, s in
              itertools.product((0.0, 1.0, 3.0), (-1, 1))]  # fmt: skip
    for turn in turns:
        wanted = pose(*rng.normal(size=3), *turn)
        after = with_moved_mount(urdf_with_camera(), "tool0", OPTICAL, MOUNT, wanted)
        for read in (by_pinocchio, by_yourdfpy):
            T = read(after, "tool0", OPTICAL)
            np.testing.assert_allclose(T, wanted, rtol=0, atol=1e-9)


def test_the_link_that_carries_the_camera_may_hang_beside_it():
    """ee_link and tool0 are both fixed to the wrist."""
    wanted = pose(0.1, 0.2, 0.3, 0.4, 0.5, 0.6)
    after = with_moved_mount(urdf_with_camera(), "ee_link", OPTICAL, MOUNT, wanted)
    T = by_pinocchio(after, "ee_link", OPTICAL)
    np.testing.assert_allclose(T, wanted, rtol=0, atol=1e-9)
    assert len(changed_lines(urdf_with_camera(), after)) == 2


def test_on_a_corrected_urdf_the_arm_s_origins_stay_corrected():
    robot = Robot.from_urdf(urdf_with_camera(), "tool0", "base")
    moved = robot.placements.copy()
    moved[2] = moved[2] @ pose(1e-3, -2e-3, 3e-3, 1e-3, 2e-3, -1e-3)
    corrected = robot.with_placements(moved)
    after = with_moved_mount(corrected.urdf, "tool0", OPTICAL, MOUNT, T_TOOL_OPTICAL)
    q = np.random.default_rng(0).uniform(-2, 2, (5, 6))
    poses = Robot.from_urdf(after, "tool0", "base").poses(q)
    np.testing.assert_allclose(poses, corrected.poses(q), rtol=0, atol=1e-15)
    T = by_pinocchio(after, "tool0", OPTICAL)
    np.testing.assert_allclose(T, T_TOOL_OPTICAL, rtol=0, atol=1e-9)


def test_fixed_pose_goes_up_and_down():
    urdf = urdf_with_camera()
    for link, frame in (("ee_link", OPTICAL), (OPTICAL, "depth_optical"), (OPTICAL, "tool0")):
        T = fixed_pose(urdf, link, frame)
        np.testing.assert_allclose(T, by_pinocchio(urdf, link, frame), rtol=0, atol=1e-12)
    np.testing.assert_array_equal(fixed_pose(urdf, OPTICAL, OPTICAL), np.eye(4))


def test_the_only_joint_needs_no_name():
    urdf = urdf_with_camera()
    assert mount_joint(urdf, "tool0", "camera_mount", None) == MOUNT
    assert mount_joint(urdf, "tool0", OPTICAL, "camera_body_joint") == "camera_body_joint"


@pytest.mark.parametrize(
    ("link", "frame", "joint", "named"),
    [
        # several joints, none named
        ("tool0", OPTICAL, None, ["'camera_mount_joint'", "'camera_body_joint'", "--move"]),
        # a joint on the way moves
        ("forearm_link", OPTICAL, MOUNT, ["'wrist_1_joint' (revolute)", "'forearm_link'"]),
        # another joint: not between, or above the link that carries the camera
        ("tool0", OPTICAL, "depth_optical_joint", ["does not lie between", "'camera_body_joint'"]),
        ("camera_body", OPTICAL, MOUNT, ["carries 'camera_body'", "'color_optical_joint'"]),
        ("tool0", OPTICAL, "elbow_joint", ["carries 'tool0'", "'camera_mount_joint'"]),
        ("ee_link", OPTICAL, "ee_fixed_joint", ["carries 'ee_link'"]),
        # the optical frame carries itself
        (OPTICAL, OPTICAL, "color_optical_joint", ["no joint between them", "a link above"]),
        # names that do not exist
        ("tool0", OPTICAL, "camera_mont_joint", ["did you mean 'camera_mount_joint'"]),
        ("tool0", "color_opticl", MOUNT, ["did you mean 'color_optical'"]),
        ("tool", OPTICAL, MOUNT, ["no link 'tool'"]),
    ],
)
def test_what_is_refused_and_names_the_joints(link, frame, joint, named):
    with pytest.raises(UrdfError) as error:
        mount_joint(urdf_with_camera(), link, frame, joint)
    for words in named:
        assert words in str(error.value)
    if joint is not None:
        with pytest.raises(UrdfError):
            with_moved_mount(urdf_with_camera(), link, frame, joint, T_TOOL_OPTICAL)


def test_a_new_link_is_added_before_the_end_and_moved_by_the_next_hand_over():
    before = urdf_with_camera()
    added = with_fixed_link(before, "cam", "tool0", T_TOOL_OPTICAL)
    text = added.data.decode()
    start = before.data.decode().rindex("</robot>")
    assert text.startswith(before.data.decode()[:start])
    assert text.endswith("</robot>\n") == before.data.decode().endswith("</robot>\n")
    again = with_fixed_link(added, "cam", "tool0", pose(0.5, 0, 0, 0, 0, 0))
    assert len(again.links) == len(added.links) == len(before.links) + 1
    for urdf, wanted in ((added, T_TOOL_OPTICAL), (again, pose(0.5, 0, 0, 0, 0, 0))):
        for read in (by_pinocchio, by_yourdfpy):
            T = read(urdf, "tool0", "cam")
            np.testing.assert_allclose(T, wanted, rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        (OPTICAL, "a child of 'camera_body'"),
        ("wrist_3_link", "a child of 'wrist_2_link'"),
        ("world", "the root"),
    ],
)
def test_a_new_link_takes_no_name_of_another_one(name, words):
    text = urdf_with_camera().data.decode()
    if name == "world":
        name = urdf_with_camera().root
    assert CAMERA in text
    with pytest.raises(UrdfError, match=words):
        with_fixed_link(urdf_with_camera(), name, "tool0", T_TOOL_OPTICAL)


def fixed_joints_above(urdf: Urdf, frame: str) -> list[str]:
    """The fixed joints next above a link, topmost first."""
    names = reversed(urdf.chain(urdf.root, frame)[1])
    fixed = itertools.takewhile(lambda name: urdf.joint(name).type == "fixed", names)
    return list(fixed)[::-1]


def check_every_mount(urdf: Urdf) -> int:
    """Move every optical frame of a robot by every fixed joint above it; their number."""
    count = 0
    wanted = pose(0.1, 0.2, 0.3, 0.4, 0.5, 0.6)
    for frame in (link for link in urdf.links if "optical" in link):
        joints = fixed_joints_above(urdf, frame)
        for joint in joints:
            link = urdf.joint(joints[0]).parent
            check_fixed_frame(
                with_moved_mount(urdf, link, frame, joint, wanted), link, frame, wanted
            )
            count += 1
    return count


def test_the_cameras_of_a_tiago():
    assert check_every_mount(Robot.load("tiago_no_hand").urdf) == 8


@pytest.mark.slow
def test_the_cameras_of_all_robots():
    """Of example-robot-data; two of its files are no URDFs of a robot with joints."""
    robots = []
    for path in robot_data_urdfs().values():
        with contextlib.suppress(UrdfError):
            robots.append(Urdf.read(path))
    assert sum(map(check_every_mount, robots)) > 150


# Read back


@pytest.fixture(scope="module")
def mounted() -> Urdf:
    return with_moved_mount(
        urdf_with_camera(), "tool0", "color_optical", "camera_mount_joint", T_TOOL_OPTICAL
    )


def test_both_readers_have_the_frame_where_it_was_placed(mounted):
    check_fixed_frame(mounted, "tool0", "color_optical", T_TOOL_OPTICAL)


@pytest.mark.parametrize("off", [(2e-9, 0, 0, 0, 0, 0), (0, 0, 0, 0, 0, 3e-9)])
def test_a_frame_elsewhere_is_refused(mounted, off):
    with pytest.raises(UrdfError, match="read back by Pinocchio, has 'color_optical'"):
        check_fixed_frame(mounted, "tool0", "color_optical", T_TOOL_OPTICAL @ pose(*off))


def test_the_second_reader_counts_too(monkeypatch):
    monkeypatch.setattr(fixed_frames, "_by_pinocchio", lambda *_: T_TOOL_OPTICAL)
    with pytest.raises(UrdfError, match="read back by calib"):
        check_fixed_frame(urdf_with_camera(), "tool0", "color_optical", np.asarray(T_TOOL_OPTICAL))
