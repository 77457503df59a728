"""Films in which some pictures are sharper than others."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from calib.boards.opencv import opencv


def film(path: Path, count: int, sharp: int = 8) -> Path:
    """Write a film of blurred pictures, the brighter the later, but for a sharp one."""
    cv2 = opencv()
    rng = np.random.default_rng(1)
    pattern = (rng.integers(0, 2, (15, 20)) * 80).astype(np.uint8)
    pattern = cv2.resize(pattern, (160, 120), interpolation=cv2.INTER_NEAREST)
    blurred = cv2.GaussianBlur(pattern, (0, 0), 4.0)
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 25.0, (160, 120))
    for i in range(count):
        image = (pattern if i == sharp else blurred) + np.uint8(5 * i)
        writer.write(cv2.merge([image] * 3))
    writer.release()
    return path
