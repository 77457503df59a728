"""What sweeps are called: the plane, the chain's joints by name or number, and the user's own words for them."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from calib.errors import MeasurementError, choices
from calib.measure.columns import close_names

#: What the sweep is called that is none, and its number.
PLANE, PLANE_NUMBER = "plane", -1

_NUMBERED = re.compile(r"(?:joint|axis|sweep|j|a)?[ _\-.]*0*([1-9][0-9]?)", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class SweepWords:
    """The words of one file.

    Attributes:
        source: The file's name, for messages.
        joint_names: Of the chain, base to tip; empty where nobody named them.
        words: What the file calls sweeps, to what they are.
    """

    source: str
    joint_names: tuple[str, ...]
    words: Mapping[str, str]

    def number(self, word: str) -> int | None:
        """The joint that a word names, from 0; `PLANE_NUMBER` for the plane; None for any other word."""
        plain = self.words.get(word, word).strip()
        if plain.casefold() == PLANE:
            return PLANE_NUMBER
        if plain in self.joint_names:
            return self.joint_names.index(plain)
        match = _NUMBERED.fullmatch(plain)
        if match is None or (self.joint_names and int(match[1]) > len(self.joint_names)):
            return None
        return int(match[1]) - 1

    def refusal(self, where: str, word: str) -> str:
        """What to say of a word that names no sweep."""
        close = close_names(word, [PLANE, *self.joint_names])
        hint = f" Close to it: {choices(close)}." if close else ""
        count = len(self.joint_names)
        joints = f"a joint's name ({choices(self.joint_names)}), or " if count else ""
        last = f" to 'joint {count}'" if count > 1 else ""
        names = (
            ""
            if count
            else " Joints go by their names where --robot or columns of joint values tell them."
        )
        return (
            f"{where}: '{word}' is not a sweep; allowed are '{PLANE}', {joints}a joint's number, 'joint 1'{last}."
            f'{hint}{names} Correct it, or map it: --sweep "{word}=joint 1".'
        )


def check_words(words: Mapping[str, str], joint_names: Sequence[str], what: str) -> None:
    """Refuse a mapping to what is no sweep.

    Args:
        words: What the file calls sweeps, to what they are.
        joint_names: Of the chain; empty where they are not known.
        what: Where it was given, for the message.

    Raises:
        MeasurementError: The first that names none.
    """
    spelled = SweepWords("", tuple(joint_names), {})
    for word, wanted in words.items():
        if spelled.number(wanted) is None:
            raise MeasurementError(spelled.refusal(f"{what} maps '{word}'", wanted))
