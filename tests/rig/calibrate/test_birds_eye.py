"""The ground as cameras see it from above: where a plane is met, which part is shared, and what lies flat on it."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from twin_node.geometry import inverse_pose, looking_at, transform
from twin_node.rig.calibrate.birds_eye import (
    CONTRAST,
    LARGEST_SHEET_PX,
    RIM_PX,
    Ground,
    ground_of,
    lay_flat,
    plane_hits,
)
from twin_node.rig.calibrate.lenses import raw_pixels
from twin_node.rig.calibrate.stills import Still
from twin_node.rig.errors import RigError
from twin_node.scene import Float64, RigCamera, UInt8

FLOOR = np.array([0.0, 0.0, 1.0, 0.1])
"""z = -0.1 m."""
WORKSPACE = np.array([[-0.4, -0.3, -0.2], [0.4, 0.3, 0.5]])


def seeing(name: str, *centre: float, at: tuple[float, float, float] = (0.0, 0.0, -0.1)) -> RigCamera:
    K = np.array([[200.0, 0, 83.0], [0, 201.0, 58.0], [0, 0, 1]])
    D = np.array([-0.1, 0.03, 0.001, -0.001, 0.0])
    return RigCamera(name, 160, 120, K, looking_at(np.array(centre), np.array(at)), D=D)


LEFT, RIGHT = seeing("left", -0.5, -0.4, 0.9), seeing("right", 0.6, -0.3, 0.8)


def on_plane(plane: Float64, count: int = 50) -> Float64:
    """[N, 3] m, about where the cameras look."""
    points = np.random.default_rng(0).uniform(-0.2, 0.2, (count, 3))
    return np.asarray(points - ((points @ plane[:3] + plane[3]) / (plane[:3] @ plane[:3]))[:, None] * plane[:3])


@pytest.mark.parametrize("normal", [(0.0, 0.0, 1.0), (0.0, 0.0, -1.0), (0.3, -0.2, 0.9)])
def test_rays_meet_a_plane_where_the_points_are_that_they_show(normal: tuple[float, float, float]) -> None:
    plane = np.array([*(np.array(normal) / np.linalg.norm(normal)), 0.08])
    points = on_plane(plane)
    pixels = raw_pixels(LEFT, transform(inverse_pose(LEFT.T_base_cam), points))
    np.testing.assert_allclose(plane_hits(LEFT, plane, pixels), points, atol=1e-6)


def test_rays_that_go_away_from_a_plane_or_along_it_meet_it_nowhere() -> None:
    pixels = np.array([[83.0, 58.0], [20.0, 30.0]])
    ceiling = np.array([0.0, 0.0, 1.0, -3.0])
    assert np.isnan(plane_hits(LEFT, ceiling, pixels)).all()
    level = replace(LEFT, T_base_cam=looking_at(np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 1.0])), D=np.zeros(5))
    assert np.isnan(plane_hits(level, FLOOR, np.array([[83.0, 58.0]]))).all()


PLANES = [(0.0, 0.0, 1.0), (0.0, 0.0, -1.0), (0.0, 0.2, 0.98), (0.1, 0.99, 0.1), (0.7, 0.0, 0.71)]


@pytest.mark.parametrize("normal", PLANES)
def test_the_shared_ground_lies_on_its_plane_with_axes_along_it(normal: tuple[float, float, float]) -> None:
    n = np.array(normal) / np.linalg.norm(normal)
    plane = np.array([*n, 0.05 * np.sign(n[2])])
    cameras = [seeing("a", *(1.2 * np.array([-0.3, 0.5, 0.8]))), seeing("b", *(1.2 * np.array([0.3, 0.7, 0.6])))]
    ground = ground_of(cameras, plane, 3 * WORKSPACE)
    np.testing.assert_allclose(ground.axes @ ground.axes.T, np.eye(2), atol=1e-12)
    np.testing.assert_allclose(np.cross(*ground.axes), n, atol=1e-12)
    corners = ground.points(np.array([[0.0, 0], [ground.width, 0], [0, ground.height], [7, 5]]))
    np.testing.assert_allclose(corners @ n + plane[3], 0, atol=1e-12)
    np.testing.assert_allclose(corners[1] - corners[0], ground.pixel_m * ground.width * ground.axes[0], atol=1e-12)


def test_the_ground_is_what_two_see_of_the_workspace_at_their_resolution() -> None:
    ground = ground_of([LEFT, RIGHT], FLOOR, WORKSPACE)
    np.testing.assert_allclose(ground.origin[2], -0.1)
    sheet = np.array([[0.0, 0.0], [ground.width, ground.height]])
    low, high = ground.points(sheet)[:, :2]
    assert (low >= [-0.56, -0.42]).all() and (high <= [0.56, 0.42]).all()
    assert (high - low > [0.3, 0.25]).all()
    middle = transform(inverse_pose(LEFT.T_base_cam), np.array([[0.0, 0.0, -0.1]]))[0, 2]
    assert ground.pixel_m == pytest.approx(middle / 200, rel=0.4)
    sharper = [
        replace(c, K=c.K * 2 - [[0, 0, 0.0], [0, 0, 0], [0, 0, 1]], width=320, height=240) for c in (LEFT, RIGHT)
    ]
    assert ground_of(sharper, FLOOR, WORKSPACE).pixel_m == pytest.approx(ground.pixel_m / 2, rel=0.05)


def test_the_ground_reaches_a_fifth_of_a_small_workspace_beyond_it() -> None:
    small = np.array([[-0.15, -0.1, -0.2], [0.15, 0.1, 0.5]])
    ground = ground_of([LEFT, RIGHT], FLOOR, small)
    low, high = ground.points(np.array([[0.0, 0.0], [ground.width, ground.height]]))[:, :2]
    np.testing.assert_allclose(low, [-0.21, -0.14], atol=0.02)
    np.testing.assert_allclose(high, [0.21, 0.14], atol=0.02)


def test_a_sheet_is_no_larger_than_makes_sense() -> None:
    sharp = [
        replace(c, K=c.K * 12 - [[0, 0, 0.0], [0, 0, 0], [0, 0, 11]], width=12 * c.width, height=12 * c.height)
        for c in (LEFT, RIGHT)
    ]
    ground = ground_of(sharp, FLOOR, WORKSPACE)
    assert max(ground.width, ground.height) == pytest.approx(LARGEST_SHEET_PX, abs=1)


def test_cameras_that_share_no_ground_are_named() -> None:
    away = seeing("away", 5.0, 0.0, 1.0, at=(9.0, 0.0, 0.0))
    with pytest.raises(RigError, match="cameras left, away: expected a plane that two of them see, found none"):
        ground_of([LEFT, away], FLOOR, WORKSPACE)
    with pytest.raises(RigError, match="found none"):
        ground_of([LEFT, RIGHT], FLOOR, WORKSPACE + np.array([5.0, 0.0, 0.0]))


def test_a_camera_sees_sheet_pixels_where_it_sees_their_points() -> None:
    ground = ground_of([LEFT, RIGHT], FLOOR, WORKSPACE)
    sheet = np.random.default_rng(1).uniform(0, [ground.width, ground.height], (40, 2))
    expected = raw_pixels(RIGHT, transform(inverse_pose(RIGHT.T_base_cam), ground.points(sheet)))
    np.testing.assert_allclose(ground.pixels(RIGHT, sheet), expected, atol=1e-9)
    upwards = replace(RIGHT, T_base_cam=looking_at(np.array([0.0, 0.0, 0.5]), np.array([0.1, 0.0, 2.0])))
    assert (ground.pixels(upwards, sheet) < -1e5).all()


def pattern(points: Float64) -> Float64:
    """[N] brightness of points on the floor: blobs 2 to 3 cm wide."""
    x, y = points[:, 0], points[:, 1]
    return np.asarray(110 + 60 * np.sin(130 * x + 3 * np.sin(21 * y)) * np.sin(110 * y + 3))


def taken(camera: RigCamera) -> UInt8:
    """What a camera sees of the floor's pattern."""
    v, u = np.mgrid[: camera.height, : camera.width].astype(np.float64)
    hits = plane_hits(camera, FLOOR, np.stack([u.ravel(), v.ravel()], axis=1))
    grey = np.nan_to_num(pattern(hits), nan=110).reshape(camera.height, camera.width)
    return np.repeat(np.clip(grey, 0, 255).astype(np.uint8)[..., None], 3, axis=2)


def still_of(camera: RigCamera) -> Still:
    return Still(camera, taken(camera), np.ones((camera.height, camera.width), np.bool_))


def test_two_cameras_lay_the_same_pattern_flat() -> None:
    cameras = [seeing("left", -0.15, -0.1, 0.7), seeing("right", 0.2, -0.1, 0.7)]
    ground = ground_of(cameras, FLOOR, WORKSPACE)
    a, b = (lay_flat(still_of(camera), ground) for camera in cameras)
    both = cv2.erode((a.known & b.known).astype(np.uint8), np.ones((9, 9))) > 0
    assert both.mean() > 0.2
    assert np.corrcoef(a.contrast[both], b.contrast[both])[0, 1] > 0.9
    assert np.corrcoef(a.contrast[:, :-3][both[:, :-3]], b.contrast[:, 3:][both[:, :-3]])[0, 1] < 0.8
    sheet = np.stack(np.meshgrid(np.arange(ground.width), np.arange(ground.height)), axis=-1).reshape(-1, 2)
    bright = pattern(ground.points(sheet.astype(np.float64))).reshape(a.contrast.shape)
    assert np.corrcoef(a.contrast[both], bright[both])[0, 1] > 0.7
    for s in (a, b):
        assert (s.contrast[~s.known] == 0).all()
        assert np.abs(s.contrast).max() <= CONTRAST


def test_nothing_is_known_of_what_does_not_stand_still_nor_of_the_rim_nor_beyond() -> None:
    camera = seeing("left", 0.0, -0.1, 0.5)
    ground = ground_of([camera, RIGHT], FLOOR, WORKSPACE)
    wide = replace(ground, origin=ground.origin - 0.3 * ground.axes.sum(0), width=ground.width * 3, height=200)
    still = still_of(camera)
    sheet = np.stack(np.meshgrid(np.arange(wide.width), np.arange(wide.height)), axis=-1).reshape(-1, 2)
    raw = wide.pixels(camera, sheet.astype(np.float64)).reshape(wide.height, wide.width, 2)
    limit = np.array([camera.width, camera.height]) - 1 - RIM_PX
    inside = ((raw >= RIM_PX) & (raw <= limit)).all(-1)
    np.testing.assert_array_equal(lay_flat(still, wide).known, inside)
    assert 0 < inside.mean() < 1
    moving = still.still.copy()
    moving[:, :80] = False
    known = lay_flat(replace(still, still=moving), wide).known
    assert not known[raw[..., 0] < 79].any()
    np.testing.assert_array_equal(known[raw[..., 0] > 81], inside[raw[..., 0] > 81])


def test_a_grey_ground_has_no_contrast_however_bright() -> None:
    ground = Ground(FLOOR, np.array([-0.1, -0.1, -0.1]), np.eye(3)[:2], 0.003, 60, 60)
    camera = seeing("above", 0.0, -0.01, 0.7)
    for level in (0, 3, 200):
        grey = np.full((120, 160, 3), level, np.uint8)
        sheet = lay_flat(Still(camera, grey, np.ones((120, 160), np.bool_)), ground)
        assert sheet.known.any()
        assert np.abs(sheet.contrast).max() < 1e-3


def test_highlights_count_no_more_than_the_pattern() -> None:
    camera = seeing("left", -0.15, -0.1, 0.7)
    still = still_of(camera)
    glaring = replace(still, rgb=np.where(still.rgb > 130, 255, 2).astype(np.uint8))
    assert np.abs(lay_flat(glaring, ground_of([camera, RIGHT], FLOOR, WORKSPACE)).contrast).max() == CONTRAST
