"""The record of a measurement: texts in one line, temperatures in degrees Celsius."""

from __future__ import annotations

import pickle
from dataclasses import replace

import pytest

from calib.data.cell import Cell
from calib.data.record import FOR_CERTIFICATES, LONGEST, TEXTS, Record
from calib.errors import CalibError


def test_lines_are_joined_and_what_is_not_given_is_empty():
    record = Record(note=" two\n  lines ", temperature_C=(20, 21.5))
    assert record.given == {"temperature_C": (20.0, 21.5), "note": "two lines"}
    assert {getattr(record, name) for name in TEXTS} == {"", "two lines"}
    assert pickle.loads(pickle.dumps(record)) == record
    assert Cell(record=record).record is record
    assert Cell().record == Record()


def test_what_certificates_have_besides(tmp_path):
    path = tmp_path / "cell.toml"
    path.write_text(
        '[record]\ncountry = "DE"\nhumidity_percent = [41, 44.5]\ninstrument_calibrated = 2026-05-31\n',
        encoding="utf-8",
    )
    record = Cell.read(path).record
    assert (record.country, record.humidity_percent) == ("DE", (41.0, 44.5))
    assert record.instrument_calibrated == "2026-05-31"
    assert set(FOR_CERTIFICATES) < set(TEXTS)
    assert FOR_CERTIFICATES[0] == "certificate_number"


@pytest.mark.parametrize(
    "given",
    [
        {"operator": "x" * (LONGEST + 1)},
        {"operator": 5},
        {"temperature_C": (20.0, 21.0, 22.0)},
        {"temperature_C": (300.0,)},
        {"temperature_C": (float("nan"),)},
        {"temperature_C": "20"},
        {"humidity_percent": (101.0,)},
        {"humidity_percent": (-1.0,)},
        {"country": "Germany"},
        {"country": "de"},
    ],
)
def test_what_it_cannot_hold_is_refused(given):
    with pytest.raises(CalibError, match="record"):
        replace(Record(), **given)
