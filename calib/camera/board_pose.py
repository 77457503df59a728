"""Pose of a board from one view: in closed form, then by least squares of the images.

The points of a plane and their undistorted images are related by a homography, whose columns are those of the pose:
H ~ [r1 r2 p]. A small or distant board looks nearly the same if its tilt is reflected about the line of sight; both
poses are refined, and the one that fits better is taken. Points that are not in a plane, as on the faces of a cube,
begin with the affine camera that explains their images best (scaled orthography): its two rows are those of the turned
board, divided by the distance along the line of sight. Sources: Z. Zhang, A flexible new technique for camera
calibration, 2000; T. Collins, A. Bartoli, Infinitesimal plane-based pose estimation, 2014; D. DeMenthon, L. Davis,
Model-based object pose in 25 lines of code, 1995.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from calib.basics.arrays import Array, Integers
from calib.basics.values import Value
from calib.camera.lenses import Lens

#: A view: points on the board, shape (k, 3) [m], and their images, shape (k, 2) [px].
View = tuple[Array, Array]

#: The fewest points that determine the pose.
_FEWEST = 4

#: Singular value of the board's points, over the largest, below which they lie on a line.
_LINE = 1e-3

#: Rms distance of points from a plane, over that from their middle, below which they are in the plane: that of 1 mm of
#: sag, or of errors of corners, on 60 mm is less; that of two faces of an icosahedron is 0.1 and more.
_FLAT = 0.05

#: Maximum number of steps of the refinement, and the relative fall of the sum of squares below which it ends.
_ITERATIONS = 20
_SETTLED = 1e-8

#: Damping of the first step, and its factor after a success and after a failure.
_DAMPING = 1e-3
_LESS = 0.1
_MORE = 10.0

#: Damping of motions that images do not determine at all, over the trace of the normal equations.
_LEAST_DAMPING = 1e-14

#: Damping above which no step helps.
_STUCK = 1e10


@dataclass(frozen=True, slots=True, eq=False)
class BoardPose(Value):
    """The pose of a board in the camera, estimated from one view."""

    #: shape (4, 4) [m]
    T_camera_board: Array
    #: Root of the mean square of the distances of the images from the predicted ones [px]
    rms: float
    #: shape (6, 6), covariance of the pose for images with a standard deviation of 1 px along u and v: motion of the
    #: board's origin [m], then turn [rad], along the camera's axes
    covariance: Array
    #: shape (4, 4), the other solution, tilted to the other side of the line of sight, refined too [m]
    T_camera_board_other: Array
    #: ``rms`` of the other solution [px]
    rms_other: float


def board_pose(points: Array, pixels: Array, lens: Lens, values: Array) -> BoardPose | None:
    """Estimate the pose of a board from one view.

    Args:
        points: shape (k, 3), in the board's frame [m].
        pixels: shape (k, 2), their images [px].
        lens: The lens model.
        values: shape (m,), its intrinsics.

    Returns:
        The pose; None if the points do not determine it: they are fewer than four, on a line, or not in front of the
        camera.
    """
    return board_poses([(points, pixels)], lens, values)[0]


def board_poses(views: Sequence[View], lens: Lens, values: Array) -> tuple[BoardPose | None, ...]:
    """Estimate the pose of a board from each of V views of one camera.

    Args:
        views: Points and images of each, as `board_pose` takes them.
        lens: The lens model.
        values: shape (m,), its intrinsics.

    Returns:
        The poses; None for a view whose points do not determine it.
    """
    starts = closed_form_poses(views, lens, values)
    numbers = [k for k, T in enumerate(starts) if T is not None]
    result: list[BoardPose | None] = [None] * len(views)
    if not numbers:
        return tuple(result)
    chosen = [views[k] for k in numbers]
    first = _refine(np.array([starts[k] for k in numbers]), chosen, lens, values)
    reflected = _reflect_tilts(first[0], [points for points, _ in chosen])
    other = _refine(reflected, chosen, lens, values)
    for v, (k, (points, _)) in enumerate(zip(numbers, chosen, strict=True)):
        solutions = [(float(cost[v]), poses[v], N[v]) for poses, cost, N in (first, other)]
        (cost, best, N), (other_cost, second, _) = sorted(solutions, key=lambda s: s[0])
        result[k] = BoardPose(
            T_camera_board=best,
            rms=float(np.sqrt(cost / len(points))),
            covariance=np.linalg.pinv(N),
            T_camera_board_other=second,
            rms_other=float(np.sqrt(other_cost / len(points))),
        )
    return tuple(result)


def closed_form_poses(views: Sequence[View], lens: Lens, values: Array) -> tuple[Array | None, ...]:
    """Return the pose of a board in each of V views in closed form.

    Args:
        views: Points and images of each, as `board_pose` takes them.
        lens: The lens model.
        values: shape (m,), its intrinsics.

    Returns:
        T_camera_board of each, shape (4, 4) [m]; None for a view whose points or images are too few, or on a line.
    """
    if not views:
        return ()
    rays = lens.undistort(np.concatenate([pixels for _, pixels in views]), values)[:, :2]
    ends = np.cumsum([len(pixels) for _, pixels in views])
    poses: list[Array | None] = []
    for (points, pixels), images in zip(views, np.split(rays, ends[:-1]), strict=True):
        if determines_pose(points) and determines_pose(pixels) and determines_pose(images):
            poses.append(_closed_form_pose(points, images))
        else:
            poses.append(None)
    return tuple(poses)


def _closed_form_pose(points: Array, images: Array) -> Array | None:
    """Return the pose (4, 4) [m] of points (k, 3) [m] with images (k, 2) at a depth of 1; None if there is none."""
    in_plane = points_in_plane(points)
    if in_plane is None:
        return _pose_of_body(points, images)
    T_plane_board, p = in_plane
    T_camera_plane = _pose_of_homography(homography(p, images), p.mean(axis=0))
    return None if T_camera_plane is None else T_camera_plane @ T_plane_board


def points_in_plane(points: Array) -> tuple[Array, Array] | None:
    """Return a frame in whose x-y plane points nearly are, and their places in it.

    Args:
        points: shape (k, 3), in the board's frame [m].

    Returns:
        T_plane_board, shape (4, 4) [m], the identity for a flat board, and x and y of the points, shape (k, 2) [m];
        None if they are not in a plane.
    """
    T_plane_board = _principal_frame(points)
    in_frame = points @ T_plane_board[:3, :3].T + T_plane_board[:3, 3]
    if np.linalg.norm(in_frame[:, 2]) > _FLAT * np.linalg.norm(points - points.mean(axis=0)):
        return None
    return T_plane_board, in_frame[:, :2]


def _principal_frame(points: Array) -> Array:
    """Return the frame of the plane that points (k, 3) [m] are nearest to, T_plane_board (4, 4) [m].

    It is the identity for points that are nearly in the x-y plane already, as those of a flat board are.
    """
    middle = points.mean(axis=0)
    T_plane_board = np.eye(4)
    if np.linalg.norm(points[:, 2]) > _FLAT * np.linalg.norm(points - middle):
        _, _, V = np.linalg.svd(points - middle, full_matrices=False)
        T_plane_board[:3, :3] = np.linalg.det(V) * V
        T_plane_board[:3, 3] = -T_plane_board[:3, :3] @ middle
    return T_plane_board


def _pose_of_body(points: Array, images: Array) -> Array | None:
    """Return the pose (4, 4) [m] of points (k, 3) [m], not in a plane, whose images (k, 2) at a depth of 1 are affine.

    The camera is turned to the middle of the images first, where perspective is nearest to that. With the points P from
    their middle, at p, the images are ([r1 r2]^T P + (p_x, p_y)) / p_z.
    """
    rays = _homogeneous(images)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    towards = rays.mean(axis=0) / np.linalg.norm(rays.mean(axis=0))
    aside = np.linalg.svd(towards[None])[2][1]  # any unit vector across
    turn = np.array([aside, np.cross(towards, aside), towards])
    turned = rays @ turn.T
    if turned[:, 2].min() <= 0.0:
        return None
    middle = points.mean(axis=0)
    A = _homogeneous(points - middle)
    affine, *_ = np.linalg.lstsq(A, turned[:, :2] / turned[:, 2:], rcond=None)
    U, s, V = np.linalg.svd(affine[:3].T, full_matrices=False)
    across = U @ V
    R = turn.T @ np.vstack([across, np.cross(across[0], across[1])])
    T = np.eye(4)
    T[:3, :3] = R
    T[:3, 3] = turn.T @ np.array([*affine[3], 1.0]) / s.mean() - R @ middle
    return T


def homography(points: Array, images: Array) -> Array:
    """Return the homography that takes points of a plane to their images, by the normalised direct linear transform.

    Args:
        points: shape (k, 2), k >= 4, not on a line.
        images: shape (k, 2).

    Returns:
        H, shape (3, 3), of any scale: (u, v, 1) ~ H (x, y, 1).
    """
    to_points = _normalisation(points)
    to_images = _normalisation(images)
    p = _homogeneous(points) @ to_points.T
    q = _homogeneous(images) @ to_images.T
    zeros = np.zeros_like(p)
    along_u = np.hstack([p, zeros, -q[:, :1] * p])
    along_v = np.hstack([zeros, p, -q[:, 1:2] * p])
    _, _, V = np.linalg.svd(np.vstack([along_u, along_v]))
    return np.asarray(np.linalg.inv(to_images) @ V[-1].reshape(3, 3) @ to_points)


def determines_pose(points: Array) -> bool:
    """Return True if points of a board (k, 3), or images (k, 2), are enough, finite, and not on a line."""
    if len(points) < _FEWEST or not np.all(np.isfinite(points)):
        return False
    _, s, _ = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)
    return bool(s[1] > _LINE * s[0])


def _homogeneous(points: Array) -> Array:
    """Return points (k, d) with a further coordinate of 1, shape (k, d + 1)."""
    return np.column_stack([points, np.ones(len(points))])


def _normalisation(points: Array) -> Array:
    """Return the similarity, shape (3, 3), that moves the mean of points (k, 2) to zero and their spread to 1."""
    centre = points.mean(axis=0)
    scale = 1.0 / max(float(np.sqrt(np.mean((points - centre) ** 2))), np.finfo(float).tiny)
    return np.array([[scale, 0.0, -scale * centre[0]], [0.0, scale, -scale * centre[1]], [0, 0, 1]])


def _pose_of_homography(H: Array, centre: Array) -> Array | None:
    """Return the pose, shape (4, 4) [m], of a plane with the homography H, shape (3, 3), to images at a depth of 1.

    The plane's origin may be behind the camera, but its point ``centre``, shape (2,), is in front of it. None if H is
    not finite, or not that of such a plane.
    """
    sizes = np.linalg.norm(H[:, :2], axis=0)
    depth = H[2] @ [*centre, 1.0]
    if not np.all(np.isfinite(H)) or min(sizes) <= 0.0 or depth == 0.0:
        return None
    columns = H * 2.0 / np.sum(sizes) * np.sign(depth)
    U, _, V = np.linalg.svd(
        np.column_stack([columns[:, :2], np.cross(columns[:, 0], columns[:, 1])])
    )
    T = np.eye(4)
    T[:3, :3] = U @ np.diag([1.0, 1.0, np.linalg.det(U @ V)]) @ V
    T[:3, 3] = columns[:, 2]
    return T


def _reflect_tilts(T_camera_board: Array, points: Sequence[Array]) -> Array:
    """Return the other solutions of the planar pose ambiguity of poses (V, 4, 4), shape (V, 4, 4) [m].

    The normal of the plane of each board's points, (k, 3) [m] in its frame, is reflected about the line of sight to
    their middle, which stays in place.
    """
    centres = np.array([of_view.mean(axis=0) for of_view in points])
    plane = np.array([_principal_frame(of_view)[:3, :3] for of_view in points])
    R = T_camera_board[:, :3, :3]
    in_camera = (R @ centres[:, :, None])[:, :, 0] + T_camera_board[:, :3, 3]
    sight = in_camera / np.linalg.norm(in_camera, axis=1, keepdims=True)
    half_turn = 2.0 * sight[:, :, None] * sight[:, None] - np.eye(3)
    half_turn_of_plane = plane.swapaxes(1, 2) @ np.diag([-1.0, -1.0, 1.0]) @ plane
    T: Array = T_camera_board.copy()
    T[:, :3, :3] = half_turn @ R @ half_turn_of_plane
    T[:, :3, 3] = in_camera - (T[:, :3, :3] @ centres[:, :, None])[:, :, 0]
    return T


def _refine(
    T: Array, views: Sequence[View], lens: Lens, values: Array
) -> tuple[Array, Array, Array]:
    """Refine the poses T_camera_board (V, 4, 4) of V views by Levenberg-Marquardt, each with a damping of its own.

    Return the poses; the sums of squares, shape (V,) [px^2]; and the normal equations J^T J of each, shape (V, 6, 6).
    """
    damping = np.full(len(views), _DAMPING)
    cost, N, g = _normal_equations(T, views, lens, values)
    for _ in range(_ITERATIONS):
        diagonal = np.diagonal(N, axis1=1, axis2=2)
        least = _LEAST_DAMPING * np.sum(diagonal, axis=1) + np.finfo(float).tiny
        damped = N + (damping[:, None] * diagonal + least[:, None])[:, :, None] * np.eye(6)
        step = np.linalg.solve(damped, g[:, :, None])[:, :, 0]
        trial = move_poses(T, step)
        new_cost, new_N, new_g = _normal_equations(trial, views, lens, values)
        better = new_cost < cost
        settled = np.where(better, cost - new_cost <= _SETTLED * cost, damping > _STUCK)
        T = np.where(better[:, None, None], trial, T)
        cost = np.where(better, new_cost, cost)
        N = np.where(better[:, None, None], new_N, N)
        g = np.where(better[:, None], new_g, g)
        damping = damping * np.where(better, _LESS, _MORE)
        if np.all(settled):
            break
    return T, cost, N


def _normal_equations(
    T: Array, views: Sequence[View], lens: Lens, values: Array
) -> tuple[Array, Array, Array]:
    """Return r^T r (V,) [px^2], J^T J (V, 6, 6) and J^T r (V, 6) of V views, by the twists of their poses."""
    residual, J, _ = view_system(T, views, lens, values)
    first = first_rows(views)
    cost = np.add.reduceat(np.sum(residual**2, axis=1), first)
    N = np.add.reduceat(np.einsum("nab,nac->nbc", J, J), first)
    g = np.add.reduceat(np.einsum("nab,na->nb", J, residual), first)
    return cost, N, g


def view_system(
    T: Array, views: Sequence[View], lens: Lens, values: Array
) -> tuple[Array, Array, Array]:
    """Return the residuals of V views with n points in all, and their derivatives.

    Args:
        T: shape (V, 4, 4), T_camera_board of each [m].
        views: Points and images of each.
        lens: The lens model.
        values: shape (m,), its intrinsics.

    Returns:
        Measured minus predicted images, shape (n, 2) [px]; the derivative of the prediction by the motion of the
        board's origin [m] and its turn [rad] along the camera's axes, shape (n, 2, 6), and by the intrinsics, shape
        (n, 2, m).
    """
    counts = [len(points) for points, _ in views]
    points = np.concatenate([points for points, _ in views])
    pixels = np.concatenate([pixels for _, pixels in views])
    turned = (np.repeat(T[:, :3, :3], counts, axis=0) @ points[:, :, None])[:, :, 0]
    in_camera = turned + np.repeat(T[:, :3, 3], counts, axis=0)
    by_point, by_values = lens.derivatives(in_camera, values)
    by_turn = np.cross(turned[:, None], by_point)
    residual = pixels - lens.project(in_camera, values)
    return residual, np.concatenate([by_point, by_turn], axis=2), by_values


def first_rows(views: Sequence[View]) -> Integers:
    """Return the index, from 0, of each of V views' first point among the points of all views, shape (V,)."""
    return np.cumsum([0, *(len(points) for points, _ in views[:-1])])


def move_poses(T: Array, twists: Array) -> Array:
    """Return poses (V, 4, 4) [m] moved, then turned about their origins, by twists (V, 6) [m, rad]."""
    result: Array = T.copy()
    result[:, :3, :3] = Rotation.from_rotvec(twists[:, 3:]).as_matrix() @ T[:, :3, :3]
    result[:, :3, 3] += twists[:, :3]
    return result
