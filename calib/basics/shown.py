"""What a value looks like is the business of the rooms above it: its methods name the module that shows or writes it.

A result has methods such as ``summary`` and ``write_report``, for those who use it; words, figures and files are made
above, of the result, so they cannot be imported here. `shown_by` is the one way up: by name, when a method is called.
"""

from __future__ import annotations

import importlib
from typing import Any


def shown_by(module: str) -> Any:  # noqa: ANN401  a module, whose functions a type checker does not know
    """Return the module that shows or writes a value, for a method of that value.

    Args:
        module: Its name below ``calib``, such as ``"verbs.calibrate.text"``.
    """
    return importlib.import_module(f"calib.{module}")
