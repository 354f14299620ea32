"""OpenCV's loops take one thread where nodes follow small images."""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np
import pytest

from twin_node.runtime.image_threads import image_loops_alone


@pytest.fixture(autouse=True)
def two_threads() -> Iterator[None]:
    before = cv2.getNumThreads()
    cv2.setNumThreads(2)
    yield
    cv2.setNumThreads(before)


def test_loops_take_no_other_thread_and_find_the_same() -> None:
    rng = np.random.default_rng(0)
    image = cv2.GaussianBlur(rng.integers(0, 255, (90, 160)).astype(np.uint8), (5, 5), 2)
    flow = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_ULTRAFAST)
    shared = flow.calc(image, np.roll(image, 2, axis=1), np.zeros((90, 160, 2), np.float32)).copy()
    image_loops_alone()
    assert cv2.getNumThreads() == 1
    alone = flow.calc(image, np.roll(image, 2, axis=1), np.zeros((90, 160, 2), np.float32))
    assert np.array_equal(shared, alone)
