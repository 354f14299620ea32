"""Gaussians that show in no camera are taken out: the model is no larger than what is seen of the scene needs.

What lies under others, or has been outgrown by its neighbours, costs time in every rendering and changes none. A round
looks through each camera in turn; what shows too little in all of them for some rounds in a row goes.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from twin_node.model.backgrounds import Backgrounds
from twin_node.model.gaussians import Gaussians
from twin_node.model.rendering import Splats, join
from twin_node.model.throttle import Throttle
from twin_node.model.unseen import Unseen, blend_weights
from twin_node.scene import Camera

EVERY_SETS = 8
"""Sets between two looks at what stands, each through one camera: it changes slowly."""
LEAST_PX = 0.1
"""Blend weight, summed over the pixels of a camera, under which what stands does not show. Of three times as much a
recorded cell holds no more than 2 %, and misses them by 0.1 dB."""
ROUNDS = 2
"""Rounds in a row in which a Gaussian that stands does not show before it goes."""
LEAST_MOVING_PX = 0.3
"""The same of what moves: newborns bury each other until two in five show less."""
MOVING_EVERY_S = 0.06
"""Time between two looks at what moves, s."""
MOVING_ROUNDS = 3
"""Rounds of what moves: 0.6 s with three cameras. In a third of that what is hidden for a moment goes too, and images
miss it by 0.3 dB; looks in every set of 30 Hz, and six rounds, are no better."""


class Pruner:
    """Watches the STATIC Gaussians of one model, and keeps them from filling the room of what moves: light that is
    switched, and what comes to rest, leave more of them each time."""

    def __init__(self, gaussians: Gaussians, backgrounds: Backgrounds, most: int) -> None:
        """`most`: of STATIC Gaussians and the arm's; where there are more, those that show least go."""
        self._most = most
        self._gaussians = gaussians
        self._backgrounds = backgrounds
        self._sets = 0
        self._unseen = Unseen(gaussians, LEAST_PX, ROUNDS)

    def watch(self, cameras: Sequence[Camera]) -> None:
        """Takes in that the cameras of a set are `cameras`; now and then looks through one of them."""
        self._unseen.know(cameras)
        self._sets += 1
        index = None if self._sets % EVERY_SETS else self._unseen.due(cameras)
        if index is None:
            return
        g = self._gaussians
        rows, camera = g.static_rows, cameras[index]
        gone = self._unseen.take(camera, rows, blend_weights(g.standing(g.values.index_select(0, rows)), camera))
        g.retire(gone)
        spare = self._unseen.least(g.static_rows, len(g.static_rows) + len(g.robot_rows) - self._most)
        g.retire(spare)
        if len(gone) or len(spare):
            self._backgrounds.mark()


class MovingPruner:
    """Watches the Gaussians that move; bodies that are hidden whole are left as they are."""

    def __init__(self, gaussians: Gaussians) -> None:
        self._gaussians = gaussians
        self._looking = Throttle(MOVING_EVERY_S)
        self._unseen = Unseen(gaussians, LEAST_MOVING_PX, MOVING_ROUNDS)

    def due(self, cameras: Sequence[Camera], stamp: int) -> int | None:
        """Takes in that the cameras of the set at `stamp` (ns) are `cameras`; which of them to look through now, None:
        through none."""
        self._unseen.know(cameras)
        return self._unseen.due(cameras) if self._looking.is_due(stamp) else None

    def look(self, camera: Camera, rows: Tensor, moving: Splats, around: Splats) -> None:
        """Looks through `camera` at all `rows` [n] that move, drawn as `moving` [n]; `around` can stand before them."""
        weights = torch.zeros(0, device=rows.device)
        if len(rows):
            weights = blend_weights(join(around, moving), camera)[around.means.shape[1] :]
        self._gaussians.retire(self._unseen.take(camera, rows, weights, self._gaussians.nodes[rows]))
