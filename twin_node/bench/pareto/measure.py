"""One method on one recording, in a process of its own: what it costs and what it shows."""

from __future__ import annotations

import contextlib
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch

from twin_node.bench.methods.protocol import Budget, Fitted
from twin_node.bench.methods.scores import ImageScores, score_images
from twin_node.bench.methods.table import METHODS
from twin_node.bench.methods.truth import MotionTruth, track_errors_mm
from twin_node.model.sequence import Recording
from twin_node.model.sequence.scoring import evenly
from twin_node.nodes.report.quality import unit
from twin_node.nodes.sizes import SIZES
from twin_node.runtime.memory import peak_mb, resident_bytes
from twin_node.scene import Float32, View
from twin_node.scene.narrowing import Narrower

OURS = "ours"
"""In `METHODS`; with a size, `ours_tiny` to `ours_full`."""
OWN_IMAGES = "previous"
"""Shows a camera its own image before: of a camera that it does not have it shows nothing."""


@dataclass(frozen=True)
class Job:
    """What to measure."""

    name: str
    """A name in `METHODS`, `ours_` and a size, or one of those with `:` and a number of steps."""
    recording: Recording
    truth: MotionTruth | None
    budget: Budget
    images: int
    """Most images that are scored, of the training cameras and of the held-out ones each."""


@dataclass(frozen=True)
class Point:
    """A method on the chart; None where it does not apply."""

    name: str
    title: str
    data: str
    online: bool
    """Whether it knows, at each time, the images up to then alone."""
    ms_per_frame: float
    """Of one core: learning per set of images (an online method's median set, an offline one's whole training over the
    sets), and drawing one image."""
    wall_ms_per_frame: float | None = None
    """The same by the wall clock, which other work on the machine slows."""
    latency_ms: float | None = None
    """From a set of images until it can be shown, of one core: an online method's slowest set in twenty after the
    first, an offline one's whole training."""
    first_ms: float | None = None
    """The first set, which starts an online method, of one core."""
    draw_ms: float | None = None
    bytes_per_frame: float | None = None
    parameters: int | None = None
    memory_mb: float | None = None
    """The most that the process held while it learnt, less what it held before."""
    psnr_db: float | None = None
    psnr_moving_db: float | None = None
    ssim: float | None = None
    """Of the training cameras."""
    psnr_left_out_db: float | None = None
    """Moving pixels of cameras that were not learnt from."""
    psnr_left_out_all_db: float | None = None
    ssim_left_out: float | None = None
    track_mm: float | None = None
    recall: float | None = None
    """Forecast at 200 ms: share of what was occupied then."""
    volume_l: float | None = None
    """Moving and unknown space at 200 ms, litres."""
    forecast_ms: float | None = None
    """A forecast, of one core, where one was made; not part of `ms_per_frame`, but of baselines that only forecast."""


def measure(job: Job) -> Point:
    """Fits and scores one method; run it in a fresh process, whose peak memory it reads."""
    torch.set_num_threads(1)
    base, _, steps = job.name.partition(":")
    size = SIZES.get(base.removeprefix(f"{OURS}_"))
    method = METHODS[OURS if size is not None else base]
    budget = job.budget if size is None else replace(job.budget, online=size.model(job.budget.online))
    budget = replace(budget, offline_steps=int(steps)) if steps else budget
    recording = job.recording if size is None else _narrowed(job.recording, size.width)
    stopwatch = _Stopwatch()
    before_mb = begun_mb()
    fitted = method.fit(recording, budget, stopwatch.lap)
    memory_mb = peak_mb() - before_mb
    cost = stopwatch.cost(method.online, recording.steps)
    train = _scores(fitted, job.recording.train, job.images)
    shows_others = base != OWN_IMAGES
    left_out = _scores(fitted, job.recording.held_out, job.images) if shows_others else None
    track = {} if job.truth is None else track_errors_mm(job.truth, fitted.follow)
    return Point(
        name=job.name,
        title=_title(base, steps, method.title),
        data=job.recording.name,
        online=method.online,
        ms_per_frame=cost.cpu_ms + (train.draw_ms or 0.0),
        wall_ms_per_frame=cost.wall_ms + (train.draw_ms or 0.0),
        latency_ms=cost.latency_ms,
        first_ms=cost.first_ms,
        draw_ms=train.draw_ms,
        bytes_per_frame=None if fitted.bytes is None else fitted.bytes / recording.steps,
        parameters=fitted.parameters,
        memory_mb=memory_mb,
        psnr_db=train.psnr_db,
        psnr_moving_db=train.psnr_moving_db,
        ssim=train.ssim,
        psnr_left_out_db=None if left_out is None else left_out.psnr_moving_db,
        psnr_left_out_all_db=None if left_out is None else left_out.psnr_db,
        ssim_left_out=None if left_out is None else left_out.ssim,
        track_mm=track.get("all"),
    )


def _title(base: str, steps: str, title: str) -> str:
    if base.startswith(f"{OURS}_"):
        return f"ours, {base.removeprefix(f'{OURS}_')}"
    return f"{title}, {steps} steps" if steps else title


@dataclass(frozen=True)
class _Cost:
    cpu_ms: float
    wall_ms: float
    latency_ms: float
    first_ms: float


class _Stopwatch:
    """Times of one core and of the wall clock at which a method told of its progress."""

    def __init__(self) -> None:
        self._cpu, self._wall = [time.process_time()], [time.perf_counter()]

    def lap(self, share: float) -> None:
        """A method's progress: an online one tells of every set."""
        self._cpu.append(time.process_time())
        self._wall.append(time.perf_counter())

    def cost(self, online: bool, sets: int) -> _Cost:
        """What a set has cost."""
        cpu, wall = 1e3 * np.diff(self._cpu), 1e3 * np.diff(self._wall)
        if not online:
            return _Cost(cpu.sum() / sets, wall.sum() / sets, float(cpu.sum()), float(cpu.sum()))
        if len(cpu) == 1:  # it learns once and no more
            return _Cost(0.0, 0.0, 0.0, float(cpu.sum()))
        later, later_wall = cpu[1:], wall[1:]
        return _Cost(
            float(np.median(later)), float(np.median(later_wall)), float(np.percentile(later, 95)), float(cpu[0])
        )


def _narrowed(recording: Recording, width: int) -> Recording:
    """The training images made smaller to a width in pixels; what is scored stays as it is."""
    narrower = Narrower(width)
    return replace(recording, train=tuple(narrower.view(view) for view in recording.train))


def _scores(fitted: Fitted, views: tuple[View, ...], images: int) -> ImageScores:
    """Of some images, evenly over time; moving pixels are those that differ from the camera's first image."""
    first: dict[str, Float32] = {}
    for view in views:
        first.setdefault(view.camera.name, unit(view))
    return score_images(fitted, evenly(views, images), first)


def begun_mb() -> float:
    """What the process holds; its peak is forgotten, where the system lets it be: loading torch has one of its own."""
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")
    return resident_bytes() / 2**20
