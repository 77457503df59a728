"""Dates as people and files write them."""

from __future__ import annotations

from datetime import datetime, timedelta, timezone

import pytest

from calib.basics.dates import MONTH, date_text, now, parse_date


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("2026-03-01", datetime(2026, 3, 1, tzinfo=timezone.utc)),
        (" 2026-03-01 14:30 ", datetime(2026, 3, 1, 14, 30, tzinfo=timezone.utc)),
        ("2026-03-01T14:30:05Z", datetime(2026, 3, 1, 14, 30, 5, tzinfo=timezone.utc)),
        ("2026-03-01T14:30+02:00", datetime(2026, 3, 1, 12, 30, tzinfo=timezone.utc)),
        ("01.03.2026", None),
        ("03/01/2026", None),
        ("2026-02-30", None),
        ("2026-3-1", None),
        ("20260301", None),
        ("", None),
    ],
)
def test_dates_of_one_form_are_read_and_no_others(text, expected):
    assert parse_date(text) == expected


def test_a_date_is_read_back_to_the_second():
    date = datetime(2026, 3, 1, 14, 30, 5, tzinfo=timezone(timedelta(hours=2)))
    assert date_text(date) == "2026-03-01T12:30:05Z"
    assert parse_date(date_text(date)) == date


def test_now_is_that_of_the_environment(monkeypatch):
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1700000000")
    assert date_text(now()) == "2023-11-14T22:13:20Z"
    monkeypatch.delenv("SOURCE_DATE_EPOCH")
    assert abs((now() - datetime.now(timezone.utc)).total_seconds()) < 10.0


def test_twelve_months_are_a_year():
    assert pytest.approx(timedelta(days=365.2425).total_seconds()) == 12.0 * MONTH
