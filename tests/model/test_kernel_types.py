from __future__ import annotations

import importlib.util
import itertools
from pathlib import Path

import numpy as np
import pytest
from numba.core import caching

from calib.model import batch, kernel_types
from calib.model.kernel_types import is_kept

_NUMBER = itertools.count()

CODE = """
from calib.model.kernel_types import compiled


@compiled()
def twice(x: float) -> float:
    return 2.0 * x
"""


@pytest.fixture
def source(tmp_path: Path) -> Path:
    path = tmp_path / "one_function.py"
    path.write_text(CODE)
    return path


def loaded(source: Path):
    """The function as another process would have it."""
    spec = importlib.util.spec_from_file_location(f"one_function_{next(_NUMBER)}", source)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.twice


def test_what_was_compiled_is_kept_on_disk(source):
    first = loaded(source)
    assert not is_kept(first)
    assert first(3.0) == 6.0
    again = loaded(source)
    assert is_kept(again)
    assert again(3.0) == 6.0


def test_a_change_in_any_file_of_the_kernel_is_another_function(source, monkeypatch):
    assert loaded(source)(3.0) == 6.0
    monkeypatch.setattr(kernel_types, "_CONTENTS", "of another version")
    assert not is_kept(loaded(source))


@pytest.mark.parametrize("kind", ["*.nbi", "*.nbc"])
@pytest.mark.parametrize("left", [0, 40])
def test_damaged_files_are_compiled_anew(source, kind, left):
    assert loaded(source)(3.0) == 6.0
    for path in source.parent.rglob(kind):
        path.write_bytes(path.read_bytes()[:left])
    assert loaded(source)(3.0) == 6.0
    assert loaded(source)(3.0) == 6.0


def test_no_place_for_files_ends_nothing(source, monkeypatch):
    monkeypatch.setattr(caching.CacheImpl, "_locator_classes", [])
    alone = loaded(source)
    assert alone(3.0) == 6.0
    assert not is_kept(alone)


def test_no_room_for_files_ends_nothing(source, monkeypatch):
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    function = loaded(source)
    monkeypatch.setattr(caching.IndexDataCacheFile, "save", full)
    assert function(3.0) == 6.0


def test_whether_a_table_must_wait_for_the_compiler():
    batch.warm_up()
    assert not batch.must_compile(batch.MANY - 1)
    assert not batch.must_compile(batch.MANY)
    assert not is_kept(np.sin)
