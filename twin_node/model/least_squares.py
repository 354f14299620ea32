"""One step of STATIC Gaussians towards what cameras see at rest: least squares, damped by what each of them covers.

Adam's steps are as long near the goal as far from it, and shake what has long been right. Here a step is as long as the
error says: the gradient of the squared error over the curvature of a Gaussian's colour, which is the sum of its blend
weights (one sweep of SIRT, Gilbert 1972); its shape follows with the same curvature and less haste.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from twin_node import splat
from twin_node.model.chosen import rows_where
from twin_node.model.gaussians import LOG_SCALE, LOGIT, MEAN, QUAT, RGB, SMALLEST, Gaussians
from twin_node.model.kernel_requests import DampedRequest
from twin_node.model.kernels import kernels_for
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
DEPTH_GAIN = 0.5
"""What a relative error of depth counts in errors of colour. At edges, where what is measured is one of two surfaces or
a pixel off, more of it spoils what the image shows: four times as much costs a simulated cell 0.6 dB of what stands,
and depth is no better for it."""
NEAREST_M = 1e-3
"""Smallest depth that is divided by, m."""
TOLERANCE = splat.Tolerance(OUTLIER, DEPTH_GAIN, NEAREST_M)


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
        self._ids = gaussians.ids.index_select(0, rows)
        self._values = gaussians.values.index_select(0, rows)

    @cached_property
    def _splats(self) -> Splats:
        """The Gaussians as they stood when the step began; found with the first look, by the thread that takes it."""
        return self._gaussians.standing(self._values)

    @cached_property
    def _missed(self) -> splat.Missed | splat.MissedReference:
        """What the views that were looked through miss of them."""
        kind = splat.Missed if splat.has_kernels(self._values.device) else splat.MissedReference
        drawn = self._splats
        return kind(drawn.means[0], drawn.quats[0], drawn.scales, drawn.opacities, drawn.rgb, self._learners)

    def look(self, view: AtRest) -> None:
        """Takes in what `view` misses."""
        device, camera = self._values.device, view.camera
        with_depth = bool(view.depth.any())
        sight = splat.Sight(
            torch.from_numpy(camera.viewmat).to(device, torch.float32),
            torch.from_numpy(camera.K).to(device, torch.float32),
            torch.from_numpy(view.rgb).to(device),
            torch.from_numpy(view.counted).to(device),
            torch.from_numpy(view.depth).to(device) if with_depth else None,
            torch.from_numpy(view.surface).to(device) if with_depth else None,
        )
        self._missed.add(sight, TOLERANCE)

    def take(self) -> None:
        """Takes the step towards all views that were looked through; what stands no longer takes none."""
        g, missed, splats = self._gaussians, self._missed, self._splats
        library = kernels_for(g.values.device)
        if library is None:
            self.take_reference()
            return
        refused = torch.zeros(1, dtype=torch.int64)
        drawn = (self._rows, self._learners, self._ids, splats.scales, splats.opacities)
        held = [of.contiguous() for of in (*drawn, *vars(missed.pull).values())]
        pointers = (of.data_ptr() for of in (*held, g.alive, g.tiers, g.ids, g.largest, g.values, refused))
        shares = (SHAPE_SHARE, COLOUR_SHARE, FEWEST_PIXELS, LONGEST, SMALLEST)
        library.run(DampedRequest(len(self._rows), int(Tier.STATIC), *shares, *pointers))
        g.refused += int(refused)

    def take_reference(self) -> None:
        """The same in torch, on any device: the reference of the compiled kernel."""
        gaussians, pull = self._gaussians, self._missed.pull
        alive, tiers, ids = (s.index_select(0, self._rows) for s in (gaussians.alive, gaussians.tiers, gaussians.ids))
        stands = alive & (tiers == int(Tier.STATIC)) & (ids == self._ids)
        taken = rows_where(stands & self._learners & (pull.weights > FEWEST_PIXELS))
        rows, seen = self._rows[taken], pull.weights[taken, None]
        scales, opacities, share = self._splats.scales[taken], self._splats.opacities[taken], SHAPE_SHARE / seen
        size = scales.mean(-1, keepdim=True)
        new = gaussians.values[rows]
        new[:, MEAN] += size * (share * pull.means[taken] * size).clamp(-LONGEST, LONGEST)
        new[:, QUAT] += (share * pull.quats[taken]).clamp(-LONGEST, LONGEST)
        new[:, LOG_SCALE] += (share * pull.scales[taken] * scales).clamp(-LONGEST, LONGEST)
        new[:, LOG_SCALE] = torch.minimum(new[:, LOG_SCALE], gaussians.largest[rows, None]).clamp_min(SMALLEST)
        new[:, LOGIT.start] += (share[:, 0] * pull.opacities[taken] * opacities).clamp(-2 * LONGEST, 2 * LONGEST)
        new[:, RGB] = (new[:, RGB] + COLOUR_SHARE * pull.rgb[taken] / seen).clamp(0, 1)
        finite = torch.isfinite(new).all(1)
        gaussians.refused += int((~finite).sum())
        gaussians.values[rows[finite]] = new[finite]
