"""The look of the arm: its Gaussians go where the joints say, and learn the sides that no camera had seen before."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from twin_node.model.adoption import NEWBORN_OPACITY
from twin_node.model.birth_depths import BLOCK
from twin_node.model.births import SPREAD
from twin_node.model.gaussians import RGB, Gaussians, Newborns
from twin_node.model.motion import Motion
from twin_node.model.nodes import Poses
from twin_node.model.observation import Observed, largest_channel
from twin_node.model.rays import look
from twin_node.model.rendering import Rendering, Splats, render
from twin_node.model.robot_links import RobotLinks
from twin_node.model.rotations import conjugate, rotate
from twin_node.scene import Bool, Float32, Float64, JointSample, Tier

UPTAKE = 0.3
"""Share of what a pixel misses that the Gaussian that shows there takes on: noise is averaged over about six looks."""
WRONG = 0.1
"""Difference of a channel (0 to 1) beyond which Gaussians are missing: what counts as change."""
MOST_BORN = 60
"""Gaussians born per look at most: a side that turns to a camera is whole within half a second."""
SHOWING_M = 0.01
"""How far behind what the arm's rendering shows a Gaussian may lie and still be what is seen, m."""
_AROUND = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))


@dataclass(frozen=True)
class _Skin:
    """Blocks of pixels in which a camera sees the arm itself."""

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


class ArmSkin:
    """Learns the colours of one arm's Gaussians, and makes new ones where none are; a set's share is `refine`."""

    def __init__(self, links: RobotLinks, gaussians: Gaussians, motion: Motion) -> None:
        self._links = links
        self._gaussians = gaussians
        self._motion = motion

    def refine(
        self, observed: Sequence[Observed], joints: JointSample, robots: Sequence[Bool | None]
    ) -> Generator[None]:
        """Looks at the arm through one camera after another; `robots` are its masks [H, W].

        Called while the links are where the set shows them; what it returns may be gone on with once they are not.
        """
        poses = [self._motion.poses([one.offset_s]) for one in observed]
        return self._slices(list(zip(observed, robots, poses, strict=True)), joints)

    def _slices(self, views: Sequence[tuple[Observed, Bool | None, Poses]], joints: JointSample) -> Generator[None]:
        """The work of a look through each of `views`, which saw the links at the poses beside it."""
        for one, mask, poses in views:
            if mask is not None and mask.any():
                yield from self._look(one, mask, joints, poses)
                yield

    def _look(self, one: Observed, mask: Bool, joints: JointSample, poses: Poses) -> Generator[None]:
        """Through one camera: drawn first, then learnt from."""
        skin = self._skin(one, mask, joints)
        rows = self._gaussians.robot_rows
        with torch.no_grad():
            placed = self._motion.place(self._gaussians, rows, poses, [one.view.stamp])
            shown = render(placed, [one.view.camera], [mask])[0]
        yield
        self._recolour(one, rows, placed, shown, skin)
        self._bear(one, placed, shown, skin, poses)

    def _skin(self, one: Observed, mask: Bool, joints: JointSample) -> _Skin:
        """Where the camera sees the arm: what is measured lies on it, or nothing known lies before it.

        Whole blocks off the arm's outline, which a Gaussian would stand out over.
        """
        height, width = (BLOCK * (side // BLOCK) for side in mask.shape)
        rows, columns = (BLOCK * at for at in np.nonzero(mask[:height:BLOCK, :width:BLOCK]))
        camera = one.view.camera
        rays = (one.background.rays[rows, columns] + one.background.rays[rows + BLOCK - 1, columns + BLOCK - 1]) / 2
        if one.view.depth is not None:
            depth = one.view.depth[rows, columns].astype(np.float64)
        else:
            depth = self._links.depths(joints, camera, rays)
            depth[(one.background.depth[rows, columns] < depth) | one.near_moving[rows, columns]] = 0
        points = camera.T_base_cam[:3, 3] + rays * depth[:, None]
        links = self._links.nearest(joints, points)
        own = np.zeros((height // BLOCK, width // BLOCK), np.uint8)
        own[rows // BLOCK, columns // BLOCK] = (depth > 0) & (links >= 0)
        inner = cv2.erode(own, _AROUND, borderType=cv2.BORDER_REPLICATE)[rows // BLOCK, columns // BLOCK] > 0
        return _Skin(rows[inner], columns[inner], points[inner], depth[inner], links[inner])

    def _recolour(self, one: Observed, rows: Tensor, placed: Splats, shown: Rendering, skin: _Skin) -> None:
        """What shows takes on some of what its pixel misses."""
        on_skin = np.zeros(one.usable.shape, bool)
        for down in range(BLOCK):
            for right in range(BLOCK):
                on_skin[skin.rows + down, skin.columns + right] = True
        seen = look(one.view.camera, placed.means[0].cpu().double().numpy())
        at = (seen.rows, seen.columns)
        depth = shown.depth.cpu().numpy()[at]
        front = seen.inside & on_skin[at] & (seen.depth < depth + SHOWING_M)
        missed = (one.rgb[at] - shown.rgb.cpu().numpy()[at])[front]
        chosen = rows[torch.from_numpy(front).to(rows.device)]
        rgb = self._gaussians.values[chosen, RGB] + UPTAKE * torch.from_numpy(missed).to(rows.device)
        self._gaussians.values[chosen, RGB] = rgb.clamp(0, 1)

    def _bear(self, one: Observed, placed: Splats, shown: Rendering, skin: _Skin, poses: Poses) -> None:
        """New Gaussians where the arm looks otherwise than its Gaussians do and none of them is near.

        They lie a radius behind what is seen: on the surface itself half of each would stand out over the arm's
        outline as other cameras see it.
        """
        if not len(skin.rows):
            return
        at = (skin.rows, skin.columns)
        error = largest_channel(one.rgb[at], shown.rgb.cpu().numpy()[at])
        worst = np.argsort(-error, kind="stable")[:MOST_BORN]
        worst = worst[error[worst] > WRONG]
        radii = SPREAD * BLOCK * skin.depth[worst] / one.view.camera.K[0, 0]
        rays = skin.points[worst] - one.view.camera.T_base_cam[:3, 3]
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        points = skin.points[worst] + rays * radii[:, None]
        apart = torch.cdist(torch.from_numpy(points), placed.means[0].cpu().double()).numpy()
        lonely = apart.min(1, initial=np.inf) > radii  # nothing is near where the arm has no Gaussians yet
        if lonely.any():
            born = self._newborns(one, skin, worst[lonely], points[lonely], radii[lonely], poses)
            self._gaussians.spawn(born, one.view.stamp)

    def _newborns(
        self, one: Observed, skin: _Skin, chosen: NDArray[np.intp], points: Float64, radii: Float64, poses: Poses
    ) -> Newborns:
        device = self._gaussians.values.device
        carriers = torch.from_numpy(skin.links[chosen])
        turn = conjugate(poses.quats[0, carriers])
        means = rotate(turn, torch.from_numpy(points) - poses.positions[0, carriers])
        rgb: Float32 = one.rgb[skin.rows[chosen], skin.columns[chosen]]
        return Newborns(
            means.float().to(device),
            turn.float().to(device),
            torch.from_numpy(radii).float().to(device)[:, None].repeat(1, 3),
            torch.full((len(chosen),), NEWBORN_OPACITY, device=device),
            torch.from_numpy(rgb).to(device),
            Tier.ROBOT,
            carriers.to(device),
        )
