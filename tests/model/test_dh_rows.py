from __future__ import annotations

import numpy as np

from calib.model.dh import DHRow, DHTable

QUARTER = np.pi / 2


def table(convention: str, *rows: DHRow) -> DHTable:
    return DHTable(rows, np.eye(4), np.eye(4), convention)


def test_a_row_of_each_convention_by_hand():
    row = DHRow("j", prismatic=False, theta=QUARTER, d=0.3, a=0.5, alpha=QUARTER)
    # Standard: up by d, out along the turned x by a. Modified: out along x first, then z, which alpha laid down.
    standard = table("standard", row).poses([0.0])[0]
    np.testing.assert_allclose(standard[:3, 3], [0.0, 0.5, 0.3], atol=1e-15)
    np.testing.assert_allclose(standard[:3, 2], [1.0, 0.0, 0.0], atol=1e-15)
    modified = table("modified", row).poses([0.0])[0]
    np.testing.assert_allclose(modified[:3, 3], [0.5, -0.3, 0.0], atol=1e-15)
    np.testing.assert_allclose(modified[:3, 2], [0.0, -1.0, 0.0], atol=1e-15)
    tilted = DHRow("j", prismatic=False, theta=0.0, d=0.0, a=0.5, alpha=0.0, beta=0.01)
    hayati = table("hayati", tilted).poses([0.0])[0]
    np.testing.assert_allclose(hayati[:3, 2], [np.sin(0.01), 0.0, np.cos(0.01)], atol=1e-15)
