"""The mapper: what stands still is refined on images at rest, in the time that the tracker leaves.

The tracker never touches a STATIC Gaussian's shape; here those that show where a background and what its camera sees at
rest differ take a step, in all views at once. Where nothing differs any more, or steps have been in vain, nothing is
selected, so a scene at rest soon stays as it is to the bit.
"""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import torch
from numpy.typing import NDArray

from twin_node.model import least_squares
from twin_node.model.adoption import NEWBORN_OPACITY
from twin_node.model.backgrounds import Background, Backgrounds, grow
from twin_node.model.birth_depths import BLOCK
from twin_node.model.births import SPREAD, block_means
from twin_node.model.gaussians import Gaussians, Newborns
from twin_node.model.least_squares import AtRest
from twin_node.model.observation import Observed
from twin_node.model.parameters import MapParameters
from twin_node.model.pruning import Pruner
from twin_node.model.rays import look
from twin_node.model.rest import Rest
from twin_node.scene import Bool, Camera, Float32, Float64, Tier
from twin_node.side_thread import SideThread
from twin_node.splat.library import stay_alone
from twin_node.turns import Turns

LACKING = 0.1
"""Difference (0 to 1) between background and image at rest that is too much after steps: what counts as change."""
IN_FRONT = 0.995
"""Share of the depth of what stands there already at which a newborn lies, so that it is what shows."""
UNLIKE = 0.15
"""Difference of a channel (0 to 1) at which two cameras see two things: more than gloss and exposure make of one."""
FOOTPRINT_PX = 10
"""Pixels around wrong ones that its Gaussians are held to: as far as most of them reach."""


@dataclass(frozen=True)
class _Wanting:
    """One view of what stands still, and what it should look like."""

    background: Background
    rest: Rest

    @property
    def camera(self) -> Camera:
        """That both are of."""
        return self.background.camera

    def goal(self) -> AtRest:
        """The counted pixels about the wrong ones."""
        held = grow(self.rest.wrong, FOOTPRINT_PX) & self.rest.counted
        surface = self.background.surface.astype(np.float32)
        return AtRest(self.camera, self.rest.rgb, self.rest.depth, surface, held)


@dataclass(frozen=True)
class _Patches:
    """Blocks of pixels of one view that its background cannot show."""

    rows: NDArray[np.intp]
    """[n] first row."""
    columns: NDArray[np.intp]
    """[n] first column."""
    rgb: Float32
    """[n, 3] 0 to 1."""


class Mapper:
    """Refines STATIC Gaussians of one model; a set's share of the work is `refine`."""

    def __init__(
        self, parameters: MapParameters, gaussians: Gaussians, backgrounds: Backgrounds, most_static: int
    ) -> None:
        """`most_static`: STATIC Gaussians, and the arm's, beyond which it makes no new ones, and those that show least
        go, so that what moves finds room."""
        self._parameters = parameters
        self._most_static = most_static
        self._gaussians = gaussians
        self._backgrounds = backgrounds
        self._rests: dict[str, Rest] = {}
        self._pruner = Pruner(gaussians, backgrounds, most_static)
        self._side_thread = SideThread(stay_alone)
        self._turns = Turns()

    def refine(self, observed: Sequence[Observed], stamp: int, steps: int) -> Generator[None]:
        """Takes up to `steps`, 1 or more, by what the set at `stamp` (ns) shows, slice by slice; see `stages.Sliced`.

        From each slice to the next another thread looks at what a step misses, which then is taken.
        """
        views = [_Wanting(one.background, self._rest_of(one)) for one in observed]
        index = self._turns.whose([view.camera.name for view in views])
        self._turns.take([views[index].camera.name])
        views[index].rest.see(observed[index], self._parameters)
        self._fill(views, index, stamp)
        yield from self._learn(views, steps)
        self._pruner.watch([view.camera for view in views])

    def _rest_of(self, one: Observed) -> Rest:
        """What a view's camera sees at rest."""
        camera, rest = one.view.camera, self._rests.get(one.view.camera.name)
        if rest is None or not rest.camera.sees_as(camera):
            rest = self._rests[camera.name] = Rest(one)
        return rest

    def _fill(self, views: Sequence[_Wanting], index: int, stamp: int) -> None:
        """New STATIC Gaussians where those that are there cannot show what a camera sees at rest."""
        rest = views[index].rest
        lacking = block_means(rest.lacking, BLOCK)
        blocks = np.flatnonzero(lacking > LACKING)
        if not len(blocks):
            return
        room = self._most_static - self._gaussians.count(Tier.STATIC) - self._gaussians.count(Tier.ROBOT)
        most = min(self._parameters.most_born, max(room, 0))
        order = blocks[np.argsort(-lacking.ravel()[blocks], kind="stable")][:most]
        if not len(order):
            return
        rows, columns = np.unravel_index(order, lacking.shape)
        patches = _Patches(rows * BLOCK, columns * BLOCK, block_means(rest.rgb, BLOCK)[rows, columns])
        self._gaussians.spawn(self._newborns(views, index, patches), stamp)
        rest.fill(patches.rows, patches.columns)
        self._backgrounds.mark()

    def _newborns(self, views: Sequence[_Wanting], index: int, patches: _Patches) -> Newborns:
        """Patches of one view as Gaussians at the depth that was measured, else just before what stands there.

        Where another camera sees otherwise they lie on the plane or the shell, and nowhere if that cannot be either.
        """
        background, camera = views[index].background, views[index].camera
        rows, columns = patches.rows, patches.columns
        rays = (background.rays[rows, columns] + background.rays[rows + BLOCK - 1, columns + BLOCK - 1]) / 2
        measured = views[index].rest.depth[rows, columns].astype(np.float64)
        others = [view for at, view in enumerate(views) if at != index]
        depth = np.where(measured > 0, measured, IN_FRONT * background.depth[rows, columns])
        denied = (measured == 0) & _denied(others, camera.T_base_cam[:3, 3] + rays * depth[:, None], patches.rgb)
        depth = np.where(denied, IN_FRONT * background.surface[rows, columns], depth)
        kept = (measured > 0) | ~_denied(others, camera.T_base_cam[:3, 3] + rays * depth[:, None], patches.rgb)
        means, radii = camera.T_base_cam[:3, 3] + rays * depth[:, None], SPREAD * BLOCK * depth / camera.K[0, 0]
        count, device = int(kept.sum()), self._gaussians.values.device
        quats = torch.zeros(count, 4, device=device)
        quats[:, 0] = 1
        return Newborns(
            torch.from_numpy(means[kept]).float().to(device),
            quats,
            torch.from_numpy(radii[kept]).float().to(device)[:, None].repeat(1, 3),
            torch.full((count,), NEWBORN_OPACITY, device=device),
            torch.from_numpy(patches.rgb[kept]).to(device),
            Tier.STATIC,
            torch.full((count,), -1, device=device),
        )

    def _learn(self, views: Sequence[_Wanting], steps: int) -> Generator[None]:
        """A few steps for the Gaussians that show at wrong pixels of `views`."""
        chosen = self._backgrounds.rows[torch.from_numpy(self._chosen(views)).to(self._backgrounds.rows.device)]
        if not len(chosen):
            return
        learns = torch.zeros_like(self._gaussians.alive)
        learns[chosen] = True
        goals = [view.goal() for view in views]
        for _ in range(steps):
            rows = self._gaussians.static_rows
            step = least_squares.Step(self._gaussians, rows, learns.index_select(0, rows))
            looking = self._side_thread.begin(partial(_look, step, goals))
            yield
            looking.result()
            step.take()
            self._backgrounds.repaint()

    def _chosen(self, views: Sequence[_Wanting]) -> Bool:
        """[n] which of the background's rows show at a wrong pixel of some view, while no other view comes to rest."""
        chosen, early = np.zeros(len(self._backgrounds.rows), bool), np.zeros(len(self._backgrounds.rows), bool)
        for view in views:
            seen = view.background.static
            wrong, restless = seen.within(view.rest.wrong), seen.within(~(view.rest.counted | view.rest.hidden))
            asked = np.flatnonzero(seen.inside & (wrong | restless))
            visible = asked[~view.background.occluded(seen.of(asked))]
            chosen[visible] |= wrong[visible]
            early[visible] |= restless[visible]
        return chosen & ~early


def _look(step: least_squares.Step, goals: Sequence[AtRest]) -> None:
    """Through all views, for one step."""
    for goal in goals:
        step.look(goal)


def _denied(others: Sequence[_Wanting], points: Float64, rgb: Float32) -> Bool:
    """[n] which points [n, 3] of colours `rgb` [n, 3] some camera sees as another colour, at rest and not hidden."""
    denied = np.zeros(len(points), bool)
    for other in others:
        seen = look(other.camera, points)
        at = (seen.rows, seen.columns)
        visible = seen.inside & ~other.background.occluded(seen) & other.rest.counted[at]
        denied |= visible & (np.abs(other.rest.rgb[at] - rgb).max(-1) > UNLIKE)
    return denied
