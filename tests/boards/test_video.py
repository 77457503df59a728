from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from calib.boards.opencv import opencv
from calib.boards.video import Video
from calib.errors import DeviceError
from tests.boards.films import film


def test_the_sharpest_of_several_pictures_is_taken(tmp_path: Path):
    video = Video(str(film(tmp_path / "film.avi", 30, sharp=8)))
    means = []
    for _ in range(2):
        data = np.frombuffer(video.picture(), dtype=np.uint8)
        image = opencv().imdecode(data, opencv().IMREAD_GRAYSCALE)
        assert image.shape == (120, 160)
        means.append(float(image.mean()))
    # The eighth is about 5 * 8 brighter than the pattern, whose half is black; the next ones come after the eleventh.
    assert means[0] == pytest.approx(80.0, abs=8.0)
    assert means[1] > 40 + 5 * 15
    video.close()


def test_a_camera_that_is_not_there_is_refused(tmp_path: Path):
    (tmp_path / "film.avi").write_bytes(b"none")
    for source in ("98", str(tmp_path / "film.avi"), str(tmp_path / "none.avi")):
        with pytest.raises(DeviceError, match="cannot be opened"):
            Video(source)
