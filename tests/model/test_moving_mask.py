"""The moving mask on made-up scenes: a textured floor, noise, drifting exposure, and boxes that come, stop and go."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
import pytest

from twin_node.model.moving_mask import BARED_NS, MovingMask
from twin_node.model.parameters import ModelError
from twin_node.scene import Bool, Camera, Float32, FrameSet, UInt8, View

HEIGHT, WIDTH = 90, 160
STEP_NS = 33_000_000
CAMERA = Camera("cam", WIDTH, HEIGHT, np.eye(3), np.eye(4))


def floor() -> UInt8:
    """A static background [H, W, 3] with gentle texture."""
    rng = np.random.default_rng(1)
    return cv2.resize(rng.uniform(80, 160, (6, 10, 3)), (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC).astype(np.uint8)


def box(left: int, top: int = 30, size: int = 20) -> Bool:
    shape = np.zeros((HEIGHT, WIDTH), np.bool_)
    shape[top : top + size, max(left, 0) : max(left + size, 0)] = True
    return shape


class Scene:
    """Renders boxes over the floor with sensor noise and plays them into a mask."""

    def __init__(self) -> None:
        self.mask = MovingMask()
        self.floor = floor()
        self.tick = 0

    def show(self, shape: Bool | None = None, gain: float = 1.0, robot: Bool | None = None, noise: float = 1.5) -> Bool:
        rng = np.random.default_rng(100 + self.tick)
        image = self.floor.astype(np.float64)
        if shape is not None:
            image[shape] = (230, 60, 30)
        image = image * gain + rng.normal(0, noise, image.shape)
        self.tick += 1
        view = View(CAMERA, self.tick * STEP_NS, np.clip(image, 0, 255).astype(np.uint8))
        return self.mask.update(FrameSet(view.stamp, (view,)), [robot])[0]


@pytest.fixture
def scene() -> Scene:
    return Scene()


def share(found: Bool, truth: Bool) -> float:
    return float((found & truth).sum() / truth.sum())


def test_nothing_moves_nothing_is_masked(scene: Scene) -> None:
    assert not any(scene.show(noise=3.0).any() for _ in range(15))


def test_drifting_exposure_is_not_motion(scene: Scene) -> None:
    assert not any(scene.show(gain=1.0 + 0.02 * tick).any() for tick in range(20))


def test_moving_box_is_covered_and_its_trail_is_freed(scene: Scene) -> None:
    for _ in range(3):
        scene.show()
    for left in range(0, 120, 4):
        shape = box(left)
        found = scene.show(shape)
        assert share(found, shape) == 1.0
    assert found.sum() < 2.2 * shape.sum()


def test_stopping_never_frees(scene: Scene) -> None:
    scene.show()
    for left in range(0, 60, 4):
        found = scene.show(box(left))
    for _ in range(90):
        found = scene.show(box(56))
        assert share(found, box(56)) == 1.0


def test_who_comes_to_rest_beside_ground_of_their_own_colours_is_held() -> None:
    """Skin over a grey floor, up to the edge of a wooden table: without depth only what was there before tells."""
    ground = np.full((HEIGHT, WIDTH, 3), 125.0)
    ground[:, :60] = (178, 140, 104)
    path = (*range(140, 56, -4), *range(60, 150, 4), *range(140, 60, -4), *(60 * (60,)))
    mask, shares = MovingMask(), []
    for tick, left in enumerate(path):
        image = np.where(box(left)[..., None], (170, 132, 96), ground)
        noisy = image + np.random.default_rng(tick).normal(0, 1.5, ground.shape)
        view = View(CAMERA, tick * STEP_NS, noisy.astype(np.uint8))
        shares.append(share(mask.update(FrameSet(view.stamp, (view,)), [None])[0], box(left)))
    assert min(shares[-60:]) > 0.97


def test_box_present_from_the_start_is_found_whole_and_its_place_is_freed(scene: Scene) -> None:
    for _ in range(5):
        assert not scene.show(box(40)).any()
    for left in range(40, 120, 3):
        shape = box(left)
        found = scene.show(shape)
    assert share(found, shape) == 1.0
    for _ in range(15):
        found = scene.show(shape)
    assert share(found, shape) == 1.0
    assert share(found, box(40)) < 0.1


def test_ground_is_freed_where_a_thing_of_its_own_colours_was_from_the_start() -> None:
    """Tiles of 40 levels' contrast, and a box striped in the tiles' colours and another: colour alone cannot tell."""
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    tiles = ((rows // 7 + columns // 9) % 2)[..., None]
    ground = (np.array([90, 100, 130]) + 40 * tiles).astype(np.uint8)
    stripes = np.where((rows // 2 % 2)[..., None] == 0, ground[::-1, ::-1], np.array([230, 60, 30])).astype(np.uint8)
    mask = MovingMask()
    path = (40, 40, 40, 40, 40, *range(43, 120, 3), *range(117, 80, -3), *range(82, 120, 3), *(15 * (118,)))
    for tick, left in enumerate(path):
        image = np.where(box(left)[..., None], np.roll(stripes, left, axis=1), ground)
        noisy = image + np.random.default_rng(tick).normal(0, 1.5, image.shape)
        view = View(CAMERA, tick * STEP_NS, np.clip(noisy, 0, 255).astype(np.uint8))
        found = mask.update(FrameSet(view.stamp, (view,)), [None])[0]
    assert share(found, box(118)) > 0.9
    assert share(found, box(40)) < 0.1


def test_rough_ground_that_one_thing_after_another_has_passed_is_nearly_free() -> None:
    """Gaps between limbs show ground that is doubted, and rough ground does not continue what lies around it."""
    rng = np.random.default_rng(2)
    ground = cv2.GaussianBlur(rng.uniform(40, 200, (HEIGHT, WIDTH, 3)).astype(np.float32), (0, 0), 1.5)
    colours = rng.uniform(60, 180, (HEIGHT, WIDTH, 3))
    depth = np.full((HEIGHT, WIDTH), 2, np.float32)  # things are flat: it tells none of them
    mask, sets = MovingMask(), 0
    passed = np.zeros((HEIGHT, WIDTH), np.bool_)
    passed[30:50] = True
    for _ in range(4):
        for left in (*range(-44, WIDTH, 4), *(8 * (WIDTH,))):
            limbs = box(left) & ~box(left + 6, 36, 8) | box(left + 24, size=9) | box(left + 24, 41, 9)
            image = np.where(limbs[..., None], colours, ground)
            noisy = image + np.random.default_rng(sets).normal(0, 1.5, image.shape)
            view = View(CAMERA, sets * STEP_NS, np.clip(noisy, 0, 255).astype(np.uint8), depth)
            found = mask.update(FrameSet(view.stamp, (view,)), [None])[0]
            assert not 10 < left < 100 or share(found, limbs) > 0.95
            sets += 1
        assert share(found, passed) < 0.1


@pytest.mark.parametrize("has_depth", [False, True])
def test_who_wears_the_colour_of_ground_that_another_left_is_held_where_no_depth_would_tell(has_depth: bool) -> None:
    """Five of six columns of who comes second look like the ground, which the first one has shown to be ground."""
    ground, depth = np.full((HEIGHT, WIDTH, 3), 100.0), np.full((HEIGHT, WIDTH), 2, np.float32)
    first = [box(left, 25, 34) for left in (*range(-30, WIDTH, 4), *(8 * (WIDTH,)))]
    second = [box(left, 30, 24) for left in range(20, 100, 4)]
    mask, shares = MovingMask(), []
    for tick, shape in enumerate([*first, *second]):
        worn = (np.arange(WIDTH) - int(shape.argmax() % WIDTH)) % 6 < (5 if tick >= len(first) else 0)
        image = np.where((shape & ~worn)[..., None], (230, 60, 30), ground)
        noisy = image + np.random.default_rng(tick).normal(0, 1.5, ground.shape)
        view = View(CAMERA, tick * STEP_NS, noisy.astype(np.uint8), depth if has_depth else None)
        found = mask.update(FrameSet(view.stamp, (view,)), [None])[0]
        if tick >= len(first) + 5:
            shares.append(share(found, shape))
    assert (min(shares) > 0.97) == (not has_depth)


def test_an_even_thing_that_rocks_where_it_was_from_the_start_is_held(scene: Scene) -> None:
    """Much of it looks like the first image, which shows the thing itself: what was found to move there is doubted."""
    shares = []
    for tick in range(120):
        shape = box(40 + round(8 * np.sin(tick / 4)))
        shares.append(share(scene.show(shape), shape))
    assert np.mean(shares[40:]) > 0.5


def test_robot_is_left_out(scene: Scene) -> None:
    scene.show()
    for left in range(0, 60, 4):
        found = scene.show(box(left), robot=box(left))
        assert not (found & box(left)).any()


def test_ground_that_the_robot_uncovers_is_not_motion(scene: Scene) -> None:
    for left in range(60, 20, -2):
        assert not scene.show(box(left), robot=box(left - 3, 27, 26)).any()


def test_a_thing_that_the_robot_uncovers_little_by_little_is_motion(scene: Scene) -> None:
    for left in range(0, 42, 2):  # the thing goes behind the robot that has stood there from the start
        scene.show(box(left), robot=box(40, 25, 30))
    for edge in range(42, 60, 2):  # and the robot withdraws
        robot = box(edge, 25, 30)
        found = scene.show(box(40), robot=robot)
        assert share(found, box(40) & ~robot) >= 0.9


def test_same_images_give_the_same_masks() -> None:
    first, second = Scene(), Scene()
    for left in range(0, 60, 4):
        assert np.array_equal(first.show(box(left)), second.show(box(left)))


def test_depth_finds_what_colour_cannot(scene: Scene) -> None:
    far = np.full((HEIGHT, WIDTH), 2.0, np.float32)
    mask = MovingMask()
    for tick in range(12):
        depth = far.copy()
        shape = box(4 * tick)
        if tick > 1:
            depth[shape] = 1.5
        view = View(CAMERA, tick * STEP_NS, scene.floor, depth)
        found = mask.update(FrameSet(view.stamp, (view,)), [None])[0]
        if tick > 1:
            assert share(found, shape) > 0.8
    assert found.sum() < 2 * shape.sum()


def seen_by_depth(scene: Scene, depths: Sequence[Float32 | None]) -> list[Bool]:
    """The masks where colour tells nothing."""
    mask = MovingMask()
    views = [View(CAMERA, tick * STEP_NS, scene.floor, depth) for tick, depth in enumerate(depths)]
    return [mask.update(FrameSet(view.stamp, (view,)), [None])[0] for view in views]


def before(far: Float32, shape: Bool, depth: float) -> Float32:
    return np.where(shape, np.float32(depth), far)


def test_what_comes_straight_at_a_camera_is_found_by_depth_however_slowly(scene: Scene) -> None:
    far = np.full((HEIGHT, WIDTH), 2.0, np.float32)
    for step_m in (0.004, 0.01, 0.03):
        steps = round(0.3 / step_m)
        found = seen_by_depth(scene, [far] * 5 + [before(far, box(40), 2 - step_m * k) for k in range(steps)])
        assert share(found[-1], box(40)) > 0.9
        assert not found[4].any()


@pytest.mark.parametrize("error_m", [0.05, 0.3])
def test_one_depth_image_that_is_too_deep_leaves_nothing_moving(scene: Scene, error_m: float) -> None:
    far = np.full((HEIGHT, WIDTH), 1.0, np.float32)
    found = seen_by_depth(scene, [far] * 5 + [before(far, box(40), 1 + error_m)] + [far] * 10)
    assert not any(mask.any() for mask in found)


def test_ground_that_was_hidden_from_the_start_is_known_after_two_images(scene: Scene) -> None:
    far = np.full((HEIGHT, WIDTH), 2.0, np.float32)
    found = seen_by_depth(scene, [before(far, box(40), 1.5)] * 5 + [far] * 3 + [before(far, box(40), 1.7)])
    assert not found[7].any()
    assert share(found[8], box(40)) > 0.9


def test_depth_that_begins_after_the_first_set_tells_as_well(scene: Scene) -> None:
    far = np.full((HEIGHT, WIDTH), 2.0, np.float32)
    found = seen_by_depth(scene, [None, None, far, far, before(far, box(40), 1.5)])
    assert not found[3].any()
    assert share(found[4], box(40)) > 0.9


def test_what_is_at_rest_where_no_depth_was_known_is_not_learnt_while_it_moves(scene: Scene) -> None:
    """A hand before a pixel whose depth was never measured must not become the ground there."""
    unknown = np.zeros((HEIGHT, WIDTH), np.float32)
    mask, shape = MovingMask(), box(40)
    hand = np.where(shape[..., None], np.uint8(230), scene.floor)
    images = [(scene.floor, unknown)] * 5 + [(hand, before(unknown, shape, 1.0))] * 3
    for tick, (rgb, depth) in enumerate([*images, (scene.floor, before(unknown, shape, 2.0))]):
        view = View(CAMERA, tick * STEP_NS, rgb, depth)
        mask.update(FrameSet(view.stamp, (view,)), [None])
    assert np.isin(mask._cameras["cam"].mask.depth.known[shape], (0, 2)).all()


@pytest.mark.parametrize("path", [(*(5 * (40,)), *range(40, 120, 3)), (*(5 * (WIDTH,)), *range(120, 40, -3))])
@pytest.mark.parametrize("cameras", [1, 2])
@pytest.mark.parametrize("has_depth", [False, True])
def test_only_what_stood_there_from_the_start_and_moves_off_unmeasured_is_a_warning(
    scene: Scene, path: Sequence[int], cameras: int, has_depth: bool
) -> None:
    rig = [replace(CAMERA, name=f"cam{number}") for number in range(cameras)]
    depth = np.full((HEIGHT, WIDTH), 2, np.float32) if has_depth else None
    told = []
    for tick, left in enumerate(path):
        image = np.where(box(left)[..., None], np.uint8((230, 60, 30)), scene.floor)
        views = tuple(View(camera, tick * STEP_NS, image, depth) for camera in rig)
        scene.mask.update(FrameSet(tick * STEP_NS, views), [None] * cameras)
        told.append(scene.mask.warnings)
    assert not any(told[:5])
    assert bool(told[-1]) == (path[0] == 40 and cameras == 2 and not has_depth)
    last = replace(views[0], stamp=views[0].stamp + BARED_NS + STEP_NS)
    scene.mask.update(FrameSet(last.stamp, (last,)), [None])
    assert not scene.mask.warnings, "after so long it is over"


def test_a_jump_of_exposure_is_not_motion(scene: Scene) -> None:
    for _ in range(5):
        scene.show()
    assert not any(scene.show(gain=1.25).any() for _ in range(10))


def test_a_soft_shadow_is_not_motion(scene: Scene) -> None:
    for _ in range(5):
        scene.show()
    for tick in range(20):
        shade = np.ones((HEIGHT, WIDTH, 1))
        shade[20:60, 10 + 4 * tick : 50 + 4 * tick] = 0.8
        plain, scene.floor = scene.floor, (scene.floor * cv2.GaussianBlur(shade, (9, 9), 0)[..., None]).astype(np.uint8)
        found = scene.show()
        scene.floor = plain
        assert found.mean() < 0.01


def test_cameras_may_come_and_go(scene: Scene) -> None:
    mask = MovingMask()
    for tick in range(10):
        views = [View(CAMERA, tick * STEP_NS, scene.floor)]
        if tick % 3:
            views.append(View(Camera("other", WIDTH, HEIGHT, np.eye(3), np.eye(4)), tick * STEP_NS, scene.floor))
        found = mask.update(FrameSet(tick * STEP_NS, tuple(views)), [None] * len(views))
        assert len(found) == len(views)
        assert not any(one.any() for one in found)


@pytest.mark.parametrize("times", [2, 3])
def test_a_camera_whose_images_come_smaller_begins_anew_however_they_are_looked_at(times: int) -> None:
    """Those of twice the size are looked at in as many pixels: what a part of the image shows then was all moving."""
    mask, stamp = MovingMask(), 0
    rng = np.random.default_rng(4)
    whole = cv2.resize(rng.integers(0, 255, (24, 32, 3), np.uint8), (320 * times, 240 * times))
    for image in (whole, whole, whole[:240, :320], whole[:240, :320]):
        camera = Camera("cam", image.shape[1], image.shape[0], np.eye(3), np.eye(4))
        stamp += STEP_NS
        (found,) = mask.update(FrameSet(stamp, (View(camera, stamp, np.ascontiguousarray(image)),)), [None])
        assert found.shape == image.shape[:2]
        assert not found.any()


def test_pixels_without_an_image_are_never_moving(scene: Scene) -> None:
    valid = np.ones((HEIGHT, WIDTH), np.bool_)
    valid[:, :40] = False
    mask = MovingMask()
    for tick in range(12):
        image = scene.floor.copy()
        image[box(6 * tick)] = (230, 60, 30)
        view = View(CAMERA, tick * STEP_NS, image, valid=valid)
        found = mask.update(FrameSet(view.stamp, (view,)), [None])[0]
        assert not (found & ~valid).any()


@pytest.mark.parametrize("name", ["depth", "robot"])
def test_depth_and_arm_that_are_not_of_their_cameras_size_are_refused(scene: Scene, name: str) -> None:
    half = (HEIGHT // 2, WIDTH // 2)
    view = View(CAMERA, 0, scene.floor, np.ones(half, np.float32) if name == "depth" else None)
    robot = np.zeros(half, np.bool_) if name == "robot" else None
    with pytest.raises(ModelError, match=f"camera cam: expected {name} .*; give images of the camera's size"):
        MovingMask().update(FrameSet(0, (view,)), [robot])


@pytest.mark.parametrize("size", [(360, 640), (481, 853)])
@pytest.mark.parametrize("has_depth", [False, True])
def test_in_wide_images_that_are_looked_at_smaller_what_moves_is_found_to_two_pixels(
    size: tuple[int, int], has_depth: bool
) -> None:
    """A box and the arm beside it; noise, and the whole image's pixels."""
    height, width = size
    ground = cv2.resize(floor(), (width, height), interpolation=cv2.INTER_CUBIC).astype(np.float64)
    camera, mask = Camera("cam", width, height, np.eye(3), np.eye(4)), MovingMask()
    robot = np.zeros(size, np.bool_)
    robot[50:91, 301:] = True
    for tick, left in enumerate((width, width, *range(31, 301, 11))):
        shape, inner = np.zeros(size, np.bool_), np.zeros(size, np.bool_)
        shape[101:202, left : left + 101] = True
        inner[103:200, left + 2 : left + 99] = True
        image = np.where((shape | robot)[..., None], (230.0, 60.0, 30.0), ground)
        noisy = image + np.random.default_rng(tick).normal(0, 2.0, image.shape)
        depth = np.where(shape, np.float32(1.5), np.float32(2.0)) if has_depth else None
        view = View(camera, tick * STEP_NS, np.clip(noisy, 0, 255).astype(np.uint8), depth)
        found = mask.update(FrameSet(view.stamp, (view,)), [robot])[0]
        assert found.shape == size
        assert not (found & robot).any()
        if tick < 2:
            assert not found.any()
        else:
            assert share(found, inner) == 1.0
    around = cv2.dilate(shape.astype(np.uint8), np.ones((61, 61), np.uint8)) > 0
    assert (found & ~around).sum() < 0.1 * shape.sum(), "its trail is freed"
