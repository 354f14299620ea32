"""The moving mask where a depth camera measures nothing: dark cloth, rims, sunlight, what is out of range."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
import pytest

from twin_node.model.ground_depth import LOST_NS, SILENT_NS, GroundDepth
from twin_node.model.moving_mask import MovingMask
from twin_node.scene import Bool, Camera, Float32, FrameSet, UInt8, View

HEIGHT, WIDTH = 48, 80
STEP_NS = 100_000_000
CAMERA = Camera("cam", WIDTH, HEIGHT, np.eye(3), np.eye(4))
GROUND_M, BODY_M = 2.0, 1.5
CLOTH, ORANGE = (118, 112, 120), (230, 110, 60)
"""As even as the ground, the former like it."""
COME = (*(3 * (WIDTH,)), *range(WIDTH - 4, 28, -4))
"""Where a body's left side is, set by set, until it stands before the ground."""

Lack = Callable[[Float32, Bool, np.random.Generator], None]
"""Takes depth [H, W] from an image, given which pixels show the body."""


def ground() -> UInt8:
    """[H, W, 3] gently blotched."""
    coarse = np.random.default_rng(1).uniform(85, 150, (4, 6, 3))
    return cv2.resize(coarse, (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC).astype(np.uint8)


def body(left: int) -> Bool:
    shape = np.zeros((HEIGHT, WIDTH), np.bool_)
    shape[10:40, max(left, 0) : max(left + 24, 0)] = True
    return shape


class Scene:
    """An even body before a blotched ground, seen by one depth camera."""

    def __init__(self, lack: Lack, colour: tuple[int, int, int] = CLOTH) -> None:
        self._mask, self._lack, self._colour, self._tick = MovingMask(), lack, np.array(colour), 0

    def show(self, left: int, sways: float = 0.0, has_depth: bool = True) -> Bool:
        """The mask of the next set; the body's sides are `sways` of a pixel aside."""
        rng = np.random.default_rng(self._tick)
        shape, image = body(left), ground().astype(np.float64)
        weight = (1 - sways) * shape + sways * np.roll(shape, 1, axis=1)
        image += weight[..., None] * (self._colour - image) + rng.normal(0, 1.5, image.shape)
        depth = np.where(shape, BODY_M, GROUND_M) + rng.normal(0, 0.004, shape.shape)
        depth = depth.astype(np.float32)
        self._lack(depth, shape, rng)
        self._tick += 1
        rgb = np.clip(image, 0, 255).astype(np.uint8)
        view = View(CAMERA, self._tick * STEP_NS, rgb, depth if has_depth else None)
        return self._mask.update(FrameSet(view.stamp, (view,)), [None])[0]

    def stays(self, seconds: int) -> list[float]:
        """The shares of a body that comes and keeps as still as people do that the mask holds, set by set, at rest."""
        for left in COME:
            self.show(left)
        ticks = range(seconds * 1_000_000_000 // STEP_NS)
        return [share(self.show(COME[-1], 0.5 + 0.5 * np.sin(tick / 7)), body(COME[-1])) for tick in ticks]


def share(found: Bool, truth: Bool) -> float:
    return float((found & truth).sum() / truth.sum())


def dark(depth: Float32, shape: Bool, rng: np.random.Generator) -> None:
    """Nothing is measured of the body."""
    depth[shape] = 0


def half_dark(depth: Float32, shape: Bool, rng: np.random.Generator) -> None:
    """Nothing is measured of its lower half."""
    depth[25:][shape[25:]] = 0


def rims(depth: Float32, shape: Bool, rng: np.random.Generator) -> None:
    """Depth flickers at the sides of the body, and a little everywhere."""
    edge = cv2.morphologyEx(shape.astype(np.uint8), cv2.MORPH_GRADIENT, np.ones((5, 5), np.uint8)) > 0
    depth[rng.random(depth.shape) < np.where(edge, 0.6, 0.05)] = 0


def out_of_range(depth: Float32, shape: Bool, rng: np.random.Generator) -> None:
    """The ground is too far away to be measured."""
    depth[~shape] = 0


def whole(depth: Float32, shape: Bool, rng: np.random.Generator) -> None:
    """But for single pixels."""
    depth[rng.random(depth.shape) < 0.05] = 0


@pytest.mark.parametrize("lack", [dark, half_dark, rims, whole])
def test_who_keeps_still_is_held_from_head_to_foot(lack: Lack) -> None:
    shares = Scene(lack).stays(25)
    assert min(shares[5:]) > 0.93
    assert shares[-1] > shares[5] - 0.03


def test_who_stands_before_ground_that_is_not_measured_is_held() -> None:
    """By colour: that something is measured there does not make it ground."""
    assert min(Scene(out_of_range, ORANGE).stays(25)[5:]) > 0.97


@pytest.mark.parametrize("lack", [rims, whole])
def test_ground_that_a_thing_has_stood_on_from_the_start_is_free_soon(lack: Lack) -> None:
    scene = Scene(lack)
    for left in (*(10 * (30,)), *range(30, WIDTH, 4), *(10 * (WIDTH,))):
        found = scene.show(left)
    assert share(found, body(30)) < 0.1


def test_the_rim_of_who_came_to_rest_is_not_learnt_as_ground() -> None:
    """There colours of both blend, and what depth measures is the ground's. Trousers are as dark as its stripes."""
    striped = np.full((HEIGHT, WIDTH, 3), 72.0)
    striped[:, np.arange(WIDTH) // 3 % 2 == 1] = 104
    clothed = np.full((HEIGHT, WIDTH, 3), 72.0)
    clothed[: HEIGHT // 2] = (170, 120, 100)
    mask, found = MovingMask(), np.ones((HEIGHT, WIDTH), np.bool_)
    for tick, left in enumerate((*COME, *(15 * (COME[-1],)), *range(COME[-1], WIDTH, 4), *(3 * (WIDTH,)))):
        rng, shape = np.random.default_rng(tick), body(left)
        weight = np.maximum(cv2.blur(shape.astype(np.float32), (3, 3)), shape)[..., None]
        image = striped + weight * (clothed - striped) + rng.normal(0, 1.5, striped.shape)
        depth = (np.where(shape, BODY_M, GROUND_M) + rng.normal(0, 0.004, shape.shape)).astype(np.float32)
        whole(depth, shape, rng)
        view = View(CAMERA, tick * STEP_NS, np.clip(image, 0, 255).astype(np.uint8), depth)
        found = mask.update(FrameSet(view.stamp, (view,)), [None])[0]
    assert not found.any(), f"{found.sum()} pixels still move after they left"


def test_what_passes_where_the_sun_blinds_the_camera_leaves_nothing_behind_once_it_is_blind() -> None:
    blinded = [False]

    def sun(depth: Float32, shape: Bool, rng: np.random.Generator) -> None:
        depth[:, 20:60] *= not blinded[0]

    scene = Scene(sun, ORANGE)
    passes = (*range(-24, WIDTH, 4), *(5 * (WIDTH,)))
    for left in passes:
        scene.show(left)
    blinded[0] = True
    assert not any(scene.show(WIDTH)[:, 30:].any() for _ in range(30))
    for left in passes:
        found = scene.show(left)
    assert found.sum() < 10


def test_a_camera_whose_depth_ends_goes_on_without() -> None:
    scene = Scene(whole, ORANGE)
    for _ in range(5):
        scene.show(WIDTH)
    for left in (*(20 * (WIDTH,)), *range(-24, WIDTH, 4), *(5 * (WIDTH,))):
        found = scene.show(left, has_depth=False)
    assert not found.any()


def test_ground_that_is_not_measured_is_free_once_a_measured_thing_has_left_it() -> None:
    """A crate from a black mat: the lack of depth tells nothing where the ground around has none."""

    def mat(depth: Float32, shape: Bool, rng: np.random.Generator) -> None:
        depth[:, 20:70][~shape[:, 20:70]] = 0

    scene = Scene(mat, ORANGE)
    for left in (*(10 * (30,)), *range(30, WIDTH, 4), *(10 * (WIDTH,))):
        found = scene.show(left)
    assert share(found, body(30)) < 0.1


ALL, NONE = np.ones((HEIGHT, WIDTH), np.bool_), np.zeros((HEIGHT, WIDTH), np.bool_)
SPOT = (slice(10, 20), slice(30, 40))
ALL_OF_IT = np.ones((HEIGHT, WIDTH), np.float32)


def measured(stamp: int, spot_m: float | None = GROUND_M) -> View:
    """The ground, and something else on one spot; None: no depth at all."""
    if spot_m is None:
        return View(CAMERA, stamp, ground(), None)
    depth = np.full((HEIGHT, WIDTH), GROUND_M, np.float32)
    depth[SPOT] = spot_m
    return View(CAMERA, stamp, ground(), depth)


def watched(*spots_m: float) -> GroundDepth:
    """What is known after images of a spot, all of which may be ground at once."""
    known = GroundDepth(measured(0, spots_m[0]))
    for tick, spot_m in enumerate(spots_m):
        known.learn(measured(tick * STEP_NS, spot_m), 0 * ALL_OF_IT, NONE)
    return known


@pytest.mark.parametrize(
    ("before_m", "now_m", "has_come"),
    [(GROUND_M, BODY_M, True), (0, BODY_M, True), (BODY_M, 0, True), (BODY_M, BODY_M, False), (BODY_M, 1.52, False)],
)
def test_what_stands_in_front_has_come_unless_it_was_measured_there_before(
    before_m: float, now_m: float, has_come: bool
) -> None:
    in_front = NONE.copy()
    in_front[SPOT] = True
    come = watched(GROUND_M, before_m).come(measured(2 * STEP_NS, now_m), in_front)
    assert (come[SPOT] == has_come).all()
    assert not come[~in_front].any()


def test_ground_is_bared_by_what_is_measured_behind_it_twice_in_a_row() -> None:
    """Once is an outlier."""
    halfway = (BODY_M + GROUND_M) / 2
    assert (watched(BODY_M, BODY_M, GROUND_M).known[SPOT] < halfway).all()
    assert (watched(BODY_M, BODY_M, GROUND_M, BODY_M, GROUND_M).known[SPOT] < halfway).all()
    assert (watched(BODY_M, BODY_M, GROUND_M, GROUND_M).known[SPOT] == GROUND_M).all()


def test_ground_that_is_measured_a_little_deeper_is_learnt_slowly() -> None:
    deeper_m = BODY_M * 1.02
    assert (watched(BODY_M, BODY_M, deeper_m, deeper_m).known[SPOT] < (BODY_M + deeper_m) / 2).all()


def test_measured_ground_is_lost_only_after_a_while_and_not_where_the_camera_sends_no_depth_any_more() -> None:
    known = watched(GROUND_M)
    known.meet(measured(0), ALL)
    found = {}
    for stamp in range(STEP_NS, 2 * SILENT_NS, STEP_NS):
        found[stamp] = known.look(measured(stamp, 0), STEP_NS, ALL, NONE).lost[SPOT]
    assert not any(lost.any() for stamp, lost in found.items() if stamp <= LOST_NS)
    assert all(lost.all() for stamp, lost in found.items() if stamp > LOST_NS)
    last = 2 * SILENT_NS - STEP_NS
    without = {
        stamp: known.look(measured(stamp, None), STEP_NS, ALL, NONE)
        for stamp in range(last + STEP_NS, last + 2 * SILENT_NS, STEP_NS)
    }
    for stamp, told in without.items():
        assert told.telling.any() == (stamp <= last + SILENT_NS)
        assert told.lost[SPOT].all() == (stamp <= last + SILENT_NS)
