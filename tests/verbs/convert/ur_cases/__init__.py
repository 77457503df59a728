"""Factory calibrations of Universal Robots arms as numbers; ``cases.json`` says where each is from."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from calib.robot.ur_models import COLUMNS
from calib.verbs.convert.ur_files import conf_bytes

CASES = json.loads(Path(__file__).with_name("cases.json").read_text(encoding="utf-8"))
CALIBRATIONS = CASES["calibrations"]
WITH_DELTAS = [case for case in CALIBRATIONS if case["delta"] is not None]


def rows(table) -> np.ndarray:
    """Rows out of a case's table, shape (6, 4)."""
    return np.transpose([table[name] for name in COLUMNS]).astype(float)


def write_deltas(path: Path, deltas: np.ndarray) -> Path:
    """A calibration.conf of these deltas."""
    path.write_bytes(conf_bytes(deltas))
    return path
