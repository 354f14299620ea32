"""What stands still in a recording, and what at its borders is no picture."""

from __future__ import annotations

import numpy as np
import pytest

from twin_node.rig.calibrate.matches import feature_matches
from twin_node.rig.calibrate.stills import LEAST_IMAGES, Still, stills_of
from twin_node.scene import Camera, FrameSet, Rig, RigCamera, UInt8, View

HEIGHT, WIDTH = 120, 160
NEAR = 3
"""Pixels beside a rim that are left out with it: a sixtieth of the width."""
ROWS, COLUMNS = np.mgrid[:HEIGHT, :WIDTH]
CAMERAS = tuple(
    RigCamera(name, WIDTH, HEIGHT, np.array([[150.0, 0, 80], [0, 150, 60], [0, 0, 1]]), np.eye(4)) for name in "ab"
)
RIMS = {
    "bands": (ROWS < 10) | (ROWS >= HEIGHT - 10),
    "one side": COLUMNS < 12,
    "circle": np.hypot(ROWS - 60, COLUMNS - 80) > 75,
    "none": np.zeros((HEIGHT, WIDTH), bool),
}


def _stills(*images: UInt8) -> tuple[Still, ...]:
    """What stands still where each camera has seen one picture all the time."""
    rig = Rig(CAMERAS[: len(images)])
    seen = zip(rig.cameras, images, strict=True)
    views = tuple(View(Camera(one.name, WIDTH, HEIGHT, one.K, one.T_base_cam), 0, rgb) for one, rgb in seen)
    return stills_of(rig, [FrameSet(0, views)] * LEAST_IMAGES)


def _noise(seed: int) -> UInt8:
    return np.random.default_rng(seed).integers(40, 255, (HEIGHT, WIDTH, 3), np.uint8)


@pytest.mark.parametrize("kind", RIMS)
def test_a_black_rim_is_no_picture_nor_is_what_lies_at_its_edge(kind: str) -> None:
    rim = RIMS[kind]
    rgb = _noise(0)
    rgb[rim] = np.random.default_rng(1).integers(0, 9, (int(rim.sum()), 3), np.uint8)
    (found,) = _stills(rgb)
    near = np.pad(rim, NEAR, mode="edge")
    beside = np.any([np.roll(near, (i, j), (0, 1)) for i in range(-3, 4) for j in range(-3, 4)], axis=0)
    np.testing.assert_array_equal(found.still, ~beside[NEAR:-NEAR, NEAR:-NEAR])


@pytest.mark.parametrize("dark", [(slice(0, 60), slice(0, 100)), (slice(40, 60), slice(60, 90))])
def test_what_is_dark_in_the_scene_stands_still(dark: tuple[slice, slice]) -> None:
    """Up to the border, too: a black cloth has an edge that other cameras see in another place."""
    rgb = _noise(0)
    rgb[dark] = 0
    assert _stills(rgb)[0].still.all()


def test_cameras_with_bands_have_no_more_in_common_than_without() -> None:
    """Their edges matched, and a rig was refused for "a pattern that fits in several places"."""
    images = [_noise(1), _noise(2)]
    for rgb in images:
        rgb[RIMS["bands"]] = 0
    (found,) = feature_matches(_stills(*images))
    assert len(found) < 10
