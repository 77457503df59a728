"""Numbers as people and programs write them: with a decimal point or comma, with or without a sign between thousands.

A sign with other than three digits after it is decimal, one that is there twice stands between thousands, and of two
in one number the last is decimal. Numbers such as 1,992 and 1.992 may be either: the other numbers of the file decide.
"""

from __future__ import annotations

import re
from collections.abc import Iterable

from calib.errors import MeasurementError

#: Between thousands, and never decimal: the apostrophe, and blanks at which no line is broken.
_BETWEEN_THOUSANDS = "'\N{NO-BREAK SPACE}\N{NARROW NO-BREAK SPACE}"

#: A number in any of the ways.
NUMERAL = re.compile(
    r"[+-]?(?:\d+(?:[.,]\d*)?|[.,]\d+"
    r"|\d{1,3}(?:,\d{3})+(?:\.\d*)?|\d{1,3}(?:\.\d{3})+(?:,\d*)?"
    rf"|\d{{1,3}}(?:[{_BETWEEN_THOUSANDS}]\d{{3}})+(?:[.,]\d*)?)(?:[eE][+-]?\d+)?"
)

#: A number whose one sign is decimal or stands between thousands.
_EITHER = re.compile(r"[+-]?[1-9]\d{0,2}[.,]\d{3}")

#: A remark that says which sign is decimal: ``Decimal: comma``.
_REMARK = re.compile(
    r"\bdecimals?\b[^.,\w]*(?:sign|separator)?[^.,\w]*(comma\b|point\b|[.,])", re.IGNORECASE
)

#: Signs by what remarks call them.
_SIGNS = {"comma": ",", "point": ".", ",": ",", ".": "."}


def decimal_sign_in(remarks: Iterable[str]) -> str | None:
    """Return the decimal sign that a remark names; None if none does."""
    for remark in remarks:
        found = _REMARK.search(remark)
        if found:
            return _SIGNS[found[1].casefold()]
    return None


def decimal_sign_of(
    numerals: Iterable[tuple[int, str]], source: str, stated: str | None = None
) -> str:
    """Return the decimal sign of the numbers of a file.

    Args:
        numerals: Line of each number, from 1, and the number as written; anything else is ignored.
        source: The file's name, for messages.
        stated: The sign that the file states; None: it states none.

    Returns:
        ``"."`` or ``","``; ``"."`` if nothing decides and no number has a comma: 1.992 alone is less than 2.

    Raises:
        MeasurementError: Numbers contradict each other or what is stated, or there are commas, each with three digits
            after it, and nothing decides what they are.
    """
    # The first line with each meaning of each sign.
    decimal: dict[str, int] = {}
    thousands: dict[str, int] = {}
    either: dict[str, int] = {}
    for line, text in numerals:
        signs = [character for character in text if character in ".,"]
        if not signs or not NUMERAL.fullmatch(text):
            continue
        if _EITHER.fullmatch(text):
            either.setdefault(signs[0], line)
        elif len(signs) == 1:
            decimal.setdefault(signs[0], line)
        else:
            thousands.setdefault(signs[0], line)
            if signs[-1] != signs[0]:
                decimal.setdefault(signs[-1], line)
    if stated is not None:
        decimal.setdefault(stated, 1)
    _check_agreement(source, decimal, thousands)
    if decimal:
        return next(iter(decimal))
    if thousands:
        return "." if "," in thousands else ","
    if "," in either:
        raise MeasurementError(
            f"{source}, line {either[',']}: a comma may be decimal or stand between thousands: three digits follow "
            "each, and nothing else decides. Write a first line '# Decimal: comma' or '# Decimal: point'."
        )
    return "."


def _check_agreement(source: str, decimal: dict[str, int], thousands: dict[str, int]) -> None:
    """Refuse signs that mean two things, from the first line with each meaning of each sign."""
    if len(decimal) == 2:
        fault = f"a decimal point in line {decimal['.']} and a decimal comma in line {decimal[',']}"
    elif len(thousands) == 2:
        fault = (
            f"points between thousands in line {thousands['.']} and commas in line {thousands[',']}"
        )
    elif decimal.keys() & thousands.keys():
        sign = next(iter(decimal))
        fault = f"'{sign}' as the decimal sign in line {decimal[sign]} and between thousands in line {thousands[sign]}"
    else:
        return
    raise MeasurementError(
        f"{source}: numbers have {fault}. Write all in one way, without thousands separators."
    )


def plain(text: str, decimal_sign: str) -> str:
    """Return a number with a decimal point and nothing between thousands; anything else stays as it is.

    Args:
        text: As written.
        decimal_sign: Which of ``"."`` and ``","`` is decimal; the other stands between thousands.
    """
    if not NUMERAL.fullmatch(text):
        return text
    between = "," if decimal_sign == "." else "."
    for character in (between, *_BETWEEN_THOUSANDS):
        text = text.replace(character, "")
    return text.replace(",", ".")
