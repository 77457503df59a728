from __future__ import annotations

from pathlib import Path

import pytest

import calib
from calib.errors import DeviceError
from calib.verbs.measure.devices.files import FolderReader
from calib.verbs.measure.devices.readers import READERS, Reader, Reading, open_reader, register
from tests.plugin_files import registries_kept, write_plugin
from tests.verbs.measure.devices.contexts import UR


def test_a_reader_is_opened_by_its_name(tmp_path: Path):
    reader = open_reader(f"watch:{tmp_path}", UR)
    assert isinstance(reader, FolderReader)
    reader.close()
    assert set(READERS) == {"file", "watch", "stdin", "tcp", "webcam", "virtual"}
    for text in ("wacth:exports", "", "C:\\exports"):
        with pytest.raises(DeviceError, match="There is no reader of an instrument"):
            open_reader(text, UR)


def test_an_own_reader_is_registered_once():
    class Gauge:
        def __init__(self, argument: str) -> None:
            self.value = float(argument)

        def read(self, timeout: float | None = None) -> Reading | None:
            return Reading.of({"x [mm]": self.value}) if timeout else None

        def close(self) -> None:
            pass

    with registries_kept():
        register("gauge", Reader("a gauge", lambda argument, _context: Gauge(argument)))
        gauge = open_reader("gauge:12.5", UR)
        assert gauge.read(0.0) is None
        reading = gauge.read(1.0)
        assert reading is not None
        assert reading.rows[0]["x [mm]"] == 12.5
        for name in ("gauge", "watch", "a:b", ""):
            with pytest.raises(DeviceError, match="needs a name"):
                register(name, READERS["watch"])
    assert "gauge" not in READERS


def test_a_plugin_adds_one(tmp_path: Path):
    with registries_kept():
        plugin = calib.plugins.load(write_plugin(tmp_path))
        assert (plugin.readers, plugin.controllers) == (("gauge",), ("statue",))
        reading = calib.readers.open_reader("gauge:2.5", UR).read()
        assert reading is not None
        assert reading.rows == ({"edge_distance [mm]": 2.5},)
