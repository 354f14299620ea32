"""STATIC Gaussians that show in no camera are taken out: the model is no larger than what is seen of the scene needs.

What lies under others, or has been outgrown by its neighbours, costs time in every rendering and changes none. A round
looks through each camera in turn; what shows too little in all of them for some rounds in a row goes.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from twin_node import splat
from twin_node.model.backgrounds import Backgrounds
from twin_node.model.gaussians import Gaussians
from twin_node.scene import Camera

EVERY_SETS = 8
"""Sets between two looks, each through one camera: what stands changes slowly."""
LEAST_PX = 0.1
"""Blend weight, summed over the pixels of a camera, under which a Gaussian does not show. Of three times as much a
recorded cell holds no more than 2 %, and misses them by 0.1 dB."""
ROUNDS = 2
"""Rounds in a row in which a Gaussian does not show before it goes."""


class Pruner:
    """Watches the STATIC Gaussians of one model."""

    def __init__(self, gaussians: Gaussians, backgrounds: Backgrounds) -> None:
        self._gaussians = gaussians
        self._backgrounds = backgrounds
        self._sets = 0
        self._most = torch.zeros_like(gaussians.largest)
        """[capacity] largest weight of each row in this round."""
        self._since = torch.full_like(gaussians.ids, -1)
        """[capacity] id that each row had when the round began, -1 for none."""
        self._unseen = torch.zeros_like(gaussians.ids)
        """[capacity] rounds in a row in which the row did not show."""
        self._known: dict[str, None] = {}
        self._waiting: list[str] = []

    def watch(self, cameras: Sequence[Camera]) -> None:
        """Takes in that the cameras of a set are `cameras`; now and then looks through one of them.

        A round waits for every camera that has ever been there: one that fails for a while must not cost what it sees.
        """
        self._known |= dict.fromkeys(camera.name for camera in cameras)
        self._sets += 1
        due = [camera for camera in cameras if camera.name in self._waiting]
        if self._sets % EVERY_SETS or (self._waiting and not due):
            return
        if not self._waiting:
            self._begin()
            due = list(cameras)
        rows = self._gaussians.static_rows
        self._most[rows] = torch.maximum(self._most[rows], blend_weights(self._gaussians, rows, due[0]))
        self._waiting.remove(due[0].name)
        if not self._waiting:
            self._end(rows)

    def _begin(self) -> None:
        self._waiting = list(self._known)
        self._since = torch.where(self._gaussians.alive, self._gaussians.ids, -1)
        self._most.zero_()

    def _end(self, rows: Tensor) -> None:
        """Counts the round; what has not shown for long enough goes."""
        unseen = (self._most[rows] < LEAST_PX) & (self._since[rows] == self._gaussians.ids[rows])
        self._unseen[rows] = (self._unseen[rows] + 1) * unseen
        gone = rows[self._unseen[rows] >= ROUNDS]
        if len(gone):
            self._unseen[gone] = 0
            self._gaussians.retire(gone)
            self._backgrounds.mark()


def blend_weights(gaussians: Gaussians, rows: Tensor, camera: Camera) -> Tensor:
    """[n] how much of `rows` [n] a camera sees, pixels: their blend weights, summed over the image."""
    splats = gaussians.standing(gaussians.values[rows])
    nothing = torch.zeros(len(rows), 1, device=rows.device, requires_grad=True)
    shown, _, _ = splat.rasterize(
        splats.means[0],
        splats.quats[0],
        splats.scales,
        splats.opacities,
        nothing,
        torch.from_numpy(camera.viewmat)[None].to(rows.device, torch.float32),
        torch.from_numpy(camera.K)[None].to(rows.device, torch.float32),
        camera.width,
        camera.height,
    )
    (weights,) = torch.autograd.grad(shown.sum(), nothing)  # of a feature that is zero everywhere
    return weights[:, 0]
