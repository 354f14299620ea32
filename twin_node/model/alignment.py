"""Node motion from images: the flow from the rendering to the image, explained by one twist per node (Gauss-Newton).

A rendering of the predicted state is compared with the image itself, so errors do not add up as they do when flow is
chained from image to image.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from twin_node.model.evidence import Fits
from twin_node.model.observation import Observed
from twin_node.model.rays import look
from twin_node.model.rendering import Rendering, Splats
from twin_node.scene import Bool, Camera, Float32, Float64

ACCELERATION, TURN_ACCELERATION = 10.0, 20.0
"""m/s2 and rad/s2 (1 sigma) that a prediction may be wrong by: what a quick human arm does."""
COLOUR_SIGMA = 0.1
"""Difference of colour (0 to 1) between both ends of a flow vector at which it loses most of its say."""
MARGIN_PX, SMALLEST_PX = 12, 32
"""Pixels around what moves that the flow is sought in, and the smallest side that its engine takes."""
MOST_OBSERVATIONS = 1000
"""Gaussians per view whose flow is taken; with more, every n-th stands for its neighbours."""
STRAIN = 0.05
"""1 sigma of the strain that a set may bring."""
SHOWN = 0.06
"""Share of its depth by which a Gaussian may differ from the depth rendered at its pixel and still show there."""
DEPTH_SHARE = 0.005
"""Share of the depth that counts as much as a pixel: the noise of a depth camera at 1 m is half a per cent."""
HUBER_PX = 2.0
"""Flow errors beyond this count linearly."""
SHARED_BY = 4.0
"""Gaussians that show in one pixel on average: their flow is one observation, not as many."""
MATRIX_FLOOR = 1e-9


@dataclass(frozen=True)
class Twists:
    """Correction of every node."""

    linear: Tensor
    """[M, 3] m."""
    angular: Tensor
    """[M, 3] rad."""
    sigmas: Tensor
    """[M] 1 sigma of the position after the correction, m."""
    fits: Fits
    """How well rigid motion explains the flow, and how well a strain on top of it."""


@dataclass(frozen=True)
class _Linear:
    """Observations of the n Gaussians that show in one view."""

    nodes: NDArray[np.int64]
    """[n] rows of the nodes that carry them."""
    jacobian: Float64
    """[n, 3, 12] pixels per m, rad and strain; the last row is depth, of which `DEPTH_SHARE` counts as a pixel."""
    error: Float64
    """[n, 3] pixels; 0 in the last where no depth is measured."""
    weight: Float64
    """[n] 0 to 1."""
    opacities: Float64
    """[n] 0 to 1."""


class FlowSolver:
    """Optical flow of one rig; holds the engine, no state between calls."""

    def __init__(self) -> None:
        self._engine = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
        self._engine.setFinestScale(0)
        self._engine.setPatchStride(4)
        self._engine.setGradientDescentIterations(12)
        self._engine.setVariationalRefinementIterations(1)

    def flow(self, rendering: Rendering, observed: Observed) -> Float32:
        """[H, W, 2] pixels from where the rendering shows a thing to where the image does; 0 far from what moves."""
        out = np.zeros((*observed.near_moving.shape, 2), np.float32)
        window = _window(observed.near_moving)
        if window is None:
            return out
        shown = (rendering.rgb.detach().cpu().numpy()[window].clip(0, 1) * 255).astype(np.uint8)
        a = cv2.cvtColor(shown, cv2.COLOR_RGB2GRAY)
        b = cv2.cvtColor(observed.view.rgb[window], cv2.COLOR_RGB2GRAY)
        out[window] = self._engine.calc(a, b, np.zeros((*a.shape, 2), np.float32))
        return out


def solve_twists(
    observed: Sequence[Observed],
    renderings: Sequence[Rendering],
    flows: Sequence[Float32],
    moving: Splats,
    nodes: Tensor,
    origins: Tensor,
    dt_s: float,
    sigma_px: float,
) -> Twists:
    """The twist of each node that explains the flow under its Gaussians best, held to the prediction.

    `moving` holds m Gaussians at each view's time, `nodes` [m] the rows that carry them, `origins` [C, M, 3] the nodes'
    positions, `dt_s` the time since the set before, `sigma_px` the flow's own error.
    """
    normal = _Normal(origins.shape[1])
    carried = torch.nonzero(nodes >= 0)[:, 0]
    stride = max(len(carried) // MOST_OBSERVATIONS, 1)
    carried = carried[::stride]
    carriers = nodes[carried].numpy()
    means = moving.means.detach().cpu()[:, carried].double().numpy()
    opacities = moving.opacities.detach().cpu()[carried].double().numpy()
    for index, one in enumerate(observed):
        group = _Group(carriers, means[index], means[index] - origins[index].double().numpy()[carriers], opacities)
        normal.add(_linearise(one, renderings[index], flows[index], group), stride / (SHARED_BY * sigma_px**2))
    step = max(dt_s, 1e-3) ** 2 / 2
    motion = np.array([ACCELERATION * step + 2e-3] * 3 + [TURN_ACCELERATION * step + 1e-2] * 3)
    rigid = normal.solve(6, motion)
    strained = normal.solve(12, np.concatenate([motion, np.full(6, STRAIN)]))
    sigmas = rigid.covariance.diagonal(dim1=1, dim2=2)[:, :3].mean(-1).clamp_min(MATRIX_FLOOR).sqrt()
    fits = Fits(rigid.cost, strained.cost, torch.from_numpy(normal.count))
    return Twists(rigid.solution[:, :3], rigid.solution[:, 3:], sigmas, fits)


def _window(mask: Bool) -> tuple[slice, slice] | None:
    """Rows and columns that hold all True pixels and a margin; None without one."""
    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    if not len(rows):
        return None
    return _span(rows, mask.shape[0]), _span(columns, mask.shape[1])


def _span(used: NDArray[np.int64], size: int) -> slice:
    start, stop = int(used[0]) - MARGIN_PX, int(used[-1]) + 1 + MARGIN_PX
    missing = max(SMALLEST_PX - (stop - start), 0)
    return slice(max(start - missing, 0), min(stop + missing, size))


@dataclass(frozen=True)
class _Solved:
    solution: Tensor
    """[M, k]."""
    covariance: Tensor
    """[M, k, k]."""
    cost: Tensor
    """[M] squared errors left, in units of their variance, those of the prior included."""


class _Normal:
    """Normal equations of every node: 3 parameters of translation, 3 of rotation, 6 of strain."""

    def __init__(self, count: int) -> None:
        self.H = np.zeros((count, 12, 12))
        self.g = np.zeros((count, 12))
        self.squares = np.zeros(count)
        self.count = np.zeros(count)

    def add(self, linear: _Linear, scale: float) -> None:
        """Takes in the observations of one view, each of weight `scale` times opacity and its own."""
        if not len(linear.nodes):
            return
        weight = linear.weight * linear.opacities * scale
        root = np.sqrt(weight)
        order = np.argsort(linear.nodes, kind="stable")
        J = (linear.jacobian * root[:, None, None])[order]
        error = (linear.error * root[:, None])[order]
        present, starts = np.unique(linear.nodes[order], return_index=True)
        for node, start, end in zip(present, starts, [*starts[1:], len(order)], strict=True):
            rows = J[start:end].reshape(-1, 12)
            self.H[node] += rows.T @ rows
            self.g[node] += rows.T @ error[start:end].ravel()
        size = len(self.count)
        squares = weight * np.square(linear.error).sum(-1)
        self.squares += np.bincount(linear.nodes, weights=squares, minlength=size)
        self.count += np.bincount(linear.nodes, weights=2 * linear.weight / SHARED_BY, minlength=size)

    def solve(self, size: int, sigmas: NDArray[np.float64]) -> _Solved:
        """The most likely motion in the first `size` parameters, whose own 1 sigma are `sigmas` [size]."""
        covariance = np.linalg.inv(self.H[:, :size, :size] + np.diag(1 / sigmas**2))
        g = self.g[:, :size]
        solution = (covariance @ g[..., None])[..., 0]
        cost = self.squares - (g * solution).sum(-1)
        return _Solved(torch.from_numpy(solution), torch.from_numpy(covariance), torch.from_numpy(cost))


@dataclass(frozen=True)
class _Group:
    """Carried Gaussians at one view's time."""

    nodes: NDArray[np.int64]
    """[n] rows of the nodes that carry them."""
    means: Float64
    """[n, 3] m."""
    arms: Float64
    """[n, 3] m from their nodes."""
    opacities: Float64
    """[n] 0 to 1."""


def _linearise(one: Observed, rendering: Rendering, flow: Float32, group: _Group) -> _Linear:
    """How the pixels and depths of those of `group` that show move with their nodes."""
    camera = one.view.camera
    seen = look(camera, group.means)
    shown = rendering.depth.detach().cpu().numpy()
    visible = seen.inside & (one.near_moving & one.usable)[seen.rows, seen.columns]
    visible &= np.abs(seen.depth - shown[seen.rows, seen.columns]) < SHOWN * seen.depth
    at = np.flatnonzero(visible)
    row, column = seen.rows[at], seen.columns[at]
    depth_error, scale = _depth_error(one, shown, flow)
    to_pixels = _to_pixels(camera, group.means[at], scale[row, column])
    arm = group.arms[at]
    error = np.concatenate([flow, depth_error[..., None]], -1)[row, column].astype(np.float64)
    huber = HUBER_PX / np.maximum(np.linalg.norm(error, axis=-1), HUBER_PX)
    weight = _confidence(one, rendering, flow)[row, column] * huber
    turned = np.cross(arm[:, None], to_pixels)
    jacobian = np.concatenate([to_pixels, turned, _strained(to_pixels, arm)], -1)
    return _Linear(group.nodes[at], jacobian, error, weight, group.opacities[at])


def _to_pixels(camera: Camera, points: Float64, scale: NDArray[np.floating]) -> Float64:
    """[n, 3, 3] pixels (u, v, and depth times `scale` [n]) per m of points [n, 3]."""
    R = camera.viewmat[:3, :3]
    x = points @ R.T + camera.viewmat[:3, 3]
    z = x[:, 2]
    u = camera.K[0, 0] / z[:, None] * (R[0] - (x[:, 0] / z)[:, None] * R[2])
    v = camera.K[1, 1] / z[:, None] * (R[1] - (x[:, 1] / z)[:, None] * R[2])
    return np.stack([u, v, scale[:, None] * R[2]], 1)


def _strained(to_pixels: Float64, arm: Float64) -> Float64:
    """[n, 3, 6] pixels per strain xx, yy, zz, xy, xz, yz of points at `arm` [n, 3] from their node."""
    x, y, z = arm.T[..., None]
    a, b, c = np.moveaxis(to_pixels, -1, 0)
    return np.stack([a * x, b * y, c * z, a * y + b * x, a * z + c * x, b * z + c * y], -1)


def _depth_error(one: Observed, shown: Float32, flow: Float32) -> tuple[Float32, Float32]:
    """[H, W] measured depth at the flow's end less the depth `shown` [H, W] in pixels, and pixels per m (0: none)."""
    if one.view.depth is None:
        return np.zeros_like(shown), np.zeros_like(shown)
    end = _at_the_end(one.view.depth, flow, cv2.INTER_NEAREST)
    known = (end > 0) & (shown > 0)
    scale = np.where(known, 1 / (DEPTH_SHARE * np.maximum(shown, 0.05)), 0).astype(np.float32)
    return (end - shown) * scale, scale


def _confidence(one: Observed, rendering: Rendering, flow: Float32) -> Float32:
    """[H, W] 0 to 1: whether the image shows at the flow's end what the rendering shows at its start."""
    arrived = _at_the_end(one.rgb, flow, cv2.INTER_LINEAR)
    difference = arrived - rendering.rgb.detach().cpu().numpy()
    confidence: Float32 = np.exp(-np.square(difference).mean(-1) / np.float32(COLOUR_SIGMA**2))
    return confidence


def _at_the_end(image: Float32, flow: Float32, interpolation: int) -> Float32:
    """The image [H, W, ...] looked up where the flow leads from each pixel."""
    height, width = flow.shape[:2]
    x, y = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
    looked_up = cv2.remap(image, x + flow[..., 0], y + flow[..., 1], interpolation)
    return looked_up.astype(np.float32)
