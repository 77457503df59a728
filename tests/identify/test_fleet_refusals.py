"""What a fleet's folders refuse where the system forbids it."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from calib.errors import FileError
from calib.identify.fleet_folder import MADE, SCHEMA, _swap

NOBODY = 65534


@pytest.fixture
def guarded() -> Iterator[Path]:
    """A folder that only its owner may change, seen by somebody else."""
    folder = Path(tempfile.mkdtemp())
    (folder / "arm 1").mkdir()
    (folder / "arm 1" / MADE).write_text(json.dumps({"schema": SCHEMA}))
    folder.chmod(0o555)
    root = os.geteuid() == 0  # who may change everything
    if root:
        os.seteuid(NOBODY)
    yield folder
    if root:
        os.seteuid(0)
    folder.chmod(0o755)
    shutil.rmtree(folder)


def test_a_robots_folder_that_may_not_be_replaced(guarded: Path):
    with pytest.raises(FileError) as raised:
        _swap(guarded / "new", guarded / "arm 1")
    assert (
        str(raised.value) == f"{guarded}/arm 1: this folder cannot be replaced: Permission denied."
    )
    assert (guarded / "arm 1" / MADE).is_file()
