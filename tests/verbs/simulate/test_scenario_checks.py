"""Values that a scenario cannot be made with."""

from __future__ import annotations

import pytest

from calib.errors import ArgumentError, CalibError, ModelError
from calib.verbs.simulate.scenario import Scenario


@pytest.mark.parametrize(
    ("values", "error"),
    [
        ({"model": 3}, ArgumentError),
        ({"noise": 1e-4}, ArgumentError),
        ({"target_error": -1.0}, ModelError),
        ({"visits": 0}, ModelError),
        ({"sizes": {"nothing": 1.0}}, ModelError),
        ({"sizes": {"length": -1.0}}, ModelError),
    ],
)
def test_each_is_refused_by_its_name(ur3, values, error):
    with pytest.raises(CalibError) as caught:
        Scenario(ur3, **values)
    assert type(caught.value) is error
    (name,) = values
    assert name in str(caught.value) or "nothing" in str(caught.value)
