from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from calib.model import kernel_blocks as kernel


@given(
    st.lists(st.floats(-kernel.FARTHEST, kernel.FARTHEST, allow_nan=False), min_size=1, max_size=20)
)
def test_sines_are_right_to_the_last_bit_but_one(values):
    q = np.array([values])
    S, C = np.empty_like(q), np.empty_like(q)
    kernel.sines(q, S, C)
    np.testing.assert_allclose(S, np.sin(q), rtol=0.0, atol=1.2e-16)
    np.testing.assert_allclose(C, np.cos(q), rtol=0.0, atol=1.2e-16)


def test_sines_at_multiples_of_a_quarter_turn():
    q = (np.arange(-4000, 4000) * (np.pi / 2))[None]
    S, C = np.empty_like(q), np.empty_like(q)
    kernel.sines(q, S, C)
    np.testing.assert_allclose(S, np.sin(q), rtol=1e-15, atol=1e-19)
    np.testing.assert_allclose(C, np.cos(q), rtol=1e-15, atol=1e-19)


@given(st.integers(1, 5), st.integers(1, 60), st.integers(0, 2**32 - 1))
def test_gram_adds_the_products_of_all_rows(tiles, width, seed):
    rng = np.random.default_rng(seed)
    J = rng.normal(size=(4 * tiles, 64))
    H = rng.normal(size=(4 * tiles, 4 * tiles))
    expected = H + J[:, :width] @ J[:, :width].T
    kernel.gram(J, H, width)
    np.testing.assert_allclose(np.tril(H), np.tril(expected), rtol=1e-12, atol=1e-12)
