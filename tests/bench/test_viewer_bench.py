"""The viewer's bench: its visitors are sent what the page draws."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

pytest.importorskip("viser")

from twin_node.bench import viewer
from twin_node.bench.viewer import ViewerBenchParameters, run
from twin_node.bench.visitors import brings_gaussians, connect_to, free_port
from twin_node.cli import main
from twin_node.nodes.viewer import CellPage
from twin_node.robot import ur_model


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
def test_what_would_be_ignored_is_refused(arguments: list[str], says: str, refused: Callable[..., str]) -> None:
    assert says in refused("bench", "viewer", *arguments)


def test_a_log_that_no_twin_has_written_is_told_before_anything_is_measured(
    capsys: pytest.CaptureFixture[str], cell_log: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    def never(log: Path) -> float:
        raise AssertionError("measured")

    monkeypatch.setattr(viewer, "_first_picture_s", never)
    assert main(["bench", "viewer", str(cell_log(0.5))]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "expected /twin/gaussians, which the bench needs" in line


def test_the_arms_meshes_are_no_picture_of_gaussians() -> None:
    """They are as large as a thousand Gaussians, and come before them."""
    port = free_port()
    page = CellPage(ur_model("ur10e"), (), port=port)
    try:
        with connect_to(port) as visitor:
            before = []
            with pytest.raises(TimeoutError):
                while True:
                    before.append(visitor.recv(timeout=0.5))
            assert sum(map(len, before)) > 32_000 and not any(map(brings_gaussians, before))
            viewer._show_all(page, ViewerBenchParameters(gaussians=200, moving=50, seconds=0.1))
            while not brings_gaussians(visitor.recv(timeout=10.0)):
                pass
    finally:
        page.close()
