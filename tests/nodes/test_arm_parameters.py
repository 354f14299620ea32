"""What an arm's section may say: which arm, what it carries, what it may touch, room for obstacles."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from arm_cell import MODEL, READY, TURNING, WORKSPACE, Cell, Timers
from twin_logs import START

from twin_node.errors import TwinError
from twin_node.messages import convert
from twin_node.nodes.arm import ArmNode, make_arm_node
from twin_node.nodes.arm_parameters import ArmParameters
from twin_node.nodes.chain_parameters import ChainParameters, load_parameters
from twin_node.nodes.live.beside_twin import make_arm
from twin_node.nodes.live.setup import Setup
from twin_node.nodes.topics import DIAGNOSTICS, FOLLOW, SEPARATION, kind_of
from twin_node.nodes.ur_driver import DRIVEN_ARM
from twin_node.robot import forward_kinematics
from twin_node.runtime.bus import LocalBus
from twin_node.runtime.clock import SteppedClock
from twin_node.runtime.parameters import fill
from twin_node.runtime.rmw_zenoh import Endpoint, EntityKind, NodeIdentity, Qos
from twin_node.scene import ObstacleKind, Separation


def made(
    arm: dict[str, Any],
    driver: dict[str, str],
    cell: dict[str, str] | None = None,
    scenario: str = "demo",
    **shared: str,
) -> ArmNode:
    """The arm's node of a launch file with these sections, and parameters that all its nodes share."""
    sections = {"/**": {"rig": {"scenario": scenario}, **shared}, "arm": arm, "ur_driver": driver}
    sections |= {} if cell is None else {"cell": cell}
    bus, clock = LocalBus(), SteppedClock(START)
    setup = Setup("arm", bus, clock, Timers(), sections, "cell.yaml", lambda: None, tuple)
    return make_arm(setup)


def test_the_arm_that_is_judged_is_the_one_that_is_driven() -> None:
    """Their joints have the same names: nothing else would tell that distances are those of another arm."""
    with pytest.raises(TwinError, match=r"cell.yaml: arm.model: expected the arm that is driven, ur5e, found ur10e"):
        made({}, {"robot": "192.168.1.10"})
    with pytest.raises(TwinError, match="expected the arm that is driven, ur3e, found ur5e"):
        made({"model": "ur5e"}, {"robot": "192.168.1.10", "model": "ur3e"})
    with pytest.raises(TwinError, match=r"expected the arm that is driven, my_ur5\.xml, found ur10e"):
        made({}, {"robot": "192.168.1.10", "model": "my_ur5.xml"})  # of the CB3 series, as its driver asked
    with pytest.raises(TwinError, match="expected the arm that is driven, ur10e, found airo:ur5e"):
        made({"model": "airo:ur5e"}, {"robot": "192.168.1.10", "model": "ur10e"})
    assert made({"model": "ur5e"}, {"robot": "192.168.1.10"}) is not None
    assert made({"model": "ur5e"}, {"robot": "192.168.1.10", "model": "airo:ur5e"}) is not None
    assert made({"model": "airo:ur5e"}, {"robot": "192.168.1.10"}) is not None
    assert made({"model": "sim/ur5e.xml"}, {"robot": "192.168.1.10"}) is not None  # with a gripper, perhaps
    assert made({"model": "ur10e"}, {"robot": ""}) is not None  # none is driven


def test_the_arm_that_is_driven_is_found_in_the_section_of_all_nodes_too() -> None:
    """The driver took its model from there, and the arm that was judged was held against the driver's default."""
    with pytest.raises(TwinError, match="expected the arm that is driven, ur10e, found ur5e"):
        made({"model": "ur5e"}, {}, robot="192.168.1.10", model="ur10e")
    assert made({"model": "ur10e"}, {}, robot="192.168.1.10", model="ur10e") is not None


def test_the_arm_that_is_judged_is_the_one_that_the_simulated_cell_shows() -> None:
    """`scenario:=stop arm:=scenario` of the simulated cell judged a UR5e, the default, where a UR10e moves."""
    with pytest.raises(TwinError, match=r"cell.yaml: arm.model: expected the scenario's arm, ur5e, found ur10e"):
        made({}, {}, cell={"arm": "scenario"})
    with pytest.raises(TwinError, match="expected the scenario's arm, ur5e, found airo:ur10e"):
        made({"model": "airo:ur10e"}, {}, cell={})  # by default
    with pytest.raises(TwinError, match="expected the scenario's arm, ur5e, found ur10e"):  # that driver is not begun
        made({"model": "ur10e"}, {"robot": "127.0.0.1", "model": "ur10e"}, cell={"arm": "scenario"})
    for model in ("ur5e", "airo:ur5e", "sim/ur5e.xml"):
        assert made({"model": model}, {}, cell={"arm": "scenario"}) is not None
    assert made({"model": "ur10e"}, {}, cell={"arm": "ur-sim"}) is not None  # a driver elsewhere moves it
    assert made({"model": "ur10e"}, {}) is not None  # the cell, if there is one, is another launch's


def test_a_simulated_arm_whose_tool_nobody_tells_of_is_refused() -> None:
    """It would stand beside its own gripper for ever."""
    tool = [{"start": [0, 0, 0.03], "end": [0, 0, 0.2], "radius": 0.06}]
    for moved_by in ("scenario", "ur-sim"):
        with pytest.raises(TwinError, match=r"arm.tool: expected what the scenario's arm carries, found nothing"):
            made({"model": "ur5e"}, {}, cell={"arm": moved_by}, scenario="pick")
        assert made({"model": "ur5e", "tool": tool}, {}, cell={"arm": moved_by}, scenario="pick") is not None


def test_the_joints_of_the_arm_that_is_judged_are_called_as_its_driver_calls_them() -> None:
    """Of joints under other names nothing would ever be heard, and the arm stood for ever."""
    left: Any = [f"left_{name}" for name in MODEL.joint_names]
    arm, driver = {"model": "ur5e"}, {"robot": "192.168.1.10"}
    with pytest.raises(TwinError, match=r"expected the joints that are driven, shoulder_pan_joint, .*, found left_sho"):
        made({**arm, "joints": left}, driver)
    with pytest.raises(TwinError, match=r"found shoulder_pan_joint, .* the same 'joints'"):
        made(arm, {**driver, "joints": left})
    assert made({**arm, "joints": left}, {**driver, "joints": left}) is not None
    assert made(arm, driver, joints=left) is not None


def test_an_arm_that_is_driven_is_never_judged_as_a_made_up_one() -> None:
    """Its joints may be published under another name: it was let go at full speed for what no arm does."""
    here: list[Endpoint] = []
    sections = {"/**": {"rig": {"scenario": "demo"}}, "arm": {"model": "ur5e"}}
    cell = Cell()
    setup = Setup("arm", cell.bus, cell.clock, Timers(), sections, "cell.yaml", lambda: None, lambda: tuple(here))
    make_arm(setup).configure()
    far = np.full(3, 5.0)
    assert cell.somebody(at=far).reason == "clear (of a made-up arm); speeding up"
    here[:] = [endpoint("ur_driver", SEPARATION)]
    cell.wait(32)
    told = cell.somebody(at=far)
    assert told.speed_fraction == 0
    assert told.reason == "stopped: an arm is driven, and nobody publishes its /joint_states or /arm/trajectory"
    cell.joints()
    assert cell.somebody(at=far).reason == "clear; speeding up"


def test_an_arm_that_a_driver_elsewhere_takes_for_another_stands() -> None:
    """Beside the launch nobody compared the two: a UR10e was judged by the links of a UR5e, and told "clear"."""
    here: list[Endpoint] = []
    sections = {"/**": {"rig": {"scenario": "demo"}}, "arm": {"model": "ur5e"}}
    cell = Cell()
    setup = Setup("arm", cell.bus, cell.clock, Timers(), sections, "cell.yaml", lambda: None, lambda: tuple(here))
    node = make_arm(setup)
    node.configure()
    far = np.full(3, 5.0)

    def told_by(model: str) -> Separation:
        driven = convert.Diagnosis(DRIVEN_ARM, convert.Level.OK, "", (convert.Reading("model", model),))
        others = convert.Diagnosis("twin: model", convert.Level.OK, "", (convert.Reading("model", "large"),))
        for diagnoses in ([driven], [others]):
            cell.bus.publish(DIAGNOSTICS, convert.diagnostics_to_message(cell.clock.now(), diagnoses))
        cell.wait(32)
        cell.joints()
        return cell.somebody(at=far)

    assert told_by("ur10e").reason == "clear; speeding up"  # of a driver that has ended
    here[:] = [endpoint("ur_driver", SEPARATION)]
    told = told_by("ur10e")
    assert told.speed_fraction == 0
    other = "another arm is driven than judged: 'model' of 'ur_driver' is ur10e, of 'arm' ur5e"
    assert told.reason == f"stopped: {other}"
    found = node.diagnoses()[0]
    assert (found.level, found.message) == (convert.Level.ERROR, f"{other}, so it stands")
    assert told_by("ur5e").reason == "clear; speeding up"


def beside_somebody(driver: dict[str, str], *endpoints: Endpoint, **arm: object) -> list[float]:
    """Shares of its speed that an arm is left, launched with such a driver, while one endpoint after another is there.

    First while there is none.
    """
    here: list[Endpoint] = []
    told = {"model": "ur5e", "limiter": {"rise_per_s": 1000.0}, **arm}
    sections = {"/**": {"rig": {"scenario": "demo"}}, "arm": told, "ur_driver": driver}
    cell = Cell()
    setup = Setup("arm", cell.bus, cell.clock, Timers(), sections, "cell.yaml", lambda: None, lambda: tuple(here))
    make_arm(setup).configure()
    share, shares = 1.0, []
    for endpoint in (None, None, *endpoints):
        here[:] = [] if endpoint is None else [endpoint]
        for _ in range(12):  # until it is no faster than it is told, and that has been so for a while
            cell.wait(32)
            cell.joints(qd=TURNING * share)
            share = cell.somebody().speed_fraction
        shares.append(share)
    return shares[1:]  # the first decision finds a limiter that has just begun


def endpoint(node: str, topic: str = FOLLOW, kind: EntityKind = EntityKind.SUBSCRIBER) -> Endpoint:
    return Endpoint(kind, NodeIdentity("00", 0, node), 0, f"/cell{topic}", str(kind_of(topic).msgtype), "", Qos())


def test_a_servoed_arm_is_left_room_for_the_brake_on_its_path() -> None:
    """Its driver brakes three to four times farther than the arm by itself, which is what the law took it to do."""
    others = (endpoint("recorder"), endpoint("ur_driver", SEPARATION), endpoint("ur_driver", kind=EntityKind.NODE))
    by_itself, beside, *not_servoed = beside_somebody({"mode": "slider"}, endpoint("ur_driver"), *others)
    assert 0 < beside < by_itself - 0.1
    assert not_servoed == [by_itself] * 3
    assert beside_somebody({}, servoed=True) == [beside]
    assert beside_somebody({"mode": "servo"}, servoed=False) == [beside]


def test_the_law_counts_on_the_look_ahead_of_the_driver_that_servoes() -> None:
    driver = {"mode": "servo"}
    shares = [beside_somebody({**driver, "lookahead_s": seconds}) for seconds in (0.2, 0.1, 0.03)]
    assert shares[0][0] < shares[1][0] - 0.02 < shares[2][0] - 0.04
    assert shares[1] == beside_somebody(driver) == beside_somebody({}, servoed=True)
    assert beside_somebody({}, servoed=True, lookahead_s=0.03) == shares[2]
    assert beside_somebody({**driver, "lookahead_s": 0.03}, lookahead_s=0.2) == shares[0]
    with pytest.raises(TwinError, match=r"lookahead_s: expected 0.03 to 0.2, found 0.5"):
        beside_somebody({}, lookahead_s=0.5)


def test_measured_stops_are_parameters() -> None:
    row = {"speed": 3.2, "times": [1.5] * 6, "angles": [2.5] * 6}
    assert beside_somebody({}, stopping=[row]) < beside_somebody({})
    table = fill(ArmParameters, {"stopping": [{**row, "speed": 1.0}, row]}, "arm").table(MODEL)
    assert table.stop(np.full(6, 3.2)).duration_s == pytest.approx(1.5)


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        ([{"speed": 1.0, "times": [0.1] * 6, "angles": [0.1] * 5}], "expected a time and an angle per joint, found 6"),
        ([{"speed": 1.0, "times": [0.1] * 7, "angles": [0.1] * 7}], "expected times of the 6 joints of ur5e"),
        ([{"speed": 0.0, "times": [0.0] * 6, "angles": [0.0] * 6}], "expected rising speeds"),
        (
            [{"speed": 183.0, "times": [0.5] * 6, "angles": [0.7] * 6}],
            "in rad/s, at most 15, found 183",
        ),
        (
            [{"speed": 3.2, "times": [0.5] * 6, "angles": [40.0] * 6}],
            r"about 0\.8 rad, found 40; give rad/s",
        ),
        ([{"speed": 3.2, "times": [0.5] * 6, "angles": [0.0] * 6}], r"about 0\.8 rad, found 0"),
        ([{"speed": 3.2, "times": [0.0] * 6, "angles": [0.7] * 6}], "stop from 3.2 rad/s in 0 s .* found 0.7"),
        ([{"speed": 1.0, "times": [-0.1] * 6, "angles": [0.1] * 6}], "expected finite times and angles"),
    ],
)
def test_measured_stops_that_are_none_are_refused(rows: list[dict[str, Any]], words: str) -> None:
    with pytest.raises(TwinError, match=words):
        fill(ArmParameters, {"stopping": rows}, "arm").table(MODEL)


def test_the_sections_on_the_arms_page_can_be_pasted(tmp_path: Path) -> None:
    page = (Path(__file__).parents[2] / "docs" / "arm.md").read_text()
    path, arms = tmp_path / "arm.yaml", []
    for section in page.split("```yaml\n")[1:]:
        path.write_text(section.split("```")[0])
        arms.append(load_parameters(path).arm)
    carrying, allowed = arms
    assert len(carrying.tool) == 1 and carrying.servoed
    assert carrying.table(carrying.arm()).speeds.tolist() == [3.2]
    assert len(allowed.regions(allowed.arm())) == 1


def test_a_cover_of_more_obstacles_can_be_given_room() -> None:
    """As many as 'obstacles: most_static' and the like may ask for: the error tells to raise it."""
    cell = Cell(max_obstacles=9)
    cell.joints()
    assert cell.somebody(count=9).reason == "slow for MOVING"
    with pytest.raises(TwinError, match="expected at most 9 of a shape, found 10; raise max_obstacles"):
        cell.somebody(count=10)
    with pytest.raises(TwinError, match="max_obstacles: expected a number of 1 or more, found 0"):
        ArmParameters(max_obstacles=0)


@pytest.mark.parametrize("sections", [{"obstacles": {"most_static": 600}}, {"arm": {"max_obstacles": 831}}])
def test_a_cover_that_the_arm_has_no_room_for_is_told_when_parameters_are_read(
    tmp_path: Path, sections: dict[str, dict[str, int]]
) -> None:
    """At run time it would be told by the first crowded forecast: the arm stops then, in the middle of its work."""
    file = tmp_path / "chain.yaml"
    file.write_text(yaml.safe_dump({name: {"ros__parameters": values} for name, values in sections.items()}))
    with pytest.raises(
        TwinError, match=r"arm: max_obstacles: expected room for the \d+ obstacles .* raise it, or lower"
    ):
        load_parameters(file)
    fits = {"obstacles": {"most_static": 600}, "arm": {"max_obstacles": 1176}}
    assert fill(ChainParameters, fits, "test").obstacles.most == 1176


def test_a_tool_of_the_parameters_is_kept_away_too() -> None:
    """A gripper that no parameter could tell of reached 16 cm farther than the law knew."""
    gripper = {"start": [0.0, 0.0, 0.045], "end": [0.0, 0.0, 0.25], "radius": 0.045}
    tip = forward_kinematics(MODEL, READY)[-1] @ np.array([0.0, 0.0, 0.25, 1.0])
    distances = []
    for tool in ([], [gripper]):
        cell = Cell(tool=tool)
        cell.joints()
        distances.append(cell.somebody(at=tip[:3] + np.array([0.0, 0.3, 0.0])).distance)
    assert distances[1] == pytest.approx(0.3 - 0.045 - 0.05, abs=0.1)
    assert distances[1] < distances[0] - 0.05


@pytest.mark.parametrize(
    "wrong",
    [{"radius": 0.0}, {"radius": math.inf}, {"end": [0.0, 0.0, math.inf]}, {"radius": 45.0}, {"start": [45.0, 0, 0]}],
)
def test_a_tool_that_is_none_is_refused(wrong: dict[str, Any]) -> None:
    tool = {"start": [0.0, 0.0, 0.0], "end": [0.0, 0.0, 0.1], "radius": 0.05, **wrong}
    with pytest.raises(TwinError, match="tool: expected ends and a radius in metres"):
        fill(ArmParameters, {"tool": [tool]}, "arm")


def test_what_stands_may_be_touched_where_it_is_allowed() -> None:
    """An arm at its table had no parameter that let it near, and beside its own unseen shadow it stood for ever."""
    tool = forward_kinematics(MODEL, READY)[-1, :3, 3]
    box = {"lower": (tool - 0.2).tolist(), "upper": (tool + 0.2).tolist()}
    for kind in (ObstacleKind.STATIC, ObstacleKind.UNSEEN, ObstacleKind.MOVING):
        touched = []
        for allowed in ([], [{**box, "links": ["forearm_link"]}], [box]):
            cell = Cell(allowed=allowed)
            cell.joints()
            touched.append(cell.somebody(at=tool, kind=kind).distance <= 0)
        assert touched == [True, True, kind == ObstacleKind.MOVING]


def test_an_arm_of_a_file_with_other_joints_is_told_its_own(tmp_path: Path) -> None:
    arm = '<body><joint name="{}" axis="0 0 1"/><geom size=".1"/>{}</body>'
    (tmp_path / "two.xml").write_text(
        f"<mujoco><worldbody>{arm.format('turn', '')}{arm.format('belt', '')}</worldbody></mujoco>"
    )
    given = {"model": str(tmp_path / "two.xml"), "joints": ["turn"]}
    assert fill(ArmParameters, given, "arm").arm().joint_names == ("turn",)
    with pytest.raises(TwinError, match="expected joint bend, found turn, belt"):
        fill(ArmParameters, {**given, "joints": ["bend"]}, "arm").arm()


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"lower": [1.0, 0.0, 0.0]}, "allowed: expected a lower corner below the upper one in metres"),
        ({"upper": [500.0, 500.0, 500.0]}, "allowed: expected a lower corner below the upper one in metres"),
        ({"links": ["wrist_9_link"]}, "allowed: expected links of shoulder_link, .*, found 'wrist_9_link'"),
    ],
)
def test_a_region_that_is_none_is_refused(wrong: dict[str, Any], words: str) -> None:
    box = {"lower": [0.0, 0.0, 0.0], "upper": [0.5, 0.5, 0.5], **wrong}
    with pytest.raises(TwinError, match=words):
        parameters = fill(ArmParameters, {"model": "ur5e", "allowed": [box]}, "arm")
        make_arm_node(LocalBus(), SteppedClock(START), WORKSPACE, parameters)


def test_what_a_file_says_of_all_nodes_is_said_of_the_chains_too(tmp_path: Path) -> None:
    """`/**` went past them in silence: another arm was judged than the file names."""
    file = tmp_path / "shared.yaml"
    file.write_text("/**: {ros__parameters: {model: ur5e, max_rate_hz: 12.0, use_sim_time: true}}\n")
    found = load_parameters(file)
    assert found.arm.model == "ur5e"
    assert found.synchronizer.max_rate_hz == 12
    file.write_text(file.read_text() + "arm: {ros__parameters: {model: ur3e}}\n")
    assert load_parameters(file).arm.model == "ur3e", "a node's own section counts"
