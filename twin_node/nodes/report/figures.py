"""The figures of a run under the stable names of `report.json`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from twin_node.forecast import ForecastQuality
from twin_node.json_text import known
from twin_node.nodes.collector import CollectorNode
from twin_node.nodes.replay import Run
from twin_node.nodes.report.foresight import Foresight
from twin_node.nodes.report.quality import FEWEST_PIXELS, LeftOut, Quality
from twin_node.scene import Separation, Tier


def figures_of(
    run: Run, quality: Quality, left_out: Mapping[str, LeftOut], foresight: Foresight, start: int
) -> dict[str, Any]:
    """Everything measured, as JSON values; what could not be measured is None, and `reasons` says why.

    `start`: of the span, ns, which times are told from.
    """
    collector = run.collector
    counts = collector.tier_counts[-1] if collector.tier_counts else [0] * len(Tier)
    figures: dict[str, Any] = {
        "mode": "lockstep" if run.is_lockstep else "real time",
        "sets": run.sets,
        "followed": run.followed,
        "dropped": run.dropped,
        "scored": None if run.spool is None else len(run.spool),
        "rate_hz": run.sets / run.seconds if run.seconds > 0 else None,
        "latency_ms": percentiles(run.latencies_ms),
        "work_ms": percentiles(run.work_ms),
        "quality": {**asdict(quality), "left_out": {name: asdict(scores) for name, scores in left_out.items()}},
        "tiers": {tier.name.lower(): counts[tier] for tier in Tier},
        "parameters": run.parameters_count,
        "bytes_per_frame": run.bytes_per_frame,
        "peak_rss_mb": run.peak_rss_mb,
        "forecast": {**foresight.figures(), **_coverage(collector.quality)},
        "arm": {**_arm(collector.separations), "is_made_up": not collector.is_arm_told},
        "cameras": _cameras(collector, start),
        "warnings": dict(collector.warnings),
    }
    found = known(figures)
    return {**found, "reasons": _reasons(found, foresight, collector)}


def _cameras(collector: CollectorNode, start: int) -> dict[str, Any]:
    """What the drift watch said of each camera: the last verdict, and every change on the way with its turn then."""
    cameras: dict[str, Any] = {}
    for report in collector.drift:
        for drift in report.drifts:
            camera = cameras.setdefault(drift.camera, {"changes": []})
            verdict = drift.verdict.name.lower()
            if camera.get("verdict", "steady") != verdict:
                seconds = (report.stamp - start) / 1e9
                camera["changes"].append({"at_s": seconds, "verdict": verdict, "turn_deg": drift.angle_deg})
            camera["verdict"] = verdict
            camera["left_out_sets"] = collector.withheld.get(drift.camera, 0)
    return cameras


def _arm(separations: Sequence[Separation]) -> dict[str, Any]:
    distances = np.array([s.distance for s in separations])
    touching = distances <= 0
    contacts = int(touching[:1].sum() + (touching[1:] & ~touching[:-1]).sum())
    return {
        "min_distance_m": float(distances.min()) if len(distances) else None,
        "min_speed_fraction": min((s.speed_fraction for s in separations), default=None),
        "contacts": contacts,
    }


def _coverage(quality: ForecastQuality | None) -> dict[str, float | None]:
    """The calibrated bound's own record: share of what moved that it had foreseen, and the share it aims at."""
    return {
        "coverage": None if quality is None else quality.coverage,
        "coverage_target": None if quality is None else quality.target,
    }


def percentiles(milliseconds: Sequence[float]) -> dict[str, float | None]:
    """p50, p95, p99; None without values."""
    if not milliseconds:
        return {"p50": None, "p95": None, "p99": None}
    return {f"p{p}": float(np.percentile(milliseconds, p)) for p in (50, 95, 99)}


def _reasons(figures: Mapping[str, Any], foresight: Foresight, collector: CollectorNode) -> dict[str, str]:
    """Why a figure is None."""
    none_came = "no set came after the first, which builds the model"
    reasons = dict.fromkeys(_unknown(figures, "latency_ms", "work_ms"), none_came)
    too_short = "it is measured once a second, which the run did not last"
    reasons |= dict.fromkeys(_unknown(figures, "bytes_per_frame"), too_short)
    unscored = (
        f"the truth ({foresight.truth}) cannot tell"
        if foresight.recalls or any(score.recall is not None for score in foresight.methods.values())
        else "nothing moved at a time that had been foreseen"
    )
    reasons |= dict.fromkeys(_unknown(figures, "forecast"), unscored)
    unjudged = "no forecast was made" if collector.quality is None else "no forecast was judged by what moved later"
    of_bound = _unknown(figures["forecast"], "coverage", "coverage_target")
    reasons |= {f"forecast.{name}": unjudged for name in of_bound}
    undecided = "no obstacle was near the arm" if collector.separations else "no speed was decided"
    reasons |= dict.fromkeys(_unknown(figures, "arm"), undecided)
    for name in _unknown(figures, "quality"):
        reason = f"no image had {FEWEST_PIXELS} or more pixels of that kind"
        if figures["mode"] == "lockstep" and name.startswith(("quality.published", "quality.moved_on")):
            reason = "in lockstep no cloud is out at a time of its own"
        elif name.endswith("psnr_arm_db") and not collector.is_arm_told:
            reason = "nothing is told of an arm"
        reasons[name] = reason
    if not figures["quality"]["left_out"]:
        reasons["quality.left_out"] = "one camera cannot be left out of one"
    return reasons


def _unknown(figures: Mapping[str, Any], *names: str) -> Iterator[str]:
    """Names of those that are None, of some figures and all that is in them, with the sections that they are in."""
    for name in names:
        value = figures[name]
        if isinstance(value, Mapping):
            yield from (f"{name}.{inner}" for inner in _unknown(value, *value))
        elif value is None:
            yield name
