"""The look of the arm: its Gaussians go where the joints say, and learn what the cameras see of it."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from twin_node.model.adoption import NEWBORN_OPACITY
from twin_node.model.birth_depths import BLOCK
from twin_node.model.births import SPREAD
from twin_node.model.carriage import carry
from twin_node.model.descending import Path, descend, rates_of
from twin_node.model.gaussians import LOG_SCALE, MEAN, Gaussians, Newborns
from twin_node.model.motion import Motion
from twin_node.model.nodes import Poses
from twin_node.model.observation import Observed
from twin_node.model.photometric import goal_of
from twin_node.model.quality import largest_channel
from twin_node.model.rendering import Rendering, shoot
from twin_node.model.robot_links import RobotLinks
from twin_node.model.rotations import conjugate, rotate
from twin_node.scene import Bool, Float32, Float64, JointSample, Tier

RATE = 3.0
"""What the rates of `descending.RATES` are multiplied by."""
MEANS = 0.3
"""Share of it that the means have: one camera alone would draw them towards itself."""
TURNED_RAD = 0.02
"""How far any joint turns until the arm shows the cameras something new."""
CALMING, CALM = 0.85, 0.05
"""What the rates are multiplied by with every look at an arm that does not turn, and when that is over."""
BENEATH = 0.5
"""How far under the surface of its link's capsules a Gaussian lies at least, in units of its own mean radius: half of
one that lay on it would stand out over the arm's outline."""
AROUND_PX = 3
"""Pixels around the arm's mask in which nothing of it may show."""
WRONG = 0.1
"""Difference of a channel (0 to 1) beyond which Gaussians are missing: what counts as change."""
MOST_BORN = 60
"""Gaussians born per look at most: a side that turns to a camera is whole within half a second."""
LONELY = 2.0
"""Radii of a newborn within which there must be no other. Within one, they are half as many again and show no more."""
_CROSS = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
_AROUND = np.ones((2 * AROUND_PX + 1, 2 * AROUND_PX + 1), np.uint8)
_REACHED = np.ones((7, 7), np.uint8)
"""Blocks about one that the arm's mask, which is grown, and the pixels around it reach to."""


@dataclass(frozen=True)
class _Skin:
    """Where a camera sees the arm itself, in blocks of pixels."""

    one: Observed
    """The view."""
    rows: NDArray[np.intp]
    """[n] first row."""
    columns: NDArray[np.intp]
    """[n] first column."""
    points: Float64
    """[n, 3] m, what is seen there at the view's own time."""
    depth: Float64
    """[n] m along the optical axis."""
    links: NDArray[np.int64]
    """[n] row of the node of the nearest link."""
    counted: Bool
    """[H, W] pixels that tell how the arm looks: its own, and those around it that show what stands behind it."""


@dataclass(frozen=True)
class _Own:
    """The arm's Gaussians, in float64 on the CPU: they are few."""

    means: Tensor
    """[n, 3] m in the frames of their nodes."""
    carriers: Tensor
    """[n] rows of these."""

    def placed(self, poses: Poses) -> Tensor:
        """[n, 3] m where nodes at `poses` [M, ...] carry them."""
        return rotate(poses.quats[self.carriers], self.means) + poses.positions[self.carriers]

    def with_newborns(self, born: Newborns) -> _Own:
        """These and `born`."""
        means, carriers = born.means.cpu().double(), born.nodes.cpu()
        return _Own(torch.cat([self.means, means]), torch.cat([self.carriers, carriers]))


class ArmSkin:
    """Learns the look of one arm's Gaussians, and makes new ones where none are; a set's share is `refine`."""

    def __init__(self, links: RobotLinks, gaussians: Gaussians, motion: Motion) -> None:
        self._links = links
        self._gaussians = gaussians
        self._motion = motion
        self._q: Float64 | None = None
        """[J] rad, where the arm was when it had turned last."""
        self._share = 1.0
        """What the rates are multiplied by."""

    def refine(
        self, observed: Sequence[Observed], joints: JointSample, robots: Sequence[Bool | None]
    ) -> Generator[None]:
        """Takes a step by what the cameras see of the arm; `robots` are its masks [H, W].

        Called while the links are where the set shows them; what it returns may be gone on with once they are not. An
        arm that does not turn soon stays as it is, to the bit.
        """
        masks = zip(observed, robots, strict=True)
        seen = [(one, mask) for one, mask in masks if mask is not None and mask.any() and min(mask.shape) >= BLOCK]
        if seen and self._is_known(joints):
            seen = []
        poses = self._motion.poses([one.offset_s for one, _ in seen])
        return self._slices(seen, joints, poses)

    def _is_known(self, joints: JointSample) -> bool:
        """Whether another look would tell nothing new."""
        q = self._links.angles(joints)
        if self._q is None or np.abs(q - self._q).max() > TURNED_RAD:
            self._q, self._share = q, 1.0
        else:
            self._share *= CALMING
        return self._share < CALM

    def _slices(self, seen: Sequence[tuple[Observed, Bool]], joints: JointSample, poses: Poses) -> Generator[None]:
        """The work of a look through the views in `seen`, which saw the links at `poses`."""
        if not seen:
            return
        skins = []
        for one, mask in seen:
            skins.append(self._skin(one, mask, joints.at(one.view.stamp)))
            yield
        shown = self._learn(skins, poses)
        yield
        own = self._sunk()
        yield
        self._bear(skins, shown, poses, own)

    def _learn(self, skins: Sequence[_Skin], poses: Poses) -> list[Rendering]:
        """One step of all that the Gaussians look like, before what stands behind the arm; what was seen before it."""
        g = self._gaussians
        rows, nobody, ones = g.robot_rows, g.standing(g.values[:0]), [skin.one for skin in skins]
        goal = goal_of(
            [one.view for one in ones],
            [skin.counted for skin in skins],
            [one.background.backdrop for one in ones],
            g.values.device,
            [one.rgb for one in ones],
        )
        if not len(rows):
            return goal.own(shoot(nobody, goal.shots))
        rates = rates_of(g.values.index_select(0, rows), RATE * self._share)
        rates[:, MEAN] *= MEANS
        carriage = carry(poses, g.nodes.index_select(0, rows))
        return descend(g, Path(rows, carriage, rates, nobody, goal), 1).seen

    def _sunk(self) -> _Own:
        """The arm's Gaussians, of which those that have come too near the surface of their link sink back."""
        g = self._gaussians
        rows = g.robot_rows
        values = g.values.index_select(0, rows)
        held = values.cpu().double()
        carriers, radii = g.nodes.index_select(0, rows).cpu(), held[:, LOG_SCALE].exp().mean(1).numpy()
        means = torch.from_numpy(self._links.beneath(carriers.numpy(), held[:, MEAN].numpy(), BENEATH * radii))
        values[:, MEAN] = means.to(values)
        g.values.index_copy_(0, rows, values)
        return _Own(means, carriers)

    def _skin(self, one: Observed, mask: Bool, joints: JointSample) -> _Skin:
        """Where the camera sees the arm: what is measured lies on it, or nothing known lies before it.

        Whole blocks off the arm's outline, which a Gaussian would stand out over.
        """
        height, width = (BLOCK * (side // BLOCK) for side in mask.shape)
        rows, columns = (BLOCK * at for at in np.nonzero(mask[:height:BLOCK, :width:BLOCK]))
        camera, background = one.view.camera, one.background
        rays = (background.rays[rows, columns] + background.rays[rows + BLOCK - 1, columns + BLOCK - 1]) / 2
        if one.view.depth is not None:
            depth = one.view.depth[rows, columns].astype(np.float64)
        else:
            depth = self._links.depths(joints, camera, rays)
            depth[(background.depth[rows, columns] < depth) | one.near_moving[rows, columns]] = 0
        points = camera.T_base_cam[:3, 3] + rays * depth[:, None]
        links = self._links.nearest(joints, points)
        depths = np.zeros((height // BLOCK, width // BLOCK), np.float32)
        depths[rows // BLOCK, columns // BLOCK] = np.where(links >= 0, depth, 0)
        whole = cv2.erode((depths > 0).astype(np.uint8), _CROSS, borderType=cv2.BORDER_REPLICATE) > 0
        inner = whole[rows // BLOCK, columns // BLOCK]
        own = mask if one.view.depth is not None else _pixels(whole, mask.shape)
        counted = (own | _around(one, mask, depths)) & ~one.near_moving
        return _Skin(one, rows[inner], columns[inner], points[inner], depth[inner], links[inner], counted)

    def _bear(self, skins: Sequence[_Skin], shown: Sequence[Rendering], poses: Poses, own: _Own) -> None:
        """New Gaussians where the arm looks otherwise than its Gaussians do and none of them is near.

        They lie a radius behind what is seen, see `BENEATH`.
        """
        for index, (skin, seen) in enumerate(zip(skins, shown, strict=True)):
            its = Poses(poses.positions[index], poses.quats[index])
            born = self._missing(skin, seen, its, own)
            if born is not None:
                self._gaussians.spawn(born, skin.one.view.stamp)
                own = own.with_newborns(born)

    def _missing(self, skin: _Skin, shown: Rendering, poses: Poses, own: _Own) -> Newborns | None:
        """What one view lacks of the arm, whose links were at `poses` [M, ...] then."""
        one = skin.one
        error = largest_channel(one.rgb[skin.rows, skin.columns], shown.colours_at(skin.rows, skin.columns))
        worst = np.argsort(-error, kind="stable")[:MOST_BORN]
        worst = worst[error[worst] > WRONG]
        if not len(worst):
            return None
        radii = SPREAD * BLOCK * skin.depth[worst] / one.view.camera.K[0, 0]
        rays = skin.points[worst] - one.view.camera.T_base_cam[:3, 3]
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        points = torch.from_numpy(skin.points[worst] + rays * radii[:, None])
        lonely = torch.cdist(points, own.placed(poses)).numpy().min(1, initial=np.inf) > LONELY * radii
        if not lonely.any():
            return None
        return self._newborns(skin, worst[lonely], points[torch.from_numpy(lonely)], radii[lonely], poses)

    def _newborns(
        self, skin: _Skin, chosen: NDArray[np.intp], points: Tensor, radii: Float64, poses: Poses
    ) -> Newborns:
        device = self._gaussians.values.device
        carriers = torch.from_numpy(skin.links[chosen])
        turn = conjugate(poses.quats[carriers])
        means = rotate(turn, points - poses.positions[carriers])
        rgb: Float32 = skin.one.rgb[skin.rows[chosen], skin.columns[chosen]]
        return Newborns(
            means.float().to(device),
            turn.float().to(device),
            torch.from_numpy(radii).float().to(device)[:, None].repeat(1, 3),
            torch.full((len(chosen),), NEWBORN_OPACITY, device=device),
            torch.from_numpy(rgb).to(device),
            Tier.ROBOT,
            carriers.to(device),
        )


def _around(one: Observed, mask: Bool, depths: Float32) -> Bool:
    """[H, W] pixels around the arm's `mask` that show what stands behind the arm, whose blocks lie `depths` m deep."""
    left, top, width, height = cv2.boundingRect(mask.view(np.uint8))
    box = _within(top, height, mask.shape[0]), _within(left, width, mask.shape[1])
    blocks = tuple(slice(side.start // BLOCK, -(-side.stop // BLOCK)) for side in box)
    stands = one.background.depth[box]
    if one.nearest is not None:
        stands = np.where(one.nearest[box] > 0, one.nearest[box], stands)
    behind = stands > _pixels(cv2.dilate(depths, _REACHED)[blocks], stands.shape)
    around = np.zeros(mask.shape, bool)
    around[box] = cv2.dilate(mask[box].view(np.uint8), _AROUND).view(bool) & behind & one.usable[box]
    return around


def _within(first: int, count: int, size: int) -> slice:
    """Whole blocks about `count` pixels from `first` on and those around them, of `size` in all."""
    end = -(-(first + count + AROUND_PX) // BLOCK) * BLOCK
    return slice(max(first - AROUND_PX, 0) // BLOCK * BLOCK, min(end, size))


def _pixels(blocks: NDArray[Any], shape: tuple[int, ...]) -> NDArray[Any]:
    """[H, W] of values [H // BLOCK, W // BLOCK] of blocks; zero in the rows and columns that fill none."""
    out = np.zeros(shape, blocks.dtype)
    whole = blocks.repeat(BLOCK, 0).repeat(BLOCK, 1)
    out[: whole.shape[0], : whole.shape[1]] = whole
    return out
