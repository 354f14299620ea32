"""The mapper: what stands still is refined on images at rest, in the time that the tracker leaves.

The tracker never touches a STATIC Gaussian's shape; here those that show where a background and what its camera sees at
rest differ take steps of Adam, in all views at once. Where nothing differs nothing is selected, so a scene at rest
stays as it is to the bit.
"""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from twin_node.model.adoption import NEWBORN_OPACITY
from twin_node.model.backgrounds import Background, Backgrounds, grow
from twin_node.model.births import BLOCK, SPREAD
from twin_node.model.carriage import carry
from twin_node.model.descending import Path, descend, diverged, rates_of, undo
from twin_node.model.gaussians import Gaussians, Newborns
from twin_node.model.nodes import Poses
from twin_node.model.observation import Observed, largest_channel
from twin_node.model.parameters import MapParameters
from twin_node.model.photometric import Goal, Targets
from twin_node.model.rendering import by_size
from twin_node.scene import Bool, Camera, Float32, Tier

UPTAKE = 0.3
"""Share of each image that enters what a pixel shows at rest: noise is averaged over about six images."""
STIRRED = 25 / 255
"""Change from what a pixel shows at rest that is no noise: it starts anew (the threshold for moving pixels)."""
MOST_FILLS = 2
"""Times that one place is given new Gaussians before it changes again: what they do not mend, more will not."""
IN_FRONT = 0.995
"""Share of the depth of what stands there already at which a newborn lies, so that it is what shows."""
FOOTPRINT_PX = 3
"""Pixels around a Gaussian that learns that its views are held to: it is about two pixels wide."""


class _AtRest:
    """What one camera sees where nothing moves."""

    def __init__(self, one: Observed) -> None:
        """Begins with an image."""
        rgb = one.rgb.copy()
        self.camera = one.view.camera
        self.rgb = rgb
        """[H, W, 3] running mean of what pixels show at rest, 0 to 1."""
        self.depth = np.zeros(rgb.shape[:2], np.float32)
        """[H, W] m, what was measured there last; 0 where unknown."""
        self.counted = np.zeros(rgb.shape[:2], bool)
        """[H, W] pixels that had been at rest for long enough when it looked last."""
        self.wrong = np.zeros(rgb.shape[:2], bool)
        """[H, W] those of them where the background looks otherwise, and the pixels around."""
        self.lacking = np.zeros(rgb.shape[:2], np.float32)
        """[H, W] what steps have not made good although there was time for them, 0 to 1."""
        self._calm_s = np.zeros(rgb.shape[:2], np.float32)
        self._filled = np.zeros(rgb.shape[:2], np.uint8)
        self._stamp = one.view.stamp

    def see(self, one: Observed, parameters: MapParameters) -> None:
        """Takes in an image."""
        change = largest_channel(one.rgb, self.rgb)
        calm = one.usable & ~one.near_moving & (change < STIRRED)
        since_s = np.float32((one.view.stamp - self._stamp) * 1e-9)
        self._stamp = one.view.stamp
        self._calm_s = np.where(calm, self._calm_s + since_s, np.float32(0))
        self.rgb += np.where(calm, np.float32(UPTAKE), np.float32(1))[..., None] * (one.rgb - self.rgb)
        if one.view.depth is not None:
            self.depth = np.where(calm & (one.view.depth > 0), one.view.depth, self.depth)
        self.counted = self._calm_s > parameters.calm_s
        missed = cv2.blur(largest_channel(self.rgb, one.background.rgb) - one.misfit, (3, 3))
        self.wrong = grow(self.counted & (missed > parameters.threshold), 1)
        self._filled[one.usable & ~one.near_moving & ~calm] = 0
        patient = (self._calm_s > parameters.patience_s) & (self._filled < MOST_FILLS)
        self.lacking = np.where(patient, missed, np.float32(0))

    def fill(self, rows: NDArray[np.intp], columns: NDArray[np.intp]) -> None:
        """The blocks of pixels that begin at `rows` and `columns` [n] have new Gaussians, which must learn first."""
        for down in range(BLOCK):
            for right in range(BLOCK):
                self._calm_s[rows + down, columns + right] = 0
                self._filled[rows + down, columns + right] += 1


@dataclass(frozen=True)
class _Wanting:
    """One view of what stands still, and what it should look like."""

    background: Background
    at_rest: _AtRest

    @property
    def camera(self) -> Camera:
        """That both are of."""
        return self.background.camera


class Mapper:
    """Refines STATIC Gaussians of one model; a set's share of the work is `refine`."""

    def __init__(
        self, parameters: MapParameters, gaussians: Gaussians, backgrounds: Backgrounds, most_static: int
    ) -> None:
        """`most_static`: STATIC Gaussians beyond which it makes no new ones, so that what moves finds room."""
        self._parameters = parameters
        self._most_static = most_static
        self._gaussians = gaussians
        self._backgrounds = backgrounds
        self._at_rest: dict[str, _AtRest] = {}
        self._turn = 0
        self._learning = torch.zeros(gaussians.capacity, dtype=torch.bool, device=gaussians.values.device)

    def refine(self, observed: Sequence[Observed], stamp: int) -> Generator[None]:
        """Takes the share of the set at `stamp` (ns), slice by slice: before any of them what is left can be let be."""
        yield
        self._turn += 1
        views = []
        for index, one in enumerate(observed):
            at_rest = self._at_rest_of(one)
            if index == self._turn % len(observed):
                at_rest.see(one, self._parameters)
                self._fill(one, at_rest, stamp)
            views.append(_Wanting(one.background, at_rest))
        for chosen in by_size([v.camera for v in views]):
            yield
            yield from self._learn([views[index] for index in chosen])

    def _at_rest_of(self, one: Observed) -> _AtRest:
        """What a view's camera sees at rest."""
        camera, at_rest = one.view.camera, self._at_rest.get(one.view.camera.name)
        if at_rest is None or at_rest.camera is not camera:
            at_rest = self._at_rest[camera.name] = _AtRest(one)
        return at_rest

    def _fill(self, one: Observed, at_rest: _AtRest, stamp: int) -> None:
        """New STATIC Gaussians where those that are there cannot show what is seen at rest."""
        size = (one.view.camera.width // BLOCK, one.view.camera.height // BLOCK)
        lacking: Float32 = cv2.resize(at_rest.lacking, size, interpolation=cv2.INTER_AREA).astype(np.float32)
        room = max(self._most_static - self._gaussians.count(Tier.STATIC), 0)
        order = np.argsort(-lacking, axis=None, kind="stable")[: min(self._parameters.most_born, room)]
        order = order[lacking.ravel()[order] > self._parameters.lacking]
        if not len(order):
            return
        colours: Float32 = cv2.resize(at_rest.rgb, size, interpolation=cv2.INTER_AREA).astype(np.float32)
        rows, columns = np.unravel_index(order, lacking.shape)
        born = self._patches(one, at_rest, rows * BLOCK, columns * BLOCK, colours[rows, columns])
        self._gaussians.spawn(born, stamp)
        at_rest.fill(rows * BLOCK, columns * BLOCK)
        self._backgrounds.mark()

    def _patches(
        self, one: Observed, at_rest: _AtRest, rows: NDArray[np.intp], columns: NDArray[np.intp], rgb: Float32
    ) -> Newborns:
        """Blocks of pixels that begin at `rows` and `columns` [n], as Gaussians of colours `rgb` [n, 3].

        They lie at the depth that was measured, else just before what stands there.
        """
        background, camera = one.background, one.view.camera
        measured = at_rest.depth[rows, columns].astype(np.float64)
        depth = np.where(measured > 0, measured, IN_FRONT * background.depth[rows, columns])
        rays = (background.rays[rows, columns] + background.rays[rows + BLOCK - 1, columns + BLOCK - 1]) / 2
        means = camera.T_base_cam[:3, 3] + rays * depth[:, None]
        radii = SPREAD * BLOCK * depth / camera.K[0, 0]
        count, device = len(rows), self._gaussians.values.device
        quats = torch.zeros(count, 4, device=device)
        quats[:, 0] = 1
        return Newborns(
            torch.from_numpy(means).float().to(device),
            quats,
            torch.from_numpy(radii).float().to(device)[:, None].repeat(1, 3),
            torch.full((count,), NEWBORN_OPACITY, device=device),
            torch.from_numpy(rgb).to(device),
            Tier.STATIC,
            torch.full((count,), -1, device=device),
        )

    def _learn(self, views: Sequence[_Wanting]) -> Generator[None]:
        """A few steps for the Gaussians that show at wrong pixels of `views`, cameras of one size."""
        chosen = self._chosen(views)
        g, rows = self._gaussians, self._backgrounds.rows
        standing = (g.alive[rows] & (g.tiers[rows] == int(Tier.STATIC))).cpu().numpy()
        chosen &= standing
        if not chosen.any():
            return
        masks = [_footprint(view, chosen) for view in views]
        reaching = np.any([_reaching(view, mask) for view, mask in zip(views, masks, strict=True)], axis=0)
        learners, others = rows[_at(chosen, rows)], rows[_at(standing & reaching & ~chosen, rows)]
        fresh = learners[~self._learning[learners]]
        g.forget_moments(fresh)
        self._learning[:] = False
        self._learning[learners] = True
        still = Poses(torch.zeros(len(views), 0, 3), torch.zeros(len(views), 0, 4))
        carriage = carry(still, torch.full((len(learners),), -1, device=g.values.device))
        before = g.values[learners]
        rates = rates_of(before, self._parameters.learning_rate)
        path = Path(learners, carriage, rates, g.standing(g.values[others]), _goal(views, masks, g.values.device))
        losses: list[float] = []
        try:
            for _ in range(self._parameters.steps):
                yield
                losses += descend(g, path, 1).losses
        finally:
            if losses and diverged(losses):
                undo(g, learners, before)
            self._backgrounds.repaint()

    def _chosen(self, views: Sequence[_Wanting]) -> Bool:
        """[n] which of the background's rows show at a wrong pixel of some view, as many as may learn at once."""
        need = np.zeros(len(self._backgrounds.rows), np.int64)
        for view in views:
            seen = view.background.static
            need += seen.inside & ~view.background.occluded(seen) & view.at_rest.wrong[seen.rows, seen.columns]
        chosen = need > 0
        if chosen.sum() > self._parameters.most_learners:
            order = np.argsort(-need, kind="stable")
            chosen[order[self._parameters.most_learners :]] = False
        return chosen


def _goal(views: Sequence[_Wanting], masks: Sequence[Bool], device: torch.device) -> Goal:
    """What cameras of one size see at rest, inside `masks` [H, W]."""
    depths = np.stack([view.at_rest.depth for view in views])
    targets = Targets(
        torch.from_numpy(np.stack([view.at_rest.rgb for view in views])).to(device),
        torch.from_numpy(np.stack(masks)).to(device).float(),
        torch.from_numpy(depths).to(device) if depths.any() else None,
    )
    return Goal([view.camera for view in views], masks, [targets], [_behind(view.background, device) for view in views])


def _footprint(view: _Wanting, chosen: Bool) -> Bool:
    """[H, W] counted pixels at and around the chosen Gaussians."""
    seen = view.background.static
    at = chosen & seen.inside
    mask = np.zeros(view.at_rest.counted.shape, bool)
    mask[seen.rows[at], seen.columns[at]] = True
    return grow(mask, FOOTPRINT_PX) & view.at_rest.counted


def _reaching(view: _Wanting, mask: Bool) -> Bool:
    """[n] which of the background's rows reach into a mask [H, W]."""
    seen, reach_px = view.background.static, view.background.reach_px
    apart = cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_3)
    return (reach_px >= 0) & (apart[seen.rows, seen.columns] <= reach_px + 1)


def _at(mask: Bool, like: Tensor) -> Tensor:
    return torch.from_numpy(mask).to(like.device)


def _behind(background: Background, device: torch.device) -> Tensor:
    """[H, W, 4] black at the depth of plane and shell."""
    behind = np.zeros((*background.surface.shape, 4), np.float32)
    behind[..., 3] = background.surface
    return torch.from_numpy(behind).to(device)
