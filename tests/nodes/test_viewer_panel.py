"""What the page's side panel says of the arm."""

from __future__ import annotations

from dataclasses import dataclass

from twin_node.messages import Message, convert
from twin_node.nodes.snapshot import Snapshot
from twin_node.nodes.topics import SEPARATION
from twin_node.nodes.viewer.panel import arm_text
from twin_node.scene import Separation

NOW = 1_000_000_000


@dataclass(frozen=True)
class Heard:
    stamp: int
    message: Message


def said(separation: Separation) -> list[str]:
    """Lines of the panel once this has been decided."""
    heard = Heard(NOW, convert.separation_to_message(separation))
    return arm_text(Snapshot(NOW, {SEPARATION: heard}, {}, None)).split("\n")


def test_the_nearest_pair_is_told_apart_from_the_one_that_the_law_looks_at() -> None:
    terms = (0.1, 0.05, 0.03, 0.2, 0.005)
    lines = said(Separation(NOW, NOW, 0.007, 0.385, *terms, "wrist_2_link", 2, 0.0, "stopped for MOVING"))
    (nearest,) = (line for line in lines if "0.01 m" in line)
    (short,) = (line for line in lines if "wrist" in line)
    assert nearest.startswith("nearest") and "required" not in nearest
    assert short.startswith("falls most short") and "0.39 m required" in short and "reaction 0.05" in short


def test_where_nobody_closes_in_nothing_falls_short() -> None:
    lines = said(Separation(NOW, NOW, 0.3, *[0.0] * 6, "forearm_link", 2, 1.0, "not closing in"))
    assert "nearest: 0.30 m" in lines
    assert not any("short" in line for line in lines)
