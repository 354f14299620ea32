"""Depth of a first set of colour images: every pixel tries depths along its ray, and what all views see decides."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from twin_node.model.matching import Match, Sight, match
from twin_node.model.plane import Plane
from twin_node.model.rays import pixel_rays
from twin_node.model.semi_global import smoothed
from twin_node.scene import Bool, Camera, Float32, Float64, View

NEAREST, FARTHEST = 0.2, 1.25
"""Shares of the depth of plane or shell between which depths are tried, evenly in their inverse, as disparities are."""
PLANE_BONUS = 0.5
"""How much likelier, in log, a pixel shows the plane than any other one depth."""
NEARNESS_COST = 0.6
"""What it costs to stand e times as near as plane or shell."""
SEEN_THROUGH_COST = 1.0
"""What it costs a point that another view's surface lies behind it: no more than a mismatch, that may be wrong too."""
SAME_SURFACE = 0.03
"""Share of its depth by which a point may lie off another view's surface and still be on it."""
ROUNDS = 3
"""Times that depths are chosen; from the second on each view heeds what the others have chosen."""
PARTNERS = 4
"""Other views, the nearest in direction, that a view is compared with."""
LEAST_REACH = 2.0
"""How many times as far as a camera is from the shell's centre the shell is to it at least: one that comes later may
stand beyond the shell of those that were first, or just before it."""
LEAST_RADIUS = 0.5
"""Of the shell about cameras that do not tell what they look at, in units of its factor, m."""
SEEN_WITHIN = 0.7
"""Cosine of the angle from a camera's axis within which it looks at a point."""
MOST_PIXELS = 40_000
"""Of an image as it is matched, larger ones are made smaller first: a pixel takes 8 bytes per depth and partner."""
SMOOTHING_PX = 0.7
"""1 sigma that images are smoothed by before they are compared."""


@dataclass(frozen=True)
class Surface:
    """What one view's pixels show."""

    depth: Float64
    """[H, W] m along the optical axis, everywhere finite and positive."""
    on_plane: Bool
    """[H, W] whether the pixel shows the dominant plane."""


@dataclass(frozen=True)
class Shell:
    """The sphere that stands for everything too far to measure."""

    centre: Float64
    """[3] m: what the rig looks at."""
    radius: float
    """m."""

    def depth(self, camera: Camera) -> Float64:
        """[H, W] m along the optical axis at which each pixel's ray leaves the shell, everywhere above 0.

        To a camera whose distance from the centre it is not `LEAST_REACH` times, it is as large as that.
        """
        rays = pixel_rays(camera)
        start = camera.T_base_cam[:3, 3] - self.centre
        square = max(self.radius**2, LEAST_REACH**2 * float(start @ start))
        a = (rays**2).sum(-1)
        b = rays @ start
        depth: Float64 = (np.sqrt(np.maximum(b**2 - a * (start @ start - square), 0)) - b) / a
        return depth


def shell_around(cameras: Sequence[Camera], factor: float) -> Shell:
    """The shell about the point nearest to all optical axes, `factor` times as far as the farthest camera.

    Cameras that all look at a point need not be told in metres: their shell is as large as they stand apart. Others, as
    those that look outwards from one place, tell nothing of how far they see: theirs is `LEAST_RADIUS` at least.
    """
    centres = np.stack([camera.T_base_cam[:3, 3] for camera in cameras])
    axes = np.stack([camera.T_base_cam[:3, 2] for camera in cameras])
    target = _looked_at(centres, axes, 1.0)
    radius = float(np.linalg.norm(centres - target, axis=1).max())
    if radius < LEAST_RADIUS:
        nearer = _looked_at(centres, axes, radius)
        ahead = np.einsum("ni,ni->n", nearer - centres, axes)
        distances = np.linalg.norm(nearer - centres, axis=1)
        is_seen = bool((ahead > SEEN_WITHIN * distances).all())
        target, radius = (nearer, float(distances.max())) if is_seen else (target, LEAST_RADIUS)
    return Shell(target, factor * radius)


def _looked_at(centres: Float64, axes: Float64, usual: float) -> Float64:
    """[3] nearest to rays from `centres` [n, 3] along `axes` [n, 3]; `usual` m ahead where all are parallel."""
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    A = across.sum(0) + 1e-3 * np.eye(3)
    ahead = (centres + usual * axes).mean(0)
    point: Float64 = np.linalg.solve(A, np.einsum("nij,nj->i", across, centres) + 1e-3 * ahead)
    return point


def sweep(views: Sequence[View], plane: Plane, shell: Shell, levels: int) -> list[Surface]:
    """Depth of each of two views or more, from `levels` depths per pixel.

    Each depth costs what the colours there in the other views say against it (`matching`); neighbours are made to agree
    (`semi_global`). Then all views choose again: what lies behind another view's surface is hidden there and that view
    has no say, what lies before it is seen through (visibility as in Kang, Szeliski and Chai 2001).
    """
    sights = [_sight(view, plane, shell) for view in views]
    shares = _shares(levels)
    prior = (NEARNESS_COST * np.maximum(-np.log(shares), 0) - PLANE_BONUS * (shares == 1.0)).astype(np.float32)
    matches = [_matches(sights, index, shares) for index in range(len(sights))]
    chosen: list[Float64] = []
    for _ in range(ROUNDS):
        chosen = [
            _chosen(sight, _costs(found, shares, chosen) + prior, shares)
            for sight, found in zip(sights, matches, strict=True)
        ]
    return [_surface(view, share, plane, shell) for view, share in zip(views, _shares_of(sights, chosen), strict=True)]


def _shares(levels: int) -> Float64:
    """[K] shares of the base depth, the base itself among them."""
    shares = 1 / np.linspace(1 / NEAREST, 1 / FARTHEST, levels)
    shares[np.abs(shares - 1).argmin()] = 1.0
    return shares


def _sight(view: View, plane: Plane, shell: Shell) -> Sight:
    """The view, no larger than is matched."""
    camera, rgb = view.camera, view.rgb
    valid = np.ones(rgb.shape[:2], bool) if view.valid is None else view.valid
    factor = min(1.0, float(np.sqrt(MOST_PIXELS / (camera.width * camera.height))))
    if factor < 1:
        width, height = max(round(camera.width * factor), 1), max(round(camera.height * factor), 1)
        K = np.diag([width / camera.width, height / camera.height, 1.0]) @ camera.K
        camera = replace(camera, width=width, height=height, K=K)
        rgb = cv2.resize(rgb, (width, height), interpolation=cv2.INTER_AREA).astype(np.uint8)
        valid = cv2.resize(valid.astype(np.uint8), (width, height), interpolation=cv2.INTER_NEAREST) > 0
    unit = cv2.GaussianBlur(rgb.astype(np.float32) / np.float32(255), (3, 3), SMOOTHING_PX)
    return Sight(camera, unit.astype(np.float32), valid, pixel_rays(camera), _base(camera, plane, shell))


def _base(camera: Camera, plane: Plane, shell: Shell) -> Float64:
    """[H, W] m: depth of the plane, and of the shell where the plane is not met before it."""
    far = shell.depth(camera)
    return np.where(_meets(plane, camera, far), plane.depth(camera), far)


def _meets(plane: Plane, camera: Camera, far: Float64) -> Bool:
    """[H, W] whether rays meet the plane before they are `far` [H, W] m deep."""
    hit = plane.depth(camera)
    return (hit > 0.05) & (hit < far)


def _matches(sights: Sequence[Sight], index: int, shares: Float64) -> list[Match]:
    """The view number `index` beside those that look most nearly the same way."""
    one = sights[index]
    others = [number for number in range(len(sights)) if number != index]
    others.sort(key=lambda number: -float(one.camera.T_base_cam[:3, 2] @ sights[number].camera.T_base_cam[:3, 2]))
    return [match(one, sights[number], number, shares) for number in others[:PARTNERS]]


def _costs(matches: Sequence[Match], shares: Float64, chosen: Sequence[Float64]) -> Float32:
    """[H, W, K] what the other views say against each depth; the better half of them, as long as none has `chosen`."""
    if not chosen:
        return _least([found.costs for found in matches], (len(matches) + 1) // 2)
    total = np.zeros_like(matches[0].costs)
    for found in matches:
        depths = found.near[..., None] + found.slope[..., None] * shares.astype(np.float32)
        theirs = chosen[found.other].astype(np.float32).ravel()[found.pixels]
        seen = found.pixels >= 0
        total += np.where(seen & (depths > theirs * (1 + SAME_SURFACE)), 0, found.costs)
        total += np.float32(SEEN_THROUGH_COST) * (seen & (depths < theirs * (1 - SAME_SURFACE)))
    return total


def _least(terms: Sequence[Float32], count: int) -> Float32:
    """[...] sum of the `count` least of `terms` [...]; sorting so few at every place takes ten times as long."""
    rest, total = list(terms), np.zeros_like(terms[0])
    for _ in range(count):
        least = rest[0]
        for index in range(1, len(rest)):
            rest[index], least = np.maximum(rest[index], least), np.minimum(rest[index], least)
        total += least
        rest = rest[1:]
    return total


def _chosen(sight: Sight, costs: Float32, shares: Float64) -> Float64:
    """[H, W] m: the cheapest depth of every pixel."""
    depth: Float64 = sight.base * shares[smoothed(costs, sight.rgb).argmin(-1)]
    return depth


def _shares_of(sights: Sequence[Sight], depths: Sequence[Float64]) -> list[Float64]:
    """[H, W] per view: depths in units of plane and shell."""
    return [depth / sight.base for sight, depth in zip(sights, depths, strict=True)]


def _surface(view: View, share: Float64, plane: Plane, shell: Shell) -> Surface:
    """The view's own pixels at `share` [h, w] of plane and shell."""
    camera = view.camera
    own = cv2.resize(share, (camera.width, camera.height), interpolation=cv2.INTER_NEAREST)
    far = shell.depth(camera)
    on_plane = _meets(plane, camera, far) & (own == 1.0)
    return Surface(np.minimum(own * _base(camera, plane, shell), far), on_plane)
