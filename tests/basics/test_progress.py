"""What a computation says of itself, and who hears it."""

from __future__ import annotations

import threading

from calib.basics.progress import Stage, begin, counted, is_watched, trying, watching


def test_a_watcher_hears_what_is_said_within_its_block():
    heard: list[tuple[Stage | None, str, int, int]] = []
    trying("nobody hears this")
    with watching(lambda *said: heard.append(said)):
        begin(Stage.MODELS)
        trying("dh+gain")
        counted(2, 7)
        with watching(None):
            trying("nobody hears this either")
        apart = threading.Thread(target=trying, args=("of another thread",))
        apart.start()
        apart.join()
    begin(Stage.WRITING)
    assert heard == [(Stage.MODELS, "", 0, 0), (None, "dh+gain", 0, 0), (None, "", 2, 7)]


def test_whether_somebody_watches():
    assert not is_watched()
    with watching(lambda *_: None):
        assert is_watched()
        with watching(None):
            assert not is_watched()
