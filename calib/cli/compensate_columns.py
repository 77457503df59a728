"""What a program's columns that were not read may have been meant for: an orientation under a controller's names."""

from __future__ import annotations

from typing import TYPE_CHECKING

from calib.units import split_header

if TYPE_CHECKING:
    from calib.compensate.program import Program

_RPY = ("roll", "pitch", "yaw")

#: Names of orientations on controllers, in small letters; whose they are, and what calib calls each.
_MEANT = (
    (("a", "b", "c"), "KUKA", ("yaw", "pitch", "roll")),
    (("w", "p", "r"), "FANUC", _RPY),
    (("q1", "q2", "q3", "q4"), "ABB", ("qw", "qx", "qy", "qz")),
    (("q0", "q1", "q2", "q3"), "a quaternion that begins with w", ("qw", "qx", "qy", "qz")),
    (("o", "a", "t"), "Kawasaki", ()),
    (("alpha", "beta", "gamma"), "", ()),
    (("phi", "theta", "psi"), "", ()),
)

#: Columns that are named, at most.
_MOST = 12


def passed_through(program: Program) -> str:
    """The columns that go into the commands unread; nothing where there are none."""
    labels = [label for label, _ in program.kept if label]
    if not labels:
        return ""
    more = f" and {len(labels) - _MOST} more" if len(labels) > _MOST else ""
    return f"Passed through unread: {', '.join(labels[:_MOST])}{more}."


def unread_orientation(program: Program) -> str:
    """What to do about columns that look like an orientation, where positions alone were read."""
    if program.T_wanted is None or program.oriented:
        return ""
    named = {}
    for label, _ in program.kept:
        name, _ = split_header(label)
        named[name.casefold()] = name
    for names, whose, meaning in _MEANT:
        if not all(name in named for name in names):
            continue
        there = [named[name] for name in names]
        return (
            f"The columns {', '.join(there)} look like an orientation and were not read: positions alone are matched, "
            "and beside the new orientation in the table the old one is wrong. "
            + (_mapping(there, whose, meaning) if meaning else _CONVERT)
        )
    return ""


_CONVERT = (
    "If they are one, convert them to quaternions, qx, qy, qz, qw, or to roll, pitch and yaw: "
    "docs/compensation.md."
)


def _mapping(there: list[str], whose: str, meaning: tuple[str, ...]) -> str:
    """The options that read them."""
    unit = "" if "qw" in meaning else " [deg]"
    options = " ".join(
        f'--columns "{column}={name}{unit}"' for column, name in zip(there, meaning, strict=True)
    )
    return f"If they are one ({whose}): {options}. Otherwise they mean nothing here."
