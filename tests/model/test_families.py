"""The registry of families: its rows, and a family that is added from outside."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.basics.units import UNITS
from calib.errors import ArgumentError, ModelError
from calib.model import families
from calib.model.families import FAMILIES, Factor, Family, JointState, register
from calib.model.joint_errors import joint_parameters

#: The families that calib has itself.
NAMES = (
    *("length", "angle", "zero", "gain", "eccentricity", "harmonic_2"),
    *("lost_motion", "creep", "compliance", "gravity"),
)


@pytest.fixture
def registry():
    """The registry as it is, and again so afterwards: only tests take families out."""
    before = dict(families._REGISTRY)
    yield FAMILIES
    families._REGISTRY.clear()
    families._REGISTRY.update(before)


def test_the_rows():
    assert tuple(FAMILIES) == NAMES
    assert [name for name, row in FAMILIES.items() if row.geometric] == ["length", "angle", "zero"]
    assert [name for name, row in FAMILIES.items() if row.loaded] == ["compliance", "gravity"]
    for row in FAMILIES.values():
        assert row.bounds[0] < row.typical <= row.prior < row.bounds[1]


def test_prior_standard_deviations_are_those_of_docs_and_cell_files():
    priors = {name: row.prior for name, row in FAMILIES.items()}
    turns = {"gain": 1e-3, "eccentricity": 1e-3, "harmonic_2": 1e-3}
    moves = {"lost_motion": 0.3e-3, "creep": 1e-3}
    loads = {"compliance": 1e-5, "gravity": 1e-3}
    assert priors == {"length": 3e-3, "angle": 15e-3, "zero": 15e-3, **turns, **moves, **loads}


@pytest.mark.parametrize("name", ["gain", "eccentricity", "harmonic_2"])
def test_slopes_are_the_derivatives_of_the_factors(ur3, name):
    q = np.random.default_rng(1).uniform(-3.0, 3.0, (20, 6))
    for joint in ur3.joint_names:
        step = 1e-6 * (np.array(ur3.joint_names) == joint)
        for factor in FAMILIES[name].factors:
            high, low = (
                factor.value(JointState(joint, ur3.joint_names, q + s * step)) for s in (1.0, -1.0)
            )
            slope = factor.slope(JointState(joint, ur3.joint_names, q))
            np.testing.assert_allclose((high - low) / 2e-6, slope, atol=1e-8)


def test_a_family_from_outside(registry, ur3):
    own = Family("lost", families.RAD, 1e-3, 1e-3, (Factor("sign", lambda s: np.sign(s.q), None),))
    register(own)
    assert registry["lost"] is own
    names = [p.name for p in joint_parameters(ur3, "lost")]
    assert names == [f"{joint}.sign" for joint in ur3.joint_names]


@pytest.mark.parametrize(
    ("name", "factors", "fault"),
    [
        ("gain", ("other",), "'gain' has a name that is taken"),
        ("other", ("sin",), "the name of its factor 'sin' is taken"),  # of eccentricity
        ("other", ("other", "cos"), "the name of its factor 'cos' is taken"),
        ("other", ("twice", "twice"), "the name of its factor 'twice' is taken"),
        ("other", (), "'other' has no factors"),
        ("a+b", ("other",), "'a[+]b' is not a name"),
        ("", ("other",), "'' is not a name"),
        ("other", ("a.b",), "'a[.]b' is not a name"),
        ("other", ("a[b]",), "is not a name"),
        (3, ("other",), "3 is not a name"),
    ],
)
def test_a_family_of_a_wrong_name_or_without_factors_is_refused(registry, name, factors, fault):
    rows = tuple(Factor(factor, lambda state: state.q, None) for factor in factors)
    with pytest.raises(ModelError, match=f"The family .*{fault}"):
        register(Family(name, families.RAD, 1e-3, 1e-3, rows))
    assert len(registry) == len(NAMES)


OTHER_RAD = replace(families.RAD, step=1.0)


@pytest.mark.parametrize(
    ("unit", "sliding", "error", "fault"),
    [
        ("rad", None, ArgumentError, "has the unit 'rad'; it must be a Unit"),
        (families.RAD, "m", ArgumentError, "has the sliding 'm'; it must be a Unit"),
        (OTHER_RAD, None, ModelError, "a unit 'rad' that is not calib's"),
        (families.RAD, OTHER_RAD, ModelError, "a sliding 'rad' that is not calib's"),
    ],
)
def test_a_family_of_an_unknown_unit_is_refused(registry, unit, sliding, error, fault):
    factor = Factor("other", lambda state: state.q, None)
    with pytest.raises(error, match=fault) as caught:
        register(Family("other", unit, 1e-3, 1e-3, (factor,), sliding=sliding))
    assert type(caught.value) is error
    assert len(registry) == len(NAMES)


def test_only_families_are_registered(registry):
    with pytest.raises(ArgumentError, match="'family'"):
        register("gain")
    assert len(registry) == len(NAMES)


@pytest.mark.parametrize(
    ("value", "slope", "words"),
    [
        (lambda _s: 1.0, None, ("'value'", "no array", "(N,)")),
        (lambda s: s.values, None, ("'value'", "(64, 6)", "(N,)")),
        (lambda s: s.angle, None, ("'value'", "AttributeError", "angle")),
        (lambda s: s.q * np.nan, None, ("'value'", "finite")),
        (lambda s: np.sin(s.q), lambda s: s.values, ("'slope'", "(64, 6)")),
        (lambda s: np.sin(s.q), lambda s: -np.cos(s.q), ("'slope'", "differences")),
        (lambda s: np.sin(2 * s.q), lambda s: np.cos(2 * s.q), ("'slope'", "differences")),
        (lambda s: s.q, lambda s: s.q * np.nan, ("'slope'", "nan")),
    ],
)
def test_a_wrong_function_of_a_factor_is_named(registry, value, slope, words):
    with pytest.raises(ModelError) as caught:
        register(Family("own", families.RAD, 1e-3, 1e-3, (Factor("wave", value, slope),)))
    message = str(caught.value)
    for word in ("'wave'", *words):
        assert word in message
    assert "\n" not in message
    assert "own" not in registry


@pytest.mark.parametrize(
    ("value", "slope"),
    [
        (lambda s: np.sin(200 * s.q), lambda s: 200 * np.cos(200 * s.q)),
        (lambda s: np.sqrt(s.q), lambda s: 0.5 / np.sqrt(s.q)),  # of positive values only
        (lambda s: np.abs(s.q), lambda s: np.sign(s.q)),
        (lambda s: s.load * s.q, lambda s: s.load),
        (lambda s: s.values[:, s.joint_names.index("elbow_joint")], None),  # of one robot
        (lambda s: s.values[:, 6], None),  # of a robot with seven joints
    ],
)
def test_right_functions_pass_wherever_they_have_values(registry, value, slope):
    register(Family("own", families.RAD, 1e-3, 1e-3, (Factor("wave", value, slope),)))
    assert "own" in registry


@pytest.mark.parametrize("name", ["gain", "eccentricity", "compliance", "gravity"])
def test_each_family_of_calib_passes(registry, name):
    family = families._REGISTRY.pop(name)
    register(family)
    assert registry[name] is family


#: Every unit that a parameter of any family has, by its symbol.
FAMILY_UNITS = {
    unit.symbol: unit
    for family in FAMILIES.values()
    for unit in (family.unit, family.sliding)
    if unit is not None
}


def in_si(symbol: str) -> float:
    """What one of a unit such as ``urad/Nm`` is in SI units."""
    top, _, bottom = symbol.partition("/")
    of_top = 1e-6 * UNITS["rad"].to_si if top == "urad" else UNITS[top].to_si
    return of_top / (UNITS[bottom].to_si if bottom else 1.0)


def test_every_unit_of_a_family_is_known_here():
    assert set(FAMILY_UNITS) == {"m", "rad", "1", "m/m", "rad/Nm", "rad/m", "m/N"}


@pytest.mark.parametrize("symbol", FAMILY_UNITS)
def test_shown_values_and_those_of_cell_files_are_in_the_units_that_they_name(symbol):
    unit = FAMILY_UNITS[symbol]
    assert symbol == "1" or in_si(symbol) == 1.0
    factor, shown = unit.shown
    assert factor * in_si(shown) == pytest.approx(1.0, rel=1e-12)
    suffix, of_cell = unit.cell
    named = suffix.removeprefix("_").replace("_per_", "/")
    assert of_cell == pytest.approx(in_si(named) if named else 1.0, rel=1e-12)
    assert unit.key == symbol.replace("/", "_")
