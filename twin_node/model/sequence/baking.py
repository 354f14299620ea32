"""Pre-baking: a model evaluated at its time steps into fixed buffers, played at the rate of a static model."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from twin_node import splat
from twin_node.errors import repeated
from twin_node.model.parameters import ModelError
from twin_node.model.ply import SH_C0, StoredGaussians
from twin_node.model.sequence.recording import nearest
from twin_node.model.sequence.sequence_model import MovedGaussians, SequenceModel
from twin_node.model.sequence.tensor_file import (
    camera_from_record,
    camera_record,
    colour_from_record,
    read_tensors,
    write_tensors,
)
from twin_node.scene import Camera, Float32, GaussianCloud, TwinState

FORMAT = "twin_node baked"
VERSION = 1
BATCH = 16
"""Time steps evaluated at once: what bounds the memory that baking takes beside its result."""
CLOUD_BYTES = 4 * (3 + 4 + 3 + 1 + 3)
"""Of a Gaussian of a published cloud: mean, quaternion, scale, opacity, colour."""
MOST_STEPS = 1_000_000
"""Their stamps and counts stand in the header: safetensors reads none of over 100 MB, and a step takes 30 bytes."""
MOST_BYTES = 8 * 2**30
"""Of buffers: baking holds them twice while it joins them."""


@dataclass(frozen=True)
class Baked:
    """Gaussians at T time steps, every attribute as it is drawn: playing one looks nothing up but its row.

    What all steps share is stored once: its first dimension is 1.
    """

    stamps: tuple[int, ...]
    """[T] rising, ns."""
    counts: tuple[int, ...]
    """[T] Gaussians of a step: the first rows of its buffers."""
    means: Tensor
    """[T or 1, N, 3] m."""
    quats: Tensor
    """[T or 1, N, 4] w, x, y, z."""
    scales: Tensor
    """[T or 1, N, 3] m."""
    opacities: Tensor
    """[T or 1, N] 0 to 1."""
    sh: Tensor
    """[T or 1, N, K, 3] harmonic coefficients."""
    background: tuple[float, float, float]
    """Red, green, blue, 0 to 1, where nothing is."""
    cameras: tuple[Camera, ...]
    """Those that the model was made from."""

    @property
    def is_whole(self) -> bool:
        """Whether it has a step, and stamps, counts and buffers of the shapes that belong together."""
        steps, rows = len(self.stamps), max(self.counts, default=0)
        harmonics = self.sh.shape[2] if self.sh.ndim > 2 else 0
        own = {"means": (3,), "quats": (4,), "scales": (3,), "opacities": (), "sh": (harmonics, 3)}
        return (
            0 < steps == len(self.counts)
            and all(count >= 0 for count in self.counts)
            and all(first < second for first, second in pairwise(self.stamps))
            and math.isqrt(harmonics) ** 2 == harmonics > 0
            and all(
                buffer.ndim >= 2
                and len(buffer) in (1, steps)
                and buffer.shape[1] >= rows
                and buffer.shape[2:] == own[name]
                for name, buffer in self._buffers().items()
            )
        )

    @property
    def bytes(self) -> int:
        """Size of the buffers."""
        return sum(buffer.nbytes for buffer in self._buffers().values())

    def render(self, camera: Camera, stamp: int) -> Float32:
        """[H, W, 3] 0 to 1: what `camera` sees at the time step nearest to `stamp` (ns)."""
        return self.render_step(camera, nearest(self.stamps, stamp))

    def render_step(self, camera: Camera, step: int) -> Float32:
        """[H, W, 3] 0 to 1: what `camera` sees at a time step; the background where it has no Gaussians."""
        count = self.counts[step]
        if not count:
            return np.full((camera.height, camera.width, 3), self.background, np.float32)
        means, quats, scales, opacities, sh = (
            buffer[min(step, len(buffer) - 1), :count] for buffer in self._buffers().values()
        )

        def tensor(values: object) -> Tensor:
            return torch.as_tensor(values, dtype=torch.float32, device=means.device)[None]

        with torch.no_grad():
            renders, _, _ = splat.rasterize(
                means,
                quats,
                scales,
                opacities,
                sh,
                tensor(camera.viewmat),
                tensor(camera.K),
                camera.width,
                camera.height,
                sh_degree=math.isqrt(sh.shape[1]) - 1,
                backgrounds=tensor(self.background),
            )
        image: Float32 = renders[0].clamp(0, 1).cpu().numpy()
        return image

    def stored(self, step: int) -> StoredGaussians:
        """The Gaussians of a time step as PLY files hold them."""
        means, quats, scales, opacities, sh = (
            buffer[min(step, len(buffer) - 1), : self.counts[step]].cpu() for buffer in self._buffers().values()
        )
        logits = opacities.double().clamp(1e-6, 1 - 1e-6).logit().float()
        return StoredGaussians(
            means.numpy(), quats.numpy(), scales.clamp_min(1e-9).log().numpy(), logits.numpy(), sh.numpy()
        )

    def _buffers(self) -> dict[str, Tensor]:
        return {name: getattr(self, name) for name in ("means", "quats", "scales", "opacities", "sh")}


def bake_model(model: SequenceModel, stamps: Sequence[int], cameras: tuple[Camera, ...]) -> Baked:
    """Evaluates a sequence model at stamps (ns, rising). Raises `ModelError` without stamps, or with too many."""
    if not stamps:
        raise ModelError("bake: expected one time step or more, found none")
    check_size(model, len(stamps))
    parts = []
    with torch.no_grad():
        for begin in range(0, len(stamps), BATCH):
            parts.append(model.at(stamps[begin : begin + BATCH]))
    last = parts[-1]
    moves = model.field is not None

    def buffer(chunks: list[Tensor]) -> Tensor:
        return torch.cat(chunks) if moves else chunks[0][:1].clone()

    return Baked(
        tuple(stamps),
        (len(model.gaussians),) * len(stamps),
        buffer([part.means for part in parts]),
        buffer([part.quats for part in parts]),
        buffer([part.scales for part in parts]),
        last.opacities[None].clone(),
        last.sh[None].clone(),
        model.background,
        cameras,
    )


def check_size(model: SequenceModel, steps: int) -> None:
    """Raises `ModelError` for more than `MOST_STEPS`, or where those of a model that moves are over `MOST_BYTES`."""
    if steps > MOST_STEPS:
        raise ModelError(f"bake: expected at most {MOST_STEPS} steps, found {repeated(steps)}; take fewer")
    moved = (model.gaussians.means, model.gaussians.quats, model.gaussians.log_scales)
    _check_bytes(steps if model.field is not None else 1, len(model.gaussians), sum(one[0].nbytes for one in moved))


def _check_bytes(steps: int, gaussians: int, per_gaussian: int) -> None:
    if steps * gaussians * per_gaussian > MOST_BYTES:
        raise ModelError(
            f"bake: expected buffers of at most {MOST_BYTES / 2**30:g} GiB, found more with {steps} steps of "
            f"{gaussians} Gaussians; take fewer steps"
        )


def bake_clouds(states: Iterable[TwinState]) -> Baked:
    """The clouds that a live model published, one time step each.

    Raises `ModelError` without states, and as soon as there are too many.
    """
    stamps: list[int] = []
    steps: list[MovedGaussians] = []
    cameras: dict[str, Camera] = {}
    most = 0
    for state in states:
        stamps.append(state.stamp)
        steps.append(moved_from_cloud(state.gaussians))
        most = max(most, len(state.gaussians.means))
        _check_bytes(len(steps), most, CLOUD_BYTES)
        for view in state.frames.views:
            cameras.setdefault(view.camera.name, view.camera)
    return bake_steps(stamps, steps, (0.0, 0.0, 0.0), tuple(cameras.values()))


def bake_steps(
    stamps: Sequence[int],
    steps: Sequence[MovedGaussians],
    background: tuple[float, float, float],
    cameras: tuple[Camera, ...],
) -> Baked:
    """Time steps with different Gaussians, each of one time, padded to the most. Raises `ModelError` without steps."""
    if not steps:
        raise ModelError("bake: expected one time step or more, found none; give a longer --duration")
    most = max(one.means.shape[1] for one in steps)

    def buffer(rows: Sequence[Tensor]) -> Tensor:
        packed = rows[0].new_zeros(len(rows), most, *rows[0].shape[1:])
        for step, values in enumerate(rows):
            packed[step, : len(values)] = values
        return packed

    return Baked(
        tuple(stamps),
        tuple(one.means.shape[1] for one in steps),
        buffer([one.means[0] for one in steps]),
        buffer([one.quats[0] for one in steps]),
        buffer([one.scales[0] for one in steps]),
        buffer([one.opacities for one in steps]),
        buffer([one.sh for one in steps]),
        background,
        cameras,
    )


def moved_from_cloud(cloud: GaussianCloud) -> MovedGaussians:
    """A published cloud as Gaussians of one time, degree 0."""
    return MovedGaussians(
        torch.from_numpy(cloud.means)[None],
        torch.from_numpy(cloud.quats)[None],
        torch.from_numpy(cloud.scales)[None],
        torch.from_numpy(cloud.opacities),
        torch.from_numpy(((cloud.rgb - 0.5) / SH_C0)[:, None].astype(np.float32)),
    )


def save_baked(baked: Baked, path: Path) -> None:
    """Writes buffers as safetensors. Raises `ModelError` where the file cannot be written."""
    header = {
        "stamps": list(baked.stamps),
        "counts": list(baked.counts),
        "background": list(baked.background),
        "cameras": [camera_record(camera) for camera in baked.cameras],
    }
    metadata = {"format": FORMAT, "version": str(VERSION), "header": json.dumps(header)}
    names = ("means", "quats", "scales", "opacities", "sh")
    write_tensors({name: getattr(baked, name) for name in names}, metadata, path)


def is_baked(path: Path) -> bool:
    """Whether a file is what `save_baked` wrote. Raises `ModelError` for one that holds no tensors."""
    return read_tensors(path).metadata.get("format") == FORMAT


def load_baked(path: Path) -> Baked:
    """Reads what `save_baked` wrote. Raises `ModelError` for any other file."""
    file = read_tensors(path)
    metadata = file.metadata
    if metadata.get("format") != FORMAT or metadata.get("version") != str(VERSION):
        found = f"{metadata.get('format', 'another kind of file')}, version {metadata.get('version', 'unknown')}"
        raise ModelError(f"{path}: expected buffers of twin_node bake, version {VERSION}, found {found}; bake it anew")
    try:
        header = json.loads(metadata["header"])
        baked = Baked(
            tuple(int(stamp) for stamp in header["stamps"]),
            tuple(int(count) for count in header["counts"]),
            file.tensors["means"],
            file.tensors["quats"],
            file.tensors["scales"],
            file.tensors["opacities"],
            file.tensors["sh"],
            colour_from_record(header["background"]),
            tuple(camera_from_record(record) for record in header["cameras"]),
        )
    except (AttributeError, KeyError, OverflowError, TypeError, ValueError) as error:
        raise ModelError(f"{path}: the header of the buffers is damaged ({error}); bake again") from None
    if not baked.is_whole:
        raise ModelError(f"{path}: the buffers are not those of their header; bake again")
    return baked
