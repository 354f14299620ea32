"""What keeps still for long leaves the moving mask where depth is measured, and is in it again when it stirs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from model_scenes import frames, rig

from twin_node.model import ModelParameters, SeedParameters, WindowModel
from twin_node.model.long_rest import STANDS_NS
from twin_node.model.moving_mask import MovingMask
from twin_node.model.quality import moving_pixels, psnr, squared_error
from twin_node.scene import Bool, Camera, Float32, FrameSet, Tier, UInt8, View

HEIGHT, WIDTH = 45, 80
CAMERA = Camera("cam", WIDTH, HEIGHT, np.array([[35.0, 0, 40], [0, 35, 22], [0, 0, 1]]), np.eye(4))
"""A pixel shows 4 cm of the thing."""
STEP_NS = 100_000_000
FLOOR_M, THING_M = 2.0, 1.5
COMING, STILL = 10, STANDS_NS // STEP_NS + 10
"""Sets in which the thing comes, and in which it has then stood for long."""

Change = Callable[[int, UInt8, Float32], None]
"""Changes image [H, W, 3] and depth [H, W] of a set, given how many sets ago the thing came to rest."""


def where(left: int) -> tuple[slice, slice]:
    """Rows and columns of the thing."""
    return slice(12, 32), slice(max(left, 0), max(left + 20, 0))


PLACE = where(30)


class Cell:
    """A floor of blotches that a thing is pushed onto from the left; it comes to rest at `PLACE`."""

    def __init__(self, has_depth: bool = True) -> None:
        rng = np.random.default_rng(1)
        self._floor = np.repeat(np.repeat(rng.uniform(80, 150, (5, 8, 3)), 9, 0), 10, 1)
        self._thing = np.repeat(np.repeat(rng.uniform(0, 255, (5, 5, 3)), 4, 0), 4, 1)
        self._mask, self._has_depth, self._tick = MovingMask(), has_depth, 0

    def show(self, change: Change | None = None, robot: Bool | None = None) -> Bool:
        """The mask of the next set."""
        rng = np.random.default_rng(self._tick)
        left = min(-20 + 5 * self._tick, 30)
        image, depth = self._floor.copy(), np.full((HEIGHT, WIDTH), FLOOR_M, np.float32)
        rows, columns = where(left)
        width = columns.stop - columns.start
        if width:
            image[rows, columns], depth[rows, columns] = self._thing[:, -width:], THING_M
        rgb = np.clip(image + rng.normal(0, 2, image.shape), 0, 255).astype(np.uint8)
        depth += rng.normal(0, 0.004, depth.shape).astype(np.float32)
        depth[rng.random(depth.shape) < 0.05] = 0
        if change is not None and self._tick >= COMING:
            change(self._tick - COMING, rgb, depth)
        self._tick += 1
        view = View(CAMERA, self._tick * STEP_NS, rgb, depth if self._has_depth else None)
        return self._mask.update(FrameSet(view.stamp, (view,)), [robot])[0]

    def pause(self, seconds: float) -> None:
        """No images come for so long."""
        self._tick += round(seconds * 1e9 / STEP_NS)

    def rested(self, change: Change | None = None) -> Bool:
        """The mask once the thing has stood for long."""
        return [self.show(change) for _ in range(COMING + STILL)][-1]


def test_what_stands_for_long_still_does_after_the_arm_has_hidden_all_of_it() -> None:
    cell, arm = Cell(), np.zeros((HEIGHT, WIDTH), np.bool_)
    cell.rested()
    arm[8:36, 26:54] = True
    behind = [cell.show(robot=arm) for _ in range(5)]
    again = [cell.show() for _ in range(5)]
    assert not any(mask.any() for mask in behind + again)


def test_what_was_put_down_is_in_the_mask_until_it_has_stood_for_long() -> None:
    cell = Cell()
    masks = [cell.show() for _ in range(COMING + STILL)]
    soon = masks[COMING + STILL - 20]
    assert soon[PLACE].mean() > 0.95
    assert not masks[-1].any()


def test_time_without_images_does_not_count_as_having_stood() -> None:
    """Who stood there may have turned to something else and back."""
    cell = Cell()
    for _ in range(COMING + STILL // 2):
        cell.show()
    cell.pause(30)
    masks = [cell.show() for _ in range(STILL // 2 + 30)]
    assert min(mask[PLACE].mean() for mask in masks[: STILL // 2 - 30]) > 0.95
    assert not masks[-1].any(), "what it has stood before and after counts"


def test_what_has_stood_for_long_still_stands_after_a_time_without_images() -> None:
    cell = Cell()
    assert not cell.rested().any()
    cell.pause(30)
    assert not any(cell.show().any() for _ in range(5))


def test_it_is_in_it_again_as_a_whole_with_the_first_image_that_shows_it_otherwise() -> None:
    cell = Cell()
    assert not cell.rested().any()

    def tilt(_: int, rgb: UInt8, depth: Float32) -> None:
        rgb[12:16, 30:50] = 255 - rgb[12:16, 30:50]

    assert cell.show(tilt)[PLACE].mean() > 0.95


def test_without_depth_it_stays_in_it() -> None:
    """Nothing else would tell that it is there."""
    assert Cell(has_depth=False).rested()[PLACE].mean() > 0.95


def _works(since: int, rgb: UInt8, depth: Float32) -> None:
    """Somebody whose hands alone move."""
    rgb[20:26, 30:36] = (250, 20, 20) if since // 3 % 2 else (20, 250, 20)


def _works_beside(since: int, rgb: UInt8, depth: Float32) -> None:
    """Somebody whose hands alone move, beside a load that they hang together with: a hand is 1 % of both."""
    rgb[20:22, 36:38] = (250, 20, 20) if since // 3 % 2 else (20, 250, 20)


def _turns(since: int, rgb: UInt8, depth: Float32) -> None:
    """What looks the same every half a second."""
    rgb[PLACE] = 60 + 30 * (since % 5)


def _creeps(since: int, rgb: UInt8, depth: Float32) -> None:
    """A pixel in three seconds."""
    rgb[PLACE] = np.roll(rgb[PLACE], since // 30, axis=1)


def _comes_nearer(since: int, rgb: UInt8, depth: Float32) -> None:
    """Straight at the camera, 2 cm per second; it is even."""
    rgb[PLACE] = 200
    depth[PLACE] = THING_M - 0.002 * since


def _sways(since: int, rgb: UInt8, depth: Float32) -> None:
    """Somebody in plain clothes who keeps still, as people do: by a pixel, once in four seconds."""
    rows, columns = PLACE
    rgb[PLACE] = (170, 60, 60)
    aside = 0.5 + 0.5 * np.sin(since * 2 * np.pi / 40)
    for edge, beside in ((columns.start, columns.start - 1), (columns.stop, columns.stop - 1)):
        rgb[rows, edge] = (1 - aside) * rgb[rows, edge] + aside * rgb[rows, beside]


@pytest.mark.parametrize("moves", [_works, _works_beside, _turns, _creeps, _comes_nearer, _sways])
def test_what_moves_however_little_stays(moves: Change) -> None:
    """At no time is it left out, not for a single image either."""
    cell = Cell()
    masks = [cell.show(moves) for _ in range(COMING + STILL)]
    assert min(mask[PLACE].mean() for mask in masks[COMING:]) > 0.9


def test_behind_the_arm_it_is_taken_to_be_as_it_was() -> None:
    cell, arm = Cell(), np.zeros((HEIGHT, WIDTH), bool)
    arm[:, 36:44] = True  # and a margin

    def hide(_: int, rgb: UInt8, depth: Float32) -> None:
        rgb[:, 38:42], depth[:, 38:42] = 230, 1.0

    for index in range(COMING + STILL):
        passes = index % 20 < 4 and index >= COMING
        mask = cell.show(hide if passes else None, arm if passes else None)
    assert not mask.any()


def test_light_may_change_slowly_about_what_stands() -> None:
    cell = Cell()
    assert not cell.rested().any()

    def glow(since: int, rgb: UInt8, depth: Float32) -> None:
        brighter = min(0.05 * (since - STILL), 25)
        rgb[PLACE] = np.clip(rgb[PLACE] + brighter, 0, 255).astype(np.uint8)

    assert not any(cell.show(glow).any() for _ in range(300))


@pytest.mark.parametrize("levels", [3, -3])
def test_what_turns_slowly_after_it_has_stood_is_in_it_again(levels: int) -> None:
    """From image to image it looks the same."""
    cell = Cell()
    assert not cell.rested().any()

    def fade(since: int, rgb: UInt8, depth: Float32) -> None:
        rgb[PLACE] = np.clip(rgb[PLACE].astype(int) + levels * (since - STILL), 0, 255).astype(np.uint8)

    assert any(cell.show(fade)[PLACE].mean() > 0.95 for _ in range(30))


def unit(rgb: UInt8) -> Float32:
    return rgb.astype(np.float32) / np.float32(255)


def test_the_model_of_what_was_put_down_stands_and_shows_it_as_well() -> None:
    cameras, model = rig(), WindowModel(ModelParameters(seed=SeedParameters(steps=20)))
    errors = {}
    for index in range(50):
        block_x = -0.1 + 0.01 * min(index, 12)
        seen = frames(index, block_x, cameras, depth=True)
        stamp = seen.stamp + max(index - 13, 0) * 767_000_000  # most of a second from set to set once it rests
        views = tuple(replace(view, stamp=stamp) for view in seen.views)
        state = model.update(replace(seen, stamp=stamp, views=views))
        view = views[0]
        block = moving_pixels(unit(view.rgb), unit(frames(0, None, cameras).views[0].rgb))
        errors[index] = psnr(float(squared_error(model.render(view.camera).rgb, unit(view.rgb))[block].mean()))
    assert not any(mask.any() for mask in state.moving_masks)
    assert model.nodes_count == 0
    assert model.tier_counts[Tier.STATIC] == sum(model.tier_counts.values())
    assert errors[49] > errors[14] - 0.5
