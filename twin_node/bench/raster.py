"""How fast the rasteriser's backends are: `twin_node bench raster`."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from twin_node.bench.raster_scene import RoomScene, Size, room
from twin_node.bench.step_speed import time_steps
from twin_node.bench.text_table import text_table
from twin_node.splat import image_loss, rasterize, rasterize_reference

TRAINING, MASKED = Size(5000, 160, 120), Size(10000, 320, 240)


@dataclass(frozen=True)
class RasterBench:
    """What to measure."""

    cpu: tuple[Size, ...] = tuple(
        Size(n, width, height, degree)
        for n in (2000, 5000, 10000, 20000)
        for width, height in ((160, 120), (320, 240))
        for degree in (0, 2)
    )
    plain: tuple[Size, ...] = (Size(5000, 160, 120), Size(10000, 320, 240))
    cuda: tuple[Size, ...] = (Size(10000, 320, 240), Size(100000, 640, 480), Size(100000, 640, 480, 2))
    steps: tuple[Size, ...] = (Size(100000, 640, 480),)
    learning: tuple[float, ...] = (1.0, 0.0625)
    """Shares of the Gaussians that take the steps, and of the pixels that lead them."""
    training: Size = TRAINING
    masked: Size = MASKED
    repetitions: int = 30
    """Calls of each kind; the best one counts, as anything else on the machine only adds to it."""
    plain_repetitions: int = 3


def run(bench: RasterBench | None = None) -> dict[str, Any]:
    """Measures and gives the JSON object of `twin_node bench raster --json`, times in milliseconds.

    `cuda` and `steps` are null without a CUDA device; `gsplat_...` beside its figures is gsplat called directly.
    """
    bench = bench or RasterBench()
    on_cuda = torch.cuda.is_available()
    return {
        "cpu": [_measure(rasterize, room(size), bench.repetitions) for size in bench.cpu],
        "plain": [_measure(rasterize_reference, room(size), bench.plain_repetitions) for size in bench.plain],
        "cuda": [_measure_cuda(room(size, "cuda"), bench.repetitions) for size in bench.cuda] if on_cuda else None,
        "steps": _time_steps(bench) if on_cuda else None,
        "training_iteration_ms": _training_iteration(bench),
        "masked_ratio": _masked_ratio(bench),
    }


def table(report: dict[str, Any]) -> str:
    """The report as lines to read."""
    rows = [
        (
            backend,
            str(row["n"]),
            f"{row['width']}x{row['height']}",
            str(row["sh_degree"]),
            *(f"{row[time]:.2f}" for time in ("forward_ms", "forward_backward_ms")),
        )
        for backend in ("cpu", "plain", "cuda")
        for row in report[backend] or []
    ]
    lines = [text_table(("backend", "Gaussians", "image", "SH", "forward ms", "with backward ms"), rows)]
    for row in report["steps"] or []:
        share = f"{100 * row['learning']:.0f} % of {row['n']} learning"
        lines.append(
            f"step with 4 cameras of {row['width']}x{row['height']}, {share}: {row['recorded_ms']:.2f} ms, "
            f"unrecorded {row['unrecorded_ms']:.2f} ms"
        )
    lines.append(f"training iteration, 3 cameras: {report['training_iteration_ms']:.2f} ms")
    lines.append(f"5 % of the pixels against all: {report['masked_ratio']:.2f}")
    return "\n".join(lines)


def _best_ms(call: Callable[[], None], repetitions: int) -> float:
    call()
    best = math.inf
    for _ in range(repetitions):
        start = time.perf_counter()
        call()
        if torch.cuda.is_available():
            torch.cuda.synchronize()
        best = min(best, time.perf_counter() - start)
    return 1e3 * best


def _time_passes(render: Callable[[], list[Tensor]], leaves: list[Tensor], repetitions: int) -> tuple[float, float]:
    """Best times of the forward pass alone and with the backward pass, ms."""
    weights = [torch.randn_like(image) for image in render()]

    def forward() -> None:
        with torch.no_grad():
            render()

    def forward_backward() -> None:
        torch.autograd.grad(render(), leaves, weights)

    without = _best_ms(forward, repetitions)
    for leaf in leaves:
        leaf.requires_grad_()
    return without, _best_ms(forward_backward, repetitions)


def _measure(renderer: Callable[..., Any], scene: RoomScene, repetitions: int, **options: Any) -> dict[str, Any]:
    """One camera, colours and depth."""
    size = scene.size

    def render() -> list[Tensor]:
        cameras = (scene.viewmats[:1], scene.Ks[:1], size.width, size.height)
        return list(renderer(*scene.leaves(), *cameras, sh_degree=size.sh_degree, render_mode="RGB+D", **options)[:2])

    forward, both = _time_passes(render, scene.leaves(), repetitions)
    return {**vars(size), "forward_ms": round(forward, 3), "forward_backward_ms": round(both, 3)}


def _measure_cuda(scene: RoomScene, repetitions: int) -> dict[str, Any]:
    ours = _measure(rasterize, scene, repetitions)
    from gsplat import rasterization

    alone = _measure(rasterization, scene, repetitions, packed=False)
    times = {f"gsplat_{name}": alone[name] for name in ("forward_ms", "forward_backward_ms")}
    return {**ours, **times}


def _time_steps(bench: RasterBench) -> list[dict[str, Any]]:
    scenes = [room(size, "cuda", 4) for size in bench.steps]
    return [time_steps(scene, learning, bench.repetitions) for scene in scenes for learning in bench.learning]


def _training_iteration(bench: RasterBench) -> float:
    """Three cameras in one call, fused loss with depth, backward pass and a fused Adam step over all parameters."""
    scene, size = room(bench.training), bench.training
    options: dict[str, Any] = {"sh_degree": size.sh_degree, "render_mode": "RGB+D"}
    cameras = (scene.viewmats, scene.Ks, size.width, size.height)
    s = scene
    target, _, _ = rasterize(s.means, s.quats, s.scales, s.opacities, s.sh, *cameras, **options)
    random = torch.Generator().manual_seed(1)
    raw = [scene.means, scene.quats, scene.scales.log(), torch.logit(scene.opacities.clamp(0.01, 0.99)), scene.sh]
    raw = [(t + 0.01 * torch.randn(t.shape, generator=random)).requires_grad_() for t in raw]
    optimizer = torch.optim.Adam([{"params": [t]} for t in raw], lr=1e-3, eps=1e-15, fused=True)
    colors, depth = target[..., :3].contiguous(), target[..., 3].contiguous()

    def iterate() -> None:
        optimizer.zero_grad()
        means, quats, log_scales, logits, sh = raw
        renders, _, _ = rasterize(means, quats, log_scales.exp(), torch.sigmoid(logits), sh, *cameras, **options)
        torch.autograd.backward(image_loss(renders, colors, target_depth=depth, depth_weight=0.1))
        optimizer.step()

    return round(_best_ms(iterate, bench.repetitions), 3)


def _masked_ratio(bench: RasterBench) -> float:
    """Time of a frame with its gradient where 5 % of the pixels are selected, as a share of that of the whole frame."""
    size = bench.masked
    mask = torch.zeros(1, size.height, size.width, dtype=torch.bool)
    side = math.sqrt(0.05)
    top, left = int(0.4 * size.height), int(0.4 * size.width)
    mask[:, top : top + round(side * size.height), left : left + round(side * size.width)] = True
    whole = _measure(rasterize, room(size), bench.repetitions)
    part = _measure(rasterize, room(size), bench.repetitions, pixel_mask=mask)
    return round(float(part["forward_backward_ms"] / whole["forward_backward_ms"]), 3)
