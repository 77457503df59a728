"""Controllers' files and DH tables. Imports result and below.

`register` adds a format of a user; the names for it, those of `calib.formats.convert`, are imported on first use.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from calib.formats.convert import (
        FORMATS as FORMATS,
        Format as Format,
        Options as Options,
        Source as Source,
        register as register,
    )

__all__ = ["FORMATS", "Format", "Options", "Source", "register"]


def __getattr__(name: str) -> Any:  # noqa: ANN401  any public name
    """Import a name on first use."""
    if name not in __all__:
        raise AttributeError(f"module 'calib.formats' has no attribute '{name}'")
    return getattr(importlib.import_module("calib.formats.convert"), name)


def __dir__() -> list[str]:
    """The names above."""
    return sorted(__all__)
