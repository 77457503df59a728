"""The compiled arithmetic of many samples: poses, Jacobian columns and normal matrices of a whole chunk in one pass.

`calib.model.batch` and `calib.identify.passes` prepare what it reads and are the only callers; what each number means
is said in `calib.model.kernel_types`. Pinocchio's regressor is the reference: `calib.model.kinematics` gives the same
for few samples, and tests compare. Residual is measured minus predicted; columns are the derivative of the prediction.

A chunk is always computed in the same order, whatever the number of threads, so that results are the same to the bit.
"""

from __future__ import annotations

import numpy as np

from calib.model.kernel_blocks import columns_of, forward, gram, scratch_of, turning_of
from calib.model.kernel_scores import deleted, leverage, square_over
from calib.model.kernel_types import (
    BETWEEN,
    HEIGHT,
    LANES,
    POSE,
    POSITION,
    Array,
    Geometry,
    Measured,
    Scratch,
    Stood,
    compiled,
)

#: A length below this has no direction [m].
_TINY = 1e-12


@compiled(inline=True)
def _placed(
    measured: Measured, first: int, count: int, scale: Array, F: Array, p: int, J: Array
) -> None:
    """Measured minus predicted positions, times ``scale``."""
    last = F.shape[0] - 1
    for k in range(3):
        for w in range(LANES):
            i = first + min(w, count - 1)
            J[p, k * LANES + w] = (measured.points[i, k] - F[last, 9 + k, w]) * scale[w]


@compiled(inline=True)
def _projected(
    measured: Measured, first: int, count: int, scale: Array, U: Array, F: Array, p: int, J: Array
) -> None:
    """Lengths in place of positions: rows of J along the unit vectors U, shape (3, LANES), and their residual."""
    last = F.shape[0] - 1
    if measured.what == HEIGHT:
        for w in range(LANES):
            U[0, w], U[1, w], U[2, w] = 0.0, 0.0, 1.0
            J[p, w] = -F[last, 11, w] * scale[w]
    else:
        for w in range(LANES):
            i = first + min(w, count - 1)
            length = np.sqrt(U[0, w] ** 2 + U[1, w] ** 2 + U[2, w] ** 2)
            over = 1.0 / max(length, _TINY)
            for r in range(3):
                U[r, w] *= over
            J[p, w] = (measured.lengths[i] - length) * scale[w]
    for k in range(p):
        for w in range(LANES):
            J[k, w] = U[0, w] * J[k, w] + U[1, w] * J[k, LANES + w] + U[2, w] * J[k, 2 * LANES + w]


@compiled(inline=True)
def _turned(
    measured: Measured,
    first: int,
    count: int,
    scale: Array,
    F: Array,
    p: int,
    A: Array,
    pose_jacobian: Array,
) -> None:
    """Rotation vectors r = log(M R^T), and the columns of A by the inverse right Jacobian of SO(3) at r.

    I + [r]x / 2 + (1 / t^2 - 1 / (2 t tan(t / 2))) [r]x^2, t = |r|.
    """
    last = F.shape[0] - 1
    R = np.empty((3, 3))
    for w in range(LANES):
        i = first + min(w, count - 1)
        for a in range(3):
            for b in range(3):
                x = 0.0
                for k in range(3):
                    x += measured.rotations[i, 3 * a + k] * F[last, 3 * b + k, w]
                R[a, b] = x
        x, y, z = _rotation_vector(R)
        A[p, w], A[p, LANES + w], A[p, 2 * LANES + w] = x * scale[w], y * scale[w], z * scale[w]
        t2 = x * x + y * y + z * z
        t = np.sqrt(t2)
        f = 1.0 / 12.0 if t < 1e-4 else 1.0 / t2 - 0.5 / (t * np.tan(0.5 * t))
        G = pose_jacobian
        G[0, w] = 1.0 - f * (y * y + z * z)
        G[1, w], G[2, w] = f * x * y - 0.5 * z, f * x * z + 0.5 * y
        G[3, w], G[4, w], G[5, w] = (
            f * x * y + 0.5 * z,
            1.0 - f * (x * x + z * z),
            f * y * z - 0.5 * x,
        )
        G[6, w], G[7, w] = f * x * z - 0.5 * y, f * y * z + 0.5 * x
        G[8, w] = 1.0 - f * (x * x + y * y)
    for k in range(p):
        for w in range(LANES):
            x, y, z = A[k, w], A[k, LANES + w], A[k, 2 * LANES + w]
            for a in range(3):
                A[k, a * LANES + w] = G[3 * a, w] * x + G[3 * a + 1, w] * y + G[3 * a + 2, w] * z


@compiled()
def _rotation_vector(R: Array) -> tuple[float, float, float]:
    """The rotation vector of a matrix, by its quaternion, whose largest entry is found first (Shepperd, 1978)."""
    trace = R[0, 0] + R[1, 1] + R[2, 2]
    largest = max(trace, R[0, 0], R[1, 1], R[2, 2])
    if largest == trace:
        q = 1.0 + trace
        x, y, z = R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]
    elif largest == R[0, 0]:
        x = 1.0 + R[0, 0] - R[1, 1] - R[2, 2]
        q, y, z = R[2, 1] - R[1, 2], R[0, 1] + R[1, 0], R[0, 2] + R[2, 0]
    elif largest == R[1, 1]:
        y = 1.0 + R[1, 1] - R[0, 0] - R[2, 2]
        q, x, z = R[0, 2] - R[2, 0], R[0, 1] + R[1, 0], R[1, 2] + R[2, 1]
    else:
        z = 1.0 + R[2, 2] - R[0, 0] - R[1, 1]
        q, x, y = R[1, 0] - R[0, 1], R[0, 2] + R[2, 0], R[1, 2] + R[2, 1]
    if q < 0.0:
        q, x, y, z = -q, -x, -y, -z
    norm = np.sqrt(x * x + y * y + z * z)
    factor = 2.0 * np.arctan2(norm, q) / norm if norm > 1e-150 else 0.0
    return x * factor, y * factor, z * factor


@compiled(inline=True)
def _block(
    geometry: Geometry,
    stood: Stood,
    other: Stood,
    measured: Measured,
    first: int,
    count: int,
    lengths: Array,
    angles: Array,
    room: Scratch,
    spare: Scratch,
    U: Array,
    G: Array,
) -> int:
    """Columns and residual of one block, into J (and A, of a pose's rotation); gives how many lanes of J count."""
    p, F, J = geometry.columns, room.F, room.J
    last = F.shape[0] - 1
    forward(geometry, stood, first, count, room)
    columns_of(geometry, stood, first, count, lengths, F, J)
    if measured.what == POSITION or measured.what == POSE:
        _placed(measured, first, count, lengths, F, p, J)
        if measured.what == POSE:
            turning_of(geometry, stood, first, count, angles, F, room.A)
            _turned(measured, first, count, angles, F, p, room.A, G)
        return 3 * LANES
    for r in range(3):
        for w in range(LANES):
            U[r, w] = F[last, 9 + r, w]
    if measured.what == BETWEEN:
        forward(geometry, other, first, count, spare)
        columns_of(geometry, other, first, count, lengths, spare.F, spare.J)
        for r in range(3):
            for w in range(LANES):
                U[r, w] -= spare.F[last, 9 + r, w]
        for k in range(p):
            for w in range(3 * LANES):
                J[k, w] -= spare.J[k, w]
    _projected(measured, first, count, lengths, U, F, p, J)
    return LANES


@compiled(inline=True)
def _lanes(values: Array, first: int, count: int, out: Array) -> None:
    """One number of each sample of a block; 0 in the lanes beyond its end."""
    for w in range(LANES):
        out[w] = values[first + w] if w < count else 0.0


@compiled()
def normal(
    geometry: Geometry,
    stood: Stood,
    other: Stood,
    measured: Measured,
    lengths: Array,
    angles: Array,
    first: int,
    last: int,
    H: Array,
) -> None:
    """Add [J r]^T [J r] of samples ``first`` to ``last`` to the lower halves of H.

    Args:
        geometry: `Geometry`.
        stood: `Stood`.
        other: `Stood` of the other sample of each pair; of anything else ``stood`` again.
        measured: `Measured`.
        lengths: shape (N,), root of a row's weight over the standard deviation of its lengths.
        angles: shape (N,), the same of its angles.
        first: Number of the first sample.
        last: Number behind the last.
        H: shape (2, m, m), of lengths and of angles, m = columns + 1 in whole tiles of four.
    """
    n, p = stood.values.shape[1], geometry.columns
    room, spare = scratch_of(n, p), scratch_of(n, p)
    U, G, l, a = np.empty((3, LANES)), np.empty((9, LANES)), np.empty(LANES), np.empty(LANES)  # noqa: E741
    for begin in range(first, last, LANES):
        count = min(LANES, last - begin)
        _lanes(lengths, begin, count, l)
        _lanes(angles, begin, count, a)
        width = _block(geometry, stood, other, measured, begin, count, l, a, room, spare, U, G)
        gram(room.J, H[0], width)
        if measured.what == POSE:
            gram(room.A, H[1], 3 * LANES)


@compiled()
def rows(
    geometry: Geometry,
    stood: Stood,
    other: Stood,
    measured: Measured,
    lengths: Array,
    angles: Array,
    first: int,
    last: int,
    out: Array,
) -> None:
    """[J r] of samples ``first`` to ``last``, times ``lengths`` and ``angles``, into out, shape (N, D, columns + 1)."""
    n, p = stood.values.shape[1], geometry.columns
    room, spare = scratch_of(n, p), scratch_of(n, p)
    U, G, l, a = np.empty((3, LANES)), np.empty((9, LANES)), np.empty(LANES), np.empty(LANES)  # noqa: E741
    for begin in range(first, last, LANES):
        count = min(LANES, last - begin)
        _lanes(lengths, begin, count, l)
        _lanes(angles, begin, count, a)
        width = _block(geometry, stood, other, measured, begin, count, l, a, room, spare, U, G)
        for w in range(count):
            for k in range(p + 1):
                for r in range(width // LANES):
                    out[begin + w, r, k] = room.J[k, r * LANES + w]
                if measured.what == POSE:
                    for r in range(3):
                        out[begin + w, 3 + r, k] = room.A[k, r * LANES + w]


@compiled()
def norms(
    geometry: Geometry,
    stood: Stood,
    other: Stood,
    measured: Measured,
    lengths: Array,
    angles: Array,
    part: int,
    moved: Array,
    root: Array,
    weights: Array,
    first: int,
    last: int,
    out: Array,
) -> None:
    """How far each row lies from what the others predict, in standard deviations; see `calib.identify.robust`.

    The linearised problem at x, looked at ``moved`` away from there.

    Args:
        geometry: As for `normal`, and the next three.
        stood: See there.
        other: See there.
        measured: See there.
        lengths: shape (N,), 1 over the standard deviation of a row's lengths.
        angles: shape (N,), 1 over that of its angles.
        part: 0 for all scalars of a row, 1 for its lengths, 2 for its angles.
        moved: shape (columns,), step from x.
        root: shape (m, m), upper triangle T of the parameters' covariance C = T^T T, and 0 beyond the columns.
        weights: shape (N,), between 0 and 1.
        first: Number of the first sample.
        last: Number behind the last.
        out: shape (N,), norms.
    """
    n, p = stood.values.shape[1], geometry.columns
    room, spare = scratch_of(n, p), scratch_of(n, p)
    U, G, l, a = np.empty((3, LANES)), np.empty((9, LANES)), np.empty(LANES), np.empty(LANES)  # noqa: E741
    Y, K, M = np.empty((4, 6 * LANES)), np.empty((6, 6, LANES)), np.empty((6, 7))
    for begin in range(first, last, LANES):
        count = min(LANES, last - begin)
        _lanes(lengths, begin, count, l)
        _lanes(angles, begin, count, a)
        width = _block(geometry, stood, other, measured, begin, count, l, a, room, spare, U, G)
        d = width // LANES if part != 2 else 0  # scalars of lengths
        all_of = d + (3 if measured.what == POSE and part != 1 else 0)
        for k in range(p):
            for w in range(d * LANES):
                room.J[p, w] -= moved[k] * room.J[k, w]
            for w in range((all_of - d) * LANES):
                room.A[p, w] -= moved[k] * room.A[k, w]
        leverage(room, root, p, d, all_of, Y, K)
        for w in range(count):
            weight = weights[begin + w]
            for r in range(all_of):
                M[r, 6] = room.J[p, r * LANES + w] if r < d else room.A[p, (r - d) * LANES + w]
            deleted(K[:, :, w], weight, all_of, M)
            out[begin + w] = np.sqrt(square_over(M, all_of))


@compiled()
def poses(geometry: Geometry, stood: Stood, first: int, last: int, out: Array) -> None:
    """T_frame_target of samples ``first`` to ``last``, into out, shape (N, 4, 4), [m]."""
    n = stood.values.shape[1]
    room = scratch_of(n, 0)
    for begin in range(first, last, LANES):
        count = min(LANES, last - begin)
        forward(geometry, stood, begin, count, room)
        for w in range(count):
            for r in range(3):
                for c in range(3):
                    out[begin + w, r, c] = room.F[n + 2, 3 * r + c, w]
                    out[begin + w, 3, c] = 0.0
                out[begin + w, r, 3] = room.F[n + 2, 9 + r, w]
            out[begin + w, 3, 3] = 1.0


@compiled()
def twists(geometry: Geometry, stood: Stood, first: int, last: int, out: Array) -> None:
    """The target's velocity in a unit of each parameter, into out, shape (N, 6, columns); linear part first."""
    n, p = stood.values.shape[1], geometry.columns
    room, one = scratch_of(n, p), np.ones(LANES)
    for begin in range(first, last, LANES):
        count = min(LANES, last - begin)
        forward(geometry, stood, begin, count, room)
        columns_of(geometry, stood, begin, count, one, room.F, room.J)
        turning_of(geometry, stood, begin, count, one, room.F, room.A)
        for w in range(count):
            for r in range(3):
                for k in range(p):
                    out[begin + w, r, k] = room.J[k, r * LANES + w]
                    out[begin + w, 3 + r, k] = room.A[k, r * LANES + w]
