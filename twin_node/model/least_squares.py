"""One step of STATIC Gaussians towards what cameras see at rest: least squares, damped by what each of them covers.

Adam's steps are as long near the goal as far from it, and shake what has long been right. Here a step is as long as the
error says: the gradient of the squared error over the curvature of a Gaussian's colour, which is the sum of its blend
weights (one sweep of SIRT, Gilbert 1972); its shape follows with the same curvature and less haste.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from twin_node import splat
from twin_node.model.gaussians import LOG_SCALE, LOGIT, MEAN, QUAT, RGB, SMALLEST, Gaussians
from twin_node.model.rendering import Splats
from twin_node.scene import Bool, Camera, Float32, Tier

COLOUR_SHARE = 0.7
"""Share of the colour's full step: neighbours that overlap correct the same pixels."""
SHAPE_SHARE = 0.55
"""The same of means, sizes, turns and opacities, whose curvature is known worse: from twice as much on they swing."""
LONGEST = 0.05
"""Longest step of a mean in its Gaussian's sizes, of a log size and of a quaternion; twice as much of a logit."""
OUTLIER = 0.1
"""Error of a channel (0 to 1) that pulls no harder when it grows: a view that shows what no Gaussian can, as a glare,
must not outweigh what all others see."""
FEWEST_PIXELS = 0.3
"""Blend weight, summed over pixels, under which a Gaussian is seen too little to be judged."""
DEPTH_GAIN = 2.0
"""What a relative error of depth counts in errors of colour."""


@dataclass(frozen=True)
class AtRest:
    """What one camera sees of what stands still."""

    camera: Camera
    rgb: Float32
    """[H, W, 3] 0 to 1."""
    depth: Float32
    """[H, W] m; 0 where nothing was measured."""
    surface: Float32
    """[H, W] m: what stands behind all Gaussians."""
    counted: Bool
    """[H, W] pixels that are held to it."""


class Step:
    """One step of STATIC Gaussians, which views lead one after another: `look` through each, then `take` it."""

    def __init__(self, gaussians: Gaussians, rows: Tensor, learners: Tensor) -> None:
        """`learners` [n] are True among STATIC `rows` [n]; the others are drawn with them."""
        self._gaussians = gaussians
        self._rows = rows
        self._learners = learners
        self._ids = gaussians.ids[rows]
        self._splats = gaussians.standing(gaussians.values[rows])
        self._pull = Splats(*(torch.zeros_like(field) for field in vars(self._splats).values()))
        self._weights = torch.zeros_like(self._splats.opacities)

    def look(self, view: AtRest) -> None:
        """Takes in what `view` misses."""
        told = _descent(self._splats, view)
        self._weights += told.weights
        for whole, part in zip(vars(self._pull).values(), vars(told.splats).values(), strict=True):
            whole.add_(part)

    def take(self) -> None:
        """Takes the step towards all views that were looked through; what stands no longer takes none."""
        gaussians, pull = self._gaussians, self._pull
        stands = gaussians.alive[self._rows] & (gaussians.tiers[self._rows] == Tier.STATIC)
        stands &= gaussians.ids[self._rows] == self._ids
        taken = torch.nonzero(stands & self._learners & (self._weights > FEWEST_PIXELS))[:, 0]
        rows, seen = self._rows[taken], self._weights[taken, None]
        scales, opacities, share = self._splats.scales[taken], self._splats.opacities[taken], SHAPE_SHARE / seen
        size = scales.mean(-1, keepdim=True)
        new = gaussians.values[rows]
        new[:, MEAN] += size * (share * pull.means[0, taken] * size).clamp(-LONGEST, LONGEST)
        new[:, QUAT] += (share * pull.quats[0, taken]).clamp(-LONGEST, LONGEST)
        new[:, LOG_SCALE] += (share * pull.scales[taken] * scales).clamp(-LONGEST, LONGEST)
        new[:, LOG_SCALE] = torch.minimum(new[:, LOG_SCALE], gaussians.largest[rows, None]).clamp_min(SMALLEST)
        new[:, LOGIT.start] += (share[:, 0] * pull.opacities[taken] * opacities).clamp(-2 * LONGEST, 2 * LONGEST)
        new[:, RGB] = (new[:, RGB] + COLOUR_SHARE * pull.rgb[taken] / seen).clamp(0, 1)
        finite = torch.isfinite(new).all(1)
        gaussians.refused += int((~finite).sum())
        rows = rows[finite]
        gaussians.take(rows, new[finite], gaussians.moment1[rows], gaussians.moment2[rows], gaussians.steps[rows])


@dataclass(frozen=True)
class _Descent:
    """Half the squared error's steepest descent, and how much each Gaussian shows."""

    splats: Splats
    weights: Tensor
    """[n] blend weights summed over the counted pixels."""


def _descent(splats: Splats, view: AtRest) -> _Descent:
    device, count, camera = splats.means.device, len(splats.scales), view.camera
    means, quats, scales, opacities = (
        field.detach().requires_grad_() for field in (splats.means[0], splats.quats[0], splats.scales, splats.opacities)
    )
    features = torch.cat([splats.rgb, splats.rgb.new_zeros(count, 1)], 1).requires_grad_()
    counted = torch.from_numpy(view.counted).to(device)
    with_depth = bool(view.depth.any())
    (seen,), (alpha,), _ = splat.rasterize(
        means,
        quats,
        scales,
        opacities,
        features,
        torch.from_numpy(camera.viewmat)[None].to(device, torch.float32),
        torch.from_numpy(camera.K)[None].to(device, torch.float32),
        camera.width,
        camera.height,
        render_mode="RGB+D" if with_depth else "RGB",
        pixel_mask=counted[None],
    )
    pull, pull_alpha = torch.zeros_like(seen), torch.zeros_like(alpha)
    pull[..., :3] = (torch.from_numpy(view.rgb).to(device) - seen.detach()[..., :3]).clamp(-OUTLIER, OUTLIER)
    pull[..., 3] = 1  # on a feature that is zero everywhere: its gradient is the sum of the blend weights
    if with_depth:
        surface, depth = torch.from_numpy(view.surface).to(device), torch.from_numpy(view.depth).to(device)
        shown = seen.detach()[..., 4] + (1 - alpha.detach()[..., 0]) * surface
        missed = torch.where(depth > 0, DEPTH_GAIN * (depth / shown.clamp_min(1e-3) - 1), 0.0)
        pull[..., 4] = missed.clamp(-OUTLIER, OUTLIER) * DEPTH_GAIN / shown.clamp_min(1e-3)
        pull_alpha[..., 0] = -pull[..., 4] * surface
    held = counted[..., None]
    # as a sum: given as two gradients they would make torch import its symbolic algebra, 0.2 s in the midst of a run
    torch.autograd.backward((seen * (pull * held)).sum() + (alpha * (pull_alpha * held)).sum())
    of = [torch.zeros_like(leaf) if leaf.grad is None else leaf.grad for leaf in (means, quats, scales, opacities)]
    assert features.grad is not None
    return _Descent(Splats(of[0][None], of[1][None], of[2], of[3], features.grad[:, :3]), features.grad[:, 3])
