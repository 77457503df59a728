"""Languages of programs by the endings of their names."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from calib.errors import MeasurementError
from calib.verbs.compensate.programs.dialects import DIALECTS, find_dialect, read_program_file
from calib.verbs.compensate.programs.program_file import Stated

KUKA = Path(__file__).with_name("data") / "kuka"


def test_endings_in_any_case():
    assert find_dialect("A/PROG.SRC") is DIALECTS[".src"]
    assert find_dialect("program.csv") is None
    assert all(ending == ending.lower() and ending.startswith(".") for ending in DIALECTS)


def test_a_program_is_read_by_its_ending():
    stated = Stated(tuple(f"a{j}" for j in range(1, 7)), frames={"1": np.eye(4)})
    assert len(read_program_file(KUKA / "plain.src", stated).moves) == 9
    with pytest.raises(MeasurementError, match=r"\.src"):
        read_program_file(KUKA / "plain.txt", stated)
