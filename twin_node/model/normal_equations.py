"""What the flow under the Gaussians of a node says about its motion, as normal equations."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from twin_node.geometry import cross
from twin_node.model.kernels import kernels
from twin_node.model.node_requests import SolveRequest
from twin_node.model.observation import Observed
from twin_node.model.points import MOTIONS, Carried, Equations, Seen, Weighing, gather_motion, has_points
from twin_node.model.rays import look
from twin_node.model.rendering import Rendering
from twin_node.model.velocity_equations import add_up
from twin_node.native_library import addresses_of
from twin_node.scene import Camera, Float32, Float64

COLOUR_SIGMA = 0.1
"""Difference of colour (0 to 1) between both ends of a flow vector at which it loses most of its say."""
SHOWN = 0.06
"""Share of its depth by which a Gaussian may differ from the depth rendered at its pixel and still show there."""
DEPTH_SHARE = 0.005
"""Share of the depth that counts as much as a pixel: the noise of a depth camera at 1 m is half a per cent."""
HUBER_PX = 2.0
"""Flow errors beyond this count linearly."""
SHARED_BY = 4.0
"""Gaussians that show in one pixel on average: their flow is one observation, not as many."""


@dataclass(frozen=True)
class Linear:
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


@dataclass(frozen=True)
class Solved:
    """The most likely motion of M nodes in k parameters."""

    solution: Float64
    """[M, k]."""
    variances: Float64
    """[M, k] of each parameter."""
    cost: Float64
    """[M] squared errors left, in units of their variance, those of the prior included."""


class NormalEquations:
    """Of every node: 3 parameters of translation, 3 of rotation, 6 of strain."""

    def __init__(self, count: int) -> None:
        own = (np.zeros((count, MOTIONS, MOTIONS)), np.zeros((count, MOTIONS)), np.zeros(count), np.zeros(count))
        self.sums = Equations(*own)

    @property
    def count(self) -> Float64:
        """[M] independent observations: Gaussians that show in one pixel have the same flow."""
        return 2 / SHARED_BY * self.sums.weights

    def add_view(self, carried: Carried, one: Observed, rendering: Rendering, flow: Float32, scale: float) -> None:
        """Takes in what one view says, each observation of weight `scale` times opacity and its own."""
        if not has_points():
            self.add(linearise(one, rendering, flow, carried), scale)
            return
        seen = Seen(
            one.view.camera.viewmat,
            one.view.camera.K,
            one.near_moving & one.usable,
            rendering.pixels,
            one.rgb,
            flow,
            one.view.depth,
        )
        gather_motion(carried, seen, Weighing(scale, SHOWN, DEPTH_SHARE, HUBER_PX, COLOUR_SIGMA), self.sums)

    def add(self, linear: Linear, scale: float) -> None:
        """The same from what `linearise` has found: the reference of the compiled library."""
        if not len(linear.nodes):
            return
        weight = linear.weight * linear.opacities * scale
        root = np.sqrt(weight)
        order = np.argsort(linear.nodes, kind="stable")
        J = (linear.jacobian * root[:, None, None])[order]
        error = (linear.error * root[:, None])[order]
        present, starts = np.unique(linear.nodes[order], return_index=True)
        for node, start, end in zip(present, starts, [*starts[1:], len(order)], strict=True):
            rows = J[start:end].reshape(-1, MOTIONS)
            self.sums.H[node] += rows.T @ rows
            self.sums.g[node] += rows.T @ error[start:end].ravel()
        size = len(self.sums.squares)
        squares = weight * np.square(linear.error).sum(-1)
        self.sums.squares[:] += np.bincount(linear.nodes, weights=squares, minlength=size)
        self.sums.weights[:] += np.bincount(linear.nodes, weights=linear.weight, minlength=size)

    def summed(self, owners: NDArray[np.int64], count: int) -> NormalEquations:
        """Those of `count` nodes that the bodies of these belong to: `owners` [M]."""
        total = NormalEquations(count)
        for name, values in vars(total.sums).items():
            add_up(vars(self.sums)[name], owners, values)
        return total

    def solve(self, size: int, sigmas: NDArray[np.float64]) -> Solved:
        """The most likely motion in the first `size` parameters, 6 or 12, whose own 1 sigma are `sigmas` [size]."""
        library = kernels()
        if library is None:
            return self.solve_reference(size, sigmas)
        count, own = len(self.sums.squares), self.sums
        solved = Solved(np.empty((count, size)), np.empty((count, size)), np.empty(count))
        given = (sigmas, own.H, own.g, own.squares, own.weights)
        library.run(SolveRequest(count, size, *addresses_of(*given, *vars(solved).values())))
        return solved

    def solve_reference(self, size: int, sigmas: NDArray[np.float64]) -> Solved:
        """The same in NumPy: the reference of the compiled kernel."""
        told = (self.sums.weights > 0).nonzero()[0]  # what is not seen stays as it was foretold
        known = np.linalg.inv(self.sums.H[told, :size, :size] + np.diag(1 / sigmas**2))
        g = self.sums.g[:, :size]
        solution, variances = np.zeros(g.shape), np.empty(g.shape)
        solution[told] = (known @ g[told, :, None])[..., 0]
        variances[:], variances[told] = sigmas**2, known.diagonal(axis1=1, axis2=2)
        cost = self.sums.squares - (g * solution).sum(-1)
        return Solved(solution, variances, cost)


def linearise(one: Observed, rendering: Rendering, flow: Float32, group: Carried) -> Linear:
    """How the pixels and depths of those of `group` that show move with their nodes."""
    camera = one.view.camera
    seen = look(camera, group.means)
    shown = rendering.pixels[..., 3]
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
    turned = cross(arm[:, None], to_pixels)
    jacobian = np.concatenate([to_pixels, turned, _strained(to_pixels, arm)], -1)
    return Linear(group.carriers[at], jacobian, error, weight, group.opacities[at])


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
    difference = arrived - rendering.pixels[..., :3]
    confidence: Float32 = np.exp(-np.square(difference).mean(-1) / np.float32(COLOUR_SIGMA**2))
    return confidence


def _at_the_end(image: Float32, flow: Float32, interpolation: int) -> Float32:
    """The image [H, W, ...] looked up where the flow leads from each pixel."""
    height, width = flow.shape[:2]
    x, y = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
    looked_up = cv2.remap(image, x + flow[..., 0], y + flow[..., 1], interpolation)
    return looked_up.astype(np.float32)
