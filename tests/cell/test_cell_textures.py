from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twin_node.cell.raycast import RayCaster
from twin_node.cell.shapes import Form, Placed, Shape
from twin_node.cell.solids import Solid
from twin_node.cell.textures import PATTERNS, Texture, colors
from twin_node.geometry import pose
from twin_node.scene import Camera

CAMERA = Camera("cam", 64, 48, np.array([[60.0, 0, 32], [0, 60, 24], [0, 0, 1]]), np.eye(4))


@pytest.mark.parametrize("pattern", PATTERNS)
@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_colors_lie_between_the_two_of_the_texture_and_vary(pattern: str, seed: int) -> None:
    texture = Texture(pattern, (200, 40, 90), (20, 140, 90), 0.05)
    points = np.random.default_rng(seed).uniform(-20, 20, (3, 300)).astype(np.float32)
    mixed = colors(texture, points)
    low, high = np.array([20, 40, 90])[:, None], np.array([200, 140, 90])[:, None]
    assert (mixed >= low - 0.01).all() and (mixed <= high + 0.01).all()
    assert mixed[0].std() > 2
    assert np.array_equal(mixed, colors(texture, points))


def seen(texture: Texture, position: tuple[float, float, float], side: float = 0.4) -> np.ndarray:
    box = Solid(Placed(Shape(Form.BOX, (side, side, side)), pose(np.eye(3), np.array(position))), texture, 0)
    rendering = RayCaster(CAMERA, ()).render((box,))
    return np.where(rendering.owners[..., None] == 0, rendering.rgb.astype(int), -1)


def test_the_texture_moves_with_the_body() -> None:
    """At depth 1.2 m the front face lies at 1 m, where 60 px per metre make 0.1 m exactly six pixels."""
    texture = Texture("patches", (250, 250, 250), (10, 10, 10), 0.04)
    here, there = seen(texture, (0.0, 0.0, 1.2)), seen(texture, (0.1, 0.0, 1.2))
    shifted = np.roll(here, 6, axis=1)
    face = shifted.min(axis=-1) >= 0
    assert face.sum() > 300
    assert np.array_equal(shifted[face], there[face])
    assert not np.array_equal(here[face], there[face])


def test_what_is_nearer_hides_what_is_behind_in_any_order() -> None:
    red, blue = (Texture("plain", color, color) for color in ((250, 0, 0), (0, 0, 250)))
    near, far = (
        Solid(Placed(Shape(Form.SPHERE, (0.2,)), pose(np.eye(3), np.array([0.0, 0, z]))), texture, owner)
        for z, texture, owner in ((1.0, red, 0), (1.4, blue, 1))
    )
    first = RayCaster(CAMERA, ()).render((near, far))
    second = RayCaster(CAMERA, (far,)).render((near,))
    assert first.owners[24, 32] == second.owners[24, 32] == 0
    assert first.depth[24, 32] == pytest.approx(0.8, abs=1e-3)
    assert np.array_equal(first.rgb, second.rgb) and np.array_equal(first.depth, second.depth)


def test_a_solid_behind_or_beside_the_camera_is_not_seen_and_one_around_it_does_no_harm() -> None:
    ball = Shape(Form.SPHERE, (0.2,))
    for position in ((0.0, 0, -1.0), (5.0, 0, 1.0), (0.0, -5.0, 1.0), (0.0, 0.0, 0.0)):
        placed = Placed(ball, pose(np.eye(3), np.array(position)))
        rendering = RayCaster(CAMERA, ()).render((Solid(placed, Texture(), 0),))
        assert (rendering.owners == -1).all() and (rendering.depth == 0).all()
