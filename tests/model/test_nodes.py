"""Node poses over time: prediction, correction, memory."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from twin_node.model.adoption import grouped, grouped_reference, nearest, nearest_reference
from twin_node.model.carriage import carry, carry_reference
from twin_node.model.field import HexPlane
from twin_node.model.kernels import kernels
from twin_node.model.motion import Motion
from twin_node.model.nodes import FORETOLD_NS, MAX_SPEED, MAX_TURN, Nodes, advanced, advanced_reference
from twin_node.model.rotations import conjugate, quat_from_vector, quat_product, vector_from_quat
from twin_node.scene import Tier

TICK_NS = 33_000_000


def moving_nodes(speed: float = 1.0) -> Nodes:
    """One node that has moved along x at `speed` for six sets."""
    nodes = Nodes(4, 8)
    nodes.stamp = 1000
    row = nodes.give_birth(torch.zeros(3, dtype=torch.float64), torch.zeros(3, dtype=torch.float64))
    nodes.velocities[row, 0] = speed
    nodes.remember()
    for index in range(1, 7):
        nodes.predict(1000 + index * TICK_NS, 1.0)
        nodes.remember()
    return nodes


def test_a_constant_velocity_is_carried_on_exactly() -> None:
    nodes = moving_nodes(0.5)
    assert nodes.positions[0, 0] == pytest.approx(0.5 * 6 * 0.033)
    ahead = nodes.extrapolated([0.2])
    assert ahead.positions[0, 0, 0] == pytest.approx(0.5 * (6 * 0.033 + 0.2))


@pytest.mark.parametrize(("pause_ns", "gone_s"), [(FORETOLD_NS, 1.0), (FORETOLD_NS + 1, 0.0), (10**15, 0.0)])
def test_after_a_pause_nodes_are_looked_for_where_they_were(pause_ns: int, gone_s: float) -> None:
    nodes = moving_nodes(0.5)
    nodes.predict(nodes.stamp + pause_ns, 1.0)
    assert nodes.positions[0, 0] == pytest.approx(0.5 * (6 * 0.033 + gone_s))
    assert nodes.stamp == 1000 + 6 * TICK_NS + pause_ns


def test_the_window_remembers_and_interpolates() -> None:
    nodes = moving_nodes(1.0)
    stamps = (1000 + 2 * TICK_NS, 1000 + 2 * TICK_NS + TICK_NS // 2, 1000 + 6 * TICK_NS)
    x = [float(nodes.poses_at(stamp).positions[0, 0, 0]) for stamp in stamps]
    assert x == pytest.approx([0.066, 0.0825, 0.198])


def test_orientations_are_interpolated_inside_the_window_and_go_on_turning_after_it() -> None:
    nodes = Nodes(1, 8)
    nowhere = torch.zeros(3, dtype=torch.float64)
    nodes.angular_velocities[nodes.give_birth(nowhere, nowhere), 2] = 3.0
    for index in range(4):
        nodes.predict(index * TICK_NS, 1.0)
        nodes.remember()
    for ticks, turned in ((-5, 0.0), (0, 0.0), (1.25, 1.25), (3, 3), (5, 5)):
        at = vector_from_quat(nodes.poses_at(round(ticks * TICK_NS)).quats[0, 0])
        assert at.tolist() == pytest.approx([0, 0, 3.0 * turned * TICK_NS * 1e-9], abs=1e-9), ticks


def test_a_set_of_the_same_stamp_takes_no_further_place_in_the_window() -> None:
    nodes = Nodes(1, 2)
    nowhere = torch.zeros(3, dtype=torch.float64)
    nodes.give_birth(nowhere, nowhere)
    for stamp, x in ((0, 0.0), (TICK_NS, 1.0), (TICK_NS, 2.0), (TICK_NS, 3.0)):
        nodes.predict(stamp, 1.0)
        nodes.positions[0, 0] = x
        nodes.remember()
    xs = [float(nodes.poses_at(stamp).positions[0, 0, 0]) for stamp in (0, TICK_NS // 2, TICK_NS)]
    assert xs == pytest.approx([0.0, 1.5, 3.0], abs=1e-6)


def test_before_the_window_its_oldest_pose_holds_and_after_it_the_velocity() -> None:
    nodes = moving_nodes(1.0)
    assert nodes.poses_at(0).positions[0, 0, 0] == pytest.approx(0.0)
    later = nodes.poses_at(1000 + 6 * TICK_NS + 100_000_000)
    assert later.positions[0, 0, 0] == pytest.approx(0.298)


def test_measured_poses_teach_velocity_and_turn() -> None:
    nodes = Nodes(2, 4)
    row = torch.tensor([nodes.give_birth(torch.zeros(3, dtype=torch.float64), torch.zeros(3, dtype=torch.float64))])
    velocity = torch.tensor([[0.4, -0.2, 0.1]], dtype=torch.float64)
    turn = torch.tensor([[0.0, 0.0, 1.5]], dtype=torch.float64)
    for index in range(1, 40):
        nodes.predict(index * TICK_NS, 0.98)
        at = index * TICK_NS * 1e-9
        turned = quat_product(quat_from_vector(turn * at), conjugate(nodes.quats[row]))
        nodes.correct(row, velocity * at - nodes.positions[row], vector_from_quat(turned), TICK_NS * 1e-9)
    assert torch.allclose(nodes.velocities[row], velocity, atol=0.05)
    assert torch.allclose(nodes.angular_velocities[row], turn, atol=0.15)
    assert torch.allclose(nodes.positions[row], velocity * at, atol=2e-3)


def test_a_wild_measurement_cannot_make_an_impossible_speed() -> None:
    nodes = Nodes(2, 4)
    row = torch.tensor([nodes.give_birth(torch.zeros(3, dtype=torch.float64), torch.zeros(3, dtype=torch.float64))])
    far = torch.full((1, 3), 100.0, dtype=torch.float64)
    nodes.correct(row, far, torch.zeros_like(far), 0.033)
    assert nodes.velocities[row].norm() <= MAX_SPEED + 1e-9


def test_a_wild_turn_is_cut_in_its_own_direction_and_others_are_left() -> None:
    nodes = Nodes(2, 4)
    nowhere = torch.zeros(3, dtype=torch.float64)
    rows = torch.tensor([nodes.give_birth(nowhere, nowhere) for _ in range(2)])
    turns = np.array([[0.0, -4 * MAX_TURN, 3 * MAX_TURN], [0.0, 0.9 * MAX_TURN, 0.0]])
    nodes.set_velocities(rows, np.array([[0.9 * MAX_SPEED, 0.0, 0.0], [0.0, 0.0, -3 * MAX_SPEED]]), turns)
    assert nodes.angular_velocities.numpy() == pytest.approx(
        np.array([[0.0, -0.8 * MAX_TURN, 0.6 * MAX_TURN], [0.0, 0.9 * MAX_TURN, 0.0]])
    )
    assert nodes.velocities.numpy() == pytest.approx(np.array([[0.9 * MAX_SPEED, 0, 0], [0, 0, -MAX_SPEED]]))


def test_a_prediction_turns_damps_and_leaves_links_where_their_joints_have_them() -> None:
    nodes = Nodes(2, 4)
    nowhere, fast = torch.zeros(3, dtype=torch.float64), torch.tensor([1.0, 0.0, 0.0], dtype=torch.float64)
    for tier in (Tier.RIGID, Tier.ROBOT):
        nodes.angular_velocities[nodes.give_birth(nowhere, fast, tier)] = 2 * fast
    nodes.predict(100_000_000, 0.5)
    turned = vector_from_quat(nodes.quats)
    assert nodes.positions[:, 0].tolist() == pytest.approx([0.1, 0.0])
    assert turned[:, 0].tolist() == pytest.approx([0.2, 0.0])
    assert nodes.velocities[0].tolist() == [0.5, 0.0, 0.0]
    assert nodes.angular_velocities[0].tolist() == [1.0, 0.0, 0.0]


def test_driven_nodes_take_the_pose_and_its_speed() -> None:
    nodes = Nodes(2, 4)
    row = torch.tensor(
        [nodes.give_birth(torch.zeros(3, dtype=torch.float64), torch.zeros(3, dtype=torch.float64), Tier.ROBOT)]
    )
    quats = quat_from_vector(torch.tensor([[0.0, 0.1, 0.0]], dtype=torch.float64))
    nodes.drive(row, torch.tensor([[0.01, 0, 0]], dtype=torch.float64), quats, 0.05)
    assert nodes.velocities[row].tolist() == [pytest.approx([0.2, 0, 0])]
    assert nodes.angular_velocities[row].tolist() == [pytest.approx([0, 2.0, 0])]
    assert torch.allclose(vector_from_quat(nodes.quats[row]), torch.tensor([[0.0, 0.1, 0.0]], dtype=torch.float64))


def test_rows_are_used_again_but_ids_never() -> None:
    nodes = Nodes(2, 4)
    origin = torch.zeros(3, dtype=torch.float64)
    first = nodes.give_birth(origin, origin)
    nodes.give_birth(origin, origin)
    assert not nodes.free
    nodes.retire(torch.tensor([first]))
    again = nodes.give_birth(origin + 1, origin)
    assert again == first
    assert sorted(nodes.ids.tolist()) == [1, 2]


def test_who_takes_a_row_has_nothing_of_who_had_it() -> None:
    nodes = moving_nodes()
    nodes.tiers[0], nodes.evidence[0], nodes.sigmas[0] = int(Tier.DEFORMABLE), 1e3, 9.0
    nodes.angular_velocities[0] = 5.0
    nodes.quats[0] = quat_from_vector(torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64))
    nodes.retire(torch.tensor([0]))
    place, velocity = (torch.tensor([x, 0.0, 0.0], dtype=torch.float64) for x in (2.0, 0.3))
    assert nodes.give_birth(place, velocity) == 0
    assert torch.equal(nodes.positions[0], place) and torch.equal(nodes.anchors[0], place)
    assert torch.equal(nodes.velocities[0], velocity) and not nodes.angular_velocities[0].any()
    assert nodes.quats[0].tolist() == [1, 0, 0, 0] and not nodes.moved[0].any()
    assert (int(nodes.tiers[0]), float(nodes.evidence[0]), int(nodes.births[0])) == (Tier.RIGID, 0, nodes.stamp)
    assert nodes.sigmas[0] < 0.1


def test_the_past_of_a_row_stays_with_the_node_that_had_it_then() -> None:
    nodes = moving_nodes(1.0)
    nodes.retire(torch.tensor([0]))
    nodes.predict(1000 + 7 * TICK_NS, 1.0)
    origin = torch.zeros(3, dtype=torch.float64)
    assert nodes.give_birth(origin + 5, origin) == 0
    nodes.remember()
    assert nodes.poses_at(1000 + 6 * TICK_NS).positions[0, 0, 0] == pytest.approx(0.198)
    between = nodes.poses_at(1000 + 6 * TICK_NS + TICK_NS // 2)
    assert between.positions[0, 0].tolist() == pytest.approx([5.0, 5.0, 5.0])


def test_who_has_just_taken_a_row_comes_from_nowhere() -> None:
    nodes = moving_nodes(1.0)
    newest = 1000 + 6 * TICK_NS
    assert nodes.poses_before(newest, TICK_NS // 3).positions[0, 0, 0] == pytest.approx(0.198 - 0.011)
    assert nodes.poses_before(newest + TICK_NS, TICK_NS // 3).positions[0, 0, 0] == pytest.approx(0.198 + 0.022)
    nodes.retire(torch.tensor([0]))
    nodes.predict(newest + TICK_NS, 1.0)
    origin = torch.zeros(3, dtype=torch.float64)
    turned = quat_from_vector(torch.tensor([0.0, 0.0, 1.2], dtype=torch.float64))
    assert nodes.give_birth(origin + 5, origin, quat=turned) == 0
    nodes.remember()
    for since in (1, TICK_NS // 6, TICK_NS // 2, TICK_NS, 2 * TICK_NS):
        before = nodes.poses_before(newest + since, TICK_NS // 3)
        assert before.positions[0, 0].tolist() == pytest.approx([5.0] * 3), since
        assert before.quats[0, 0].tolist() == pytest.approx(turned.tolist()), since


def test_who_has_just_taken_a_row_comes_from_where_the_set_of_its_birth_shows_it() -> None:
    nodes, newest = moving_nodes(1.0), 1000 + 6 * TICK_NS
    nodes.retire(torch.tensor([0]))
    born, third = newest + TICK_NS, TICK_NS // 3
    nodes.predict(born, 1.0)
    origin = torch.zeros(3, dtype=torch.float64)
    assert nodes.give_birth(origin + 5, origin + 2) == 0
    nodes.remember()

    def before(stamp: int, ago_ns: int) -> float:
        return float(nodes.poses_before(stamp, ago_ns).positions[0, 0, 0])

    assert before(born + third, third) == pytest.approx(5.0)
    assert before(born + third, 2 * third) == pytest.approx(5.0), "between the sets it is where it was born"
    assert before(born + third, third + TICK_NS) == pytest.approx(5.022), "not yet there, so it has not moved"
    assert before(born, TICK_NS) == pytest.approx(5.0), "the row was another's until this very set"
    assert before(newest, third) == pytest.approx(0.198 - 0.011), "who had the row before has its own past"


def test_what_is_born_after_a_set_moves_from_there_and_leaves_what_the_set_has_shown() -> None:
    nodes = moving_nodes(1.0)
    nodes.retire(torch.tensor([0]))
    origin = torch.zeros(3, dtype=torch.float64)
    turned = quat_from_vector(torch.tensor([0.0, 0.0, 1.2], dtype=torch.float64))
    assert nodes.give_birth(origin + 5, origin + 2, quat=turned) == 0
    assert torch.equal(nodes.quats[0], turned)
    newest = 1000 + 6 * TICK_NS
    for stamp in (newest, newest + TICK_NS):
        assert nodes.poses_at(stamp).positions[0, 0].tolist() == pytest.approx([0.198, 0, 0])
    nodes.predict(newest + TICK_NS, 1.0)
    assert nodes.moved[0].tolist() == pytest.approx([0.066] * 3 + [0.0] * 3)


@pytest.mark.skipif(kernels() is None, reason="no compiled kernels here")
def test_compiled_poses_are_those_in_torch() -> None:
    draw = torch.Generator().manual_seed(3)
    positions, velocities, turns = (torch.randn(20, 3, generator=draw, dtype=torch.float64) for _ in range(3))
    turns[0], turns[1] = 0, 1e-7
    quats = quat_from_vector(torch.randn(20, 3, generator=draw, dtype=torch.float64))
    given = (positions, quats, velocities, turns, [0.0, -0.02, 0.2])
    found, expected = advanced(*given), advanced_reference(*given)
    assert torch.allclose(found.positions, expected.positions, atol=1e-12)
    assert torch.allclose(found.quats, expected.quats, atol=1e-12)


@pytest.mark.skipif(kernels() is None, reason="no compiled kernels here")
@pytest.mark.parametrize("width", [3, 6])
@pytest.mark.parametrize("places", [0, 1, 50])
@pytest.mark.parametrize("things", [0, 400])
def test_the_nearest_by_kernel_are_those_by_tree(width: int, places: int, things: int) -> None:
    draw = np.random.default_rng(5)
    at, own = draw.uniform(0, 4, (places, width)), draw.uniform(0, 4, (things, width))
    found = nearest(at, own)
    assert np.array_equal(found, nearest_reference(at, own))
    assert not len(found) or not things or width == 6 or (found >= 0).any()


@pytest.mark.skipif(kernels() is None, reason="no compiled kernels here")
@pytest.mark.parametrize("count", [0, 1, 120])
def test_groups_by_kernel_are_those_in_numpy(count: int) -> None:
    places = np.random.default_rng(6).uniform(0, 4, (count, 3))
    found = grouped(places)
    assert np.array_equal(found, grouped_reference(places))
    assert count < 2 or 1 < found.max() < count - 1


@pytest.mark.skipif(kernels() is None, reason="no compiled kernels here")
def test_how_nodes_have_moved_and_what_they_carry_are_by_kernel_what_they_are_in_torch() -> None:
    draw, nodes = torch.Generator().manual_seed(9), Nodes(6, 4)
    quats = quat_from_vector(torch.randn(6, 3, generator=draw, dtype=torch.float64))
    nodes.positions, nodes.quats = torch.randn(6, 3, generator=draw, dtype=torch.float64), quats
    nodes.remember()
    turns = torch.randn(6, 3, generator=draw, dtype=torch.float64)
    turns[0], turns[1] = 0, 1e-9
    nodes.quats, nodes.positions = quat_product(quat_from_vector(turns), quats), nodes.positions + 0.1
    nodes.quats[2] *= -1
    assert torch.allclose(nodes.moved, nodes.moved_reference(), atol=1e-12)
    assert torch.allclose(nodes.moved[:, 3:], turns, atol=1e-9)
    poses, carriers = nodes.extrapolated([0.0, 0.1]), torch.tensor([3, -1, 0, 5])
    compiled, plain = (vars(find(poses, carriers)) for find in (carry, carry_reference))
    for name, found in compiled.items():
        expected = plain[name]
        assert found.dtype == expected.dtype
        assert torch.allclose(found, expected, atol=1e-6)


def test_whether_anything_bends_is_asked_anew_when_tiers_or_lives_change() -> None:
    nodes = Nodes(4, 2)
    motion = Motion(nodes, HexPlane(torch.full((3,), -1.0), torch.ones(3), 2))
    row = nodes.give_birth(torch.zeros(3, dtype=torch.float64), torch.zeros(3, dtype=torch.float64))
    assert not motion.bends
    nodes.tiers[row] = int(Tier.DEFORMABLE)
    assert motion.bends
    nodes.retire(torch.tensor([row]))
    assert not motion.bends


def test_whose_motion_is_learned_is_asked_anew_when_tiers_or_lives_change() -> None:
    nodes = Nodes(4, 2)
    nowhere = torch.zeros(3, dtype=torch.float64)
    rows = [nodes.give_birth(nowhere, nowhere) for _ in range(3)]
    assert nodes.learned_rows.tolist() == rows
    nodes.tiers[rows[0]] = int(Tier.ROBOT)
    assert nodes.learned_rows.tolist() == rows[1:]
    nodes.retire(torch.tensor(rows[1:2]))
    assert nodes.learned_rows.tolist() == rows[2:]


def test_a_measured_pose_is_taken_for_nearly_all_of_it_and_a_velocity_for_some() -> None:
    nodes, shift = moving_nodes(0.0), torch.tensor([[0.1, 0.0, 0.0]], dtype=torch.float64)
    nodes.correct(torch.tensor([0]), shift, torch.zeros_like(shift), 0.05)
    assert nodes.positions[0].tolist() == pytest.approx([0.09, 0.0, 0.0])
    assert nodes.velocities[0].tolist() == pytest.approx([0.35 * 0.1 / 0.05, 0.0, 0.0])
