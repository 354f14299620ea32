"""What the twin says of itself and of the arm, as text for the side panel."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

from twin_node.errors import several
from twin_node.messages.convert import Status
from twin_node.nodes.snapshot import SILENT_S, Snapshot
from twin_node.nodes.topics import (
    GAUSSIANS,
    GAUSSIANS_CHANGED,
    GAUSSIANS_MOVING,
    OBSTACLES,
    OCCUPANCY,
    SEPARATION,
    STATUS,
)
from twin_node.scene import Separation, Tier

OF_THE_TWIN = (GAUSSIANS, GAUSSIANS_CHANGED, GAUSSIANS_MOVING, OCCUPANCY, OBSTACLES, STATUS)
"""What the twin itself says; the arm's node and all others speak on without it."""
MARKDOWN = re.compile(r"([\\`*_\[\]<>&!#|~+-])")
"""What Markdown takes for more than itself; the page takes HTML in it too."""


def plain(words: str) -> str:
    """Markdown of words from elsewhere, as they are: of '/<camera>/image' the page would make a tag that none sees."""
    return MARKDOWN.sub(r"\\\1", " ".join(words.split()))


def arm_text(snapshot: Snapshot) -> str:
    """Markdown: the arm's distance and speed, with the reason, and for how long nobody has decided on it."""
    if snapshot.separation is None:
        return "No decision about the arm's speed was heard."
    return _silence(snapshot, (SEPARATION,), "There has been no decision about the arm") + _arm(snapshot.separation)


def twin_text(snapshot: Snapshot) -> str:
    """Markdown: how the twin does, or for how long it or a camera has been silent."""
    silence = _silence(snapshot, OF_THE_TWIN, "The twin has said nothing")
    for name, camera in snapshot.cameras.items():
        silence += _silence(snapshot, (camera.image,), f"Camera {plain(name)} has sent no image")
    return silence + ("The twin has not said how it does." if snapshot.status is None else _twin(snapshot.status))


def _silence(snapshot: Snapshot, topics: Sequence[str], what: str) -> str:
    """Markdown: `what` has lasted so long, where it has lasted too long; nothing where nobody ever spoke."""
    silent_s = snapshot.silent_s(topics)
    return f"**{what} for {silent_s:.0f} s.**\n\n" if silent_s > SILENT_S else ""


def _arm(separation: Separation) -> str:
    distance = f"{separation.distance:.2f} m" if math.isfinite(separation.distance) else "nothing near"
    lines = [f"### Speed {separation.speed_fraction:.0%}", plain(separation.reason), "", f"nearest: {distance}"]
    if separation.required > 0:
        lines += [
            "",
            f"falls most short: {plain(separation.link)}, {separation.required:.2f} m required at full speed "
            f"(person {separation.term_human:.2f}, reaction {separation.term_reaction:.2f}, "
            f"stopping {separation.term_stopping:.2f}, intrusion {separation.term_intrusion:.2f}, "
            f"uncertainty {separation.term_uncertainty:.2f})",
        ]
    return "\n".join(lines)


def _twin(status: Status) -> str:
    tiers = "".join(f"| {tier.name} | {status.tier_counts[tier]} |\n" for tier in Tier if status.tier_counts[tier])
    lines = [
        "### Twin",
        f"latency {_known(status.latency_p50_ms, '{:.0f} ms')}, p99 {_known(status.latency_p99_ms, '{:.0f} ms')}; "
        f"{several(status.sets, 'set')}, {status.dropped} dropped",
        "",
        f"coverage {_known(status.coverage, '{:.1%}')} of {status.coverage_target:.1%}; {status.parameters} parameters",
        "",
        "| tier | Gaussians |\n| --- | --- |\n" + tiers,
    ]
    warnings = [f"- **{plain(warning)}**" for warning in status.warnings]
    return "\n".join([*lines, *warnings])


def _known(value: float, form: str) -> str:
    """A figure, or that it is not measured (in lockstep there is no latency, at the start no coverage)."""
    return form.format(value) if math.isfinite(value) else "not measured"
