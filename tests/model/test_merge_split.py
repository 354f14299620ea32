"""Who merges and who splits, by what points of bodies say of their velocities."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from model_scenes import TICK_NS

from twin_node.model import merge_split
from twin_node.model.cells import Cells
from twin_node.model.decisions import Kind, LogEvidence
from twin_node.model.gaussians import Gaussians
from twin_node.model.kernels import kernels
from twin_node.model.merge_split import AGREED_S, SEARCHES, Merge, MergeSplit, Regrouping, Split
from twin_node.model.nodes import Nodes
from twin_node.model.parts import halves_of, halves_reference, lie_apart, redealt
from twin_node.model.passing import Passing
from twin_node.model.regrouping import Carried, regroup
from twin_node.model.velocity_equations import PARAMETERS, PoseEquations, VelocityEquations, nothing, velocities_of
from twin_node.scene import Tier

DT_S = TICK_NS * 1e-9
ORANGE, WHITE = (0.9, 0.4, 0.2), (0.7, 0.6, 0.6)


def told(velocities: np.ndarray, centres: np.ndarray, seed: int, noise: float | np.ndarray = 0.2) -> VelocityEquations:
    """What points about `centres` [c, 3] of bodies with `velocities` [c, 6] about the origin would say in one set."""
    rng = np.random.default_rng(seed)
    points = centres[:, None] + rng.uniform(-0.03, 0.03, (len(centres), 40, 3))
    x, y, z = np.moveaxis(points, -1, 0)
    o = np.zeros_like(x)
    crossed = np.stack([o, z, -y, -z, o, x, y, -x, o], -1).reshape(*x.shape, 3, 3)
    J = np.concatenate([np.broadcast_to(np.eye(3), crossed.shape), crossed], -1).reshape(len(centres), -1, PARAMETERS)
    J = 200 * DT_S * J
    error = (J @ velocities[..., None])[..., 0] + np.reshape(noise, (-1, 1)) * rng.standard_normal(J.shape[:2])
    turned_J = np.swapaxes(J, 1, 2)
    g = (turned_J @ error[..., None])[..., 0]
    return VelocityEquations(turned_J @ J, g, (error**2).sum(1), np.full(len(centres), 120.0))


def row_of(count: int, nodes: list[int], colours: dict[int, tuple[float, float, float]] | None = None) -> Cells:
    """Cells in a row along x, 6 cm apart, of the nodes given: white ones, if `colours` by cell do not say otherwise."""
    rgb = np.array([(colours or {}).get(cell, WHITE) for cell in range(count)])
    centres = np.stack([0.06 * np.arange(count), np.zeros(count), np.zeros(count)], 1)
    keys, of_nodes = np.arange(count, dtype=np.int64), np.array(nodes, np.int64)
    return Cells(keys, of_nodes, of_nodes, keys, centres, rgb)


def decided(cells: Cells, velocities: np.ndarray, sets: int = 12, noise: float | np.ndarray = 0.2) -> list[Regrouping]:
    """All decisions about bodies whose cells go on moving alike."""
    merge_split, ids = MergeSplit(), np.arange(8)
    out: list[Regrouping] = []
    for index in range(sets):
        merge_split.accumulate(cells, told(velocities, cells.centres, index, noise), DT_S)
        out += merge_split.decide(ids, DT_S)
    return out


def test_nothing_is_decided_about_nodes_and_gaussians_that_have_gone_since() -> None:
    nodes = Nodes(2, 4)
    place = torch.zeros(3, dtype=torch.float64)
    kept, ended = (nodes.give_birth(place, place) for _ in range(2))
    gaussians = Gaussians(3, torch.device("cpu"))
    gaussians.alive[:] = True
    gaussians.nodes[:] = torch.tensor([kept, ended, ended])
    carried = Carried(torch.arange(3), row_of(3, [kept, ended, ended]), nodes.ids.clone())
    gaussians.retire(torch.tensor([2]))
    assert carried.leavers(gaussians, ended, np.array([True, True, True])).tolist() == [1]
    assert carried.are_there(nodes, kept, ended)
    nodes.retire(torch.tensor([ended]))
    assert not carried.are_there(nodes, kept, ended)
    assert nodes.give_birth(place, place) == ended
    assert not carried.are_there(nodes, kept, ended), "another one has its row"


@pytest.mark.parametrize("staying", [[], [7], [0]])
def test_what_parts_takes_no_founder_along_that_stays_with_the_node(
    staying: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    # Cells are told apart by founder and place: were a founder of two nodes, cells of both could be taken for one.
    nodes, place = Nodes(4, 4), torch.zeros(3, dtype=torch.float64)
    node = nodes.give_birth(place, place)
    gaussians = Gaussians(4 + len(staying), torch.device("cpu"))
    gaussians.alive[:] = True
    gaussians.nodes[:] = node
    gaussians.tiers[:] = int(Tier.RIGID)
    gaussians.values[:, 0] = torch.tensor([0.0, 0.06, 0.12, 0.18, *[0.2] * len(staying)])
    gaussians.founders[:4] = torch.tensor([int(nodes.ids[node]) + 9, int(nodes.ids[node]) + 9, 7, int(nodes.ids[node])])
    gaussians.founders[4:] = torch.tensor(staying, dtype=torch.int64)  # housed since the set told of the others' motion
    cells = replace(row_of(4, [node] * 4), founders=gaussians.founders[:4].numpy().copy())
    carried = Carried(torch.arange(4), cells, nodes.ids.clone())
    merge_split, leaving = MergeSplit(), np.array([False, False, True, True])
    merge_split.accumulate(cells, told(np.zeros((4, 6)), cells.centres, 0), DT_S)
    split = Split(node, leaving, LogEvidence(0.0, 20.0, 0.0, 1.0))
    monkeypatch.setattr(merge_split, "decide", lambda *_: [split])
    assert [one.kind for one in regroup(gaussians, carried, nodes, merge_split, 0.1)] == [Kind.SPLIT]
    begun = int(gaussians.nodes[3])
    assert gaussians.nodes.tolist() == [node, node, begun, begun] + [node] * len(staying)
    of = [set(gaussians.founders[gaussians.nodes == row].tolist()) for row in (node, begun)]
    assert not of[0] & of[1]
    assert int(nodes.ids[node]) not in of[1], "whom it takes in from now on has it as founder"
    assert (int(gaussians.founders[2]) == 7) != (7 in staying)


def test_neighbours_that_turn_about_one_axis_are_one_body_and_others_are_not() -> None:
    cells = row_of(6, [0, 0, 0, 1, 1, 1])
    about_one = np.tile([0.1, 0.0, 0.0, 0.0, 0.0, 0.8], (6, 1))
    merged = decided(cells, about_one)
    assert merged and all(isinstance(one, Merge) and {one.kept, one.ended} == {0, 1} for one in merged)
    two = about_one.copy()
    two[3:, 1] += 0.05
    assert not decided(cells, two)


def test_what_goes_a_little_slower_than_its_neighbour_is_not_taken_for_part_of_it() -> None:
    """One motion for both would cost less than what two more certain ones do: it must not err more than by chance."""
    cells, velocities = row_of(6, [0, 0, 0, 1, 1, 1]), np.tile([0.1, 0.0, 0.0, 0.0, 0.0, 0.8], (6, 1))
    velocities[3:, 1] += 0.012
    assert not decided(cells, velocities)


def test_neighbours_merge_once_they_have_agreed_for_long_and_each_with_one_other_at_a_time() -> None:
    cells, about_one = row_of(6, [0, 0, 1, 1, 2, 2]), np.tile([0.1, 0.0, 0.0, 0.0, 0.0, 0.8], (6, 1))
    assert not decided(cells, about_one, int(AGREED_S / DT_S))
    merge_split, pairs = MergeSplit(), set()
    for index in range(12):
        merge_split.accumulate(cells, told(about_one, cells.centres, index), DT_S)
        merged = [one for one in merge_split.decide(np.arange(3), DT_S) if isinstance(one, Merge)]
        assert len({row for one in merged for row in (one.kept, one.ended)}) == 2 * len(merged)
        pairs |= {frozenset((one.kept, one.ended)) for one in merged}
    assert pairs, "and they do"


@pytest.mark.parametrize("larger", [0, 1])
def test_of_two_that_merge_the_one_more_is_known_of_goes_on(larger: int) -> None:
    cells, about_one = row_of(6, [larger] * 4 + [1 - larger] * 2), np.tile([0.1, 0.0, 0.0, 0.0, 0.0, 0.8], (6, 1))
    merged = decided(cells, about_one)
    assert merged and all(isinstance(one, Merge) and one.kept == larger for one in merged)


def test_of_many_nodes_each_is_looked_at_in_turn() -> None:
    alone = 2 * SEARCHES - 1
    nodes = [*range(alone), *[alone] * 6]
    cells, velocities = row_of(len(nodes), nodes), np.zeros((len(nodes), 6))
    cells.centres[:alone, 1] = np.arange(1, alone + 1)
    cells.centres[-2:, 0] += 0.01
    velocities[-2:, 1] = 0.1
    splits = [one for one in decided(cells, velocities) if isinstance(one, Split)]
    assert splits and splits[0].node == alone
    assert np.flatnonzero(splits[0].leaving).tolist() == [alone + 4, alone + 5]


def test_velocities_are_those_of_late_and_none_where_nothing_was_said() -> None:
    cells, moving = row_of(3, [0, 0, 0]), np.tile([0.3, 0.0, 0.0, 0.0, 0.0, 0.0], (3, 1))
    merge_split, at = MergeSplit(), np.zeros((2, 3))
    said = []
    for index in range(12):
        merge_split.accumulate(cells, told(moving * (index < 6), cells.centres, index), DT_S)
        said.append(merge_split.velocities(np.array([0, 5]), at))
    assert said[5][0, :3] == pytest.approx([0.3, 0.0, 0.0], abs=0.02)
    assert np.abs(said[11][0, :3]).max() < 0.02
    assert not said[11][1].any()
    merge_split.accumulate(cells, told(moving, cells.centres, 12), DT_S)
    others = replace(cells, keys=cells.keys + 3)
    merge_split.accumulate(others, told(0 * moving, cells.centres, 13), DT_S)
    assert np.abs(merge_split.velocities(np.array([0]), at[:1])[0, :3]).max() < 0.02, "new cells have no past"


def test_what_rests_together_is_one_body_only_where_it_looks_alike() -> None:
    rest, orange = np.zeros((6, 6)), dict.fromkeys((3, 4, 5), ORANGE)
    assert not decided(row_of(6, [0, 0, 0, 1, 1, 1], orange), rest)
    merged = decided(row_of(6, [0, 0, 0, 1, 1, 1]), rest)
    assert merged and all(isinstance(one, Merge) for one in merged)
    shaded = {cell: (0.5 * r, 0.5 * g, 0.5 * b) for cell, (r, g, b) in {4: WHITE, 5: WHITE, 3: WHITE}.items()}
    assert decided(row_of(6, [0, 0, 0, 1, 1, 1], shaded), rest), "shade is no other colour"


def test_what_a_precise_part_says_is_not_drowned_by_what_errs_beside_it() -> None:
    """A textured block that a loosely seen arm pushes against, and leaves behind."""
    velocities = np.zeros((6, 6))
    velocities[:3, 1] = 0.12
    noise = np.array([3.0] * 3 + [0.2] * 3)
    orange = dict.fromkeys((3, 4, 5), ORANGE)
    assert not decided(row_of(6, [0, 0, 0, 1, 1, 1], orange), velocities, noise=noise)
    splits = [one for one in decided(row_of(6, [0] * 6, orange), velocities, 30, noise) if isinstance(one, Split)]
    assert splits and splits[0].leaving.tolist() in ([True] * 3 + [False] * 3, [False] * 3 + [True] * 3)


def test_a_part_that_looks_like_a_neighbour_and_moves_with_it_goes_over_to_it() -> None:
    cells = row_of(7, [0, 0, 0, 0, 0, 1, 1], dict.fromkeys((3, 4, 5, 6), ORANGE))
    velocities = np.zeros((7, 6))
    velocities[:3, 1] = 0.12
    passed = [one for one in decided(cells, velocities, 2) if isinstance(one, Passing)]
    assert passed[0].node == 0 and passed[0].to == 1
    assert passed[0].leaving.tolist() == [False] * 4 + [True] + [False] * 2, "what touches the neighbour"
    as_the_arm = np.tile([0.0, 0.12, 0.0, 0.0, 0.0, 0.0], (7, 1))
    as_the_arm[5:] = 0.0
    assert not [one for one in decided(cells, as_the_arm, 2) if isinstance(one, Passing)], "it moves with its own"


def test_a_node_whose_cells_move_two_ways_parts_along_the_cut_and_one_body_never_does() -> None:
    cells = row_of(6, [0] * 6)
    alike = np.tile([0.1, 0.0, 0.0, 0.0, 0.0, 0.8], (6, 1))
    assert not decided(cells, alike, 30)
    two = alike.copy()
    two[4:, 1] -= 0.1
    splits = [one for one in decided(cells, two, 30) if isinstance(one, Split)]
    assert splits[0].leaving.tolist() == [False] * 4 + [True] * 2


def test_a_suspicion_that_explains_less_than_another_cut_gives_way_to_it_and_the_best_stands() -> None:
    cells = row_of(6, [0] * 6)
    two = np.tile([0.1, 0.0, 0.0, 0.0, 0.0, 0.8], (6, 1))
    two[4:, 1] -= 0.1
    said = told(two, cells.centres, 0)
    smaller, wrong = np.arange(6) >= 4, np.arange(6) % 2 > 0
    better = halves_of(said, cells.centres, 0.04, wrong)
    assert better is not None
    assert np.array_equal(better, smaller)
    assert halves_of(said, cells.centres, 0.04, smaller) is None
    almost = np.arange(6) >= 3
    assert halves_of(said, cells.centres, 1e6, almost) is None, "among errors as large neither tells more"


def test_what_errs_throughout_a_body_is_no_second_one_and_what_parts_is() -> None:
    """Views that err differently see cells of all of a body, as a body's own motion does not part it."""
    centres = np.stack(np.meshgrid(0.06 * np.arange(6), 0.06 * np.arange(6), [0.0]), -1).reshape(-1, 3)
    throughout, half = np.random.default_rng(4).random(36) > 0.5, centres[:, 1] > 0.15
    found = []
    for second in (throughout, half):
        two = np.tile([0.2, 0.0, 0.0, 0.0, 0.0, 0.0], (36, 1))
        two[second, 1] += 0.1
        said = told(two, centres, 1)
        found.append(halves_of(said, centres, 0.04))
        assert np.array_equal(redealt(said, centres, second, 0.04), second), "its motion tells whose each cell is"
    assert found[0] is None
    assert found[1] is not None
    assert np.array_equal(found[1], half) or np.array_equal(found[1], ~half)
    assert lie_apart(centres, np.stack([throughout, half])).tolist() == [False, True]
    assert lie_apart(centres[:3], np.array([[True, False, True]])).all(), "three cells are too few to tell"


@pytest.mark.parametrize(("nats", "goes_along"), [(0.5, True), (0.9, True), (1.1, False), (3.0, False)])
def test_a_cell_that_tells_less_than_a_nat_of_whose_it_is_goes_with_its_neighbours(
    nats: float, goes_along: bool
) -> None:
    centres, misfit, odd = np.stack([0.06 * np.arange(12), np.zeros(12), np.zeros(12)], 1), 0.04, 2
    second = np.arange(12) >= 6
    one, other = np.array([0.2, 0, 0, 0, 0, 0]), np.array([0.2, 0.1, 0, 0, 0, 0])
    motions = np.where(second[:, None], other, one)
    motions[odd] = other
    apart = told(np.tile(other - one, (12, 1)), centres, 1, noise=0.0).squares[odd]
    share = np.ones(12)
    share[odd] = nats * 2 * misfit / apart
    along = redealt(weighed(told(motions, centres, 1, noise=0.0), share), centres, second, misfit)
    assert bool(along[odd]) != goes_along
    assert np.array_equal(np.delete(along, odd), np.delete(second, odd))


@pytest.mark.parametrize("weak", [False, True])
def test_where_no_cell_of_one_part_tells_whose_it_is_none_changes_hands(weak: bool) -> None:
    """Else all would go to the part of which some tell."""
    centres, second = np.stack([0.06 * np.arange(12), np.zeros(12), np.zeros(12)], 1), np.arange(12) >= 6
    motions = np.where(second[:, None], [0.1, 0.1, 0, 0, 0, 0], [0.1, 0, 0, 0, 0, 0])
    said = weighed(told(motions, centres, 1, noise=0.0), np.where(second == weak, 1.5e-3, 1.0))
    assert np.array_equal(redealt(said, centres, second, 0.04), second)


def weighed(said: VelocityEquations, share: np.ndarray) -> VelocityEquations:
    """What was said by a share [c] of the points of each cell."""
    return VelocityEquations(
        said.H * share[:, None, None], said.g * share[:, None], said.squares * share, said.counts * share
    )


def test_a_suspicion_that_tells_nothing_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """It must tell more and more, or another cut is looked for without it."""
    cells, asked = row_of(12, [0] * 12), []

    def half(said: VelocityEquations, _: object, __: object, suspected: np.ndarray | None) -> np.ndarray | None:
        asked.append(suspected is None)
        return np.arange(len(said)) < 6 if suspected is None else None

    monkeypatch.setattr(merge_split, "halves_of", half)
    decided(cells, np.tile([0.1, 0.0, 0.0, 0.0, 0.0, 0.8], (12, 1)), 30)
    assert sum(asked) > 4
    assert sum(asked) < 15, "nor at once"


def test_what_parts_slowly_is_told_by_what_comes_and_not_by_what_has_long_been_said() -> None:
    cells, slowly = row_of(6, [0] * 6), np.tile([0.1, 0.0, 0.0, 0.0, 0.0, 0.8], (6, 1))
    slowly[4:, 1] -= 0.025
    assert [one for one in decided(cells, slowly, 8) if isinstance(one, Split)]


@pytest.mark.skipif(kernels() is None, reason="no compiled kernels here")
def test_compiled_halves_are_the_plain_ones() -> None:
    """Of bodies of few to many cells whose part goes its own way, not at all to clearly."""
    rng, found = np.random.default_rng(0), []
    for count in (5, 24, 60, 61, 121, 200):
        centres = rng.uniform(-0.15, 0.15, (count, 3)) * (1.0, 0.9, 0.4) + rng.normal(size=3)
        tilted = (centres - centres.mean(0)) @ rng.normal(size=3) > 0.02
        second = tilted if count % 2 else np.linalg.norm(centres - centres[0], axis=1) < 0.12
        for apart, noise in ((0.0, 0.2), (0.002, 0.2), (0.01, 0.2), (0.1, 0.2), (0.1, 4.0)):
            two = np.zeros((count, PARAMETERS))
            two[second, 1] = apart
            said = replace(told(two, centres, count, noise), counts=rng.permutation(np.geomspace(1, 200, count)))
            for suspected in (None, second, rng.random(count) > 0.5):
                plain = halves_reference(said, centres, noise**2, suspected)
                found.append(halves_of(said, centres, noise**2, suspected))
                assert (found[-1] is None) == (plain is None)
                assert plain is None or np.array_equal(found[-1], plain)
    assert 0 < sum(one is None for one in found) < len(found)


def test_of_hardly_anything_said_there_are_no_halves() -> None:
    cells = row_of(6, [0] * 6)
    said = told(np.zeros((6, 6)), cells.centres, 0)
    for few in (nothing(0), nothing(6), said.of(np.zeros(1, np.int64))):
        assert halves_of(few, np.zeros((len(few), 3)), 0.04) is None
        assert halves_reference(few, np.zeros((len(few), 3)), 0.04) is None


def test_a_suspicion_whose_cut_lies_all_over_the_body_is_dropped(monkeypatch: pytest.MonkeyPatch) -> None:
    cells, two = row_of(12, [0] * 12), np.tile([0.1, 0.0, 0.0, 0.0, 0.0, 0.8], (12, 1))
    two[::2, 1] -= 0.1
    asked = []

    def suspected(said: VelocityEquations, *_: object) -> np.ndarray:
        asked.append(len(said))
        return np.arange(len(said)) % 2 == 0

    monkeypatch.setattr(merge_split, "halves_of", suspected)
    assert not [one for one in decided(cells, two, 30) if isinstance(one, Split)]
    assert len(asked) > 1, "another cut is looked for"


def test_a_correction_to_a_predicted_pose_and_the_whole_step_say_the_same_velocity() -> None:
    rng = np.random.default_rng(2)
    velocity, origin = np.array([[0.2, -0.1, 0.05, 0.3, 0.6, -0.4]]), np.array([[0.5, 0.2, 0.3]])
    arms = rng.uniform(-0.1, 0.1, (30, 3))
    x, y, z = arms.T
    o = np.zeros(30)
    crossed = np.stack([o, z, -y, -z, o, x, y, -x, o], -1).reshape(-1, 3, 3)
    J = np.concatenate([np.broadcast_to(np.eye(3), crossed.shape), crossed], -1).reshape(1, 90, PARAMETERS) * 1e4
    predicted = 0.7 * velocity * DT_S
    error = (J @ (velocity * DT_S - predicted)[..., None])[..., 0]
    g = (np.swapaxes(J, 1, 2) @ error[..., None])[..., 0]
    said = PoseEquations(np.swapaxes(J, 1, 2) @ J, g, (error**2).sum(1), np.array([60.0]), origin, predicted)
    assert velocities_of(said.velocity_equations(DT_S), origin) == pytest.approx(velocity, abs=1e-3)
