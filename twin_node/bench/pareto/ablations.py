"""What each part of the twin is worth: the chain on a log with one part at a time left out."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from itertools import islice
from pathlib import Path

import numpy as np
import torch

from twin_node.bench.contenders import OURS
from twin_node.bench.errors import BenchError
from twin_node.bench.pareto.following import Follower, settled_ms
from twin_node.bench.pareto.suite import check_names
from twin_node.bench.text_table import figure, markdown_table, text_table
from twin_node.bench.workers import workers
from twin_node.model.first_light import once_lit
from twin_node.nodes.chain_parameters import ChainParameters, load_parameters
from twin_node.nodes.log_source import LogSession, LogSource
from twin_node.nodes.report.quality import clouds_against_images, score
from twin_node.nodes.truth import truth_of
from twin_node.scene import Tier

NEVER = 1_000_000
"""Members that no node ever has."""

Progress = Callable[[Iterable["Ablated"], int], Iterable["Ablated"]]
"""May wrap the rows as they come; told how many there will be."""
Change = Callable[[ChainParameters], ChainParameters]


def _without_nodes(chain: ChainParameters) -> ChainParameters:
    return replace(chain, model=replace(chain.model, birth=replace(chain.model.birth, node_members=NEVER)))


def _without_transients(chain: ChainParameters) -> ChainParameters:
    return replace(chain, model=replace(chain.model, birth=replace(chain.model.birth, transient_s=0.0)))


def _without_steps(chain: ChainParameters) -> ChainParameters:
    return replace(chain, model=replace(chain.model, track=replace(chain.model.track, steps=0)))


def _without_alignment(chain: ChainParameters) -> ChainParameters:
    return replace(chain, model=replace(chain.model, track=replace(chain.model.track, alignments=0)))


def _without_field(chain: ChainParameters) -> ChainParameters:
    return replace(chain, model=replace(chain.model, track=replace(chain.model.track, bends=False)))


def _without_selection(chain: ChainParameters) -> ChainParameters:
    return replace(chain, model=replace(chain.model, track=replace(chain.model.track, selects=False)))


def _without_mapper(chain: ChainParameters) -> ChainParameters:
    return replace(chain, model=replace(chain.model, map=replace(chain.model.map, steps=0)))


def _without_adaptation(chain: ChainParameters) -> ChainParameters:
    bound = replace(chain.forecast.bound, follow=0.0, correction=0.0, surprise=0.0)
    return replace(chain, forecast=replace(chain.forecast, bound=bound))


def _as_it_is(chain: ChainParameters) -> ChainParameters:
    return chain


ABLATIONS: Mapping[str, Change] = {
    "whole": _as_it_is,
    "no_nodes": _without_nodes,
    "no_field": _without_field,
    "no_transients": _without_transients,
    "no_selection": _without_selection,
    "no_gradient_steps": _without_steps,
    "no_alignment": _without_alignment,
    "no_mapper": _without_mapper,
    "one_rate": _as_it_is,
    "no_self_filter": _as_it_is,
    "bound_not_adapted": _without_adaptation,
}
"""By the names that `--json` prints: the tiers RIGID and DEFORMABLE; DEFORMABLE alone; TRANSIENT; the choice of what
descends; the descent on what moves; the motion of nodes from optical flow; the refinement of what stands still; the
same as part of every update instead of after it; the robot's own space with the tier ROBOT; the bound's correction by
what comes true (online conformal inference)."""
ONE_RATE = "one_rate"
SELF_FILTER = "no_self_filter"


@dataclass(frozen=True)
class AblationParameters:
    """Which logs, and how much of each."""

    logs: tuple[Path, ...]
    frames: int = 150
    start_offset_s: float = 0.0
    """Where in each log to begin, s."""
    names: tuple[str, ...] = tuple(ABLATIONS)
    params: Path | None = None
    """Parameter file of the chain, which says which arm the logs have."""
    width: int = 160
    processes: int = 1


@dataclass(frozen=True)
class Ablated:
    """The twin with one part left out, on one log."""

    data: str
    """The log's name."""
    name: str
    model_ms: float
    """Median update, of one core: until the set's cloud can go out."""
    mapper_ms: float
    """Median of what comes after it."""
    forecast_ms: float
    psnr_moving_db: float | None
    psnr_unchanged_db: float | None
    recall: float | None
    """Against the log's exact occupancy, else against what was seen to move when the time had come."""
    recall_new: float | None
    moving_volume_l: float | None
    coverage: float | None
    """Of the bound by its own record."""
    kb_per_frame: float
    parameters: int
    moving_gaussians: float
    """Mean, of all tiers but STATIC and ROBOT."""
    bending_gaussians: int
    """DEFORMABLE ones at the end."""


@dataclass(frozen=True)
class _Job:
    log: Path
    name: str
    parameters: AblationParameters


def run(parameters: AblationParameters, progress: Progress = lambda rows, total: rows) -> list[Ablated]:
    """Follows every log once per ablation, each in a process and on a core of its own.

    Raises `BenchError` for an ablation that is none and two logs of one name, and the logs' errors.
    """
    check_names([log.stem for log in parameters.logs])
    load_parameters(parameters.params)
    for name in parameters.names:
        if name not in ABLATIONS:
            raise BenchError(f"--only: expected some of {', '.join(ABLATIONS)}, found '{name}'")
    for log in parameters.logs:
        with LogSession(log, start_offset_s=parameters.start_offset_s):
            pass
    jobs = [_Job(log, name, parameters) for log in parameters.logs for name in parameters.names]
    with workers(parameters.processes) as pool:
        return list(progress(pool.map(_follow, jobs), len(jobs)))


def as_json(rows: Iterable[Ablated]) -> dict[str, object]:
    """The stable names that `--json` prints: per log, per ablation."""
    figures: dict[str, dict[str, object]] = {}
    for row in rows:
        own = {key: value for key, value in asdict(row).items() if key not in ("data", "name")}
        figures.setdefault(row.data, {})[row.name] = own
    return dict(figures)


def _follow(job: _Job) -> Ablated:
    """One ablation on one core."""
    torch.set_num_threads(1)
    parameters = job.parameters
    chain = ABLATIONS[job.name](load_parameters(parameters.params))
    arm = None if job.name == SELF_FILTER else chain.arm.arm()
    with LogSession(job.log, start_offset_s=parameters.start_offset_s) as session:
        names = chain.arm.arm().joint_names
        source = LogSource(session, replace(chain.synchronizer, width=parameters.width), names)
        follower = Follower(chain, arm, source.workspace, truth_of(session.log))
        ticks = follower.follow(islice(once_lit(source), parameters.frames))
        quality = score(clouds_against_images(ticks, lambda camera: follower.model.render_frozen(camera).rgb))
    sets = len(follower.laps.model)
    if sets < 2:
        raise BenchError(f"{job.log}: expected two sets of images or more, found {sets}; give more --frames")
    ours, coverage = follower.scores.get(OURS), follower.quality.coverage
    model_ms, mapper_ms = settled_ms(follower.laps.model), settled_ms(follower.laps.mapper)
    if job.name == ONE_RATE:
        model_ms, mapper_ms = model_ms + mapper_ms, 0.0
    return Ablated(
        data=job.log.stem,
        name=job.name,
        model_ms=model_ms,
        mapper_ms=mapper_ms,
        forecast_ms=settled_ms(follower.laps.forecast),
        psnr_moving_db=quality.psnr_moving_db,
        psnr_unchanged_db=quality.psnr_unchanged_db,
        recall=None if ours is None else ours.recall,
        recall_new=None if ours is None else ours.recall_new,
        moving_volume_l=None if ours is None else ours.moving_volume_l,
        coverage=coverage if np.isfinite(coverage) else None,
        kb_per_frame=float(np.mean(follower.laps.sent[1:])) / 1e3,
        parameters=follower.model.parameters_count,
        moving_gaussians=float(np.mean(follower.laps.moving)),
        bending_gaussians=follower.model.tier_counts[Tier.DEFORMABLE],
    )


def text(rows: Sequence[Ablated]) -> str:
    """The tables as lines, one per log."""
    logs = dict.fromkeys(row.data for row in rows)
    return "\n".join(
        text_table((data, *_COLUMNS), ((row.name, *_cells(row)) for row in rows if row.data == data)) for data in logs
    )


def markdown(rows: Sequence[Ablated]) -> str:
    """One table of all logs, as Markdown."""
    heads = ("data", "left out", *(name.replace("_", " ") for name in _COLUMNS))
    cells = ((row.data, row.name.replace("_", " "), *_cells(row)) for row in rows)
    return markdown_table(heads, cells) + "\n"


def _cells(row: Ablated) -> Iterator[str]:
    return (figure(getattr(row, name)) for name in _COLUMNS)


_COLUMNS = tuple(field.name for field in fields(Ablated) if field.name not in ("data", "name"))
