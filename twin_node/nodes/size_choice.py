"""Picks a replay's size by need: the largest that keeps a budget on its log, or the fastest that reached a quality."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from twin_node import resources
from twin_node.forecast import Forecaster, default_grid
from twin_node.model.first_light import once_lit
from twin_node.nodes.chain import make_model
from twin_node.nodes.chain_parameters import ChainParameters, at_size
from twin_node.nodes.log_source import LogSession, LogSource
from twin_node.nodes.sizes import SIZES
from twin_node.nodes.sizing import TRIED_SETS, Choice, best_within, median_ms
from twin_node.nodes.topics import GraphError
from twin_node.runtime.parameters import ParameterError, fill
from twin_node.yaml_file import read_yaml

FRONT_FILE = "launch/sizes.yaml"
"""What `bench pareto` has found, as shipped."""


@dataclass(frozen=True)
class Rated:
    """What a size reached on the bench's data, mean over the data sets."""

    name: str = ""
    """In `SIZES`."""
    ms_per_frame: float = 0.0
    """Model alone, of one core of the machine that the table was made on."""
    psnr_left_out_db: float = 0.0
    """Moving pixels of cameras left out."""


@dataclass(frozen=True)
class _Front:
    """The file."""

    sizes: tuple[Rated, ...] = ()


def by_target(psnr_db: float) -> Choice:
    """The fastest size whose moving pixels of left-out cameras reached `psnr_db` on the bench's data.

    Raises `GraphError` where none did, naming the best.
    """
    front = read_front(resources.find(Path(FRONT_FILE)))
    good = [rated for rated in front if rated.psnr_left_out_db >= psnr_db]
    if not good:
        best = max(rated.psnr_left_out_db for rated in front)
        raise GraphError(f"--target {psnr_db:g}: expected at most {best:.2f} dB, the best of {FRONT_FILE}")
    chosen = min(good, key=lambda rated: rated.ms_per_frame)
    reached = f"{chosen.psnr_left_out_db:.1f} dB in {FRONT_FILE}"
    return Choice(chosen.name, f"size {chosen.name}: the fastest that reached {psnr_db:g} dB ({reached})")


def by_budget(session: LogSession, chain: ChainParameters, budget_ms: float) -> Choice:
    """The best size whose model and forecast of a set take no more than `budget_ms` on the log's first sets, here.

    Sizes are tried from the smallest up, a second or two each. Where none keeps the budget, that one is taken.
    """
    return best_within(budget_ms, tuple(SIZES), lambda name: timed_ms(session, at_size(chain, name)))


def timed_ms(session: LogSession, chain: ChainParameters, clock: Callable[[], float] = time.perf_counter) -> float:
    """Median time of model and forecast on the first sets of a log, ms by the wall clock."""
    arm = chain.arm.arm()
    source = LogSource(session, chain.synchronizer, arm.joint_names)
    forecaster = Forecaster(default_grid(source.workspace, chain.grid.voxel_size), chain.forecast, arm)
    spent = median_ms(islice(once_lit(source), TRIED_SETS), make_model(chain), forecaster, clock)
    if spent is None:
        raise GraphError(f"{session.log.path}: expected two sets of images to measure on, found less")
    return spent


def read_front(path: Path) -> tuple[Rated, ...]:
    """The sizes of a file that `bench pareto` wrote. Raises `GraphError` for one that is none."""
    content = read_yaml(path, "sizes as `twin_node bench pareto` writes them", GraphError)
    try:
        sizes = fill(_Front, content, str(path)).sizes if isinstance(content, dict) else ()
    except ParameterError as error:
        raise GraphError(f"{path}: expected sizes as `twin_node bench pareto` writes them: {error}") from error
    unknown = [rated.name for rated in sizes if rated.name not in SIZES]
    if unknown or not sizes:
        raise GraphError(f"{path}: expected sizes of {', '.join(SIZES)}, found {', '.join(unknown) or 'none'}")
    return sizes
