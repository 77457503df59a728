"""Random numbers: one stream for each purpose."""

import numpy as np
import pytest

from calib.errors import CalibError
from calib.measure.random_streams import STREAMS, stream


def test_every_purpose_and_every_seed_has_numbers_of_its_own():
    drawn = {(s, name): stream(s, name).standard_normal() for s in (0, 1, 2) for name in STREAMS}
    assert len(set(drawn.values())) == len(drawn) == 3 * len(STREAMS)


def test_the_same_seed_gives_the_same_numbers():
    assert (
        stream(7, "errors").normal(size=5) == stream(np.int64(7), "errors").normal(size=5)
    ).all()


@pytest.mark.parametrize("seed", [-1, 1.0, "1", None, True])
def test_what_is_no_seed_is_refused(seed):
    with pytest.raises(CalibError, match="it must be a whole number, 0 or more"):
        stream(seed, "errors")


def test_an_unknown_purpose_is_refused_with_those_there_are():
    with pytest.raises(CalibError, match="no random numbers for 'tea'; there are for 'errors'"):
        stream(0, "tea")
