"""Draws solids into an image, compiled or in plain NumPy: which of them every pixel shows, and what it looks like."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from twin_node.cell import textures
from twin_node.cell.in_view import InView
from twin_node.cell.kernel_requests import CastRequest, Lighting, Patterns
from twin_node.cell.kernels import Kernels, kernels
from twin_node.cell.rendering import Rendering
from twin_node.cell.shapes import Form, along, normals, ray_entries
from twin_node.cell.solids import Solid
from twin_node.cell.textures import Texture, colors
from twin_node.native_library import address_of, addresses_of
from twin_node.scene import Float32

LIGHTS = ((0.45, (0.35, -0.45, 0.82)), (0.25, (-0.55, 0.6, 0.58)))
"""Strength and direction towards each lamp in `base_link`: a key light above the front right, a fill at the back."""

AMBIENT = 0.45
"""Light from everywhere, as a share of full brightness."""

TEXTURE_DEPTH = 0.002
"""m under the surface where solid textures are read, so that faces that lie on a pattern's joint do not flicker."""


def cast(rays: Float32, seen: InView, image: Rendering) -> None:
    """Draws solids into an image that may show others already, before and behind them.

    `rays` [3, H, W] are directions in `base_link` whose component along the optical axis is 1.
    """
    compiled = kernels()
    if compiled is None:
        _cast_plain(rays, seen, image)
    else:
        _cast_compiled(compiled, rays, seen, image)


def _cast_compiled(compiled: Kernels, rays: Float32, seen: InView, image: Rendering) -> None:
    solids = seen.solids
    kinds = np.array([(_FORMS[s.placed.shape.form], _PATTERNS[s.texture.pattern], s.owner) for s in solids], np.int32)
    lengths = np.array([solid.placed.shape.lengths for solid in solids], np.float32)
    looks = np.array([_look(solid.texture) for solid in solids], np.float32)
    height, width = image.depth.shape
    request = CastRequest(
        *(width, height, len(solids), TEXTURE_DEPTH),
        *addresses_of(rays, kinds, seen.rects, lengths, seen.rotations, seen.origins, looks),
        *(_patterns(), _lighting()),
        *addresses_of(image.rgb, image.depth, image.owners),
    )
    compiled.run(request)


_FORMS = {form: index for index, form in enumerate(Form)}
_PATTERNS = {pattern: index for index, pattern in enumerate(textures.PATTERNS)}


def _look(texture: Texture) -> tuple[float, ...]:
    return (*texture.color, *texture.color2, texture.scale_m)


@cache
def _patterns() -> Patterns:
    return Patterns(
        *(textures.LATTICE, textures.GRAIN, textures.JOINT, textures.SHADES),
        *(textures.WOOD_DISTORTION, textures.WOOD_RINGS),
        *addresses_of(_WOOD_GRAIN, _SHARES, textures.random_volume()),
    )


@cache
def _lighting() -> Lighting:
    return Lighting(len(LIGHTS), AMBIENT, address_of(_LAMPS))


_WOOD_GRAIN = np.array(textures.WOOD_GRAIN, np.float32)
_SHARES = np.array([(share, 1 - share) for share in textures.SHARES], np.float32)
_LAMPS = np.array([(strength, *direction) for strength, direction in LIGHTS], np.float32)


def _cast_plain(rays: Float32, seen: InView, image: Rendering) -> None:
    """`cast` in NumPy."""
    depth = np.where(image.depth > 0, image.depth, np.float32(np.inf))
    for solid, R, origin, rect in zip(seen.solids, seen.rotations, seen.origins, seen.rects, strict=True):
        _draw(solid, R, origin, rays, depth, image, rect)
    image.depth[:] = np.where(np.isfinite(depth), depth, 0)


def _draw(
    solid: Solid,
    R: Float32,
    origin: Float32,
    rays: Float32,
    depth: Float32,
    image: Rendering,
    rect: NDArray[np.int32],
) -> None:
    left, right, top, bottom = rect
    part = (slice(top, bottom), slice(left, right))
    local = _turned(R.T, rays[:, *part].reshape(3, -1))
    entries = ray_entries(solid.placed.shape, origin, local)
    nearer = entries.reshape(bottom - top, right - left) < depth[part]
    hit = np.flatnonzero(nearer)
    t = entries[hit]
    points = origin[:, None] + t * local[:, hit]
    facing = normals(solid.placed.shape, points)
    color = colors(solid.texture, points - np.float32(TEXTURE_DEPTH) * facing) * _brightness(_turned(R, facing))
    depth[part][nearer] = t
    image.owners[part][nearer] = solid.owner
    image.rgb[part][nearer] = np.minimum(color + np.float32(0.5), 255).T


def _turned(R: Float32, vectors: Float32) -> Float32:
    """Vectors [3, n] turned by a rotation [3, 3]."""
    return np.stack([along(row, vectors) for row in R])


def _brightness(facing: Float32) -> Float32:
    """Lambert shading [n] of unit normals [3, n] in `base_link`, without shadows."""
    light = np.full(facing.shape[1], AMBIENT, np.float32)
    for strength, direction in LIGHTS:
        light += np.float32(strength) * np.maximum(along(np.array(direction, np.float32), facing), 0)
    return light
