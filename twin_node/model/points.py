"""Where points fall in an image, and what the flow there says about the nodes that carry them: on numpy arrays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin_node.model.kernels import kernels
from twin_node.model.node_requests import MotionRequest, PixelsRequest
from twin_node.native_library import addresses_of

Float64 = NDArray[np.float64]
Float32 = NDArray[np.float32]
Bool = NDArray[np.bool_]
Int64 = NDArray[np.int64]

MOTIONS = 12
"""Parameters of a node's motion: translation, rotation vector, strain xx, yy, zz, xy, xz, yz."""


@dataclass(frozen=True)
class Pixels:
    """Where n points fall."""

    columns: Int64
    """[n] cut to the image."""
    rows: Int64
    """[n] cut to the image."""
    depths: Float64
    """[n] along the optical axis."""
    inside: Bool
    """[n] whether the point is more than 2 cm in front of the camera and inside its image."""
    reached: Float32 | None
    """[n] pixels that a sphere about the point reaches into the image from this pixel; negative: it does not."""


def has_points() -> bool:
    """Whether the compiled library is at hand, which the functions of this module need."""
    return kernels() is not None


def find_pixels(
    points: NDArray[np.floating],
    viewmat: Float64,
    K: Float64,
    width: int,
    height: int,
    radii: NDArray[np.floating] | None = None,
) -> Pixels:
    """Pixels of points [n, 3] for a pinhole camera with `viewmat` [4, 4] (world to camera) and K [3, 3].

    `radii` [n] of spheres about them, in the units of the points: how far these reach into the image is found too.
    """
    library = kernels()
    assert library is not None
    count = len(points)
    pixels = Pixels(
        np.empty(count, np.int64),
        np.empty(count, np.int64),
        np.empty(count),
        np.empty(count, np.bool_),
        None if radii is None else np.empty(count, np.float32),
    )
    given = [np.ascontiguousarray(a, dtype=np.float64) for a in (points, viewmat, K)]
    spheres = None if radii is None else np.ascontiguousarray(radii, dtype=np.float32)
    found = (pixels.columns, pixels.rows, pixels.depths, pixels.inside)
    library.run(PixelsRequest(count, width, height, *addresses_of(*given, *found, spheres, pixels.reached)))
    return pixels


@dataclass(frozen=True)
class Carried:
    """n Gaussians that nodes carry, as one view finds them."""

    means: Float64
    """[n, 3] m."""
    arms: Float64
    """[n, 3] m from their nodes."""
    opacities: Float64
    """[n] 0 to 1."""
    carriers: Int64
    """[n] rows of the nodes."""


@dataclass(frozen=True)
class Seen:
    """One view, and the flow from what is shown to what came."""

    viewmat: Float64
    """[4, 4]."""
    K: Float64
    """[3, 3] pixels."""
    counted: Bool
    """[H, W] pixels whose flow counts."""
    shown: Float32
    """[H, W, 4] rendered colour 0 to 1 and depth, m."""
    image: Float32
    """[H, W, 3] 0 to 1."""
    flow: Float32
    """[H, W, 2] pixels."""
    depth: Float32 | None
    """[H, W] m, 0 where unknown."""


@dataclass(frozen=True)
class Weighing:
    """How observations are weighed."""

    scale: float
    """Weight of an observation."""
    shown_share: float
    """Share of its depth by which a Gaussian may differ from the depth shown and still be what shows there."""
    depth_share: float
    """Share of the depth that counts as much as a pixel."""
    huber_px: float
    """Errors beyond count linearly."""
    colour_sigma: float
    """Difference of colour between both ends of a flow vector at which it loses most of its say."""


@dataclass(frozen=True)
class Equations:
    """Normal equations of M nodes."""

    H: Float64
    """[M, 12, 12]."""
    g: Float64
    """[M, 12]."""
    squares: Float64
    """[M] weighted squared errors."""
    weights: Float64
    """[M] sum of the observations' own weights."""


def gather_motion(carried: Carried, seen: Seen, weighing: Weighing, to: Equations) -> None:
    """Adds one view's observations to the normal equations of the nodes."""
    library = kernels()
    assert library is not None
    floats = [np.ascontiguousarray(a, dtype=np.float64) for a in (carried.means, carried.arms, carried.opacities)]
    carriers = np.ascontiguousarray(carried.carriers, dtype=np.int64)
    camera = [np.ascontiguousarray(a, dtype=np.float64) for a in (seen.viewmat, seen.K)]
    counted = np.ascontiguousarray(seen.counted)
    images = [np.ascontiguousarray(a, dtype=np.float32) for a in (seen.shown, seen.image, seen.flow)]
    depth = None if seen.depth is None else np.ascontiguousarray(seen.depth, dtype=np.float32)
    height, width = seen.counted.shape
    library.run(
        MotionRequest(
            len(carriers),
            width,
            height,
            *vars(weighing).values(),
            *addresses_of(*floats, carriers, *camera, counted, *images, depth, *vars(to).values()),
        )
    )
