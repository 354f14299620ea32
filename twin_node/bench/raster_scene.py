"""A made-up room for measuring rasterisers."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

from twin_node.model.ply import SH_C0

FIELD_OF_VIEW = math.radians(70)


@dataclass(frozen=True)
class Size:
    """One scene and image size."""

    n: int
    width: int
    height: int
    sh_degree: int = 0


@dataclass(frozen=True)
class RoomScene:
    """Gaussians of a 6 x 6 x 3 m room with round objects in it, flat on their surfaces, and cameras inside."""

    means: Tensor
    quats: Tensor
    scales: Tensor
    opacities: Tensor
    sh: Tensor
    viewmats: Tensor
    Ks: Tensor
    size: Size

    def leaves(self) -> list[Tensor]:
        """What gradients are taken of."""
        return [self.means, self.quats, self.scales, self.opacities, self.sh]


def room(size: Size, device: str = "cpu", cameras: int = 3) -> RoomScene:
    """The same room for each size, with up to four cameras."""
    random = torch.Generator().manual_seed(0)
    walls, objects = int(0.45 * size.n), size.n - int(0.45 * size.n)
    wall_points, wall_normals = _walls(walls, random)
    object_points, object_normals, object_spacing = _objects(objects, random)
    means, normals = torch.cat([wall_points, object_points]), torch.cat([wall_normals, object_normals])
    spacing = torch.cat([torch.full((walls,), math.sqrt(144 / walls)), torch.full((objects,), object_spacing)])
    scales = 0.6 * spacing[:, None] * torch.exp(0.35 * torch.randn(size.n, 3, generator=random))
    scales[:, 2] *= 0.15
    sh = 0.15 * torch.randn(size.n, (size.sh_degree + 1) ** 2, 3, generator=random)
    sh[:, 0] = (torch.rand(size.n, 3, generator=random) - 0.5) / SH_C0
    opacities = torch.sigmoid(1.8 * torch.randn(size.n, generator=random) + 0.8)
    shuffled = torch.randperm(size.n, generator=random)
    focal = size.width / 2 / math.tan(FIELD_OF_VIEW / 2)
    K = torch.tensor([[focal, 0, size.width / 2], [0, focal, size.height / 2], [0, 0, 1]])
    eyes = ((2.4, 2.2, 1.8), (-2.5, 1.5, 1.2), (0.3, -2.6, 2.2), (-1.2, 2.6, 2.0))[:cameras]
    viewmats = torch.stack([_look_at(torch.tensor(eye), torch.tensor([0.0, 0.0, 0.75])) for eye in eyes])
    return RoomScene(
        means=means[shuffled].to(device),
        quats=_turn_z_to(normals)[shuffled].to(device),
        scales=scales[shuffled].to(device),
        opacities=opacities[shuffled].to(device),
        sh=sh[shuffled].to(device),
        viewmats=viewmats.to(device),
        Ks=K.repeat(cameras, 1, 1).to(device),
        size=size,
    )


def _walls(count: int, random: torch.Generator) -> tuple[Tensor, Tensor]:
    """Points and inward normals on floor, ceiling and walls, in proportion to their areas."""
    points = torch.rand(count, 3, generator=random) * torch.tensor([6.0, 6.0, 3.0]) - torch.tensor([3.0, 3.0, 0.0])
    faces = torch.multinomial(torch.tensor([36.0, 36, 18, 18, 18, 18]), count, replacement=True, generator=random)
    normals = torch.zeros(count, 3)
    for face, (axis, at) in enumerate(((2, 0.0), (2, 3.0), (0, -3.0), (0, 3.0), (1, -3.0), (1, 3.0))):
        points[faces == face, axis] = at
        normals[faces == face, axis] = 1.0
    return points, normals


def _objects(count: int, random: torch.Generator) -> tuple[Tensor, Tensor, float]:
    """Points and normals on fourteen spheres, and the spacing of the points in metres."""
    extent, centre = torch.tensor([4.0, 4.0, 1.4]), torch.tensor([0.0, 0.0, 0.9])
    centres = (torch.rand(14, 3, generator=random) - 0.5) * extent + centre
    radii = 0.15 + 0.35 * torch.rand(14, generator=random)
    chosen = torch.multinomial(radii**2, count, replacement=True, generator=random)
    normals = F.normalize(torch.randn(count, 3, generator=random), dim=-1)
    area = float((4 * math.pi * radii**2).sum())
    return centres[chosen] + normals * radii[chosen, None], normals, math.sqrt(area / count)


def _turn_z_to(normals: Tensor) -> Tensor:
    """Quaternions [N, 4] (not normalised) that turn z to unit normals [N, 3]: 1 + cos, and the cross product."""
    straight_down = normals[:, 2] < -0.999
    w = torch.where(straight_down, 0.0, 1 + normals[:, 2])
    x = torch.where(straight_down, 1.0, -normals[:, 1])
    return torch.stack([w, x, normals[:, 0], torch.zeros_like(w)], dim=-1)


def _look_at(eye: Tensor, target: Tensor) -> Tensor:
    forward = F.normalize(target - eye, dim=0)
    right = F.normalize(torch.linalg.cross(forward, torch.tensor([0.0, 0.0, 1.0])), dim=0)
    viewmat = torch.eye(4)
    viewmat[:3, :3] = torch.stack([right, torch.linalg.cross(forward, right), forward])
    viewmat[:3, 3] = -viewmat[:3, :3] @ eye
    return viewmat
