"""Files that a call writes: checked before the work, and named after it."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

from calib.errors import FileError


def check_outputs(
    outputs: Iterable[Path | None],
    inputs: Iterable[str | Path | None],
    *,
    force: bool,
    xacro: bool = False,
) -> None:
    """Refuse outputs that cannot be written before the work begins.

    Args:
        outputs: The files to write; None: not wanted.
        inputs: The files that are read; None: not given.
        force: Whether existing files are overwritten.
        xacro: Whether an output may be a xacro.

    Raises:
        FileError: A file exists, its folder does not, or it is an input, a xacro, or named twice.
    """
    from calib.basics.files import check_no_xacro, check_writable

    roles = {Path(os.path.realpath(path)): "an input" for path in inputs if path is not None}
    for path in outputs:
        if path is None:
            continue
        resolved = Path(os.path.realpath(path))
        if resolved in roles:
            raise FileError(
                f"{path} is also {roles[resolved]} of this command; give the output another name or folder."
            )
        roles[resolved] = "another output"
        if not xacro:
            check_no_xacro(path)
        check_writable(path, overwrite=force)


def written_lines(*paths: Path | None) -> list[str]:
    """Return a line for each file that was written; None: it was not wanted."""
    return [f"Written: {path}" for path in paths if path is not None]
