"""Priors: zero-mean Gaussian distributions of a robot's errors, one standard deviation for each family."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from calib.basics.records import Key, Option, written_parts
from calib.basics.value_forms import number, one_of
from calib.errors import CalibError, choices
from calib.model.families import FAMILIES, family_of

#: Allowed values of `Priors.source`.
PRIOR_SOURCES = ("data", "given", "off")

#: Least and largest prior standard deviation, in the family's SI unit: a larger one has no effect,
#: a smaller one is a constraint, and the squares of both leave the range of doubles.
PRIOR_STD_RANGE = (1e-15, 1e6)


@dataclass(frozen=True, slots=True, init=False)
class Priors:
    """Prior standard deviations of a robot's errors, by family, and whether they are estimated.

    Example:
        >>> Priors("given", length=1e-3).of("length")
        0.001
    """

    #: ``"data"``: the prior standard deviations are estimated from the measurements, starting at
    #: those given; ``"given"``: they are those given; ``"off"``: plain least squares, except for a
    #: weak prior on what no measurement determines.
    source: str
    #: (family, prior standard deviation in the family's SI unit) of the families whose value is
    #: not the default of the registry, sorted by name.
    given: tuple[tuple[str, float], ...]

    def __init__(self, source: str = "data", **given: float) -> None:
        """Set prior standard deviations by family, ``Priors("given", length=1e-3, compliance=2e-6)``.

        Args:
            source: ``"data"``, ``"given"`` or ``"off"``, see `source`.
            **given: Prior standard deviation by the name of the family, in its SI unit, such as
                [m] or [rad/Nm]; families that are left out have the default of the registry.

        Raises:
            CalibError: An unknown source or family, or a value out of `PRIOR_STD_RANGE`.
        """
        if source not in PRIOR_SOURCES:
            raise CalibError(
                f"The source of the priors is '{source}'; choose one of {choices(PRIOR_SOURCES)}."
            )
        least, largest = PRIOR_STD_RANGE
        for name, std in given.items():
            if not least <= std <= largest:
                raise CalibError(
                    f"The prior's {name} is {std:g} {family_of(name).unit.symbol}; it lies "
                    f"between {least:g} and {largest:g}. Use the source 'off' for none."
                )
        changed = [(name, std) for name, std in given.items() if std != family_of(name).prior]
        object.__setattr__(self, "source", source)
        object.__setattr__(self, "given", tuple(sorted(changed)))

    def with_source(self, source: str) -> Priors:
        """Return the same prior standard deviations with another source, see `source`."""
        return Priors(source, **dict(self.given))

    def of(self, family: str) -> float:
        """Return the prior standard deviation of a family's errors, in its SI unit.

        Args:
            family: Name of the family, ``"length"``.

        Returns:
            The value given, or the default of the registry.
        """
        return dict(self.given).get(family, family_of(family).prior)


def prior_keys() -> Sequence[Key]:
    """Return the keys of a cell file for priors, one for each registered family; their parts are those of `Priors`."""
    source = Option(
        "--priors",
        group="fit",
        type=PRIOR_SOURCES,
        help="Prior standard deviations of the robot's errors: estimated from the data ('data', the default), as the "
        "cell file or calib's own 3 mm and 15 mrad say ('given'), or no priors ('off').",
        merge=Priors.with_source,
    )
    rows = [
        Key(
            "priors",
            one_of(PRIOR_SOURCES),
            "Prior standard deviations of the robot's errors: estimated, starting from those below; as given below; or "
            "none.",
            '"data"',
            (source,),
            part="source",
        )
    ]
    for name, family in FAMILIES.items():
        suffix, unit_in_si = family.unit.cell
        meaning = family.meaning or f"an error of the family `{name}`"
        rows.append(
            Key(
                f"prior_{name}{suffix}",
                number(suffix.strip("_").replace("_per_", "/"), unit_in_si=unit_in_si),
                f"Prior standard deviation of {meaning}.",
                f"{family.prior / unit_in_si:g}".replace("e-0", "e-"),
                part=name,
            )
        )
    return rows


def write_priors(priors: Priors) -> dict[str, Any]:
    """Return the entries of a file, by the keys of `prior_keys`, of what was given."""
    return written_parts(prior_keys(), {"source": priors.source, **dict(priors.given)})
