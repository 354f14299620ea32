"""What a set costs the model: by how much of the images moves, and by how large the scene is."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np
import torch

from twin_node.bench.stability.scenes import MIDDLE, SIZE, Course, box, ramped, sampled, small_cell
from twin_node.bench.text_table import figure, text_table
from twin_node.bench.workers import workers
from twin_node.cell import CellSource, Scenario
from twin_node.cell.actors import Triple
from twin_node.model import ModelParameters, WindowModel
from twin_node.scene import Float64, Tier

SHARES = (0.01, 0.03, 0.1, 0.25, 0.5)
"""Shares of the pixels that are to move; what is reached is measured."""
CAPACITIES = (1_350, 6_000, 26_000, 100_000)
"""Gaussians that scenes which differ in nothing else have room for; the first set fills a part of them."""
MOST_MOVING = 400
"""Of them, that may move: the same in all scenes, and less than the smallest has room for beside what stands."""
SCENE_SHARE = 0.1
"""Of the pixels, that are to move in scenes of any size."""


@dataclass(frozen=True)
class CostParameters:
    """How much is measured."""

    seconds: float = 1.5
    """Length of each run, s."""
    processes: int = 1


@dataclass(frozen=True)
class Cost:
    """One run."""

    name: str
    """moving or scene."""
    gaussians: int
    moving_pixels: float
    """Share of the pixels that the model took to move, mean."""
    moving_gaussians: float
    """Mean, of all tiers but STATIC."""
    first_ms: float
    """Median update, its mapper with it, in the first half of the run, of one core; without its very first set."""
    last_ms: float
    """The same in the second half: by then what moves has got its Gaussians."""


@dataclass(frozen=True)
class _Job:
    name: str
    scenario: Scenario
    model: ModelParameters


def run(
    parameters: CostParameters | None = None,
    progress: Callable[[Iterable[Cost], int], Iterable[Cost]] = lambda costs, total: costs,
) -> list[Cost]:
    """Measures every run in a process and on a core of its own."""
    parameters = parameters or CostParameters()
    plain = ModelParameters()
    jobs = [_Job("moving", crowd(share, parameters.seconds), plain) for share in SHARES]
    scene = crowd(SCENE_SHARE, parameters.seconds)
    jobs += [_Job("scene", scene, _with_room(plain, capacity)) for capacity in CAPACITIES]
    with workers(parameters.processes, fresh=True) as pool:
        return list(progress(pool.map(_measure, jobs), len(jobs)))


def _with_room(model: ModelParameters, capacity: int) -> ModelParameters:
    birth = replace(model.birth, moving_share=MOST_MOVING / capacity)
    seed = replace(model.seed, stride_px=1)  # as fine as there is room for
    return replace(model, gaussians_per_pixel=10.0, most_gaussians=capacity, birth=birth, seed=seed)


BOX_SCALE = 1.5
"""Of the boxes, in units of `SIZE`."""
BOX_SHARE = 0.018
"""Of the pixels, that such a box covers, mean over the places and cameras."""
PITCH_M = 0.32
"""Between the boxes' places, which lie in a square lattice: farther apart than they reach."""
ROUND_M = 0.08
"""Radius of the circles that they go in step, m."""
HEIGHT_M = 0.2
PACE = 0.5
"""Speed of every box, m/s."""


def crowd(share: float, seconds: float) -> Scenario:
    """The small cell with as many boxes that circle side by side as cover about this share of the pixels.

    A share of less than one box is a smaller box.
    """
    count = max(1, round(share / BOX_SHARE))
    scale = BOX_SCALE * min(1.0, float(np.sqrt(share / BOX_SHARE)))
    x, y, z = SIZE
    size: Triple = (scale * x, scale * y, scale * z)

    def course(site: Float64) -> Course:
        def place(t: float) -> Float64:
            angle = PACE * ramped(t) / ROUND_M
            away = site + ROUND_M * np.array([np.cos(angle), np.sin(angle)])
            return np.array([MIDDLE[0] + away[0], MIDDLE[1] + away[1], HEIGHT_M])

        return place

    boxes = (box(f"box_{n}", sampled(course(site), seconds), size=size) for n, site in enumerate(_sites(count)))
    return small_cell(tuple(boxes), seconds)


def _sites(count: int) -> Float64:
    """[count, 2] places of a square lattice that are nearest to its middle, m."""
    half = int(np.ceil(np.sqrt(count)))
    side = PITCH_M * np.arange(-half, half + 1)
    sites = np.stack(np.meshgrid(side, side, indexing="ij"), -1).reshape(-1, 2)
    nearest: Float64 = sites[np.argsort((sites**2).sum(1), kind="stable")[:count]]
    return nearest


def _measure(job: _Job) -> Cost:
    """One run, told of by its halves."""
    torch.set_num_threads(1)
    model = WindowModel(job.model)
    ms, shares, moving = [], [], []
    for frames in CellSource(job.scenario):
        started = time.process_time()
        state = model.update(frames)
        ms.append(1e3 * (time.process_time() - started))
        shares.append(float(np.mean([mask.mean() for mask in state.moving_masks])))
        moving.append(int(np.count_nonzero(state.gaussians.tiers != Tier.STATIC)))
    half = len(ms) // 2
    return Cost(
        name=job.name,
        gaussians=sum(model.tier_counts.values()),
        moving_pixels=float(np.mean(shares[half:])),
        moving_gaussians=float(np.mean(moving[half:])),
        first_ms=float(np.median(ms[1:half])),
        last_ms=float(np.median(ms[half:])),
    )


def as_json(costs: Sequence[Cost]) -> dict[str, object]:
    """The stable names that `--json` prints; the ratios are those that are asked for."""
    by_name = {name: [cost for cost in costs if cost.name == name] for name in ("moving", "scene")}
    scene, moving = by_name["scene"], by_name["moving"]
    return {
        **{name: [asdict(cost) for cost in rows] for name, rows in by_name.items()},
        "most_over_least_moving": moving[-1].last_ms / moving[0].last_ms,
        "ten_times_the_scene": _tenfold(scene).last_ms / scene[0].last_ms,
        "largest_over_smallest_scene": scene[-1].last_ms / scene[0].last_ms,
    }


def _tenfold(scenes: Sequence[Cost]) -> Cost:
    """The scene that is most nearly ten times the first."""
    return min(scenes, key=lambda one: abs(one.gaussians / scenes[0].gaussians - 10))


def text(costs: Sequence[Cost]) -> str:
    """The runs as lines."""
    heads = ("", "Gaussians", "moving px %", "moving Gaussians", "ms, first", "ms, last")
    rows = (
        (
            one.name,
            *map(figure, (one.gaussians, 100 * one.moving_pixels, one.moving_gaussians)),
            *map(figure, (one.first_ms, one.last_ms)),
        )
        for one in costs
    )
    return text_table(heads, rows)
