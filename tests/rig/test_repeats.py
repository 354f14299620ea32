"""Images that come again and again: a camera that hangs, and what only looks like one."""

from __future__ import annotations

import numpy as np
import pytest

from twin_node.rig.repeats import LIVELY, REPEATS, Repeats, Streams
from twin_node.scene import Camera, Float32, UInt8, View

SHAPE = (24, 32, 3)
CAMERA = Camera("left", SHAPE[1], SHAPE[0], np.eye(3), np.eye(4))


def noise(seed: int) -> UInt8:
    return np.random.default_rng(seed).integers(0, 255, SHAPE, dtype=np.uint8)


def depth(seed: int) -> Float32:
    return np.random.default_rng(seed).uniform(1, 2, SHAPE[:2]).astype(np.float32)


def lively() -> Repeats:
    """A stream whose images have just differed all over as often as a sensor's noise takes to be known."""
    stream = Repeats()
    for seed in range(LIVELY + 1):
        stream.take(noise(seed))
    return stream


def test_a_lively_stream_hangs_from_the_second_repeat_to_the_next_image() -> None:
    stream = lively()
    said = []
    for image in (noise(LIVELY), noise(LIVELY), noise(99)):
        stream.take(image.copy())
        said.append((stream.repeats, stream.hangs(beside_lively=False)))
    assert said == [(1, False), (REPEATS, True), (0, False)]


def test_one_lively_image_too_few_is_no_noise() -> None:
    stream = Repeats()
    for seed in range(LIVELY):
        stream.take(noise(seed))
    assert stream.lively == LIVELY - 1
    for _ in range(REPEATS):
        stream.take(noise(LIVELY - 1))
    assert not stream.hangs(beside_lively=True)


def test_a_stream_that_never_changed_hangs_beside_a_lively_one_alone() -> None:
    stream, said = Repeats(), []
    for _ in range(LIVELY + 1):
        stream.take(noise(0))
        said.append(stream.hangs(beside_lively=True))
    assert said == [False] * LIVELY + [True]
    assert not stream.hangs(beside_lively=False)


def test_what_moves_in_a_corner_is_no_noise() -> None:
    """Three eighths of the image's parts differ: a scene without noise may stand still afterwards."""
    stream = Repeats()
    for seed in range(LIVELY + 1):
        image = noise(0)
        image[:12, :24] = noise(seed)[:12, :24]
        stream.take(image)
    assert stream.lively == 0
    assert stream.changed


def test_noise_in_half_of_the_parts_is_enough_for_dark_ones_have_none() -> None:
    stream = Repeats()
    for seed in range(LIVELY + 1):
        image = np.zeros(SHAPE, np.uint8)
        image[:, :16] = noise(seed)[:, :16]
        stream.take(image)
    assert stream.lively == LIVELY


def test_a_pixel_here_and_there_is_no_noise() -> None:
    stream, shape = Repeats(), (160, 160)
    for number in range(LIVELY + 1):
        image = np.full(shape, 100, np.uint8)
        image[::40, ::40] += np.uint8(number)  # one in a hundred of those that are compared
        stream.take(image)
    assert stream.changed
    assert stream.lively == 0


def test_one_pixel_between_those_compared_is_a_change() -> None:
    stream = lively()
    image = noise(LIVELY)
    image[1, 1, 0] ^= 1
    stream.take(image)
    assert (stream.repeats, stream.lively) == (0, 0)


def test_black_images_other_sizes_and_none_are_no_repeats() -> None:
    stream = lively()
    for _ in range(REPEATS + 1):
        stream.take(np.zeros(SHAPE, np.uint8))
    assert stream.repeats == 0
    stream = lively()
    stream.take(noise(LIVELY))
    stream.take(noise(LIVELY)[:12])
    stream.take(None)
    assert stream.repeats == 0


@pytest.mark.parametrize("what", ["colour", "depth"])
def test_either_stream_that_stands_hangs_the_camera_since_its_last_new_image(what: str) -> None:
    streams = Streams()
    for number in range(LIVELY + 4):
        seed = min(number, LIVELY)
        rgb, measured = noise(seed if what == "colour" else number), depth(seed if what == "depth" else number)
        streams.take(View(CAMERA, 100 + number, rgb, measured))
    assert streams.hang([])
    assert streams.since == 100 + LIVELY


@pytest.mark.parametrize("what", ["colour", "depth"])
def test_a_stream_is_held_against_the_same_kind_of_the_others(what: str) -> None:
    still, others = Streams(), Streams()
    for number in range(LIVELY + 1):
        still.take(View(CAMERA, number, noise(0), depth(0)))
        moving = noise(number) if what == "colour" else noise(0)
        others.take(View(CAMERA, number, moving, depth(number) if what == "depth" else None))
    assert still.hang([others])
    assert not still.hang([])
