"""The sentences of the pages, a table for each language: a file ``sentences/LANGUAGE.yaml``.

All tables have the same keys, and the same placeholders in each. A further language is a further file.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import yaml

#: The language of those whose browser names none of ours.
DEFAULT = "en"

#: The folder of the tables.
FOLDER = Path(__file__).parent / "sentences"


@dataclass(frozen=True, slots=True)
class Sentences:
    """The sentences of one language."""

    #: Its code, ``"de"``
    language: str
    #: By their keys
    texts: Mapping[str, str]

    def __call__(self, key: str, **words: object) -> str:
        """Return a sentence with words in its placeholders; KeyError if there is none of this key."""
        text = self.texts[key]
        return text.format(**words) if words else text

    def has(self, key: str) -> bool:
        """Return True if there is a sentence of this key."""
        return key in self.texts


@cache
def languages() -> Mapping[str, Sentences]:
    """Return the tables by the codes of their languages, the default one first."""
    tables = {}
    for path in sorted(FOLDER.glob("*.yaml"), key=lambda path: (path.stem != DEFAULT, path.stem)):
        texts = yaml.safe_load(path.read_text(encoding="utf-8"))
        tables[path.stem] = Sentences(
            path.stem, {str(key): str(text).strip() for key, text in texts.items()}
        )
    return tables


def sentences_for(*wanted: str | None) -> Sentences:
    """Return the table of the first language that there is.

    Args:
        wanted: Codes of languages, the preferred ones first; None: not stated.
    """
    tables = languages()
    return next((tables[code] for code in wanted if code and code in tables), tables[DEFAULT])


def accepted(header: str) -> Iterator[str]:
    """Yield the languages that a browser accepts, by its header ``Accept-Language``, the preferred ones first.

    Example:
        >>> list(accepted("fr;q=0.5, de-AT, en;q=0.8"))
        ['de', 'en', 'fr']
    """
    weighed = []
    for part in header.split(","):
        name, _, parameter = part.strip().partition(";")
        try:
            weight = float(parameter.strip().removeprefix("q=") or 1.0)
        except ValueError:
            continue
        weighed.append((-weight, name.strip().split("-")[0].lower()))
    yield from (name for _, name in sorted(weighed, key=lambda pair: pair[0]))
