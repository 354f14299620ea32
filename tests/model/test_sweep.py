"""Depth of a first set from colour alone: what rays meet in other views, smoothing among neighbours, visibility."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from model_scenes import camera, frames

from twin_node.cell.raycast import RayCaster
from twin_node.cell.shapes import Form, Placed, Shape
from twin_node.cell.solids import Solid
from twin_node.cell.textures import Texture
from twin_node.geometry import pose, project
from twin_node.model import sweep as sweeping
from twin_node.model.kernels import kernels
from twin_node.model.matching import COLOUR_SIGMA, Sight, compared, compared_reference, match
from twin_node.model.plane import Plane
from twin_node.model.rays import pixel_rays
from twin_node.model.sweep import Surface, shell_around, sweep
from twin_node.scene import Bool, Camera, Float32, Float64, View

FLOOR = Plane(np.array([0.0, 0.0, 1.0]), 0.0)
WIDTH, HEIGHT = 96, 72
CAMERAS = tuple(
    camera(f"c{index}", (1.2 * np.cos(angle), 1.2 * np.sin(angle), 0.9), width=WIDTH, height=HEIGHT)
    for index, angle in enumerate(np.radians([-35, 0, 35]))
)
BOX = Solid(
    Placed(Shape(Form.BOX, (0.24, 0.24, 0.2)), pose(np.eye(3), np.array([0.0, 0.0, 0.1]))),
    Texture("patches", (200, 60, 50), (230, 210, 80), 0.05),
    1,
)
GROUND = Solid(
    Placed(Shape(Form.BOX, (4.0, 4.0, 0.04)), pose(np.eye(3), np.array([0.0, 0.0, -0.02]))),
    Texture("patches", (90, 110, 140), (150, 150, 120), 0.08),
    0,
)


def _seen(of: tuple[Camera, ...] = CAMERAS) -> tuple[list[View], list[Float32]]:
    """Views of the box on the ground, and their true depths."""
    rendered = [RayCaster(one, (GROUND,)).render((BOX,)) for one in of]
    views = [View(one, 0, image.rgb) for one, image in zip(of, rendered, strict=True)]
    return views, [np.asarray(image.depth, np.float32) for image in rendered]


def _swept(views: list[View]) -> list[Surface]:
    return sweep(views, FLOOR, shell_around([view.camera for view in views], 2.5), 96)


def _on_box(view: View, truth: Float32) -> Bool:
    """[H, W] pixels that show the box, where it is a centimetre above the ground or more."""
    return (truth > 0) & (truth < 0.99 * FLOOR.depth(view.camera))


def _errors(depth: Float64, truth: Float32, chosen: Bool) -> Float64:
    """[n] |log| of depth over true depth."""
    errors: Float64 = np.abs(np.log(depth[chosen] / truth[chosen]))
    return errors


def _assert_found(views: list[View], truth: list[Float32], share: float) -> None:
    """The box is found to `share` of what the plane alone would be wrong by, and the ground is left where it is."""
    for view, surface, depth in zip(views, _swept(views), truth, strict=True):
        box = _on_box(view, depth)
        ground = (depth > 0) & ~box
        assert box.sum() > 200
        assert surface.depth.shape == surface.on_plane.shape == view.rgb.shape[:2]
        found, plane = (np.median(_errors(one, depth, box)) for one in (surface.depth, FLOOR.depth(view.camera)))
        assert found < share * plane
        assert np.mean(_errors(surface.depth, depth, ground) < 0.03) > 0.85


def test_a_box_stands_before_the_ground_and_the_ground_is_the_plane() -> None:
    views, truth = _seen()
    _assert_found(views, truth, 0.4)
    flat = np.abs(truth[0] - FLOOR.depth(CAMERAS[0])) < 1e-3
    assert np.mean(_swept(views)[0].on_plane[flat]) > 0.8


def test_two_views_do() -> None:
    views, truth = _seen(CAMERAS[:2])
    _assert_found(views, truth, 0.7)


def test_large_images_are_matched_smaller_and_come_back_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sweeping, "MOST_PIXELS", WIDTH * HEIGHT // 2)
    views, truth = _seen()
    _assert_found(views, truth, 0.6)


def test_invalid_pixels_have_no_say() -> None:
    views, _ = _seen()
    blind = [views[0], *(replace(view, valid=np.zeros((HEIGHT, WIDTH), bool)) for view in views[1:])]
    surface = _swept(blind)[0]
    shell = shell_around(list(CAMERAS), 2.5)
    hit = FLOOR.depth(CAMERAS[0])
    assert np.allclose(
        surface.depth, np.where((hit > 0.05) & (hit < shell.depth(CAMERAS[0])), hit, shell.depth(CAMERAS[0]))
    )


@pytest.mark.parametrize("target", [(12.0, 0.0, 0.0), (6.0, 5.0, 0.0), (0.0, 0.0, 0.0)])
@pytest.mark.parametrize("far_m", [1.0, 2.4, 2.6, 6.0, 100.0])
def test_the_shell_is_before_every_camera_wherever_it_stands(target: tuple[float, float, float], far_m: float) -> None:
    """Of one that came later, outside, and looked away it lay behind."""
    shell = shell_around([camera("first", (-1.0, 0.0, 0.0))], 2.5)
    depth = shell.depth(camera("later", (far_m, 0.0, 0.5), tuple(far_m / 6 * np.array(target))))
    assert depth.min() > 0.4 * np.linalg.norm(shell.centre - [far_m, 0.0, 0.5])


def _in_units(one: Camera, metres: float) -> Camera:
    """The camera where a unit is so many metres."""
    T = one.T_base_cam.copy()
    T[:3, 3] /= metres
    return replace(one, T_base_cam=T)


@pytest.mark.parametrize("metres", [5.0, 10.0, 20.0])
def test_a_scene_in_other_units_than_metres_is_swept_as_it_is(metres: float) -> None:
    """The units of a data set are its own: of a rig within 0.3 of them no depth was tried that was not beyond it."""
    views, truth = _seen()
    smaller = [replace(view, camera=_in_units(view.camera, metres)) for view in views]
    shells = [shell_around([view.camera for view in of], 2.5) for of in (smaller, views)]
    assert metres * shells[0].radius == pytest.approx(shells[1].radius, rel=0.02)
    _assert_found(smaller, [depth / np.float32(metres) for depth in truth], 0.4)


def test_cameras_that_look_outwards_from_one_place_have_a_shell_half_a_metre_away_at_least() -> None:
    outwards = [(1.0, 0.0, 0.0), (-1.0, 1.0, 0.0), (-1.0, -1.0, 0.0)]
    cameras = [camera(f"c{i}", tuple(0.02 * np.array(axis)), tuple(axis)) for i, axis in enumerate(outwards)]
    assert shell_around(cameras, 1.0).radius == pytest.approx(0.5)
    assert (
        shell_around(
            [replace(one, T_base_cam=pose(one.T_base_cam[:3, :3], np.zeros(3))) for one in cameras], 2.0
        ).radius
        == 1.0
    )


def test_what_is_alike_everywhere_tells_nothing() -> None:
    views = [replace(view, rgb=np.full_like(view.rgb, 120)) for view in frames(0, None, CAMERAS).views]
    for view, surface in zip(views, _swept(views), strict=True):
        hit = FLOOR.depth(view.camera)
        floor = np.isfinite(hit) & (hit > 0.05) & (hit < surface.depth + 1e-6)
        assert np.mean(surface.on_plane[floor]) > 0.9


def _sight(one: Camera, rgb: Float32, base: Float64) -> Sight:
    return Sight(one, rgb, np.ones(base.shape, bool), pixel_rays(one), base)


def test_a_match_says_where_its_points_are() -> None:
    rng = np.random.default_rng(0)
    one, other = CAMERAS[:2]
    base = np.full((HEIGHT, WIDTH), 1.1)
    shares = np.array([0.6, 1.0])
    sights = [_sight(c, rng.random((HEIGHT, WIDTH, 3), np.float32), base) for c in (one, other)]
    found = match(*sights, 1, shares)
    row, column = 40, 50
    for k, share in enumerate(shares):
        point = one.T_base_cam[:3, 3] + pixel_rays(one)[row, column] * 1.1 * share
        u, v, z = project(other.K, other.viewmat, point[None])[0]
        assert np.isclose(found.near[row, column] + share * found.slope[row, column], z, rtol=1e-5)
        inside = 0 <= u < WIDTH and 0 <= v < HEIGHT
        assert found.pixels[row, column, k] == (int(v) * WIDTH + int(u) if inside else -1)
        assert inside or found.costs[row, column, k] == 0


def test_the_colour_that_agrees_is_the_cheapest() -> None:
    one, other = CAMERAS[:2]
    base = np.full((HEIGHT, WIDTH), 1.1)
    shares = np.linspace(0.5, 1.2, 24)
    gradient = np.repeat(np.linspace(0, 1, WIDTH, dtype=np.float32)[None, :, None], HEIGHT, 0).repeat(3, 2)
    found = match(_sight(one, gradient, base), _sight(other, gradient, base), 1, shares)
    row, column = 36, 48
    seen = found.pixels[row, column] >= 0
    apart = np.abs(gradient[:, :, 0].ravel()[found.pixels[row, column]] - gradient[row, column, 0])
    assert seen.sum() > 8
    assert found.costs[row, column][seen].argmin() == apart[seen].argmin()
    assert found.costs[row, column][seen & (apart > 4 * COLOUR_SIGMA)].min() > 0 > found.costs[row, column][seen].min()


@pytest.mark.skipif(kernels() is None, reason="no compiled kernels here")
def test_compiled_comparisons_are_those_in_numpy() -> None:
    """Also of points behind the other view and beside it, and of pixels of it that show nothing."""
    one, other = CAMERAS[0], CAMERAS[2]
    rng = np.random.default_rng(4)
    first, second = (rng.random((HEIGHT, WIDTH, 3), np.float32) for _ in range(2))
    base = rng.uniform(0.5, 3.0, (HEIGHT, WIDTH))
    theirs = replace(_sight(other, second, base), valid=rng.random((HEIGHT, WIDTH)) > 0.2)
    ours = _sight(one, first, base)
    given = (ours, theirs, ours.rays * base[..., None], np.linspace(-1.0, 2.0, 13))
    (apart, at), (apart_plain, at_plain) = compared(*given), compared_reference(*given)
    np.testing.assert_array_equal(at, at_plain)
    assert 0.1 < (at < 0).mean() < 0.9
    np.testing.assert_allclose(apart[at >= 0], apart_plain[at >= 0], atol=1e-6)
