"""The moving mask where an arm hides the ground: what passes before it, and what it shows when it goes."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
import pytest

from twin_node.model.camera_mask import CameraMask
from twin_node.model.compiled_mask import can_compile, update_compiled
from twin_node.scene import Bool, Camera, View

HEIGHT, WIDTH = 90, 160
STEP_NS = 66_000_000
CAMERA = Camera("cam", WIDTH, HEIGHT, np.eye(3), np.eye(4))
FLOOR_M, ARM_M, BALL_M = 2.0, 1.5, 1.0


def square(left: int, top: int, size: int) -> Bool:
    shape = np.zeros((HEIGHT, WIDTH), np.bool_)
    shape[top : top + size, max(left, 0) : max(left + size, 0)] = True
    return shape


ARM = square(60, 25, 40)
Update = Callable[[CameraMask, View, Bool], Bool]


@pytest.fixture(params=["plain", "compiled"])
def update(request: pytest.FixtureRequest) -> Update:
    if request.param == "plain":
        return lambda camera, view, robot: camera.update(view, robot)
    if not can_compile():
        pytest.skip("no compiler on this machine")
    return lambda camera, view, robot: update_compiled([camera], [view], [robot])[0]


class Cell:
    """A textured floor, before it an arm, and before both, at times, a ball; as a camera with depth sees them."""

    def __init__(self, update: Update) -> None:
        rng = np.random.default_rng(1)
        texture = rng.uniform(80, 160, (18, 32, 3))
        self._floor = cv2.resize(texture, (WIDTH, HEIGHT), interpolation=cv2.INTER_NEAREST).astype(np.uint8)
        self._update = update
        self._tick = 0
        self.camera: CameraMask | None = None

    def show(self, arm: Bool, ball: Bool | None = None) -> Bool:
        """The mask of what is seen next; the arm shows another side in each image."""
        image, depth = self._floor.astype(np.float64), np.full((HEIGHT, WIDTH), FLOOR_M, np.float32)
        image[arm], depth[arm] = (60, 90 + 40 * (self._tick % 4), 200), ARM_M
        robot = cv2.dilate(arm.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
        if ball is not None:
            image[ball], depth[ball] = (230, 60, 30), BALL_M
            robot &= ~ball
        image += np.random.default_rng(self._tick).normal(0, 1.5, image.shape)
        view = View(CAMERA, self._tick * STEP_NS, np.clip(image, 0, 255).astype(np.uint8), depth)
        self._tick += 1
        if self.camera is None:
            self.camera = CameraMask(view)
        return self._update(self.camera, view, robot)


def test_what_flies_past_before_the_arm_is_no_ground_that_it_hides(update: Update) -> None:
    cell = Cell(update)
    for _ in range(4):
        cell.show(ARM)
    for left in range(-20, 160, 30):  # farther from image to image than it is wide
        ball = square(left, 35, 24)
        found = cell.show(ARM, ball)
        assert (found & ball).sum() >= 0.9 * ball.sum()
    for withdrawn in range(0, 60, 3):
        arm = square(60 + withdrawn, 25, 40)
        found = cell.show(arm)
    assert not found.any()


def test_what_rests_before_the_arm_is_held(update: Update) -> None:
    cell = Cell(update)
    for _ in range(4):
        cell.show(ARM)
    cell.show(ARM, square(0, 35, 24))
    for left in [*range(6, 66, 6), *[66] * 20]:
        ball = square(left, 35, 24)
        found = cell.show(ARM, ball)
        assert (found & ball).sum() >= 0.9 * ball.sum()


def test_no_rim_stays_beside_the_arm_where_something_passed(update: Update) -> None:
    cell = Cell(update)
    cell.show(square(0, 25, 40))  # what was the arm's place before is met
    for _ in range(4):
        cell.show(ARM)
    for left in range(-20, 160, 30):
        cell.show(ARM, square(left, 20, 50))
    for _ in range(6):
        found = cell.show(ARM)
    assert not found.any()


def test_what_the_arm_hides_is_not_known_to_be_ground_for_that(update: Update) -> None:
    cell = Cell(update)
    away = square(120, 25, 40)
    for _ in range(4):
        cell.show(away)
    ball = square(40, 35, 20)
    cell.show(away, ball)
    cell.show(square(30, 25, 40))  # before the ball is gone
    assert cell.camera is not None
    assert not cell.camera.confirmed[ball].any()
    cell.show(away)
    assert not cell.camera.mask.any()
