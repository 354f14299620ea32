"""The viewer's bench: its visitors are sent what the page draws."""

from __future__ import annotations

import json

import pytest

pytest.importorskip("viser")

from twin_node.bench.viewer import ViewerBenchParameters, run
from twin_node.cli import main


def test_every_visitor_sees_what_moves() -> None:
    figures = run(parameters=ViewerBenchParameters(gaussians=200, moving=50, seconds=0.5))
    assert len(figures.seen_hz) == 2 and min(figures.seen_hz) > 0
    assert max(figures.seen_hz) <= figures.shown_hz * 1.01
    assert figures.first_picture_s is None and figures.send is None
    assert set(json.loads(json.dumps(figures.as_json()))) >= {
        "first_picture_s",
        "seen_hz",
        "shown_hz",
        "show_ms",
        "send",
    }


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["twin.mcap", "--latency", "cell.mcap"], "--latency: expected instead of a log, found twin.mcap too"),
        (["--rounds", "2"], "expected with --latency"),
        (["-p", "twin.width:=64"], "expected with --latency"),
    ],
)
def test_what_would_be_ignored_is_refused(arguments: list[str], says: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "viewer", *arguments]) == 2
    assert says in capsys.readouterr().err
