"""Blocks of the compiled kernel: the frames of all places, the columns of all parameters, and their products.

Everything is a loop over `LANES` samples, laid out so that the same step of all of them is one vector instruction.
Sine and cosine: reduction by pi/2 in three parts and the minimax polynomials of FDLIBM (Sun Microsystems, 1993), within
one unit in the last place up to `FARTHEST`.
"""

from __future__ import annotations

import numpy as np

from calib.model.kernel_types import LANES, Array, Geometry, Scratch, Stood, compiled

#: Joint values beyond this are not reduced exactly [rad].
FARTHEST = 1e5


@compiled(exact=True)
def sines(q: Array, S: Array, C: Array) -> None:
    """Sine and cosine of each entry of q, into S and C, all of one shape, [rad]."""
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
    """The target's angular velocity in a unit of each parameter, times ``scale``, into J, shape (columns, 3 LANES)."""
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
    """Add J J^T to the lower half of H, in tiles of 4 by 4; J has the shape (4 k, any), ``width`` columns count."""
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
