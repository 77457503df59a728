"""scripts/goldens.py: a run equals itself, and a number that changed is found."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[1] / "scripts" / "goldens.py"


def goldens(*words: str | Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, SCRIPT, *words],
        capture_output=True,
        encoding="utf-8",
        timeout=120,
        check=False,
    )


@pytest.mark.slow
def test_a_run_is_stored_and_a_changed_number_is_found(tmp_path: Path) -> None:
    stored, changed = tmp_path / "stored.json", tmp_path / "changed.json"
    done = goldens("-o", stored, "--only", "convert/panda")
    assert done.returncode == 0, done.stderr
    assert goldens("--compare", stored, stored).returncode == 0
    table = json.loads(stored.read_text())
    row = table["convert/panda"]["files"]["panda.json"]["after"]["rows"]
    row["d_m"][2] += 1e-8
    changed.write_text(json.dumps(table))
    compared = goldens("--compare", stored, changed)
    assert compared.returncode == 1
    assert compared.stdout.startswith("convert/panda/files/panda.json/after/rows/d_m/2: ")
