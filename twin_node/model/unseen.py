"""Which Gaussians show in no camera: looks through one camera at a time, round after round."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from twin_node import splat
from twin_node.model.gaussians import Gaussians
from twin_node.model.rendering import Splats, shot_of
from twin_node.scene import Camera

AWAY_SETS = 20_000
"""Sets after which a camera that is away has left for good: ten minutes at 30 Hz."""


class Unseen:
    """Counts, per Gaussian of one store, the rounds in a row in which it did not show.

    A round looks through every camera that has ever been there, and waits for those that are away: one that fails for a
    while must not cost what it sees. One that has left for good is no longer waited for.
    """

    def __init__(self, gaussians: Gaussians, least_px: float, patience: int) -> None:
        """`least_px`: blend weight, summed over the pixels of a camera, under which a Gaussian does not show;
        `patience`: rounds in a row in which it does not before it is named."""
        self._gaussians = gaussians
        self._least_px = least_px
        self._patience = patience
        self._most = torch.zeros_like(gaussians.largest)
        """[capacity] largest weight of each row in this round."""
        self._since = torch.full_like(gaussians.ids, -1)
        """[capacity] id that each row had when the round began, -1 for none."""
        self._rounds = torch.zeros_like(gaussians.ids)
        """[capacity] rounds in a row in which the row did not show."""
        self._sets = 0
        self._known: dict[str, int] = {}
        """Cameras, and which set they were last in."""
        self._waiting: list[str] = []

    def know(self, cameras: Sequence[Camera]) -> None:
        """The cameras of a set are `cameras`."""
        self._sets += 1
        self._known |= dict.fromkeys((camera.name for camera in cameras), self._sets)

    def due(self, cameras: Sequence[Camera]) -> int | None:
        """Which of `cameras` to look through next; None: the round waits for one that is away."""
        if not self._waiting:
            self._known = {name: seen for name, seen in self._known.items() if self._sets - seen <= AWAY_SETS}
            self._waiting = list(self._known)
            since = torch.where(self._gaussians.alive, self._gaussians.ids, -1)
            self._rounds *= since == self._since  # of who has another's row nothing has been counted
            self._since = since
            self._most.zero_()
        due = next((i for i, camera in enumerate(cameras) if camera.name in self._waiting), None)
        if due is None and all(self._sets - self._known[name] > AWAY_SETS for name in self._waiting):
            self._waiting = []  # the next round does without them
        return due

    def least(self, rows: Tensor, count: int) -> Tensor:
        """[count or fewer] those of `rows` [n] that showed least in the round that has just come to its end.

        None within one, nor any that were not there when it began.
        """
        if self._waiting or count <= 0:
            return rows[:0]
        judged = rows[self._since.index_select(0, rows) == self._gaussians.ids.index_select(0, rows)]
        return judged[self._most.index_select(0, judged).argsort(stable=True)[:count]]

    def take(self, camera: Camera, rows: Tensor, weights: Tensor, bodies: Tensor | None = None) -> Tensor:
        """Takes in that `camera` sees `rows` [n] with `weights` [n] px; returns the rows that have not shown for long.

        `bodies` [n] names what each is part of, -1 for nothing: while a body shows nowhere its parts are not counted,
        for nothing that shows stands for them.
        """
        most = torch.maximum(self._most.index_select(0, rows), weights)
        self._most[rows] = most
        self._waiting.remove(camera.name)
        if self._waiting:
            return rows[:0]
        hidden = most < self._least_px
        counted = hidden & (self._since.index_select(0, rows) == self._gaussians.ids.index_select(0, rows))
        if bodies is not None:
            counted &= (bodies < 0) | torch.isin(bodies, bodies[~hidden])
        rounds = (self._rounds.index_select(0, rows) + 1) * counted
        self._rounds[rows] = rounds
        named = rows[rounds >= self._patience]
        self._rounds[named] = 0
        return named


def blend_weights(splats: Splats, camera: Camera) -> Tensor:
    """[n] how much of `splats`, all at one time, a camera sees, pixels: their blend weights, summed over the image."""
    return splat.weigh(shot_of(splats, camera))
