"""Writes the report of a run: `report.json` and `report.html`."""

from __future__ import annotations

import base64
import contextlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment

from twin_node.errors import TwinError, several
from twin_node.json_text import json_text
from twin_node.nodes.chain import make_model
from twin_node.nodes.log_source import LogSession
from twin_node.nodes.replay import Run
from twin_node.nodes.report import pictures
from twin_node.nodes.report.figures import figures_of
from twin_node.nodes.report.foresight import OURS, ForecastExample, Foresight, score_forecasts
from twin_node.nodes.report.quality import Renderings, clouds_against_images, leave_one_out, score, unit
from twin_node.unfinished import unwritable, whole_file

STRIP_TIMES = 3
"""Times at which every camera is shown."""
FORECAST_TIMES = 6
"""Forecasts that are drawn."""


class ReportError(TwinError):
    """A report cannot be written where it should go."""


@dataclass(frozen=True)
class Captioned:
    """A picture of the page."""

    data: str
    """PNG in base64."""
    caption: str


def write_report(run: Run, session: LogSession, folder: Path, step: Callable[[], object]) -> None:
    """Score a run and write its report into `folder`: both files whole, or an error and neither.

    `step()` is called after each of the `STEPS`. Raises `ReportError` where the folder cannot be written.
    """
    spool = run.spool
    if spool is None:
        raise ValueError("write_report: expected a run whose ticks were kept")
    strips = _StripKeeper(len(spool))
    shown = clouds_against_images(spool, lambda camera: run.model.render_frozen(camera).rgb)
    quality = score(strips.watch(shown))
    step()
    cameras = {view.camera.name: view.camera for tick in spool for view in tick.frames.views}
    fresh = partial(make_model, run.parameters)
    left_out = leave_one_out(lambda: (tick.frames for tick in spool), tuple(cameras.values()), fresh)
    step()
    foresight = score_forecasts(spool, session.log, run.parameters, FORECAST_TIMES)
    step()
    figures = figures_of(run, quality, left_out, foresight, session.span.start_ns)
    html = _page(session, run, figures, strips.taken, foresight)
    _write(folder, dict(zip(FILES, (json_text(figures, 2) + "\n", html), strict=True)))
    step()


FILES = ("report.json", "report.html")
"""What a report's folder holds."""
STEPS = 4
"""Times that `write_report` calls its `step`."""


class _StripKeeper:
    """Takes pictures of all cameras at a few times while renderings go by."""

    def __init__(self, ticks: int) -> None:
        self._wanted = np.linspace(0.1 * ticks, 0.95 * ticks, STRIP_TIMES).astype(int).tolist()
        self._tick = -1
        self._set: int | None = None
        self._taking: int | None = None
        self.taken: list[Renderings] = []

    def watch(self, renderings: Iterable[Renderings]) -> Iterator[Renderings]:
        """The renderings as they come; of each wanted tick, or the next that was not dropped, all are kept."""
        for shown in renderings:
            if shown.set_stamp != self._set:
                self._set = shown.set_stamp
                self._tick += 1
                if self._wanted and self._tick >= self._wanted[0] and shown.mask is not None:
                    self._wanted.pop(0)
                    self._taking = shown.set_stamp
            if shown.set_stamp == self._taking:
                self.taken.append(shown)
            yield shown


def _page(
    session: LogSession, run: Run, figures: Mapping[str, Any], strips: Sequence[Renderings], foresight: Foresight
) -> str:
    template = resources.files(__package__).joinpath("page.html").read_text(encoding="utf-8")
    environment = Environment(autoescape=True, trim_blocks=True)
    start = session.span.start_ns
    return environment.from_string(template).render(
        title=session.log.path.absolute().name,
        lead=_lead(session, run),
        warnings=[f"{text} ({count} set{'s' if count > 1 else ''})" for text, count in figures["warnings"].items()],
        changes=_changes(figures["cameras"]),
        cards=_cards(figures),
        strips=_strips(strips, start),
        forecasts=[_forecast(foreseen, start) for foreseen in foresight.examples],
        truth=foresight.truth,
        methods=_methods(foresight),
        has_overlap=any(score.iou is not None for score in foresight.methods.values()),
        curves=_curves(run, foresight, start),
        quality=_quality_rows(figures["quality"]),
    )


def _lead(session: LogSession, run: Run) -> str:
    names = ", ".join(camera.name for camera in session.rig.cameras)
    pace = "in lockstep" if run.is_lockstep else "in real time"
    if run.rate is not None and run.rate != 1:
        pace += f" at {run.rate:g} times the log's pace"
    lead = (
        f"{session.span.seconds:.1f} s of {names}, replayed {pace}: {several(run.sets, 'set')} went through the twin, "
        f"whose model followed {run.followed} of them; {run.dropped} were dropped because a newer one was there."
    )
    if run.spool is not None and not run.spool.keeps_all:
        scored = several(len(run.spool), "set")
        lead += f" Pictures and forecasts are scored on {scored}, in blocks of a second all over the run."
    if not run.collector.is_arm_told:
        lead += (
            f" Nothing is told of an arm: distances and speeds are those of a made-up {run.parameters.arm.model} that "
            "picks and places in the workspace."
        )
    return lead


def _changes(cameras: Mapping[str, Any]) -> list[str]:
    """When the drift watch changed its mind on a camera, in words."""
    return [
        f"{name}: {change['verdict']} at {change['at_s']:.1f} s"
        + (f", turned by {change['turn_deg']:.2f} degrees" if change["verdict"] in ("bumped", "drifting") else "")
        for name, camera in cameras.items()
        for change in camera["changes"]
    ]


def _cards(figures: Mapping[str, Any]) -> list[dict[str, str]]:
    quality, forecast, arm = figures["quality"], figures["forecast"], figures["arm"]
    moving = sum(count for tier, count in figures["tiers"].items() if tier not in ("static", "robot"))
    shown = [
        ("image sets per second", _number(figures["rate_hz"], "{:.1f}")),
        (
            f"{'work per set' if figures['mode'] == 'lockstep' else 'latency'}, p50 / p99",
            f"{_number(figures['latency_ms']['p50'])} / {_number(figures['latency_ms']['p99'])} ms",
        ),
        ("PSNR on moving pixels", _number(quality["psnr_moving_db"], "{:.1f} dB")),
        ("recall 200 ms ahead", _number(forecast["recall"], "{:.2%}")),
        ("Gaussians that move, of all", f"{moving} / {sum(figures['tiers'].values())}"),
        (f"smallest distance to {_whose(arm['is_made_up'])} arm", _number(arm["min_distance_m"], "{:.2f} m")),
        ("lowest speed fraction", _number(arm["min_speed_fraction"], "{:.0%}")),
        ("peak memory", _number(figures["peak_rss_mb"], "{:.0f} MB")),
    ]
    return [{"label": label, "value": value} for label, value in shown]


def _strips(taken: Sequence[Renderings], start: int) -> list[Captioned]:
    """One picture per time, with a column per camera."""
    by_set = {shown.set_stamp: [other for other in taken if other.set_stamp == shown.set_stamp] for shown in taken}
    captioned = []
    for stamp, shown in by_set.items():
        columns = [pictures.camera_column(one.image, one.ours, one.mask) for one in shown]
        names = ", ".join(one.view.camera.name for one in shown)
        captioned.append(
            Captioned(_encoded(pictures.png(pictures.table(columns))), f"{_seconds(stamp, start)}: {names}")
        )
    return captioned


def _forecast(foreseen: ForecastExample, start: int) -> Captioned:
    view = foreseen.view
    picture = pictures.forecast_picture(unit(view), view.camera, foreseen.grid, foreseen.foreseen, foreseen.seen)
    return Captioned(_encoded(pictures.png(picture)), f"{view.camera.name}, {_seconds(view.stamp, start)}")


def _methods(foresight: Foresight) -> list[dict[str, Any]]:
    return [
        {
            "name": name.replace("_", " "),
            "ours": name == OURS,
            "recall": _number(score.recall, "{:.2%}"),
            "recall_new": _number(score.recall_new, "{:.2%}"),
            "volume": _number(score.moving_volume_l, "{:.1f} l"),
            "iou": _number(score.iou, "{:.2f}"),
        }
        for name, score in foresight.methods.items()
    ]


def _curves(run: Run, foresight: Foresight, start: int) -> list[Captioned]:
    collector = run.collector
    seconds = (np.array(collector.stamps) - start) * 1e-9
    measured = seconds[len(seconds) - len(run.latencies_ms) :]
    recalls = np.array(foresight.recalls, dtype=np.float64).reshape(-1, 2)
    recall = pictures.Curve("recall", (recalls[:, 0] - start) * 1e-9, recalls[:, 1])
    latency = pictures.Curve("latency", measured, np.array(run.latencies_ms))
    took = ("Latency", "from capture to decision")
    if run.is_lockstep:
        took = ("Work per set", "by the wall clock; without the first, from which the model is built")
    drawn = [
        (
            pictures.separation_over_time(seconds, collector.separations),
            f"{_whose(not collector.is_arm_told).capitalize()} arm: distance, required distance, speed",
        ),
        (pictures.tiers_over_time(seconds, np.array(collector.tier_counts)), "Gaussians per tier"),
        (pictures.curves(took[0], "ms", [latency]), ": ".join(took)),
    ]
    if foresight.recalls:
        share = pictures.curves("Foreseen", "share", [recall])
        drawn.append((share, "Share of what was seen to move that had been foreseen"))
    return [Captioned(_encoded(data), caption) for data, caption in drawn]


def _whose(is_made_up: bool) -> str:
    return "a made-up" if is_made_up else "the"


def _quality_rows(quality: Mapping[str, Any]) -> list[dict[str, str]]:
    rows = [
        ("all pixels", quality["psnr_db"], None, None),
        (
            "moving pixels",
            quality["psnr_moving_db"],
            quality["frozen_psnr_moving_db"],
            quality["previous_psnr_moving_db"],
        ),
        ("unchanged pixels", quality["psnr_unchanged_db"], quality["frozen_psnr_unchanged_db"], None),
    ]
    if quality["published_psnr_moving_db"] is not None:
        out = quality["published_psnr_moving_db"], quality["moved_on_psnr_moving_db"]
        rows.append(("moving pixels, by the newest cloud that was out when the image was taken", out[0], None, None))
        rows.append(("the same, moved on along its velocities", out[1], None, None))
    if quality["psnr_arm_db"] is not None:
        rows.append(("the arm", quality["psnr_arm_db"], quality["frozen_psnr_arm_db"], None))
    rows += [
        (f"moving pixels of {name}, left out", scores["psnr_moving_db"], scores["frozen_psnr_moving_db"], None)
        for name, scores in quality["left_out"].items()
    ]
    return [
        {"name": name, "ours": _number(ours), "frozen": _number(frozen), "previous": _number(previous)}
        for name, ours, frozen, previous in rows
    ]


def _number(value: float | None, form: str = "{:.1f}") -> str:
    return "–" if value is None else form.format(value)


def _seconds(stamp: int, start: int) -> str:
    return f"{(stamp - start) * 1e-9:.2f} s"


def _encoded(data: bytes) -> str:
    return base64.b64encode(data).decode("ascii")


def _write(folder: Path, files: Mapping[str, str]) -> None:
    """Every file under a partial name first, then all under their own."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ReportError(unwritable(folder, error)) from None
    with contextlib.ExitStack() as whole:
        for name, text in files.items():
            whole.enter_context(whole_file(folder / name, ReportError)).write_text(text, encoding="utf-8")
