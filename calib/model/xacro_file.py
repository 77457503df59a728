"""Xacro files: flattened to a URDF by the ``xacro`` package, with the arguments behind their name."""

from __future__ import annotations

from pathlib import Path

from calib.model.urdf import Urdf


def is_xacro(source: str | Path) -> bool:
    """Whether this names a xacro file, with or without arguments: ``"ur.urdf.xacro ur_type:=ur5e"``."""
    raise NotImplementedError


def read_xacro(source: str | Path) -> Urdf:
    """Flatten a xacro file.

    Args:
        source: The file, and behind it arguments as in ``"ur.urdf.xacro ur_type:=ur5e name:=ur"``.

    Raises:
        FileError: The file cannot be read.
        UrdfError: The xacro package is not installed, the file cannot be flattened, or what comes out is no URDF.
    """
    raise NotImplementedError
