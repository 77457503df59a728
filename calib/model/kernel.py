"""The compiled arithmetic of many samples: poses, Jacobian columns and normal matrices of a whole chunk in one pass.

Everything here is a loop over blocks of `LANES` samples, laid out so that the same step of all of them is one vector
instruction. `calib.model.batch` prepares what it reads and is the only caller; what each number means is said there.
Pinocchio's regressor is the reference: `calib.model.kinematics` gives the same for few samples, and tests compare.

A chunk is always computed in the same order, whatever the number of threads, so that results are the same to the bit.
Sine and cosine: reduction by pi/2 in three parts and the minimax polynomials of FDLIBM (Sun Microsystems, 1993), within
one unit in the last place up to `FARTHEST`.

All of it stands in one file although it is long: numba keeps compiled code by file, and would not see that another file
has changed.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar, cast

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
Numbers = NDArray[np.int_]

#: Samples that are computed side by side.
LANES = 64

#: Joint values beyond this are not reduced exactly [rad].
FARTHEST = 1e5

#: What is measured of a sample: the target's position, its pose, its distance from the frame's origin, its distance
#: from where another sample has it, or its height over the frame's plane.
POSITION, POSE, DISTANCE, BETWEEN, HEIGHT = range(5)

#: Leverage beyond this is taken for all there is: such a row says nothing of itself.
_WHOLE = 1e-9

#: A length below this has no direction [m].
TINY = 1e-12

_F = TypeVar("_F", bound=Callable[..., Any])


class Geometry(NamedTuple):
    """A chain at one x, as the kernel reads it; poses are R by rows and the origin, shape (12,), [m].

    Attributes:
        slides: shape (n,), whether a joint slides along its z axis or turns about it.
        steps: shape (n, 12), of the next joint, or the tip, in a joint that has moved.
        starts: shape (F, 12), of the first joint, before it moves, in each measurement frame.
        bases: shape (F, 12), of the base in each measurement frame.
        targets: shape (T, 12), of each target in the tip.
        entries: shape (E, 6): place, column, only frame or -1, only target or -1, number or -1, and 0 where an entry
            is the first of its column, else 1. Each is what a unit of one parameter does at one place.
        twists: shape (E, 6), in the place's axes, linear part first.
        columns: Number of parameters.
    """

    slides: NDArray[np.bool_]
    steps: Array
    starts: Array
    bases: Array
    targets: Array
    entries: Numbers
    twists: Array
    columns: int


class Stood(NamedTuple):
    """Where the robot stood in N samples.

    Attributes:
        values: shape (N, n), values of the chain's joints [rad or m].
        frame: shape (N,), number of the frame.
        target: shape (N,), number of the target.
        numbers: shape (N, K), known numbers of the joints' state that multiply an entry.
    """

    values: Array
    frame: Numbers
    target: Numbers
    numbers: Array


class Measured(NamedTuple):
    """What was measured of N samples.

    Attributes:
        what: One of `POSITION`, `POSE`, `DISTANCE`, `BETWEEN`, `HEIGHT`; the same of all.
        points: shape (N, 3), positions [m].
        rotations: shape (N, 9), R_frame_target by rows.
        lengths: shape (N,), distances [m].
    """

    what: int
    points: Array
    rotations: Array
    lengths: Array


class Scratch(NamedTuple):
    """Room for one block: frames of the places, columns, and what goes into them."""

    Q: Array
    S: Array
    C: Array
    F: Array
    J: Array
    A: Array


def compiled(exact: bool = False, inline: bool = False) -> Callable[[_F], _F]:
    """Compile with numba, kept on disk; sums may be put in another order unless they must be exact."""
    allowed = {"contract"} if exact else {"contract", "reassoc", "nsz", "arcp"}
    decorator = njit(
        fastmath=allowed, nogil=True, cache=True, error_model="numpy", forceinline=inline
    )
    return cast("Callable[[_F], _F]", decorator)


@compiled(exact=True)
def sines(q: Array, S: Array, C: Array) -> None:
    """Sine and cosine of each entry of q, into S and C."""
    for i in range(q.shape[0]):
        for w in range(q.shape[1]):
            x = q[i, w]
            n = np.rint(x * 0.63661977236758134308)
            r = x - n * 1.57079632673412561417e00
            r = r - n * 6.07710050630396597660e-11
            r = r - n * 2.02226624879595063154e-21
            z = r * r
            u = 2.75573137070700676789e-06 + z * (
                -2.50507602534068634195e-08 + z * 1.58969099521155010221e-10
            )
            u = 8.33333333332248946124e-03 + z * (-1.98412698298579493134e-04 + z * u)
            s = r + r * z * (-1.66666666666666324348e-01 + z * u)
            v = -2.75573143513906633035e-07 + z * (
                2.08757232129817482790e-09 + z * -1.13596475577881948265e-11
            )
            v = -1.38888888888741095749e-03 + z * (2.48015872894767294178e-05 + z * v)
            v = 4.16666666666666019037e-02 + z * v
            h = 0.5 * z
            a = 1.0 - h
            c = a + (((1.0 - a) - h) + z * z * v)
            k = n - 4.0 * np.floor(0.25 * n)
            odd = (k == 1.0) | (k == 3.0)
            sine = c if odd else s
            cosine = s if odd else c
            S[i, w] = -sine if k >= 2.0 else sine
            C[i, w] = -cosine if (k == 1.0) | (k == 2.0) else cosine


@compiled(inline=True)
def _turn(F: Array, j: int, C: Array, S: Array, steps: Array) -> None:
    """The place behind joint j, which turns about its z axis by angles of these cosines and sines."""
    a0, a1, a2 = steps[j, 0], steps[j, 1], steps[j, 2]
    a3, a4, a5 = steps[j, 3], steps[j, 4], steps[j, 5]
    a6, a7, a8 = steps[j, 6], steps[j, 7], steps[j, 8]
    t0, t1, t2 = steps[j, 9], steps[j, 10], steps[j, 11]
    for w in range(LANES):
        c, s = C[j, w], S[j, w]
        for r in range(3):
            x, y, z = F[1 + j, 3 * r, w], F[1 + j, 3 * r + 1, w], F[1 + j, 3 * r + 2, w]
            u, v = x * c + y * s, y * c - x * s
            F[2 + j, 3 * r, w] = u * a0 + v * a3 + z * a6
            F[2 + j, 3 * r + 1, w] = u * a1 + v * a4 + z * a7
            F[2 + j, 3 * r + 2, w] = u * a2 + v * a5 + z * a8
            F[2 + j, 9 + r, w] = F[1 + j, 9 + r, w] + u * t0 + v * t1 + z * t2


@compiled(inline=True)
def _slide(F: Array, j: int, Q: Array, steps: Array) -> None:
    """The place behind joint j, which slides along its z axis."""
    for w in range(LANES):
        for r in range(3):
            x, y, z = F[1 + j, 3 * r, w], F[1 + j, 3 * r + 1, w], F[1 + j, 3 * r + 2, w]
            for k in range(3):
                F[2 + j, 3 * r + k, w] = x * steps[j, k] + y * steps[j, 3 + k] + z * steps[j, 6 + k]
            o = F[1 + j, 9 + r, w] + z * Q[j, w]
            F[2 + j, 9 + r, w] = o + x * steps[j, 9] + y * steps[j, 10] + z * steps[j, 11]


@compiled(inline=True)
def forward(geometry: Geometry, stood: Stood, first: int, count: int, room: Scratch) -> None:
    """The frames of all places of a block, into F, shape (n + 3, 12, LANES): R by rows, then the origin.

    Place 0 is the base, 1 to n the joints with their axis along z, before they move, n + 1 the tip, n + 2 the target.
    The last lanes of a block that is not full repeat its last sample.
    """
    values, frame, target = stood.values, stood.frame, stood.target
    slides, steps, targets = geometry.slides, geometry.steps, geometry.targets
    starts, bases = geometry.starts, geometry.bases
    Q, S, C, F = room.Q, room.S, room.C, room.F
    n = values.shape[1]
    for w in range(LANES):
        i = first + min(w, count - 1)
        for j in range(n):
            Q[j, w] = values[i, j]
    sines(Q, S, C)
    for w in range(LANES):
        i = first + min(w, count - 1)
        f = frame[i]
        for k in range(12):
            F[0, k, w] = bases[f, k]
            F[1, k, w] = starts[f, k]
    for j in range(n):
        if slides[j]:
            _slide(F, j, Q, steps)
        else:
            _turn(F, j, C, S, steps)
    for w in range(LANES):
        t = target[first + min(w, count - 1)]
        for r in range(3):
            x, y, z = F[1 + n, 3 * r, w], F[1 + n, 3 * r + 1, w], F[1 + n, 3 * r + 2, w]
            for k in range(3):
                F[2 + n, 3 * r + k, w] = (
                    x * targets[t, k] + y * targets[t, 3 + k] + z * targets[t, 6 + k]
                )
            F[2 + n, 9 + r, w] = (
                F[1 + n, 9 + r, w] + x * targets[t, 9] + y * targets[t, 10] + z * targets[t, 11]
            )


@compiled(inline=True)
def columns_of(
    geometry: Geometry, stood: Stood, first: int, count: int, scale: Array, F: Array, J: Array
) -> None:
    """The target's velocity in a unit of each parameter, times ``scale``, into J, shape (columns, 3 LANES)."""
    entries, twists = geometry.entries, geometry.twists
    frame, target, numbers = stood.frame, stood.target, stood.numbers
    last = F.shape[0] - 1
    for e in range(entries.shape[0]):
        k, col = entries[e, 0], entries[e, 1]
        only_frame, only_target, number = entries[e, 2], entries[e, 3], entries[e, 4]
        v0, v1, v2 = twists[e, 0], twists[e, 1], twists[e, 2]
        w0, w1, w2 = twists[e, 3], twists[e, 4], twists[e, 5]
        more = entries[e, 5] == 1
        G = scale
        if only_frame >= 0 or only_target >= 0 or number >= 0:
            G = np.empty(LANES)
            for w in range(LANES):
                i = first + min(w, count - 1)
                on = (only_frame < 0 or frame[i] == only_frame) and (
                    only_target < 0 or target[i] == only_target
                )
                G[w] = scale[w] * (numbers[i, number] if number >= 0 else 1.0) if on else 0.0
        turning = w0 != 0.0 or w1 != 0.0 or w2 != 0.0
        if turning and not more:
            for w in range(LANES):
                d0 = F[last, 9, w] - F[k, 9, w]
                d1 = F[last, 10, w] - F[k, 10, w]
                d2 = F[last, 11, w] - F[k, 11, w]
                a0 = F[k, 0, w] * w0 + F[k, 1, w] * w1 + F[k, 2, w] * w2
                a1 = F[k, 3, w] * w0 + F[k, 4, w] * w1 + F[k, 5, w] * w2
                a2 = F[k, 6, w] * w0 + F[k, 7, w] * w1 + F[k, 8, w] * w2
                l0 = F[k, 0, w] * v0 + F[k, 1, w] * v1 + F[k, 2, w] * v2
                l1 = F[k, 3, w] * v0 + F[k, 4, w] * v1 + F[k, 5, w] * v2
                l2 = F[k, 6, w] * v0 + F[k, 7, w] * v1 + F[k, 8, w] * v2
                J[col, w] = (l0 + a1 * d2 - a2 * d1) * G[w]
                J[col, LANES + w] = (l1 + a2 * d0 - a0 * d2) * G[w]
                J[col, 2 * LANES + w] = (l2 + a0 * d1 - a1 * d0) * G[w]
        elif not more:
            for w in range(LANES):
                for r in range(3):
                    J[col, r * LANES + w] = (
                        F[k, 3 * r, w] * v0 + F[k, 3 * r + 1, w] * v1 + F[k, 3 * r + 2, w] * v2
                    ) * G[w]
        else:
            for w in range(LANES):
                d0 = F[last, 9, w] - F[k, 9, w]
                d1 = F[last, 10, w] - F[k, 10, w]
                d2 = F[last, 11, w] - F[k, 11, w]
                a0 = F[k, 0, w] * w0 + F[k, 1, w] * w1 + F[k, 2, w] * w2
                a1 = F[k, 3, w] * w0 + F[k, 4, w] * w1 + F[k, 5, w] * w2
                a2 = F[k, 6, w] * w0 + F[k, 7, w] * w1 + F[k, 8, w] * w2
                l0 = F[k, 0, w] * v0 + F[k, 1, w] * v1 + F[k, 2, w] * v2
                l1 = F[k, 3, w] * v0 + F[k, 4, w] * v1 + F[k, 5, w] * v2
                l2 = F[k, 6, w] * v0 + F[k, 7, w] * v1 + F[k, 8, w] * v2
                J[col, w] += (l0 + a1 * d2 - a2 * d1) * G[w]
                J[col, LANES + w] += (l1 + a2 * d0 - a0 * d2) * G[w]
                J[col, 2 * LANES + w] += (l2 + a0 * d1 - a1 * d0) * G[w]


@compiled(inline=True)
def turning_of(
    geometry: Geometry, stood: Stood, first: int, count: int, scale: Array, F: Array, J: Array
) -> None:
    """The target's angular velocity in a unit of each parameter, times ``scale``; as `columns_of`."""
    entries, twists = geometry.entries, geometry.twists
    frame, target, numbers = stood.frame, stood.target, stood.numbers
    for e in range(entries.shape[0]):
        k, col = entries[e, 0], entries[e, 1]
        only_frame, only_target, number = entries[e, 2], entries[e, 3], entries[e, 4]
        w0, w1, w2 = twists[e, 3], twists[e, 4], twists[e, 5]
        for w in range(LANES):
            i = first + min(w, count - 1)
            on = (only_frame < 0 or frame[i] == only_frame) and (
                only_target < 0 or target[i] == only_target
            )
            g = scale[w] * (numbers[i, number] if number >= 0 else 1.0) if on else 0.0
            for r in range(3):
                turned = F[k, 3 * r, w] * w0 + F[k, 3 * r + 1, w] * w1 + F[k, 3 * r + 2, w] * w2
                before = J[col, r * LANES + w] if entries[e, 5] == 1 else 0.0
                J[col, r * LANES + w] = before + turned * g


@compiled()
def gram(J: Array, H: Array, width: int) -> None:
    """Add J J^T to the lower half of H, in tiles of 4 by 4; J has a multiple of four rows, ``width`` columns count."""
    for i in range(0, J.shape[0], 4):
        for l in range(0, i + 4, 4):  # noqa: E741
            a00 = a01 = a02 = a03 = a10 = a11 = a12 = a13 = 0.0
            a20 = a21 = a22 = a23 = a30 = a31 = a32 = a33 = 0.0
            for k in range(width):
                x0, x1, x2, x3 = J[i, k], J[i + 1, k], J[i + 2, k], J[i + 3, k]
                y0, y1, y2, y3 = J[l, k], J[l + 1, k], J[l + 2, k], J[l + 3, k]
                a00 += x0 * y0
                a01 += x0 * y1
                a02 += x0 * y2
                a03 += x0 * y3
                a10 += x1 * y0
                a11 += x1 * y1
                a12 += x1 * y2
                a13 += x1 * y3
                a20 += x2 * y0
                a21 += x2 * y1
                a22 += x2 * y2
                a23 += x2 * y3
                a30 += x3 * y0
                a31 += x3 * y1
                a32 += x3 * y2
                a33 += x3 * y3
            H[i, l] += a00
            H[i, l + 1] += a01
            H[i, l + 2] += a02
            H[i, l + 3] += a03
            H[i + 1, l] += a10
            H[i + 1, l + 1] += a11
            H[i + 1, l + 2] += a12
            H[i + 1, l + 3] += a13
            H[i + 2, l] += a20
            H[i + 2, l + 1] += a21
            H[i + 2, l + 2] += a22
            H[i + 2, l + 3] += a23
            H[i + 3, l] += a30
            H[i + 3, l + 1] += a31
            H[i + 3, l + 2] += a32
            H[i + 3, l + 3] += a33


@compiled(inline=True)
def scratch_of(n: int, columns: int) -> Scratch:
    """Room for a block of a chain of n joints with some columns and a residual, in whole tiles of four rows."""
    rows = (columns + 4) // 4 * 4
    return Scratch(
        np.empty((n, LANES)),
        np.empty((n, LANES)),
        np.empty((n, LANES)),
        np.empty((n + 3, 12, LANES)),
        np.zeros((rows, 3 * LANES)),
        np.zeros((rows, 3 * LANES)),
    )


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
            over = 1.0 / max(length, TINY)
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
        _leverage(room, root, p, d, all_of, Y, K)
        for w in range(count):
            weight = weights[begin + w]
            for r in range(all_of):
                M[r, 6] = room.J[p, r * LANES + w] if r < d else room.A[p, (r - d) * LANES + w]
            _deleted(K[:, :, w], weight, all_of, M)
            out[begin + w] = np.sqrt(_square_over(M, all_of))


@compiled(inline=True)
def _leverage(room: Scratch, root: Array, p: int, d: int, all_of: int, Y: Array, K: Array) -> None:
    """K = A C A^T of the scalars of each lane, d lengths and then angles, into the lower triangles of K."""
    K[:all_of, :all_of] = 0.0
    for k in range(0, p, 4):
        Y[:] = 0.0
        for j in range(k, p, 4):
            _add_tile(room.J, j, d * LANES, root, k, Y, 0)
            _add_tile(room.A, j, (all_of - d) * LANES, root, k, Y, d * LANES)
        for i in range(4):
            for r in range(all_of):
                for c in range(r + 1):
                    for w in range(LANES):
                        K[r, c, w] += Y[i, r * LANES + w] * Y[i, c * LANES + w]


@compiled(inline=True)
def _add_tile(J: Array, j: int, width: int, root: Array, k: int, Y: Array, at: int) -> None:
    """Add to four rows of Y, from column ``at`` on, four rows of J times a tile of the root."""
    t00, t01, t02, t03 = root[k, j], root[k, j + 1], root[k, j + 2], root[k, j + 3]
    t10, t11, t12, t13 = root[k + 1, j], root[k + 1, j + 1], root[k + 1, j + 2], root[k + 1, j + 3]
    t20, t21, t22, t23 = root[k + 2, j], root[k + 2, j + 1], root[k + 2, j + 2], root[k + 2, j + 3]
    t30, t31, t32, t33 = root[k + 3, j], root[k + 3, j + 1], root[k + 3, j + 2], root[k + 3, j + 3]
    for w in range(width):
        x0, x1, x2, x3 = J[j, w], J[j + 1, w], J[j + 2, w], J[j + 3, w]
        Y[0, at + w] += (t00 * x0 + t01 * x1) + (t02 * x2 + t03 * x3)
        Y[1, at + w] += (t10 * x0 + t11 * x1) + (t12 * x2 + t13 * x3)
        Y[2, at + w] += (t20 * x0 + t21 * x1) + (t22 * x2 + t23 * x3)
        Y[3, at + w] += (t30 * x0 + t31 * x1) + (t32 * x2 + t33 * x3)


@compiled(inline=True)
def _deleted(K: Array, weight: float, d: int, M: Array) -> None:
    """(I + (1 - w) K) (I - w K), the lower triangle, into M; K's lower triangle counts."""
    for r in range(d):
        for c in range(r + 1):
            square = 0.0
            for k in range(d):
                square += K[max(r, k), min(r, k)] * K[max(c, k), min(c, k)]
            M[r, c] = (1.0 - 2.0 * weight) * K[r, c] - weight * (1.0 - weight) * square
        M[r, r] += 1.0 + _WHOLE


@compiled()
def _square_over(M: Array, d: int) -> float:
    """r^T M^-1 r of the leading d by d lower triangle of M and r in its last column, by Cholesky's root in place."""
    total = 0.0
    for r in range(d):
        for c in range(r + 1):
            x = M[r, c]
            for k in range(c):
                x -= M[r, k] * M[c, k]
            M[r, c] = x / M[c, c] if c < r else np.sqrt(max(x, _WHOLE))
        y = M[r, 6]
        for k in range(r):
            y -= M[r, k] * M[k, 6]
        M[r, 6] = y / M[r, r]
        total += M[r, 6] ** 2
    return total


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
