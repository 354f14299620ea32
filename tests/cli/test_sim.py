"""`twin_node sim`: logs of simulated cells, and what it refuses."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from twin_node.bag import open_log
from twin_node.cli import launch, main
from twin_node.nodes.launch.launch_file import LaunchPlan


def test_a_scenario_becomes_a_log(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = tmp_path / "cell.mcap"
    assert main(["sim", "cross", "-o", str(log), "--duration", "0.2", "--width", "64", "--seed", "3"]) == 0
    assert "cross, seed 3, 0.2 s" in capsys.readouterr().out
    assert main(["sim", "cross", "-o", str(log), "--duration", "0.2", "--width", "64", "--seed", "0"]) == 0
    assert "cross, seed 0, 0.2 s" in capsys.readouterr().out  # the scenario's own
    with open_log(log) as opened:
        counts = {topic.name: topic.count for topic in opened.topics}
        image = next(item.message for item in opened.messages(["/cam_left/camera_info"]))
    assert counts["/cam_front/image_raw/compressed"] == counts["/truth/occupancy"] == 6
    assert (image.width, image.height) == (64, 48)


def test_the_scenarios_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["sim", "--list"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert any(line.startswith("thrown_ball") for line in lines)


def test_a_live_run_has_the_parameters_of_files(monkeypatch: pytest.MonkeyPatch) -> None:
    plans: list[LaunchPlan] = []
    monkeypatch.setattr(launch, "_run", lambda plan, logs: plans.append(plan))
    assert main(["sim", "pick", "--params-file", "launch/pick.yaml", "--duration", "2"]) == 0
    (plan,) = plans
    assert len(plan.sections["arm"]["tool"]) == 4
    assert plan.sections["arm"]["model"] == "ur5e"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "expected a scenario, found none"),
        (["demo", "--seed", "2"], "--seed is for logs"),
        (["nowhere", "-o", "x.mcap"], "nowhere"),
        (["pick", "-o", "x.mcap", "--params-file", "launch/pick.yaml"], "--params-file: expected in a live run"),
        (["pick", "--params-file", "nowhere.yaml"], "nowhere.yaml"),
    ],
)
def test_what_makes_no_sense_is_refused(
    arguments: list[str], message: str, refused: Callable[..., str], tmp_path: Path
) -> None:
    assert message in refused("sim", *arguments)
