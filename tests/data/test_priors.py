"""Prior standard deviations by family: given, or the defaults of the registry."""

from __future__ import annotations

import pytest

from calib.data.priors import PRIOR_STD_RANGE, Priors
from calib.errors import CalibError
from calib.model.families import family_of


def test_what_is_not_given_is_the_familys_default():
    priors = Priors("given", length=7e-3, angle=family_of("angle").prior)
    assert priors.of("length") == 7e-3
    assert priors.of("compliance") == family_of("compliance").prior
    assert priors.given == (("length", 7e-3),)
    assert priors == Priors("given", length=7e-3)
    assert priors.with_source("off") == Priors("off", length=7e-3)
    assert Priors().source == "data"


@pytest.mark.parametrize("std", [0.0, -1.0, PRIOR_STD_RANGE[1] * 1.1, float("nan")])
def test_a_prior_standard_deviation_is_positive(std):
    with pytest.raises(CalibError, match="The prior's angle is"):
        Priors(angle=std)


def test_sources_and_families_exist():
    with pytest.raises(CalibError, match="choose one of 'data', 'given', 'off'"):
        Priors("some")
    with pytest.raises(CalibError, match="'lenght'"):
        Priors(lenght=1e-3)
