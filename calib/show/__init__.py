"""Pictures of a calibration for people; nothing here changes a result.

``calib.show(result)`` opens the picture of a calibration in the browser and returns the page's path, in a temporary
folder; ``calib.show(result, live=True)`` returns a `calib.show.live.Viewer`, with which a program moves the robots
and draws more. ``calib.show.view.write_page(result, "view.html")`` keeps the page.

The folder's module can be called, for Python binds the name ``calib.show`` to this module as soon as anything in it is
imported, so a function of that name would not last.
"""

from __future__ import annotations

import sys
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from calib.identify.calibration import Calibration
    from calib.model.robot import Robot
    from calib.show.live import Viewer


class _Show(ModuleType):
    """A module that shows a calibration when it is called."""

    def __call__(
        self, shown: Calibration | Robot, other: Robot | None = None, *, live: bool = False
    ) -> Path | Viewer:
        """Open the picture of a calibration or of robots in the browser; see `calib.show.live.show`."""
        from calib.show.live import show

        return show(shown, other, live=True) if live else show(shown, other)


sys.modules[__name__].__class__ = _Show
