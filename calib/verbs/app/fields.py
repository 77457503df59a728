"""What the page of a job asks: its fields with their values, and the files that they are about."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True, slots=True)
class Field:
    """A field of the page: its value, what it may be, and whether the value is sure."""

    name: str
    value: str
    #: Allowed values with their labels; empty: any text
    options: tuple[tuple[str, str], ...] = ()
    #: Key of the sentence that says why the value may be wrong; empty: it is sure, or was chosen
    doubt: str = ""
    #: Words of that sentence
    words: Mapping[str, str] = field(default_factory=dict)
    #: Whether it was chosen on the page
    is_chosen: bool = False


@dataclass(frozen=True, slots=True)
class InputFile:
    """An input of a job, and what calib takes it for."""

    name: str
    #: A value of `calib.verbs.inspect.folder.What`; empty: calib does not read it
    what: str
    #: Rows, points or pictures; 0 where there are none
    count: int = 0
    #: What is wrong with it
    fault: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Looked:
    """The files of a job, and the way they are read."""

    files: tuple[InputFile, ...]
    fields: Mapping[str, Field]
    #: What keeps the files from being read so, in calib's words; empty: nothing
    fault: str = ""
    #: Key of the sentence on what is missing still; empty: nothing
    missing: str = ""
    #: Number of measured rows
    rows: int = 0
    #: The robot's chain: names of its joints
    joints: tuple[str, ...] = ()
    #: Header and first rows of the table
    header: tuple[str, ...] = ()
    preview: tuple[tuple[str, ...], ...] = ()
    #: Whether the rows are corners of boards in pictures
    images: bool = False
    #: Number of pictures whose corners are sought first; 0: the table has them
    pictures: int = 0

    @property
    def is_ready(self) -> bool:
        """True if it can be calibrated."""
        return not self.fault and not self.missing

    def value(self, name: str) -> str:
        """Return the value of a field; empty if there is none."""
        return self.fields[name].value if name in self.fields else ""


def plain(values: Iterable[str], none: str | None = None) -> list[tuple[str, str]]:
    """Return values as options, each its own label; before them one for nothing, with a label, if it is given."""
    first = [] if none is None else [("", none)]
    return [*first, *((value, value) for value in values)]


class Fields:
    """The fields, as they are guessed one after the other; what was chosen goes before."""

    def __init__(self, chosen: Mapping[str, str]) -> None:
        """Begin without any."""
        self._chosen = chosen
        self.made: dict[str, Field] = {}

    def add(
        self,
        name: str,
        guess: str,
        options: Iterable[tuple[str, str]] = (),
        doubt: str = "",
        **words: str,
    ) -> str:
        """Add a field, and return its value: as chosen if that is allowed, else the guess."""
        allowed = tuple(dict.fromkeys(options))
        chosen = self._chosen.get(name)
        if chosen is not None and (not allowed or chosen in [value for value, _ in allowed]):
            self.made[name] = Field(name, chosen, allowed, is_chosen=True)
        else:
            self.made[name] = Field(name, guess, allowed, doubt, words)
        return self.made[name].value

    def value(self, name: str) -> str:
        """Return the value of a field; empty if there is none."""
        return self.made[name].value if name in self.made else ""

    def chosen(self, name: str) -> str:
        """Return what was chosen for a field, whether it is there or not; empty for nothing."""
        return self._chosen.get(name, "")
