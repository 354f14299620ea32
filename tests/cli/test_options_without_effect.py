"""Options that would change nothing are refused by their names: who gives one expects something of it."""

from __future__ import annotations

import pytest

from twin_node.cli import main


@pytest.mark.parametrize(
    ("arguments", "named", "why"),
    [
        (["bench", "forecast", "--speed", "--noise", "0.1"], "--noise", "expected with trajectories"),
        (["bench", "forecast", "--speed", "--fps", "10", "--seed", "0"], "--fps, --seed", "expected with trajectories"),
        (["bench", "forecast", "--speed", "--height", "1.8"], "--height", "expected with a file of trajectories"),
        (["bench", "forecast", "--made-up", "--joints", "hand"], "--joints", "expected with a file of trajectories"),
        (["bench", "viewer", "--rounds", "2"], "--rounds", "expected with --latency"),
        (["bench", "viewer", "-p", "synchronizer.width:=64"], "--param", "expected with --latency"),
        (["bench", "methods", "--rig", "rig.yaml"], "--rig", "expected with recorded data"),
        (["bench", "methods", "--hold-out", "front"], "--hold-out", "expected with recorded data"),
        (["demo", "--port", "8081"], "--port", "expected with --viewer"),
        (["export", "a.mcap", "--to", "csv", "-o", "a", "--arm", "ur5e", "--params", "p.yaml"], "--arm", "expected"),
        (["calibrate", "hand-eye", "x", "--camera", "left"], "--camera", "expected with --rig"),
        (["record", "-a", "/tf", "/twin/status"], "--all", "expected instead of topics, found /tf, /twin/status too"),
    ],
)
def test_an_option_that_would_change_nothing_is_refused_alone(
    arguments: list[str], named: str, why: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("twin_node.bench.forecast_speed.run", None)  # what is not refused fails
    monkeypatch.setattr("twin_node.cell.load_scenario", None)
    monkeypatch.setattr("twin_node.nodes.live.single.run_single", None)
    assert main(arguments) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"twin_node: error: {named}: {why}")
