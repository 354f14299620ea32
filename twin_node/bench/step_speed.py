"""How long a step of Gaussians that learn takes on CUDA, recorded as graphs and launched kernel by kernel."""

from __future__ import annotations

import time
from typing import Any

import torch
from torch import Tensor

from twin_node.bench.raster_scene import RoomScene
from twin_node.splat import Aims, Bystanders, Course, Learners
from twin_node.splat.captured_descent import Captured, Unrecorded, descend_captured

STEPS = 3
"""Of a course, as the tracker takes them per set."""
SMALLEST_LOG_SCALE = -7.6


def time_steps(scene: RoomScene, learning: float, repetitions: int) -> dict[str, Any]:
    """Best times of a step (ms), what a course needs before and after it shared out, where a share is `learning`.

    Those that do not learn stand before what does; only pixels in a block of each image that holds the same share
    are drawn.
    """
    learners, bystanders, aims = _course(scene, learning)
    course = Course(STEPS, SMALLEST_LOG_SCALE)
    times = {}
    for name, kind in (("recorded_ms", Captured), ("unrecorded_ms", Unrecorded)):
        best = float("inf")
        for _ in range(1 + repetitions):
            torch.cuda.synchronize()
            start = time.perf_counter()
            descend_captured(learners, bystanders, aims, course, kind)
            torch.cuda.synchronize()
            best = min(best, time.perf_counter() - start)
        times[name] = round(1e3 * best / STEPS, 3)
    size = scene.size
    return {"n": size.n, "width": size.width, "height": size.height, "learning": learning, **times}


def _course(scene: RoomScene, learning: float) -> tuple[Learners, Bystanders, Aims]:
    times, size, device = len(scene.viewmats), scene.size, scene.means.device
    count = round(learning * size.n)
    opacities = torch.logit(scene.opacities.clamp(0.01, 0.99))[:, None]
    values = torch.cat([scene.means, scene.quats, scene.scales.log(), opacities, scene.sh[:, 0]], 1)[:count]
    eye = torch.eye(4, device=device)
    learners = Learners(
        torch.arange(count, device=device),
        values.contiguous(),
        torch.zeros_like(values),
        torch.zeros_like(values),
        torch.zeros(count, dtype=torch.int64, device=device),
        torch.zeros(count, device=device),
        torch.full((count, values.shape[1]), 1e-5, device=device),
        eye[:3, :3].repeat(times, 1, 1, 1),
        torch.zeros(times, 1, 3, device=device),
        eye.repeat(times, 1, 1, 1),
        torch.zeros(count, dtype=torch.int64, device=device),
    )
    bystanders = Bystanders(
        scene.means[count:].expand(times, -1, -1),
        scene.quats[count:].expand(times, -1, -1),
        scene.scales[count:],
        scene.opacities[count:],
        scene.sh[count:, 0].contiguous(),
    )
    return learners, bystanders, _aims(scene, learning)


def _aims(scene: RoomScene, learning: float) -> Aims:
    size, device = scene.size, scene.means.device
    shape = (len(scene.viewmats), size.height, size.width)
    random = torch.Generator().manual_seed(2)

    def drawn(*channels: int) -> Tensor:
        return torch.rand(*shape, *channels, generator=random).to(device)

    mask = torch.zeros(shape, dtype=torch.bool, device=device)
    side = learning**0.5
    mask[:, : round(side * size.height), : round(side * size.width)] = True
    backdrop = drawn(4) + torch.tensor([0.0, 0, 0, 4], device=device)
    return Aims(scene.viewmats, scene.Ks, backdrop, mask, drawn(3), mask.float(), 3 * drawn(), 0.05)
