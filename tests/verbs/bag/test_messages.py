"""What is taken out of messages of each type."""

from __future__ import annotations

from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from calib.errors import MeasurementError
from calib.verbs.bag.messages import PointReader, grey
from tests.verbs.bag.bags import BEGIN, Messages

M = Messages("db3")
V = (1.0, 2.0, 3.0)
Q = (0.5, -0.5, 0.5, 0.5)


def a_pose():
    return M("geometry_msgs/msg/Pose", M.vector("Point", V), M.vector("Quaternion", Q))


def a_transform(parent: str, child: str, x: float = 1.0):
    transform = M(
        "geometry_msgs/msg/Transform",
        M.vector("Vector3", (x, 2.0, 3.0)),
        M.vector("Quaternion", Q),
    )
    return M("geometry_msgs/msg/TransformStamped", M.header(BEGIN, parent), child, transform)


def with_covariance():
    return M("geometry_msgs/msg/PoseWithCovariance", a_pose(), np.zeros(36))


HEADER = M.header(BEGIN)


@pytest.mark.parametrize(
    ("type_name", "message", "has_pose"),
    [
        ("geometry_msgs/msg/PointStamped", lambda t: M(t, HEADER, M.vector("Point", V)), False),
        ("geometry_msgs/msg/Vector3Stamped", lambda t: M(t, HEADER, M.vector("Vector3", V)), False),
        ("geometry_msgs/msg/PoseStamped", lambda t: M(t, HEADER, a_pose()), True),
        (
            "geometry_msgs/msg/PoseWithCovarianceStamped",
            lambda t: M(t, HEADER, with_covariance()),
            True,
        ),
        ("geometry_msgs/msg/TransformStamped", lambda _: a_transform("base", "tool"), True),
        (
            "nav_msgs/msg/Odometry",
            lambda t: M(t, HEADER, "tool", with_covariance(), None),
            True,
        ),
    ],
)
def test_every_type_gives_its_pose(type_name: str, message, has_pose: bool):
    reader = PointReader(type_name, (), "topic")
    ((stamped, (position, turn)),) = reader.poses(message(type_name))
    reader.check()
    assert stamped == round(BEGIN * 1e9)
    assert position == V
    assert turn == (Q if has_pose else None)


TF = "tf2_msgs/msg/TFMessage"


def test_transforms_are_chosen_by_their_frames():
    message = M(TF, [a_transform("base", "tool", 1.0), a_transform("/camera", "/tool", 4.0)])
    reader = PointReader(TF, ("camera", "tool"), "topic")
    ((_, (position, _)),) = reader.poses(message)
    assert position[0] == 4.0
    reader.check()
    for frames, said in {
        (): "name the one",
        ("toll",): "did you mean 'tool'",
        ("tool",): "'base', 'camera'",
        ("world", "tool"): "no transform of 'tool' in the frame 'world'",
    }.items():
        reader = PointReader(TF, frames, "topic")
        list(reader.poses(message))
        with pytest.raises(MeasurementError, match=said):
            reader.check()


def test_other_types_and_frames_of_single_poses_are_refused():
    with pytest.raises(MeasurementError, match="measured points are read from"):
        PointReader("sensor_msgs/msg/Imu", (), "topic")
    with pytest.raises(MeasurementError, match="leave out ':tool'"):
        PointReader("geometry_msgs/msg/PoseStamped", ("tool",), "topic")


def picture(encoding: str, pixels: np.ndarray, pad: int = 0, big: bool = False):
    height = pixels.shape[0]
    data = np.ascontiguousarray(pixels).view(np.uint8).reshape(height, -1)
    data = np.pad(data, ((0, 0), (0, pad)))
    return SimpleNamespace(
        encoding=encoding, height=height, width=pixels.shape[1], step=data.shape[1],
        is_bigendian=int(big), data=data.reshape(-1),
    )  # fmt: skip


def test_encodings_become_the_grey_values_of_opencv():
    rng = np.random.default_rng(0)
    rgb = cv2.GaussianBlur(rng.integers(0, 256, (24, 32, 3), dtype=np.uint8), (0, 0), 3)
    wanted = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)
    alpha = np.dstack([rgb, np.full((24, 32), 255, np.uint8)])
    for encoding, pixels, pad in (
        ("rgb8", rgb, 5),
        ("bgr8", rgb[:, :, ::-1], 0),
        ("rgba8", alpha, 3),
        ("bgra8", alpha[:, :, [2, 1, 0, 3]], 0),
        ("mono8", wanted, 7),
        ("mono16", wanted.astype("<u2") * 256, 2),
    ):
        found = grey(picture(encoding, pixels, pad))
        assert found is not None
        assert np.abs(found.astype(int) - wanted).max() <= 1, encoding
    big = picture("mono16", (wanted.astype(np.uint16) * 256).astype(">u2"), big=True)
    np.testing.assert_array_equal(grey(big), wanted)
    yuv = np.dstack([np.full((24, 32), 128, np.uint8), wanted])
    np.testing.assert_array_equal(grey(picture("yuv422", yuv)), wanted)
    np.testing.assert_array_equal(grey(picture("yuv422_yuy2", yuv[:, :, ::-1])), wanted)
    assert grey(picture("32FC1", wanted.astype(np.float32))) is None


def test_a_mosaic_of_any_order_has_no_pattern_left():
    flat = np.zeros((12, 16), np.uint8)
    flat[0::2, 0::2], flat[1::2, 1::2] = 200, 40
    flat[0::2, 1::2] = flat[1::2, 0::2] = 120
    for k, encoding in enumerate(("bayer_rggb8", "bayer_bggr8", "bayer_gbrg8", "bayer_grbg8")):
        found = grey(picture(encoding, np.roll(flat, k, axis=k % 2)))
        assert found is not None
        assert np.ptp(found[1:-1, 1:-1]) == 0
