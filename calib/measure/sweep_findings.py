"""What the residuals of a sweep say beside noise, in plain words.

The fit is a linear least-squares problem at its minimum. A suspicion is a few more columns B of it: lobes k times per
turn, radial or axial; a step, from one row on, of the target on its link (radius and height change) or of the tracker
(a displacement in space). What B lowers the sum of squares by is an F test; the clearest of all suspicions counts where
its tail, times their number, is below 0.001. It then joins the problem, and the next clearest is looked for.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtrc, ndtr

from calib.measure.algebraic_circles import Ring
from calib.measure.geometric_fits import Circle, Plane, circle_residuals
from calib.measure.scatter import LEVEL
from calib.measure.sweeps import Sweep

Array = NDArray[np.float64]

#: Lobes per turn that are looked for; one per turn is a displaced centre, or a tilted circle.
_LOBES = range(2, 7)

#: Rows that are tried for a step at once.
_STEPS = 200

#: At most this many findings of lobes and steps in a sweep.
_MOST = 3


@dataclass(frozen=True, slots=True, eq=False)
class _Suspicion:
    """Columns of the problem, shape (2 N, b) in the order of the residuals, and what they would mean."""

    kind: str
    at: int
    columns: Array


def circle_findings(
    sweep: Sweep, circle: Circle, label: str, gross: NDArray[np.bool_]
) -> tuple[str, ...]:
    """Sentences on a joint's sweep: gross rows, lobes, steps, noise that is no noise.

    Args:
        sweep: The points.
        circle: Their circle.
        label: What to call the joint.
        gross: Which points are gross, left out or not, shape (N,).
    """
    used = circle.used
    found = list(_gross(sweep, np.linalg.norm(circle.residuals, axis=1), gross, used))
    ring = Ring(circle.center, circle.normal, circle.radius)
    points = sweep.points[used]
    residuals, J = circle_residuals(points, ring, np.asarray(circle.basis))
    root = _roots(sweep, used)
    e = (root[:, None] * residuals).ravel()
    base = (root[:, None, None] * J).reshape(-1, 6)
    rows = [row for row, keep in zip(sweep.rows, used, strict=True) if keep]
    problem = _Problem(circle, points, np.repeat(root, 2))
    told = []
    for _ in range(_MOST):
        best = problem.clearest(base, e)
        if best is None or best[1] * problem.count > LEVEL:
            break
        told.append(_sentence(best[0], best[2], sweep, rows, label, circle))
        base = np.hstack([base, best[0].columns])
    return (*found, *(told or _alike(residuals, label, sweep)), *_too_large(sweep, circle))


def plane_findings(sweep: Sweep, plane: Plane, gross: NDArray[np.bool_]) -> tuple[str, ...]:
    """Sentences on the plane: gross rows, a surface that is no plane; see `circle_findings`."""
    used = plane.used
    found = list(_gross(sweep, np.abs(plane.residuals[:, 0]), gross, used))
    root = _roots(sweep, used)
    local = (sweep.points[used] - plane.point) @ plane.basis
    x, y = local[:, 0], local[:, 1]
    base = root[:, None] * np.column_stack([np.ones_like(x), x, y])
    bowl = _Suspicion("bowl", 0, root[:, None] * np.column_stack([x * x, x * y, y * y]))
    best = _clearest(base, root * local[:, 2], [bowl])
    if best is not None and best[1] < LEVEL:
        bent = np.column_stack([x * x, x * y, y * y]) @ best[2]
        found.append(
            f"{sweep.where}: the surface is not flat but bent, by {1e3 * np.ptp(bent):.2g} mm over its points. "
            "Touch it where the robot stands on it."
        )
    return (*found, *_too_large(sweep, plane))


class _Problem:
    """All that is looked for in a circle."""

    __slots__ = ("_e", "_lobes", "_root", "_stride", "count")

    def __init__(self, circle: Circle, points: Array, root: Array) -> None:
        """Prepare.

        Args:
            circle: The circle.
            points: Those used, shape (N, 3) [m].
            root: Square roots of the residuals' weights, shape (2 N,).
        """
        local = (points - circle.center) @ circle.basis
        across = np.hypot(local[:, 0], local[:, 1])
        self._e = local[:, :2] / np.where(across > 0.0, across, 1.0)[:, None]
        self._root = root[:, None]
        self._lobes = [
            _Suspicion(s.kind, s.at, self._root * s.columns) for s in _lobes(circle, len(points))
        ]
        # Of thousands of rows some hundred first, then those about the clearest.
        self._stride = max(1, len(points) // _STEPS)
        self.count = len(self._lobes) + 2 * max(0, len(points) - 3)

    def clearest(self, base: Array, e: Array) -> tuple[_Suspicion, float, Array] | None:
        """The suspicion with the smallest tail, that tail, and its coefficients."""
        count = len(self._e)
        steps = [
            self._step(kind, row)
            for kind in ("target", "tracker")
            for row in range(2, count - 1, self._stride)
        ]
        best = _clearest(base, e, [*self._lobes, *steps])
        if best is None or self._stride == 1 or best[0].kind not in ("target", "tracker"):
            return best
        first, last = best[0].at - self._stride + 1, best[0].at + self._stride
        near = range(max(2, first), min(count - 1, last))
        return _clearest(base, e, [self._step(best[0].kind, row) for row in near])

    def _step(self, kind: str, row: int) -> _Suspicion:
        """A step from a row on, of the target on its link or of the tracker."""
        after = (np.arange(len(self._e)) >= row).astype(np.float64)
        width = 2 if kind == "target" else 3
        columns = np.zeros((len(after), 2, width))
        columns[:, 0, : width - 1] = after[:, None] * (1.0 if width == 2 else self._e)
        columns[:, 1, width - 1] = after
        return _Suspicion(kind, row, self._root * columns.reshape(-1, width))


def _lobes(circle: Circle, count: int) -> Iterator[_Suspicion]:
    """Waves about the axis that the arc and the points can show."""
    angles = circle.angles[circle.used]
    for k in _LOBES:
        # A lobe must be there as a whole, and with points to draw it.
        if k * circle.arc < 2.0 * np.pi or count < 4 * k:
            continue
        wave = np.column_stack([np.cos(k * angles), np.sin(k * angles)])
        flat = np.zeros_like(wave)
        yield _Suspicion("radial", k, np.stack([wave, flat], axis=1).reshape(-1, 2))
        yield _Suspicion("axial", k, np.stack([flat, wave], axis=1).reshape(-1, 2))


def _clearest(
    base: Array, e: Array, suspicions: list[_Suspicion]
) -> tuple[_Suspicion, float, Array] | None:
    """The suspicion with the smallest tail, that tail, and its coefficients."""
    Q = np.linalg.qr(base)[0]
    left = e - Q @ (Q.T @ e)
    square = float(left @ left)
    best = None
    for suspicion in suspicions:
        b = suspicion.columns.shape[1]
        freedom = len(e) - base.shape[1] - b
        if freedom < 3:
            continue
        B = suspicion.columns - Q @ (Q.T @ suspicion.columns)
        x, _, rank, _ = np.linalg.lstsq(B, left, rcond=1e-8)
        drop = float(left @ (B @ x))
        if rank == 0 or drop <= 0.0:
            continue
        rest = max(square - drop, np.finfo(np.float64).eps * square)
        tail = float(fdtrc(rank, freedom, (drop / rank) / (rest / freedom)))
        # Equal tails, both too small to be told from zero: the larger drop.
        key = (tail, -drop)
        if best is None or key < best[0]:
            best = (key, suspicion, x)
    return None if best is None else (best[1], best[0][0], best[2])


def _sentence(
    suspicion: _Suspicion, x: Array, sweep: Sweep, rows: list[int], label: str, circle: Circle
) -> str:
    """What a suspicion that holds means."""
    if suspicion.kind in ("radial", "axial"):
        size = 1e3 * float(np.hypot(*x))
        return (
            f"{sweep.where}: '{label}' runs {suspicion.at} times per turn {suspicion.kind}ly out of its circle, by "
            f"{size:.2g} mm at the target (radius {1e3 * circle.radius:.4g} mm): a bearing with {suspicion.at} lobes, "
            "or a link that bends with its own weight."
        )
    before, after = rows[suspicion.at - 1], rows[suspicion.at]
    between = f"between the {sweep.counted}s {before} and {after}"
    if suspicion.kind == "target":
        return (
            f"{sweep.where}: the target moved on its link {between}, by {1e3 * x[0]:+.2g} mm along the radius and "
            f"{1e3 * x[1]:+.2g} mm along the axis. Fix it, and measure the sweep again."
        )
    return (
        f"{sweep.where}: tracker and robot moved against each other {between}, by {1e3 * np.linalg.norm(x):.2g} mm. "
        "Check that both stand firmly, and measure the sweep again."
    )


def _gross(
    sweep: Sweep, off: Array, gross: NDArray[np.bool_], used: NDArray[np.bool_]
) -> Iterator[str]:
    """The gross rows, and whether they were left out."""
    for i in np.flatnonzero(gross):
        yield (
            f"{sweep.source}, {sweep.counted} {sweep.rows[i]} (sweep '{sweep.name}') is {1e3 * off[i]:.3g} mm off and "
            f"{'counts all the same' if used[i] else 'left out'}: measure it again."
        )


def _alike(residuals: Array, label: str, sweep: Sweep) -> Iterator[str]:
    """Whether neighbouring points err alike, where nothing else has been found."""
    if len(residuals) < 10:
        return
    for which, name in enumerate(("radially", "axially")):
        e = residuals[:, which]
        correlation = float(e[1:] @ e[:-1] / (e @ e)) if np.any(e) else 0.0
        if ndtr(-correlation * np.sqrt(len(e))) < 0.5 * LEVEL:
            yield (
                f"{sweep.where}: neighbouring points of '{label}' err alike {name} (correlation {correlation:.2f}): "
                "that is no noise, so the stated uncertainty is too small. Look for play, bending, drift."
            )


def _too_large(sweep: Sweep, figure: Circle | Plane) -> Iterator[str]:
    """Whether the residuals contradict the noise that was given."""
    scatter = figure.scatter
    if scatter.contradicted and scatter.given is not None:
        yield (
            f"{sweep.where}: the points scatter by {1e3 * scatter.estimate:.3g} mm, sigma says "
            f"{1e3 * scatter.given:.3g} mm. The uncertainty is that of the scatter."
        )


def _roots(sweep: Sweep, used: NDArray[np.bool_]) -> Array:
    """Square roots of the weights of the points used, shape (N,)."""
    if sweep.sigma is None:
        return np.ones(int(used.sum()))
    return np.asarray(np.sqrt(np.mean(sweep.sigma**2)) / sweep.sigma[used])
