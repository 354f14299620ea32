"""Images on their way from cameras to a reader that has no time for all of them."""

from __future__ import annotations

import numpy as np

from twin_node.rig.cameras.image_source import CameraImage, ImageQueue


def image(camera: str, stamp: int) -> CameraImage:
    return CameraImage(camera, stamp, np.zeros((2, 2, 3), np.uint8))


def test_the_oldest_images_are_lost_and_counted_by_camera() -> None:
    """Nobody heard of them: a rig that a computer has no time for had fewer images than it took, for no reason."""
    queue = ImageQueue(3)
    for camera, stamp in (("left", 1), ("right", 2), ("left", 3), ("left", 4), ("left", 5), ("right", 6)):
        queue.put(image(camera, stamp))
    assert (queue.lost("left"), queue.lost("right"), queue.lost("top")) == (2, 1, 0)
    read = iter(queue)
    assert [next(read).stamp for _ in range(3)] == [4, 5, 6]
    queue.put(image("left", 7))
    assert next(read).stamp == 7
    assert queue.lost("left") == 2
