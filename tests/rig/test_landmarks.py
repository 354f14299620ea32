"""What stands still in one image is found in another, and tells which way the camera has turned, and how far."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from twin_node.rig.landmarks import STRAYS, Landmarks, contrast, features_of, found, tracked
from twin_node.scene import Float32, Float64, UInt8

WIDTH, HEIGHT, FOCAL = 160, 120, 150.0
K = np.array([[FOCAL, 0, 82.0], [0, FOCAL, 57.0], [0, 0, 1]])
LEAST, SHARE = 15, 0.6
OPENCV = K - np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])


def scene(seed: int = 0) -> UInt8:
    """[H, W, 3] an image full of corners."""
    coarse = np.random.default_rng(seed).integers(0, 255, (24, 32, 3), dtype=np.uint8)
    return np.asarray(cv2.resize(coarse, (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC), np.uint8)


def after(turn: Float64, image: UInt8) -> UInt8:
    """What a camera sees once it has turned by a rotation vector [3] of its own optical frame, rad."""
    H = OPENCV @ Rotation.from_rotvec(turn).inv().as_matrix() @ np.linalg.inv(OPENCV)
    return np.asarray(cv2.warpPerspective(image, H, (WIDTH, HEIGHT), borderMode=cv2.BORDER_REPLICATE), np.uint8)


def landmarks(taken_at: Float64 | None = None) -> Landmarks:
    return Landmarks(contrast(scene()), None, K, taken_at)


def at_home(count: int) -> Landmarks:
    """Landmarks of which all but the first `count` are forgotten."""
    few = landmarks()
    few.home, few._strays = few.home[:count], few._strays[:count]
    return few


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_the_camera_s_turn_is_told_about_its_own_axes(axis: int, sign: float) -> None:
    turn = np.zeros(3)
    turn[axis] = sign * np.radians(1.0)
    marks = landmarks()
    motion = marks.motion(marks.found_in(contrast(after(turn, scene()))), LEAST, SHARE)
    assert motion is not None
    assert motion.turn == pytest.approx(turn, abs=np.radians(0.05))
    far = FOCAL * np.radians(1.0) if axis < 2 else np.radians(1.0) * np.sqrt(WIDTH**2 + HEIGHT**2) / np.sqrt(12)
    assert motion.residual_px == pytest.approx(far, rel=0.15)
    assert LEAST < motion.features <= len(marks)


def test_a_turn_is_counted_from_home_where_the_landmarks_are_of_later() -> None:
    before, since = np.radians([0.0, 0.8, 0.0]), np.radians([0.0, 0.7, 0.0])
    marks = landmarks(taken_at=before)
    motion = marks.motion(marks.found_in(contrast(after(since, scene()))), LEAST, SHARE)
    assert motion is not None
    assert motion.turn == pytest.approx(before + since, abs=np.radians(0.05))


def test_a_camera_that_stands_has_not_turned_whatever_part_of_its_view_moves() -> None:
    image = scene()
    image[:, :50] = scene(1)[:, :50]
    marks = landmarks()
    motion = marks.motion(marks.found_in(contrast(image)), LEAST, SHARE)
    assert motion is not None
    assert np.linalg.norm(motion.turn) < np.radians(0.02)
    assert motion.residual_px < 0.1


def past_near_and_far(marks: Landmarks) -> Float32:
    """[n, 2] where landmarks at all distances are once the camera has moved to its left."""
    shifts = np.random.default_rng(2).uniform(2, 8, len(marks))
    return (marks.home + np.column_stack([shifts, np.zeros(len(marks))])).astype(np.float32)


def test_a_camera_that_has_moved_past_things_near_and_far_is_told_by_the_median() -> None:
    marks = landmarks()
    motion = marks.motion(past_near_and_far(marks), LEAST, SHARE)
    assert motion is not None
    assert motion.turn == pytest.approx([0, -5 / FOCAL, 0], abs=0.1 * 5 / FOCAL)
    assert motion.residual_px == pytest.approx(5, abs=0.7)


def test_neither_what_half_the_landmarks_do_nor_what_few_do_is_the_camera_s() -> None:
    marks = landmarks()
    now = past_near_and_far(marks)
    standing = marks.home[:, 0] < WIDTH / 2  # half of the image stands
    assert marks.motion(np.where(standing[:, None], marks.home, now), LEAST, SHARE) is None
    lost = np.arange(len(marks)) % 2 == 0  # half of what is about is not found, as behind people
    assert marks.motion(np.where(lost[:, None], np.float32(np.nan), now), LEAST, SHARE) is None


def test_something_large_that_moves_as_one_before_a_standing_camera_is_not_the_camera() -> None:
    marks = landmarks()
    carried = marks.home[:, 0] > 0.42 * WIDTH
    motion = marks.motion(np.where(carried[:, None], marks.home + np.float32(5), marks.home), LEAST, SHARE)
    assert motion is None


def test_a_thing_with_many_features_has_no_more_voice_than_the_room_it_takes() -> None:
    marks = landmarks()
    crowd = np.random.default_rng(3).uniform([42, 32], [78, 58], (100, 2))  # within one of the 16 parts that vote
    columns, rows = np.meshgrid(np.arange(20, WIDTH, 40), np.arange(15, HEIGHT, 30))
    alone = np.column_stack([columns.ravel(), rows.ravel()])
    marks.home = np.concatenate([crowd, alone]).astype(np.float32)
    now = marks.home.copy()
    now[:100] += [4.0, 2.0]
    motion = marks.motion(now, LEAST, SHARE)
    assert motion is not None
    assert motion.features == 16
    assert np.linalg.norm(motion.turn) < 1e-6


@pytest.mark.parametrize(("count", "told"), [(LEAST, True), (LEAST - 1, False)])
def test_so_many_landmarks_tell_and_no_fewer(count: int, told: bool) -> None:
    marks = at_home(count)
    assert (marks.motion(marks.home, LEAST, SHARE) is not None) == told
    assert marks.stand_in(marks.reference, LEAST, SHARE) == told


def test_an_image_shows_what_stands_in_its_place_alone() -> None:
    marks = landmarks()
    assert marks.stand_in(contrast(scene()), LEAST, SHARE)
    assert not marks.stand_in(contrast(scene(1)), LEAST, SHARE)
    assert not marks.stand_in(contrast(after(np.radians([0.0, 1.0, 0.0]), scene())), LEAST, SHARE)
    assert not marks.stand_in(contrast(scene()[:, :100].copy()), LEAST, SHARE)
    most_elsewhere = np.where(np.arange(WIDTH)[None, :, None] < 0.4 * WIDTH, scene(), np.roll(scene(), 3, axis=1))
    assert not marks.stand_in(contrast(most_elsewhere), LEAST, SHARE)


def test_what_moves_while_much_stands_is_dropped_the_third_time() -> None:
    marks = landmarks()
    count, moves = len(marks), marks.home[:, 0] > 0.6 * WIDTH
    home = marks.home.copy()
    now = np.where(moves[:, None], home + np.float32([2.0, 0.0]), home)
    for _ in range(STRAYS - 1):
        marks.drop_strays(now)
        assert len(marks) == count
    marks.drop_strays(now)
    np.testing.assert_array_equal(marks.home, home[~moves])


def test_what_is_not_found_has_not_strayed_nor_what_moves_with_most() -> None:
    marks = landmarks()
    count = len(marks)
    nowhere = np.where(marks.home[:, :1] > WIDTH / 2, np.float32(np.nan), marks.home)
    with_most = marks.home + np.float32([3.0, 0.0])
    a_little = marks.home + np.float32([1.2, 0.0]) * (marks.home[:, :1] > WIDTH / 2)
    for _ in range(STRAYS):
        for now in (nowhere, with_most, a_little, np.full_like(marks.home, np.nan)):
            marks.drop_strays(now)
    assert len(marks) == count


def test_how_far_a_turn_moves_landmarks_is_counted_from_the_image_s_centre() -> None:
    marks = landmarks()
    assert marks.displacement_px(np.zeros(3)) == pytest.approx(0, abs=1e-3)
    marks.home = OPENCV[None, :2, 2].astype(np.float32)
    assert marks.displacement_px(np.array([0, 0, 0.5])) == pytest.approx(0, abs=1e-4)
    assert marks.displacement_px(np.array([0, 0.1, 0])) == pytest.approx(FOCAL * np.tan(0.1), rel=1e-4)
    assert marks.displacement_px(np.array([0.01, 0.01, 0])) == pytest.approx(FOCAL * 0.01 * np.sqrt(2), rel=1e-3)
    marks.home = np.zeros((0, 2), np.float32)
    assert marks.displacement_px(np.array([0, 0.1, 0])) == 0


def test_no_feature_is_where_nothing_is_valid_nor_at_its_edge() -> None:
    valid = np.zeros((HEIGHT, WIDTH), np.bool_)
    valid[20:90, 30:120] = True
    points = features_of(contrast(scene()), valid)
    assert len(points) > LEAST
    assert ((points >= [34, 24]) & (points <= [115, 85])).all()
    assert (points.min(axis=0) < [39, 29]).all()
    assert features_of(np.full((HEIGHT, WIDTH), 128, np.uint8), None).shape == (0, 2)
    assert len(tracked(contrast(scene()), contrast(scene()), np.zeros((0, 2), np.float32))) == 0


def test_what_is_not_found_back_is_not_found() -> None:
    marks = landmarks()
    assert found(marks.found_in(contrast(scene()))).all()
    assert found(marks.found_in(contrast(scene(1)))).mean() < 0.2


def test_contrast_takes_gain_and_offset_out_and_leaves_noise_of_plain_walls_small() -> None:
    image = scene() // 2 + 30
    lit = np.asarray(image * 0.6 + 40, np.uint8)
    inner = np.s_[10:-10, 10:-10]
    assert np.abs(contrast(image)[inner].astype(int) - contrast(lit)[inner].astype(int)).mean() < 6
    assert contrast(image)[inner].std() == pytest.approx(36, abs=6)
    assert contrast(image)[inner].mean() == pytest.approx(128, abs=6)
    wall = np.clip(100 + np.random.default_rng(0).normal(0, 0.5, image.shape), 0, 255).astype(np.uint8)
    assert contrast(wall)[inner].std() < 12


def test_landmarks_agree_that_stand_or_move_as_one_and_none_that_chance_has_found() -> None:
    marks = landmarks()
    assert marks.agreeing(marks.found_in(contrast(scene()))) == len(marks)
    turned = marks.found_in(contrast(after(np.radians([0.0, 1.0, 0.0]), scene())))
    assert marks.agreeing(turned) > 0.8 * found(turned).sum()
    other = marks.found_in(contrast(scene(1)))
    assert found(other).sum() > LEAST
    assert marks.agreeing(other) < LEAST
    few = np.full_like(marks.home, np.nan)
    assert marks.agreeing(few) == 0
    few[:3] = marks.home[:3] + np.float32([[0.0, 0.0], [0.5, 0.0], [5.0, 0.0]])
    assert marks.agreeing(few) == 2
