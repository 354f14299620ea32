"""Node motion from images: the flow from the rendering to the image, explained by one twist per node (Gauss-Newton).

A rendering of the predicted state is compared with the image itself, so errors do not add up as they do when flow is
chained from image to image.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from twin_node.model.cells import Cells
from twin_node.model.evidence import Fits
from twin_node.model.nodes import FORETOLD_NS
from twin_node.model.normal_equations import SHARED_BY, NormalEquations
from twin_node.model.observation import Observed
from twin_node.model.points import Carried
from twin_node.model.rendering import Rendering, Splats
from twin_node.scene import Float32

ACCELERATION, TURN_ACCELERATION = 10.0, 20.0
"""m/s2 and rad/s2 (1 sigma) that a prediction may be wrong by: what a quick human arm does."""
LEAST_OFF, LEAST_TURNED = 2e-3, 1e-2
"""m and rad (1 sigma) that it is wrong by at least."""
SHORTEST_S, LONGEST_S = 1e-3, FORETOLD_NS * 1e-9
"""Time without a correction that a prediction may be wrong by as much as in, s: after more nodes are looked for where
they were. It grows with the square of it, and what is held to nothing cannot be solved for where little is seen."""
UNNOTICED_S = 0.13
"""For how long what now moves may have done so while it was taken to stand, s."""
FLOW_SIGMA_PX = 0.5
"""1 sigma of the optical flow on textured pixels: what a node's own sigma is derived from."""
MOST_OBSERVATIONS = 1000
"""Gaussians per view whose flow is taken; with more, every n-th stands for its neighbours."""
STRAIN = 0.05
"""1 sigma of the strain that a set may bring."""
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
    said: NormalEquations
    """What the flow under each cell says about the motion of its node."""


def solve_twists(
    observed: Sequence[Observed],
    renderings: Sequence[Rendering],
    flows: Sequence[Float32],
    moving: Splats,
    carried: Tensor,
    cells: Cells,
    origins: Tensor,
    unseen_s: float,
) -> Twists:
    """The twist of each node that explains the flow under its Gaussians best, held to the prediction.

    `moving` holds Gaussians at each view's time, `carried` [m] tells which of them nodes carry, `cells` where in these,
    `origins` [C, M, 3] the nodes' positions, `unseen_s` for how long no image has corrected these.
    """
    said = NormalEquations(len(cells))
    stride = max(len(carried) // MOST_OBSERVATIONS, 1)
    chosen = carried[::stride].numpy()
    within = cells.of[::stride]
    carriers = cells.nodes[within]
    means = moving.means.detach().cpu().numpy().take(chosen, 1).astype(np.float64)
    opacities = moving.opacities.detach().cpu().numpy().take(chosen).astype(np.float64)
    arms = means - origins.double().numpy().take(carriers, 1)
    for index, one in enumerate(observed):
        carried_here = Carried(means[index], arms[index], opacities, within)
        said.add_view(carried_here, one, renderings[index], flows[index], stride / (SHARED_BY * FLOW_SIGMA_PX**2))
    normal = said.summed(cells.nodes, origins.shape[1])
    step = min(max(unseen_s, SHORTEST_S), LONGEST_S) ** 2 / 2
    motion = np.array([ACCELERATION * step + LEAST_OFF] * 3 + [TURN_ACCELERATION * step + LEAST_TURNED] * 3)
    rigid = normal.solve(6, motion)
    strained = normal.solve(12, np.concatenate([motion, np.full(6, STRAIN)]))
    x, y, z = rigid.variances[:, :3].T
    sigmas = torch.from_numpy(np.maximum((x + y + z) / 3, MATRIX_FLOOR)).sqrt()
    solution = torch.from_numpy(rigid.solution)
    fits = Fits(*(torch.from_numpy(of) for of in (rigid.cost, strained.cost, normal.count)))
    return Twists(solution[:, :3], solution[:, 3:], sigmas, fits, said)
