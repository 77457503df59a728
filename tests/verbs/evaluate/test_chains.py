"""A robot of several chains is evaluated row by row through each one's own chain, as the fit had it."""

from __future__ import annotations

import numpy as np
import pytest

from calib.result.calibration import Calibration
from calib.verbs.evaluate.acceptance import assess
from calib.verbs.evaluate.report import summary
from tests.two_handed import fitted


@pytest.fixture(scope="module")
def read(tmp_path_factory):
    """The result as read from its file, with the table and the cell of the fit."""
    c = fitted()
    path = c.write_json(tmp_path_factory.mktemp("result") / "result.json")
    return Calibration.read_json(path), c


def test_errors_are_those_of_the_fit_by_chain(read):
    result, c = read
    m = c.fit.measurements
    cell = result.setup.in_cell(c.fit.cell)
    assessment = assess(c.nominal, m, cell, result, which=("frame", "target"))
    found = assessment.evaluations["calibration"]
    np.testing.assert_allclose(found.residual, c.rows.residual_calibrated, atol=1e-9)
    by_chain = found.errors_by_chain
    assert list(by_chain) == ["panda_link0 to panda_link8", "panda_link0 to right/panda_link8"]
    for hand, errors in zip("ab", by_chain.values(), strict=True):
        norms = np.linalg.norm(c.rows.residual_calibrated[np.array(m.targets) == hand], axis=1)
        assert errors["m"].rms == pytest.approx(np.sqrt(np.mean(norms**2)))
    assert len(assessment.accuracies["calibration"].poses) == len(m)
    text = summary(assessment)
    assert "panda_link0 to right/panda_link8" in text
    assert "mm in right/panda_link8" in text


def test_one_chain_has_no_errors_by_chain(paper_table, ur3):
    from calib.verbs.evaluate.evaluation import evaluate

    assert evaluate(ur3, paper_table).errors_by_chain == {}
