"""Gaussians of one model where the views of a set see them, each at its own time."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from twin_node.model.gaussians import Gaussians
from twin_node.model.motion import Motion
from twin_node.model.nodes import Poses
from twin_node.model.observation import Observed
from twin_node.model.rendering import Rendering, Splats, join, render


class Placer:
    """Places Gaussians by the motion of their nodes, and draws them before the background."""

    def __init__(self, gaussians: Gaussians, motion: Motion) -> None:
        self._gaussians = gaussians
        self._motion = motion

    def poses(self, observed: Sequence[Observed]) -> Poses:
        """The nodes, as they are now, at each view's own time."""
        return self._motion.poses([one.offset_s for one in observed])

    def place(self, rows: Tensor, observed: Sequence[Observed], poses: Poses) -> Splats:
        """Gaussians `rows` [n] at each view's own time."""
        with torch.no_grad():
            stamps = self._motion.stamps([one.offset_s for one in observed])
            return self._motion.place(self._gaussians, rows, poses, stamps)

    def look(self, observed: Sequence[Observed], moving: Splats, before: Splats) -> list[Rendering]:
        """What the views would see of the model with `moving` in it; beyond their active pixels the background."""
        masks, backdrops = [one.active for one in observed], [one.background.backdrop for one in observed]
        with torch.no_grad():
            return render(join(before, moving), [one.view.camera for one in observed], masks, backdrops)
