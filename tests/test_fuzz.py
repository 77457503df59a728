"""A few spoilt files for each reader: `scripts/fuzz.py` in small."""

from __future__ import annotations

from pathlib import Path

import pytest

SCRIPTS = Path(__file__).parents[1] / "scripts"


@pytest.mark.slow
def test_spoilt_files_are_read_or_refused_with_a_word(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.syspath_prepend(SCRIPTS)
    import fuzz

    for name in fuzz.READERS:
        assert fuzz.findings(name, 50) == []
