"""How many threads OpenCV's loops over images take."""

from __future__ import annotations

import cv2


def image_loops_alone() -> None:
    """OpenCV's own loops take no other thread from now on, in all of this process.

    The threads of its pool look for the next loop for a while before they sleep. Over the small images of a twin that
    took three times as much of a processor as the loops themselves, and kept the compiled kernels' helpers from it.
    """
    cv2.setNumThreads(1)
