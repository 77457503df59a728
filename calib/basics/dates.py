"""Dates: when something was made, and the dates that people write into records.

Dates are ISO 8601: ``2026-03-01``, ``2026-03-01 14:30``, ``2026-03-01T14:30:05Z``. One without an offset counts as UTC,
one without a time of day as its midnight. Any other form is not read: 03/04/2026 is two days.
"""

from __future__ import annotations

import os
import re
from datetime import datetime, timezone

#: Dates as they may be written: the day, then the time of day, then the offset from UTC.
_FORM = re.compile(r"\d{4}-\d\d-\d\d(?:[T ]\d\d:\d\d(?::\d\d(?:\.\d{1,6})?)?(?:Z|[+-]\d\d:\d\d)?)?")

#: Mean length of a month [s]: a twelfth of 365.2425 days.
MONTH = 365.2425 / 12.0 * 86_400.0


def now() -> datetime:
    """Return the present date and time, UTC: that of the environment variable ``SOURCE_DATE_EPOCH``, if it is set."""
    epoch = os.environ.get("SOURCE_DATE_EPOCH", "")
    if epoch.isdecimal():
        return datetime.fromtimestamp(int(epoch), timezone.utc)
    return datetime.now(timezone.utc)


def date_text(date: datetime) -> str:
    """Return a date and time of files, UTC to the second: ``"2026-03-01T14:30:05Z"``."""
    return f"{date.astimezone(timezone.utc):%Y-%m-%dT%H:%M:%SZ}"


def parse_date(text: str) -> datetime | None:
    """Return the date that a text states.

    Args:
        text: As a person or a file states it, see the module's text.

    Returns:
        The date with its offset from UTC; None if it is not in that form, or there is no such day.

    Example:
        >>> parse_date("2026-03-01").isoformat()
        '2026-03-01T00:00:00+00:00'
        >>> parse_date("01.03.2026") is None
        True
    """
    stripped = text.strip()
    if not _FORM.fullmatch(stripped):
        return None
    try:
        date = datetime.fromisoformat(stripped.replace("Z", "+00:00"))
    except ValueError:
        return None
    return date if date.tzinfo is not None else date.replace(tzinfo=timezone.utc)
