"""The part that an arm takes from one place to another stands, goes with the tool and stands again: it is no actor."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from twin_node.arm.tool import with_tool
from twin_node.cell import CellError, CellTruth, Scenario, SimulatedRig, load_scenario
from twin_node.cell.actors import Part
from twin_node.cell.shapes import Placed
from twin_node.cell.ur_arm import ArmInCell, DrivenArm, HeardArm
from twin_node.geometry import distance_to_segment, transform
from twin_node.nodes.chain_parameters import load_parameters
from twin_node.robot import forward_kinematics, ur_model
from twin_node.scene import Float64, JointSample


@pytest.fixture(scope="module")
def pick() -> Scenario:
    return load_scenario("pick")


def arm_of(scenario: Scenario) -> ArmInCell:
    assert scenario.arm is not None
    return ArmInCell(scenario.arm, scenario)


def place(arm: ArmInCell, stamp: int) -> Float64:
    """[4, 4] pose of the part's one solid."""
    (solid,) = arm.handled(stamp, 7)
    assert solid.owner == 7
    return solid.placed.T_base_shape


def in_tool(arm: ArmInCell, stamp: int) -> Float64:
    """[4, 4] the part's pose in the frame of `tool0`."""
    tool = forward_kinematics(arm.model, arm.positions(np.array([stamp]))[0])[-1]
    pose: Float64 = np.linalg.inv(tool) @ place(arm, stamp)
    return pose


def amid(arm: ArmInCell, scenario: Scenario) -> list[int]:
    """Stamps in the middle of the arm's rests, of three periods."""
    rests = arm.cycle.rests.mean(axis=1).astype(np.int64)
    return [scenario.start_ns + int(k * arm.cycle.period_ns + rest) for k in range(3) for rest in rests]


def test_it_goes_there_stays_and_comes_back_over_and_over(pick: Scenario) -> None:
    arm = arm_of(pick)
    rests = amid(arm, pick)
    ends = [pick.start_ns, *rests, pick.start_ns + 3 * arm.cycle.period_ns]
    goes_with_tool = [False, True, False, False, True, False, False]
    places = []
    for begin, end, held in zip(ends, ends[1:], goes_with_tool, strict=False):
        stamps = np.linspace(begin + 1, end - 1, 9).astype(np.int64)
        seen = np.array([(in_tool if held else place)(arm, int(stamp)) for stamp in stamps])
        np.testing.assert_allclose(seen, np.broadcast_to(seen[0], seen.shape), atol=1e-9)
        places.append(None if held else seen[0])
    first, _, there, still_there, _, back, again = places
    assert first is not None and there is not None
    assert np.linalg.norm(there[:3, 3] - first[:3, 3]) > 0.4
    np.testing.assert_allclose(there, still_there)
    np.testing.assert_allclose(first, back)
    np.testing.assert_allclose(first, again)
    later = 3 * arm.cycle.period_ns
    for stamp in range(pick.start_ns, pick.start_ns + later, 400_000_000):
        np.testing.assert_allclose(place(arm, stamp), place(arm, stamp + later), atol=1e-9)


def test_it_never_jumps(pick: Scenario) -> None:
    arm = arm_of(pick)
    stamps = np.arange(pick.start_ns, pick.start_ns + round(pick.duration_s * 1e9), 8_000_000)
    places = np.array([place(arm, int(stamp))[:3, 3] for stamp in stamps])
    assert np.linalg.norm(np.diff(places, axis=0), axis=1).max() < 3.0 * 0.008
    assert np.ptp(places[:, 2]) > 0.1


def test_an_arm_that_is_driven_slower_brings_it_later(pick: Scenario) -> None:
    assert pick.arm is not None
    driven, arm = DrivenArm(pick.arm, pick), arm_of(pick)
    for step in range(1, 400):
        driven.drive(pick.start_ns + 40_000_000 * step, 20_000_000 * step)
    for seconds in (0.5, 1.5, 2.5, 4.0, 6.0):
        slow, quick = (pick.start_ns + round(s * 1e9) for s in (2 * seconds, seconds))
        np.testing.assert_allclose(place(driven, slow), place(arm, quick), atol=1e-6)


def test_an_arm_that_is_heard_of_takes_it_where_it_rests(pick: Scenario) -> None:
    assert pick.arm is not None
    heard, arm = HeardArm(pick.arm, pick), arm_of(pick)
    at_rest = arm.cycle.rests
    for phase in range(0, 2 * arm.cycle.period_ns, 8_000_000):
        stamp = pick.start_ns + phase
        heard.hear(arm.sample(stamp))
        begun = phase % arm.cycle.period_ns - at_rest
        if phase % 400_000_000 == 0 and not ((begun[:, 0] >= -100_000_000) & (begun[:, 1] <= 0)).any():
            np.testing.assert_allclose(place(heard, stamp), place(arm, stamp), atol=1e-6)


def test_an_arm_that_passes_by_does_not_take_it(pick: Scenario) -> None:
    assert pick.arm is not None
    heard, arm = HeardArm(pick.arm, pick), arm_of(pick)
    first = place(heard, pick.start_ns)
    names, rest = arm.model.joint_names, arm.cycle.at(int(arm.cycle.rests[0, 0]))
    heard.hear(JointSample(pick.start_ns, names, rest, np.full(6, 0.1)))
    heard.hear(JointSample(pick.start_ns + 8_000_000, names, rest + 0.05, np.zeros(6)))
    assert np.array_equal(place(heard, pick.start_ns + 8_000_000), first)
    heard.hear(JointSample(pick.start_ns + 16_000_000, names, rest, np.zeros(6)))
    heard.hear(JointSample(pick.start_ns + 24_000_000, names, rest - 0.2, np.zeros(6)))
    assert np.linalg.norm(place(heard, pick.start_ns + 24_000_000)[:3, 3] - first[:3, 3]) > 0.05


def test_it_is_seen_and_is_neither_arm_nor_actor(pick: Scenario) -> None:
    rig = SimulatedRig(pick.at_width(160))
    truth, world = CellTruth(rig), rig.world
    owner = world.names.index("handled part")
    for seconds in (0.1, 2.4, 5.9):
        stamp = pick.start_ns + round(seconds * 1e9)
        seen = [rig.see(camera, stamp).shows((owner,)) for camera in range(3)]
        assert max(mask.sum() for mask in seen) > 10
        assert not any((mask & truth.arm_mask(camera, stamp)).any() for camera, mask in enumerate(seen))
        assert not len(truth.moving_voxels(truth.grid, stamp))
        assert not truth.moving_mask(0, stamp).any()


def test_who_handles_nothing_has_no_part() -> None:
    world = SimulatedRig(load_scenario("demo")).world
    assert "handled part" not in world.names and world.names[world.arm_owner] == "arm"
    assert len(world.arm_solids(world.scenario.start_ns)) == len(ur_model("ur5e").capsules)


@pytest.mark.parametrize(
    ("form", "size"),
    [("box", (0.3, 0.1, 0.05)), ("box", (0.05, 0.1, 0.3)), ("capsule", (0.03, 0.2)), ("sphere", (0.04,))],
    ids=["flat box", "tall box", "capsule", "sphere"],
)
def test_what_a_twin_is_told_holds_the_part(form: str, size: tuple[float, ...]) -> None:
    part = Part(form, size, (0.1, -0.2, 0.15), (20, 30, 40))
    about = part.about
    corners = Placed(part.shape, part.T_body_part).corners
    ends = np.array([about.start, about.end])
    if form == "box":
        gaps = distance_to_segment(corners, ends) - about.radius
        assert abs(gaps.max()) < 1e-9
    else:
        assert about.radius == size[0]
        low_high = np.array([[0, 0, -sum(size[1:]) / 2], [0, 0, sum(size[1:]) / 2]])
        np.testing.assert_allclose(ends, transform(part.T_body_part, low_high), atol=1e-12)


def test_the_arms_model_has_its_tool_and_is_drawn_without_what_it_may_hold(pick: Scenario) -> None:
    assert pick.arm is not None
    arm, bare = arm_of(pick), len(ur_model("ur5e").capsules)
    assert len(arm.model.capsules) == bare + 4
    assert len(arm.solids(pick.start_ns, 0)) == bare + 3
    empty = arm_of(replace(pick, arm=replace(pick.arm, handled=())))
    assert len(empty.model.capsules) == bare + 3 and not empty.handled(pick.start_ns, 0)


def test_the_example_of_parameters_tells_of_the_scenarios_arm(pick: Scenario) -> None:
    assert pick.arm is not None
    told = load_parameters(Path("launch/pick.yaml")).arm
    model = with_tool(ur_model(told.model), told.tool).capsules
    there = arm_of(pick)
    np.testing.assert_allclose(model.ends[:-1], there.model.capsules.ends[:-1])
    np.testing.assert_allclose(sorted(model.ends[-1, :, 2]), sorted(there.model.capsules.ends[-1, :, 2]), atol=1e-9)
    np.testing.assert_allclose(model.radii, there.model.capsules.radii, atol=6e-4)
    assert (model.radii >= there.model.capsules.radii).all()
    for rest in there.cycle.rests[:, 0]:
        tip = forward_kinematics(there.model, there.cycle.at(int(rest)))[-1] @ np.array([0, 0, 0.16, 1.0])
        assert any((np.array(box.lower) < tip[:3]).all() and (tip[:3] < box.upper).all() for box in told.allowed)


@pytest.mark.parametrize(
    ("changed", "wanted"),
    [
        ("tool: [{start: [0, 0, 30], end: [0, 0, 90], radius: 45}]", "tool: expected ends and a radius in metres"),
        ("cycle: {tool_length_m: 160}", "cycle.tool_length_m"),
        ("handled: [{form: brick}]", "form must be one of"),
    ],
    ids=["tool in mm", "length in mm", "no such form"],
)
def test_what_is_no_tool_or_part_is_refused(tmp_path: Path, changed: str, wanted: str) -> None:
    path = tmp_path / "mine.yaml"
    cameras = "cameras: [{name: cam, position: [1, 0, 1]}]"
    path.write_text(f"{cameras}\narm:\n  {changed}\n")
    with pytest.raises(CellError, match=wanted) as error:
        load_scenario(path)
    assert str(path) in str(error.value)
