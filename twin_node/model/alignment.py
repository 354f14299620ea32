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
from twin_node.model.rendering import Rendering, Splats
from twin_node.scene import Bool, Float32

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
    jacobian: Tensor
    """[n, 3, 12] pixels per m, rad and strain; the last row is depth, of which `DEPTH_SHARE` counts as a pixel."""
    error: Tensor
    """[n, 3] pixels; 0 in the last where no depth is measured."""
    weight: Tensor
    """[n] 0 where a Gaussian does not show."""


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
    opacities = moving.opacities.detach().cpu()[carried].double() * stride
    for index, one in enumerate(observed):
        at = moving.means[index, carried].detach().cpu().double()
        linear = _linearise(one, renderings[index], flows[index], at, origins[index, nodes[carried]])
        normal.add(nodes[carried], linear, linear.weight * opacities / (SHARED_BY * sigma_px**2))
    step = max(dt_s, 1e-3) ** 2 / 2
    motion = torch.tensor([ACCELERATION * step + 2e-3] * 3 + [TURN_ACCELERATION * step + 1e-2] * 3)
    rigid = normal.solve(6, motion)
    strained = normal.solve(12, torch.cat([motion, torch.full((6,), STRAIN)]))
    sigmas = rigid.covariance.diagonal(dim1=1, dim2=2)[:, :3].mean(-1).clamp_min(MATRIX_FLOOR).sqrt()
    fits = Fits(rigid.cost, strained.cost, normal.count)
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
        self.H = torch.zeros(count, 12, 12, dtype=torch.float64)
        self.g = torch.zeros(count, 12, dtype=torch.float64)
        self.squares = torch.zeros(count, dtype=torch.float64)
        self.count = torch.zeros(count, dtype=torch.float64)

    def add(self, nodes: Tensor, linear: _Linear, weight: Tensor) -> None:
        """Takes in observations [n] of `nodes` [n]."""
        WJ = (linear.jacobian * weight[:, None, None]).transpose(1, 2)
        self.H.index_add_(0, nodes, WJ @ linear.jacobian)
        self.g.index_add_(0, nodes, (WJ @ linear.error[..., None])[..., 0])
        self.squares.index_add_(0, nodes, weight * linear.error.square().sum(-1))
        self.count.index_add_(0, nodes, 2 * linear.weight / SHARED_BY)

    def solve(self, size: int, sigmas: Tensor) -> _Solved:
        """The most likely motion in the first `size` parameters, whose own 1 sigma are `sigmas` [size]."""
        H = self.H[:, :size, :size] + torch.diag(1 / sigmas.double() ** 2)
        covariance = torch.linalg.inv(H)
        g = self.g[:, :size]
        solution = (covariance @ g[..., None])[..., 0]
        return _Solved(solution, covariance, self.squares - (g * solution).sum(-1))


def _linearise(one: Observed, rendering: Rendering, flow: Float32, at: Tensor, origins: Tensor) -> _Linear:
    """How the pixels and depths of Gaussians at `at` [n, 3], turning about `origins` [n, 3], move with their nodes."""
    camera = one.view.camera
    R = torch.from_numpy(camera.viewmat[:3, :3])
    x = at @ R.T + torch.from_numpy(camera.viewmat[:3, 3])
    z = x[:, 2].clamp_min(1e-3)
    fx, fy = float(camera.K[0, 0]), float(camera.K[1, 1])
    u, v = fx * x[:, 0] / z + float(camera.K[0, 2]), fy * x[:, 1] / z + float(camera.K[1, 2])
    column, row = u.floor().long(), v.floor().long()
    seen = (x[:, 2] > 0.02) & (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
    column, row = column.clamp(0, camera.width - 1), row.clamp(0, camera.height - 1)
    shown = rendering.depth.detach().cpu().double()
    seen &= ((z - shown[row, column]).abs() < SHOWN * z) & torch.from_numpy(one.near_moving & one.usable)[row, column]
    zero, one_ = torch.zeros_like(z), torch.ones_like(z)
    depth_error, scale = _depth_error(one, shown, flow)
    projection = torch.stack(
        [
            torch.stack([fx / z, zero, -fx * x[:, 0] / z**2], -1),
            torch.stack([zero, fy / z, -fy * x[:, 1] / z**2], -1),
            torch.stack([zero, zero, one_ * scale[row, column]], -1),
        ],
        1,
    )
    error = torch.cat([torch.from_numpy(flow).double(), depth_error[..., None]], -1)[row, column]
    weight = seen * _confidence(one, rendering, flow)[row, column]
    weight = weight * (HUBER_PX / error.norm(dim=-1).clamp_min(HUBER_PX))
    to_pixels = projection @ R
    arm = (at - origins.double())[:, None].expand(-1, 3, -1)
    strain = to_pixels @ _strains(arm[:, 0])
    return _Linear(torch.cat([to_pixels, torch.linalg.cross(arm, to_pixels), strain], -1), error, weight)


def _strains(arm: Tensor) -> Tensor:
    """[n, 3, 6] displacement of points at `arm` [n, 3] from their node under each symmetric strain of one."""
    x, y, z = arm.unbind(-1)
    o = torch.zeros_like(x)
    columns = [(x, o, o), (o, y, o), (o, o, z), (y, x, o), (z, o, x), (o, z, y)]
    return torch.stack([torch.stack(column, -1) for column in columns], -1)


def _depth_error(one: Observed, shown: Tensor, flow: Float32) -> tuple[Tensor, Tensor]:
    """[H, W] measured depth at the flow's end less the depth `shown` [H, W] in pixels, and pixels per m (0: none)."""
    if one.view.depth is None:
        return torch.zeros_like(shown), torch.zeros_like(shown)
    end = torch.from_numpy(_at_the_end(one.view.depth, flow, cv2.INTER_NEAREST)).double()
    scale = torch.where((end > 0) & (shown > 0), 1 / (DEPTH_SHARE * shown.clamp_min(0.05)), 0.0)
    return (end - shown) * scale, scale


def _confidence(one: Observed, rendering: Rendering, flow: Float32) -> Tensor:
    """[H, W] 0 to 1: whether the image shows at the flow's end what the rendering shows at its start."""
    arrived = _at_the_end(one.rgb, flow, cv2.INTER_LINEAR)
    difference = torch.from_numpy(arrived) - rendering.rgb.detach().cpu()
    return torch.exp(-(difference.square().mean(-1) / COLOUR_SIGMA**2)).double()


def _at_the_end(image: Float32, flow: Float32, interpolation: int) -> Float32:
    """The image [H, W, ...] looked up where the flow leads from each pixel."""
    height, width = flow.shape[:2]
    x, y = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
    looked_up = cv2.remap(image, x + flow[..., 0], y + flow[..., 1], interpolation)
    return looked_up.astype(np.float32)
