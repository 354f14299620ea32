"""What a set costs the model: by how much moves, by how large the scene is, and by how long the run has lasted."""

from __future__ import annotations

import multiprocessing
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace

import numpy as np
import torch

from twin_node.bench.stability.scenes import MIDDLE, SIZE, Course, box, circling, sampled, small_cell
from twin_node.bench.track_runs import resident_bytes, to_and_fro
from twin_node.cell import CellSource, Scenario
from twin_node.cell.scenario import Triple
from twin_node.model import ModelParameters, WindowModel
from twin_node.scene import FrameSet, Tier

SHARES = (0.01, 0.03, 0.1, 0.25, 0.5)
"""Shares of the pixels that are to move; what is reached is measured."""
DENSITIES = (0.06, 0.2, 0.6)
"""Gaussians per pixel of scenes that differ in nothing else: one is ten times another."""
CLIP_S = 1.0
"""Length of the clip that is followed to and fro, s."""


@dataclass(frozen=True)
class CostParameters:
    """How much is measured."""

    seconds: float = 1.5
    """Length of each run, s."""
    passes: int = 20
    """Over the clip, forward and backward in turn; 3600 are an hour."""
    processes: int = 1


@dataclass(frozen=True)
class Cost:
    """One run."""

    name: str
    """moving, scene or length."""
    gaussians: int
    moving_pixels: float
    """Share of the pixels that the model took to move, mean."""
    moving_gaussians: float
    """Mean, of all tiers but STATIC."""
    first_ms: float
    """Median update in the first half of the run, of one core; without its very first set."""
    last_ms: float
    """The same in the second half; of a long run in its last pass, and `first_ms` in its second one."""
    growth_mb: float
    """What the process's memory has grown by between the two."""


@dataclass(frozen=True)
class _Job:
    name: str
    scenario: Scenario
    model: ModelParameters
    passes: int = 1


def run(
    parameters: CostParameters | None = None,
    progress: Callable[[Iterable[Cost], int], Iterable[Cost]] = lambda costs, total: costs,
) -> list[Cost]:
    """Measures every run in a process and on a core of its own."""
    parameters = parameters or CostParameters()
    plain = ModelParameters()
    jobs = [_Job("moving", crowd(share, parameters.seconds), plain) for share in SHARES]
    jobs += [
        _Job("scene", crowd(0.1, parameters.seconds), replace(plain, gaussians_per_pixel=density, most_gaussians=10**6))
        for density in DENSITIES
    ]
    jobs.append(_Job("length", crowd(0.1, CLIP_S), plain, parameters.passes))
    return list(progress(_results(jobs, parameters.processes), len(jobs)))


def _results(jobs: Sequence[_Job], processes: int) -> Iterator[Cost]:
    spawn = multiprocessing.get_context("spawn")  # nothing may fork after OpenMP has started
    with ProcessPoolExecutor(processes, mp_context=spawn, max_tasks_per_child=1) as pool:
        yield from pool.map(_measure, jobs)


BOXES = 5
"""Things that move."""
BOX_SHARE = 0.012
"""Of the pixels, that one box of `SIZE` covers."""


def crowd(share: float, seconds: float) -> Scenario:
    """The small cell with boxes that circle at 0.5 m/s and cover about this share of the pixels."""
    scale = float(np.sqrt(share / (BOXES * BOX_SHARE)))
    x, y, z = SIZE
    size: Triple = (scale * x, scale * y, scale * z)
    circle = circling(0.5)

    def course(index: int) -> Course:
        turn = 2 * np.pi * index / BOXES
        rotation = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
        return lambda t: MIDDLE + rotation @ (circle(t) - MIDDLE)

    bodies = tuple(box(f"box_{index}", sampled(course(index), seconds), size=size) for index in range(BOXES))
    return small_cell(bodies, seconds)


@dataclass(frozen=True)
class _Lap:
    """One pass over a clip."""

    ms: list[float]
    """Of one core, per set."""
    shares: list[float]
    """Of the pixels that the model took to move, per set."""
    moving: list[int]
    """Gaussians that are not STATIC, per set."""
    bytes_held: int
    """By the process, after it."""


def _followed(model: WindowModel, sets: Iterable[FrameSet]) -> _Lap:
    ms, shares, moving = [], [], []
    for frames in sets:
        started = time.process_time()
        state = model.update(frames)
        ms.append(1e3 * (time.process_time() - started))
        shares.append(float(np.mean([mask.mean() for mask in state.moving_masks])))
        moving.append(int(np.count_nonzero(state.gaussians.tiers != Tier.STATIC)))
    return _Lap(ms, shares, moving, resident_bytes())


def _measure(job: _Job) -> Cost:
    """One run, which a single pass tells of by its halves, and several by the second and the last."""
    torch.set_num_threads(1)
    clip = list(CellSource(job.scenario))
    model = WindowModel(job.model)
    laps = [_followed(model, sets) for sets in to_and_fro(clip, job.passes)]
    half = len(laps[0].ms) // 2
    first, last = (laps[1].ms, laps[-1].ms) if len(laps) > 1 else (laps[0].ms[1:half], laps[0].ms[half:])
    return Cost(
        name=job.name,
        gaussians=sum(model.tier_counts.values()),
        moving_pixels=float(np.mean([share for lap in laps for share in lap.shares[1:]])),
        moving_gaussians=float(np.mean([count for lap in laps for count in lap.moving])),
        first_ms=float(np.median(first)),
        last_ms=float(np.median(last)),
        growth_mb=(laps[-1].bytes_held - laps[min(1, len(laps) - 1)].bytes_held) / 2**20,
    )


def as_json(costs: Sequence[Cost]) -> dict[str, object]:
    """The stable names that `--json` prints; the ratios are those that are asked for."""
    by_name = {name: [cost for cost in costs if cost.name == name] for name in ("moving", "scene", "length")}
    scene, moving, length = by_name["scene"], by_name["moving"], by_name["length"][0]
    return {
        **{name: [asdict(cost) for cost in rows] for name, rows in by_name.items()},
        "most_over_least_moving": moving[-1].last_ms / moving[0].last_ms,
        "ten_times_the_scene": scene[-1].last_ms / scene[0].last_ms,
        "last_over_second_pass": length.last_ms / length.first_ms,
        "growth_mb": length.growth_mb,
    }


def text(costs: Sequence[Cost]) -> str:
    """The runs as lines."""
    heads = ("", "Gaussians", "moving px %", "moving Gaussians", "ms, first", "ms, last", "growth MB")
    lines = ["".join(f"{head:>18}" for head in heads)]
    for cost in costs:
        cells = (
            cost.name,
            f"{cost.gaussians}",
            f"{100 * cost.moving_pixels:.1f}",
            f"{cost.moving_gaussians:.0f}",
            f"{cost.first_ms:.1f}",
            f"{cost.last_ms:.1f}",
            f"{cost.growth_mb:.1f}",
        )
        lines.append("".join(f"{cell:>18}" for cell in cells))
    return "\n".join(lines)
