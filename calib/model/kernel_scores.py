"""Scores in the compiled kernel: how far a row lies from what the others predict; see `calib.identify.robust`."""

from __future__ import annotations

import numpy as np

from calib.model.kernel_types import LANES, Array, Scratch, compiled

#: Leverage beyond this is taken for all there is: such a row says nothing of itself.
_WHOLE = 1e-9


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
def leverage(room: Scratch, root: Array, p: int, d: int, all_of: int, Y: Array, K: Array) -> None:
    """K = A C A^T of each lane's scalars, d lengths and then angles, into K's lower triangles, shape (6, 6, LANES)."""
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
def deleted(K: Array, weight: float, d: int, M: Array) -> None:
    """(I + (1 - w) K) (I - w K), the lower triangle, into M; of K, shape (6, 6), the lower triangle counts."""
    for r in range(d):
        for c in range(r + 1):
            square = 0.0
            for k in range(d):
                square += K[max(r, k), min(r, k)] * K[max(c, k), min(c, k)]
            M[r, c] = (1.0 - 2.0 * weight) * K[r, c] - weight * (1.0 - weight) * square
        M[r, r] += 1.0 + _WHOLE


@compiled()
def square_over(M: Array, d: int) -> float:
    """r^T M^-1 r of M's leading lower triangle, shape (d, d), and r in its last column, by Cholesky's root in place."""
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
