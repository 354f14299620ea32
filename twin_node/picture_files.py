"""Pictures in files and folders of them, whoever made them."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray


def read_picture(path: Path, flags: int) -> NDArray[np.generic] | None:
    """Pixels as OpenCV's `imread` has them with these flags; None for a file that is no picture of a kind it reads."""
    try:
        return cv2.imread(str(path), flags)
    except cv2.error:  # a kind that is switched off (EXR), or more pixels than any image has
        return None


def listed(folder: Path) -> list[Path]:
    """What a folder holds in order of names, but for what is hidden: macOS leaves a `._NAME` beside what it copies."""
    return sorted(path for path in folder.iterdir() if not path.name.startswith("."))
