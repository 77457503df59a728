"""The frame that a plane and two axes make: the paper's construction, its derivatives, its intervals."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from calib.basics.arrays import rigid_inverse
from calib.errors import UrdfError
from calib.robot.robot import Robot
from calib.verbs.base_frame.axes import Line, nominal_axes, nominal_axes_frame
from calib.verbs.base_frame.base_frame import BaseFrame, frame_of
from calib.verbs.base_frame.circles import Circle, Plane, fit_circle, fit_plane

SIGMA = 33e-6
T_TRUE = pin.exp6(np.array([2.0, 1.0, -0.5, 0.3, -0.8, 1.2])).homogeneous
DISC = np.column_stack([np.random.default_rng(0).uniform(-0.25, 0.25, (20, 2)), np.zeros(20)])


def ring(center: list[float], normal: list[float], degrees: float) -> np.ndarray:
    n = np.array(normal) / np.linalg.norm(normal)
    u = np.cross(n, [0.3, 0.5, 0.8])
    u /= np.linalg.norm(u)
    t = np.radians(np.linspace(0.0, degrees, 40))
    return center + 0.3 * (np.cos(t)[:, None] * u + np.sin(t)[:, None] * np.cross(n, u))


def figures(
    arcs: tuple[float, float] = (270.0, 180.0),
    *,
    second: tuple[float, float, float] = (0.0, 1.0, 0.2),
    rng: np.random.Generator | None = None,
    given: bool = False,
    touched: int = 20,
) -> tuple[Plane, Circle, Circle]:
    """Plane, circle 1, circle 2 in the tracker's frame; axis 2 is not quite square to axis 1."""
    sets = [
        DISC[:touched],
        ring([0, 0, 0.3], [0, 0, 1], arcs[0]),
        ring([0.1, 0.1, 0.15], list(second), arcs[1]),
    ]
    seen = [p @ T_TRUE[:3, :3].T + T_TRUE[:3, 3] for p in sets]
    if rng is not None:
        seen = [p + SIGMA * rng.normal(size=p.shape) for p in seen]
    sigmas = [np.full(len(p), SIGMA) if given else None for p in seen]
    one, two = (fit_circle(p, s) for p, s in zip(seen[1:], sigmas[1:], strict=True))
    one = one if one.normal @ T_TRUE[:3, 2] > 0 else one.turned()
    two = two if two.normal @ T_TRUE[:3, 1] > 0 else two.turned()
    return fit_plane(seen[0], sigmas[0]), one, two


def opposite(plane: Plane) -> Plane:
    """The same plane with the opposite normal."""
    # (u, v, n) -> (v, u, -n): offset and tilts change their signs, and the tilts their places.
    swap = np.array([[-1.0, 0, 0], [0, 0, -1.0], [0, -1.0, 0]])
    return replace(
        plane,
        basis=plane.basis[:, [1, 0, 2]] * [1.0, 1.0, -1.0],
        covariance=swap @ plane.covariance @ swap.T,
        residuals=-plane.residuals,
    )


def error(frame: BaseFrame, T: np.ndarray = T_TRUE) -> np.ndarray:
    return np.asarray(pin.log6(rigid_inverse(frame.T_tracker_base) @ T).vector)


def test_joint_1_elsewhere_turns_the_frame_back():
    back = pin.exp6(np.array([0, 0, 0, 0, 0, -0.3])).homogeneous
    frame = frame_of(*figures(), T_axes_base=back)
    assert np.abs(error(frame, T_TRUE @ back)).max() < 1e-9


def test_a_ball_stands_off_the_plane_on_the_robot_s_side():
    for plane in (figures()[0], opposite(figures()[0])):
        frame = frame_of(plane, *figures()[1:], plane_offset=0.02)
        assert error(frame) == pytest.approx([0, 0, 0.02, 0, 0, 0], abs=1e-9)


def test_a_robot_s_base_is_where_its_axes_say():
    # Axis 2 along -y of the base, and axis 1 beside its origin, as with `base` of a UR on a stand.
    first = Line(np.array([0.05, -0.02, 0.0]), np.array([0.0, 0.0, 1.0]))
    second = Line(np.array([0.0, 0.1, 0.15]), np.array([0.0, -1.0, 0.0]))
    T = nominal_axes_frame((first, second))
    frame = frame_of(*figures(), T_axes_base=rigid_inverse(T))
    assert np.abs(error(frame, T_TRUE @ rigid_inverse(T))).max() < 1e-9
    assert T[:3, 3] == pytest.approx([0.05, -0.02, 0.0])
    assert T[:3, 1] == pytest.approx([0, -1, 0])


@pytest.mark.slow
@pytest.mark.parametrize("arcs", [(270.0, 180.0), (60.0, 60.0)])
def test_errors_are_those_of_the_covariance_and_within_the_cramer_rao_bound(arcs):
    bound = frame_of(*figures(arcs, given=True)).covariance
    rng = np.random.default_rng(1)
    runs = 400
    frames = [frame_of(*figures(arcs, rng=rng)) for _ in range(runs)]
    xi = np.array([error(frame) for frame in frames])
    L = np.linalg.inv(np.linalg.cholesky(bound))
    assert np.linalg.eigvalsh(L @ (xi.T @ xi / runs) @ L.T) == pytest.approx(np.ones(6), abs=0.35)
    for part in (slice(0, 3), slice(3, 6)):
        rms = np.sqrt(np.mean(np.sum(xi[:, part] ** 2, axis=1)))
        assert rms < 1.1 * np.sqrt(np.trace(bound[part, part]))
    within = np.mean([np.abs(e) <= f.within() for e, f in zip(xi, frames, strict=True)], axis=0)
    assert np.all((within > 0.92) & (within < 0.98))
    if arcs[0] > 200.0:
        assert np.median(np.linalg.norm(xi[:, :3], axis=1)) < 0.05e-3
        assert np.median(np.linalg.norm(xi[:, 3:], axis=1)) < 0.1e-3


def test_degrees_of_freedom_are_those_of_the_figures_that_a_component_depends_on():
    plane, first, second = figures(rng=np.random.default_rng(3))
    dof = frame_of(plane, first, second).dof
    # Along z it is the plane, across it circle 1; about z circle 2, and a little the tilt of axis 1.
    assert dof[[0, 1, 3, 4]] == pytest.approx(first.dof)
    assert dof[2] == pytest.approx(plane.dof, rel=1e-6)
    assert second.dof < dof[5] < first.dof + second.dof
    given = frame_of(*figures(rng=np.random.default_rng(3), given=True))
    assert np.isinf(given.dof).all()


@pytest.mark.slow
def test_a_plane_of_four_points_widens_the_intervals_as_its_one_degree_of_freedom_does():
    rng = np.random.default_rng(3)
    within = []
    for _ in range(300):
        frame = frame_of(*figures(rng=rng, touched=4))
        within.append(np.abs(error(frame)) <= frame.within())
    assert frame.dof[2] < 1.5
    assert np.all((np.mean(within, axis=0) > 0.91) & (np.mean(within, axis=0) < 0.99))


def test_a_joint_with_a_coupled_reading_does_not_turn_alone(ur3: Robot):
    coupling = {"elbow_joint": {"shoulder_lift_joint": -1.0}}
    coupled = Robot.from_urdf(ur3.urdf, ur3.base, ur3.tip, coupling=coupling)
    assert len(nominal_axes(ur3)) == 6
    with pytest.raises(UrdfError, match="or with a coupled reading"):
        nominal_axes(coupled)
