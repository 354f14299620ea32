"""A model that `twin_node train` has made, as a source of exports: Gaussians at any time of its span, no more."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from twin_node.model.ply import StoredGaussians, cloud_from_stored
from twin_node.model.sequence import load_checkpoint
from twin_node.model.sequence.sequence_model import MovedGaussians
from twin_node.nodes.export.moments import ExportError, Moment
from twin_node.nodes.snapshot import in_force
from twin_node.nodes.topics import GAUSSIANS
from twin_node.robot import ArmModel
from twin_node.scene import Float32, GaussianCloud, Tier

VELOCITY_NS = 10_000_000
"""How far before and after a time Gaussians are looked at for their velocities, ns."""


class CheckpointSource:
    """A checkpoint of `twin_node train`."""

    def __init__(self, path: Path) -> None:
        """Raises `ModelError` for a file that is no checkpoint."""
        self._path = path
        checkpoint = load_checkpoint(path)
        self._model = checkpoint.model
        self.stamps = self._model.span.evenly(checkpoint.header.steps)
        """As many times, ns, as it was trained on sets of images, evenly."""
        self.start_ns, self.end_ns = self._model.span.first, self._model.span.last

    def require(self, topic: str, purpose: str) -> None:
        """Raises `ExportError` for anything but Gaussians."""
        if topic != GAUSSIANS:
            raise ExportError(
                f"{self._path}: expected {topic}, which {purpose} needs, found Gaussians alone; export to ply, spz or "
                "npz, or give a log that 'twin_node replay LOG -o FILE' has written"
            )

    def moments(self, stamps: Sequence[int], arm: ArmModel | None, with_clouds: bool) -> Iterator[Moment]:
        """The moments at rising `stamps` (ns)."""
        for stamp in stamps:
            before, after = max(stamp - VELOCITY_NS, self.start_ns), min(stamp + VELOCITY_NS, self.end_ns)
            with torch.no_grad():
                moved = self._model.at([stamp, before, after])
            means, ns = moved.means.detach().numpy(), after - before
            velocities = (means[2] - means[1]) * np.float32(1e9 / ns) if ns > 0 else np.zeros_like(means[0])
            tier = Tier.STATIC if self._model.field is None else Tier.DEFORMABLE
            harmonics = moved.sh.detach().numpy().astype(np.float32)
            cloud = _cloud(moved, velocities, tier)
            yield Moment(stamp, (stamp - stamps[0]) / 1e9, in_force(None, stamp), None, cloud, harmonics)


def _cloud(moved: MovedGaussians, velocities: Float32, tier: Tier) -> GaussianCloud:
    """The Gaussians of the first time, all of one tier, in the mean colour of all sides."""
    stored = StoredGaussians(
        moved.means[0].detach().numpy(),
        moved.quats[0].detach().numpy(),
        moved.scales[0].detach().log().numpy(),
        moved.opacities.detach().logit().numpy(),
        moved.sh.detach().numpy(),
    )
    cloud = cloud_from_stored(stored)
    return replace(cloud, velocities=velocities, tiers=np.full(len(stored), tier, np.uint8))
