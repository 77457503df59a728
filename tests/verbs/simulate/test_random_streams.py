"""Random numbers: the same for a seed and a purpose, others for another."""

from __future__ import annotations

import pytest

from calib.errors import CalibError
from calib.verbs.simulate.random_streams import STREAMS, stream


def test_each_purpose_has_numbers_of_its_own():
    first = {purpose: stream(3, purpose).standard_normal(4).tolist() for purpose in STREAMS}
    again = {purpose: stream(3, purpose).standard_normal(4).tolist() for purpose in STREAMS}
    assert first == again
    assert len({tuple(numbers) for numbers in first.values()}) == len(STREAMS)
    assert stream(4, "errors").standard_normal(4).tolist() != first["errors"]
    with pytest.raises(CalibError):
        stream(-1, "errors")
