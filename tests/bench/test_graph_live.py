"""What an arm did in a live launch is judged against where people were: the images' stamps tell when each run began."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from twin_node.bench import graph_live
from twin_node.bench.errors import BenchError
from twin_node.bench.graph_live import Heard, begins, figures_of
from twin_node.cell import Scenario, SimulatedRig, load_scenario
from twin_node.cli import main
from twin_node.nodes.launch.launch_file import LaunchPlan
from twin_node.scene import JointSample

FIRST_NS = 1_700_000_000_123_456_789
RUNS = (FIRST_NS, FIRST_NS + 9_004_000_321)
LATE_NS = 80_000_000


@pytest.fixture(scope="module")
def demo() -> Scenario:
    return load_scenario("demo")


def evidence(scenario: Scenario) -> list[int]:
    """Of every twentieth image of two runs, not of all in the same order."""
    stamps = [exposure.stamp for exposure in SimulatedRig(scenario).exposures()]
    return [begun + stamp - scenario.start_ns for begun in RUNS for stamp in stamps[5::20]]


def heard(scenario: Scenario, is_still: bool = False, ahead_ns: int = 0) -> Heard:
    """An arm on the scenario's program, so far ahead in it, or where that begins, while the scenario runs twice."""
    found, arm = Heard(), SimulatedRig(scenario).world.arm
    assert arm is not None
    shares = np.tile([0.0, 0.5], 1000)
    found.decided = [(stamp + LATE_NS, stamp, share) for stamp, share in zip(evidence(scenario), shares, strict=False)]
    for begun in RUNS:
        for after in range(0, 9_000_000_000, 20_000_000):
            there = arm.sample(scenario.start_ns + (0 if is_still else after + ahead_ns))
            found.joints.append(JointSample(begun + after, there.names, there.positions, there.velocities))
    return found


@pytest.mark.parametrize("size", ["auto", "tiny"])
def test_a_launch_is_measured_with_the_size_that_is_asked_for(monkeypatch: pytest.MonkeyPatch, size: str) -> None:
    class Launched(Exception):
        """Instead of the launch."""

    def launch(plan: LaunchPlan) -> None:
        raise Launched(plan.sections["size"]["name"], plan.sections["ur_driver"]["model"])

    monkeypatch.setattr(graph_live, "running", launch)
    with pytest.raises(Launched) as launched:
        graph_live.live(1.0, size=size)
    assert launched.value.args == (size, "ur5e")


def test_a_size_that_there_is_none_of_is_refused_before_anything_is_measured(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["bench", "graph", "--only", "live", "--size", "huge"]) == 2
    assert (
        "--size: expected one of given, auto, tiny, small, medium, large, full, found 'huge'" in capsys.readouterr().err
    )


def test_images_tell_when_each_run_began(demo: Scenario) -> None:
    assert list(begins(np.array(evidence(demo)), demo)) == list(RUNS)
    assert list(begins(np.arange(40, dtype=np.int64) * 33_333_333 + FIRST_NS, demo)) == []


def test_some_images_at_the_times_of_another_beginning_make_no_run(demo: Scenario) -> None:
    """Where images come nearly evenly some do: people were taken to be where they were in a run that never was."""
    even = replace(demo, sensing=replace(demo.sensing, jitter_ms=0.01))
    stamps = [exposure.stamp - even.start_ns for exposure in SimulatedRig(even).exposures()]
    told = np.unique([begun + stamp for begun in RUNS for stamp in stamps])
    assert list(begins(told, even)) == list(RUNS)


def test_a_scenario_whose_images_come_evenly_is_refused_before_it_is_launched(
    demo: Scenario, monkeypatch: pytest.MonkeyPatch
) -> None:
    even = replace(demo, sensing=replace(demo.sensing, jitter_ms=0.0))
    monkeypatch.setattr(graph_live, "load_scenario", lambda name: even)
    monkeypatch.setattr(graph_live, "running", lambda plan: pytest.fail("it was launched"))
    with pytest.raises(BenchError, match=r"expected sensing\.jitter_ms above 0"):
        graph_live.live(1.0, "demo")


def test_an_arm_on_its_program_comes_near_the_hand_and_does_not_touch_it(demo: Scenario) -> None:
    """As the scenario is made; had the runs begun at other times it would be elsewhere beside the hand."""
    found = figures_of(heard(demo), demo)
    assert found.moving_share > 0.5
    assert 0.0 < found.nearest_m < 0.15
    assert found.contact_s == 0
    assert found.age_ms.p50 == pytest.approx(LATE_NS / 1e6)
    assert found.speed_share == pytest.approx(0.25, abs=0.01)
    assert found.sets_per_s == pytest.approx(len(evidence(demo)) / 17.9, rel=0.05)


def test_who_comes_to_an_arm_that_stands_is_no_nearness_of_the_arms(demo: Scenario) -> None:
    found = figures_of(heard(demo, is_still=True), demo)
    assert found.moving_share < 0.01
    assert found.nearest_m == np.inf


def test_an_arm_that_goes_into_somebody_is_told(demo: Scenario) -> None:
    """The same program, begun some seconds sooner: the hand reaches in where it is then."""
    found = [figures_of(heard(demo, ahead_ns=second * 1_000_000_000), demo) for second in range(1, 6)]
    assert max(one.contact_s for one in found) > 0.05
    assert min(one.nearest_m for one in found) < 0


def test_where_nobody_knows_where_people_were_no_distance_is_told(demo: Scenario) -> None:
    one = heard(demo)
    one.decided = [
        (stamp + 1, evidence + 1 + 7 * row, share) for row, (stamp, evidence, share) in enumerate(one.decided)
    ]
    with pytest.raises(BenchError, match="too few sets"):
        figures_of(one, demo)


def test_silence_is_an_error(demo: Scenario) -> None:
    with pytest.raises(BenchError, match="fell silent"):
        figures_of(Heard(), demo)
