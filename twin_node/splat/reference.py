"""The rasteriser in plain torch: what the compiled backends are held to, and what runs where there is no compiler.

Written for clarity, differentiated by autograd, in float32 or float64. EWA projection and blending as in gsplat 1.5.3;
sources beside each step.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor
from torch.utils.checkpoint import checkpoint

from twin_node.splat.arguments import RasterMeta, Rendered, Scene
from twin_node.splat.semantics import (
    ALPHA_THRESHOLD,
    EXTENT_SIGMAS,
    SMALLEST_ALPHA,
    TRANSMITTANCE_CUT,
    Semantics,
    installed_semantics,
)

TILE = 8
"""Pixels along the side of a tile: small ones keep the temporaries in the cache."""

CHUNK_ELEMENTS = 300_000
"""Elements (tiles x Gaussians x pixels) evaluated at once: about what the second-level cache holds."""


@dataclass(frozen=True)
class Projected:
    """Gaussians of one image."""

    means2d: Tensor
    """[N, 2] pixels."""
    conics: Tensor
    """[N, 3] a, b, c of the inverse covariance ((a, b), (b, c)), 1 / pixel^2."""
    depths: Tensor
    """[N]."""
    opacities: Tensor
    """[N] after compensation."""
    radii: Tensor
    """[N, 2] pixels, whole; zero where culled."""
    reach: Tensor
    """[N, 2] pixels beyond which alpha is under the threshold."""


def render_reference(scene: Scene, semantics: Semantics | None = None) -> Rendered:
    """Renders all images of a call, one after the other."""
    semantics = semantics or installed_semantics()
    images = [
        _render_image(scene, batch, camera, semantics)
        for batch in range(scene.batches)
        for camera in range(scene.cameras)
    ]
    lead = scene.image_shape[:-2]
    stacked = [torch.stack(parts) for parts in zip(*images, strict=True)]
    renders, alphas, radii, means2d, depths = (part.reshape(*lead, *part.shape[1:]) for part in stacked)
    return Rendered(renders, alphas, RasterMeta(radii, means2d, depths))


def _render_image(scene: Scene, batch: int, camera: int, semantics: Semantics) -> tuple[Tensor, ...]:
    views, options, g = scene.views, scene.options, scene.gaussians
    own = [
        _of_batch(t, rank, batch, scene) for t, rank in ((g.means, 2), (g.quats, 2), (g.scales, 2), (g.opacities, 1))
    ]
    means, quats, scales, opacities = own
    viewmat = views.viewmats.reshape(-1, scene.cameras, 4, 4)[batch, camera]
    K = views.Ks.reshape(-1, scene.cameras, 3, 3)[batch, camera]
    p = project(scene, semantics, means, quats, scales, opacities, viewmat, K)
    colors = _channels(scene, batch, camera, means, viewmat, p)
    mask = None
    if views.pixel_mask is not None:
        mask = views.pixel_mask.reshape(-1, scene.cameras, views.height, views.width)[batch, camera]
    image = _blend(p, colors, views.width, views.height, mask, semantics)
    render, left = image[..., :-1], image[..., -1:]
    alpha = 1 - left
    if options.with_color and views.backgrounds is not None:
        background = views.backgrounds.reshape(-1, scene.cameras, views.backgrounds.shape[-1])[batch, camera]
        behind = F.pad(background, (0, int(options.with_depth)))
        if mask is not None:
            behind = torch.where(mask[..., None], behind, behind.detach())
        render = render + left * behind
    if options.expected_depth:
        render = torch.cat([render[..., :-1], render[..., -1:] / alpha.clamp_min(SMALLEST_ALPHA)], dim=-1)
    drawn = (p.radii > 0).all(-1)
    means2d = torch.where(drawn[:, None], p.means2d, 0).detach()
    return render, alpha, p.radii, means2d, torch.where(drawn, p.depths, 0).detach()


def _of_batch(tensor: Tensor, rank: int, batch: int, scene: Scene) -> Tensor:
    return tensor if tensor.dim() == rank else tensor.reshape(scene.batches, *tensor.shape[-rank:])[batch]


def rotation_matrices(quats: Tensor) -> Tensor:
    """Rotations [N, 3, 3] of quaternions [N, 4] (w, x, y, z) of any norm."""
    w, x, y, z = F.normalize(quats, dim=-1).unbind(-1)
    rows = [
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    ]  # fmt: skip
    return torch.stack(rows, dim=-1).reshape(-1, 3, 3)


def project(
    scene: Scene,
    semantics: Semantics,
    means: Tensor,  # [N, 3]
    quats: Tensor,  # [N, 4]
    scales: Tensor,  # [N, 3]
    opacities: Tensor,  # [N]
    viewmat: Tensor,  # [4, 4]
    K: Tensor,  # [3, 3]
) -> Projected:
    """EWA projection into one camera (Zwicker et al. 2002; gsplat's ProjectionEWA3DGSFused.cu)."""
    options, width, height = scene.options, scene.views.width, scene.views.height
    R = viewmat[:3, :3]
    x, y, z = (means @ R.T + viewmat[:3, 3]).unbind(-1)
    in_depth = (z >= options.near_plane) & (z <= options.far_plane)
    z_safe = torch.where(in_depth, z, 1.0)  # keeps culled rows, and their gradients, finite
    fx, fy, cx, cy = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
    means2d = torch.stack([fx * x / z_safe + cx, fy * y / z_safe + cy], dim=-1)
    margin_x, margin_y = 0.15 * width / fx, 0.15 * height / fy  # 0.3 of the half field of view
    ux = torch.clamp(x / z_safe, -(cx / fx + margin_x), (width - cx) / fx + margin_x)
    uy = torch.clamp(y / z_safe, -(cy / fy + margin_y), (height - cy) / fy + margin_y)
    axes = R @ (rotation_matrices(quats) * scales[:, None, :])  # columns are the half axes in the camera
    px = (fx / z_safe)[:, None] * (axes[:, 0] - ux[:, None] * axes[:, 2])
    py = (fy / z_safe)[:, None] * (axes[:, 1] - uy[:, None] * axes[:, 2])
    xx, xy, yy = (px * px).sum(-1), (px * py).sum(-1), (py * py).sum(-1)
    det_sharp = torch.linalg.cross(px, py).square().sum(-1)  # xx * yy - xy^2 without its cancellation
    xx_blur, yy_blur = xx + options.eps2d, yy + options.eps2d
    det = det_sharp + options.eps2d * (xx + yy_blur)
    in_depth = in_depth & (det > 0)
    det = torch.where(in_depth, det, 1.0)
    conics = torch.stack([yy_blur, -xy, xx_blur], dim=-1) / det[:, None]
    if options.rasterize_mode == "antialiased":
        # the floor under the square root lies far below any opacity that is drawn, and keeps its gradient finite
        opacities = opacities * torch.sqrt((det_sharp / det).clamp_min(max(semantics.min_compensation**2, 1e-8)))
    radii, reach = _extents(scene, means2d, xx_blur, yy_blur, opacities, in_depth)
    return Projected(means2d, conics, z, opacities, radii, reach)


@torch.no_grad()
def _extents(
    scene: Scene, means2d: Tensor, xx: Tensor, yy: Tensor, opacities: Tensor, drawn: Tensor
) -> tuple[Tensor, Tensor]:
    """Radii (zero where culled) and reach, [N, 2] each, of opacity-aware boxes (arXiv 2402.00525, section B.2)."""
    views = scene.views
    sigmas = torch.sqrt((2 * torch.log(opacities.clamp_min(1e-12) / ALPHA_THRESHOLD)).clamp_min(0))[:, None]
    deviation = torch.sqrt(torch.stack([xx, yy], dim=-1))
    radii = torch.ceil(sigmas.clamp_max(EXTENT_SIGMAS) * deviation)
    size = torch.tensor([views.width, views.height], device=means2d.device)
    on_image = ((means2d + radii > 0) & (means2d - radii < size)).all(-1)
    large = (radii > scene.options.radius_clip).any(-1)
    drawn = drawn & (opacities >= ALPHA_THRESHOLD) & on_image & large
    return torch.where(drawn[:, None], radii.clamp_max(1e9), 0).to(torch.int32), sigmas * deviation


def harmonics(degree: int, directions: Tensor) -> Tensor:
    """Real spherical harmonics [N, (degree + 1)^2] in unit directions [N, 3] (Sloan, JCGT 2013, appendix A2)."""
    x, y, z = directions.unbind(-1)
    bands = [torch.full_like(x, 0.28209479177387814)]
    if degree >= 1:
        bands += [-0.48860251190292 * y, 0.48860251190292 * z, -0.48860251190292 * x]
    cos2, sin2 = x * x - y * y, 2 * x * y
    if degree >= 2:
        bands += [0.5462742152960395 * sin2, -1.092548430592079 * y * z]
        bands += [0.9461746957575601 * z * z - 0.3153915652525201]
        bands += [-1.092548430592079 * x * z, 0.5462742152960395 * cos2]
    if degree >= 3:
        band2, band3 = 0.4570457994644658 - 2.285228997322329 * z * z, 1.445305721320277 * z
        bands += [-0.5900435899266435 * (x * sin2 + y * cos2), band3 * sin2, band2 * y]
        bands += [z * (1.865881662950577 * z * z - 1.119528997770346)]
        bands += [band2 * x, band3 * cos2, -0.5900435899266435 * (x * cos2 - y * sin2)]
    return torch.stack(bands, dim=-1)


def _channels(scene: Scene, batch: int, camera: int, means: Tensor, viewmat: Tensor, p: Projected) -> Tensor:
    """Values [N, channels] that one camera blends."""
    degree, colors = scene.options.sh_degree, scene.gaussians.colors
    depth = [p.depths[:, None]] if scene.options.with_depth else []
    if not scene.options.with_color:
        return depth[0]
    rank = 1 + scene.color_rank
    if scene.colors_per_camera:
        colors = colors.reshape(-1, scene.cameras, *colors.shape[-rank:])[batch, camera]
    else:
        colors = _of_batch(colors, rank, batch, scene)
    if degree is not None:
        position = torch.linalg.inv(viewmat)[:3, 3]
        bases = harmonics(degree, F.normalize(means - position, dim=-1))
        colors = ((bases[..., None] * colors[:, : bases.shape[-1]]).sum(-2) + 0.5).clamp_min(0)
    return torch.cat([colors, *depth], dim=-1)


@dataclass(frozen=True)
class _TileLists:
    """Gaussians of each tile, nearest first."""

    gaussians: Tensor
    """[intersections] rows, tile by tile."""
    begin: Tensor
    """[tiles] first of a tile's."""
    count: Tensor
    """[tiles]."""
    columns: int
    rows: int


@torch.no_grad()
def _tile_lists(p: Projected, width: int, height: int, mask: Tensor | None) -> _TileLists:
    columns, rows = -(-width // TILE), -(-height // TILE)
    device = p.means2d.device
    visible = torch.nonzero((p.radii > 0).all(-1))[:, 0]
    # depths are compared as float32, as the compiled backends do, so that ties are the same ones
    visible = visible[torch.argsort(p.depths[visible].float(), stable=True)]
    last = torch.tensor([columns - 1, rows - 1], device=device)
    low = torch.floor((p.means2d - p.reach - 0.5)[visible] / TILE).clamp(min=0).minimum(last + 1).long()
    high = torch.floor((p.means2d + p.reach - 0.5)[visible] / TILE).clamp(min=-1).minimum(last).long()
    spans = (high - low + 1).clamp_min(0)
    counts = spans.prod(-1)
    row = torch.repeat_interleave(torch.arange(len(visible), device=device), counts)
    within = torch.arange(len(row), device=device) - (torch.cumsum(counts, 0) - counts)[row]
    tile_x = low[row, 0] + within % spans[row, 0]
    tile = (low[row, 1] + within // spans[row, 0]) * columns + tile_x
    if mask is not None:
        padded = F.pad(mask.float(), (0, columns * TILE - width, 0, rows * TILE - height))
        selected = F.max_pool2d(padded[None, None], TILE).flatten()[tile] > 0
        row, tile = row[selected], tile[selected]
    order = torch.argsort(tile, stable=True)
    count = torch.bincount(tile, minlength=columns * rows)
    return _TileLists(visible[row[order]], torch.cumsum(count, 0) - count, count, columns, rows)


def _blend(p: Projected, colors: Tensor, width: int, height: int, mask: Tensor | None, semantics: Semantics) -> Tensor:
    """[H, W, channels + 1]: blended channels and the transmittance that is left."""
    lists = _tile_lists(p, width, height, mask)
    tiles, channels = lists.columns * lists.rows, colors.shape[-1]
    # sums over no rows: where nothing is drawn, an image is a function of what was given all the same, of gradient zero
    nothing = sum(given[:0].sum() for given in (p.means2d, p.conics, p.opacities, colors))
    empty = torch.cat([colors.new_zeros(TILE * TILE, channels), colors.new_ones(TILE * TILE, 1)], dim=-1) + nothing
    pieces, places = [], []
    for chunk in _chunks(lists.count):
        pieces.append(checkpoint(_blend_tiles, chunk, lists, p, colors, semantics, use_reentrant=False))
        places.append(chunk)
    flat = empty.expand(tiles, -1, -1)
    if pieces:
        flat = flat.index_copy(0, torch.cat(places), torch.cat(pieces))
    image = flat.reshape(lists.rows, lists.columns, TILE, TILE, channels + 1).permute(0, 2, 1, 3, 4)
    image = image.reshape(lists.rows * TILE, lists.columns * TILE, channels + 1)[:height, :width]
    return image if mask is None else torch.where(mask[..., None], image, empty[0])


def _chunks(count: Tensor) -> list[Tensor]:
    """Tiles with Gaussians in groups of similar length."""
    order = torch.argsort(count, descending=True)
    order = order[count[order] > 0]
    lengths, chunks, first = count[order].tolist(), [], 0
    while first < len(lengths):
        size = max(1, CHUNK_ELEMENTS // (lengths[first] * TILE * TILE))
        chunks.append(order[first : first + size])
        first += size
    return chunks


def _blend_tiles(tiles: Tensor, lists: _TileLists, p: Projected, colors: Tensor, semantics: Semantics) -> Tensor:
    """[T, pixels, channels + 1] of some tiles, front to back (Kerbl et al. 2023, eq. 3)."""
    dtype, device = colors.dtype, colors.device
    longest = int(lists.count[tiles].max())
    place = torch.arange(longest, device=device)
    listed = place < lists.count[tiles][:, None]  # [T, K]
    rows = lists.gaussians[(lists.begin[tiles][:, None] + place).where(listed, lists.begin[tiles][:, None])]
    pixel = torch.arange(TILE * TILE, device=device)
    x = (tiles % lists.columns * TILE)[:, None] + pixel % TILE + torch.tensor(0.5, dtype=dtype)
    y = (tiles // lists.columns * TILE)[:, None] + pixel // TILE + torch.tensor(0.5, dtype=dtype)
    dx = p.means2d[rows][..., 0:1] - x[:, None]  # [T, K, pixels]
    dy = p.means2d[rows][..., 1:2] - y[:, None]
    a, b, c = p.conics[rows].unsqueeze(-2).unbind(-1)
    sigma = 0.5 * (a * dx * dx + c * dy * dy) + b * dx * dy
    alpha = (p.opacities[rows][..., None] * torch.exp(-sigma)).clamp_max(semantics.max_alpha)
    alpha = torch.where((sigma >= 0) & (alpha >= ALPHA_THRESHOLD) & listed[..., None], alpha, 0)
    behind = torch.cumprod(1 - alpha, dim=1)
    alpha = torch.where(behind > TRANSMITTANCE_CUT, alpha, 0)
    behind = torch.cumprod(1 - alpha, dim=1)
    before = torch.cat([torch.ones_like(behind[:, :1]), behind[:, :-1]], dim=1)
    blended = torch.einsum("tkp,tkc->tpc", alpha * before, colors[rows])
    return torch.cat([blended, behind[:, -1, :, None]], dim=-1)
