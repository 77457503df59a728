from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from calib.errors import DeviceError
from calib.verbs.measure.devices.webcam import WebcamReader
from tests.boards.films import film
from tests.verbs.measure.devices.contexts import UR


def test_each_reading_is_a_new_picture_in_the_session_s_folder(tmp_path: Path):
    path = film(tmp_path / "film.avi", 30)
    (tmp_path / "pictures").mkdir()
    (tmp_path / "pictures" / "webcam_0001.png").touch()  # of an earlier run
    reader = WebcamReader(str(path), replace(UR, folder=tmp_path))
    found = []
    for _ in range(2):
        reading = reader.read(1.0)
        assert reading is not None
        found += reading.pictures
    assert found == [tmp_path / "pictures" / f"webcam_000{i}.png" for i in (2, 3)]
    assert all(picture.stat().st_size > 1000 for picture in found)
    assert reader.read(1.0) is not None  # the last eight pictures
    with pytest.raises(DeviceError, match="a film has ended"):
        reader.read(1.0)
    reader.close()


def test_what_is_no_camera_is_refused(tmp_path: Path):
    for argument in ("", str(tmp_path / "none.avi")):
        with pytest.raises(DeviceError):
            WebcamReader(argument, UR)
