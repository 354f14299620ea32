"""People who follow motion capture: made-up motions as shipped, bodies where they are put, files beside scenarios."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bvh_files import ONE_ARM, written
from made_motions import MADE, write_bvh

from twin_node import resources
from twin_node.bag.bvh import read_clip
from twin_node.cell import CellError, load_scenario
from twin_node.cell.actors import BvhMotion, Person
from twin_node.cell.bvh_body import RecordedBody
from twin_node.cell.people import HAND_RADIUS, LEG_RADIUS
from twin_node.cell.shapes import Form
from twin_node.cell.world import World
from twin_node.scene import Float64


@pytest.mark.parametrize("name", MADE)
def test_made_up_motions_are_those_shipped(name: str) -> None:
    assert resources.find(f"sim/{name}.bvh").read_text() == write_bvh(MADE[name]())


@pytest.mark.parametrize("name", MADE)
def test_made_up_motions_are_of_a_standing_person(name: str, tmp_path: Path) -> None:
    clip = read_clip(written(tmp_path, write_bvh(MADE[name]())))
    heights = {joint.name: clip.positions[:, row, 1] for row, joint in enumerate(clip.joints)}
    assert 1.5 < np.median(heights["HeadEnd"]) < 1.8
    assert -0.1 < min(heights["LeftFootEnd"].min(), heights["RightFootEnd"].min()) < 0.05
    lengths = np.linalg.norm(np.diff(clip.positions[:, [0, 1]], axis=1), axis=-1)
    assert np.ptp(lengths) < 1e-9


def test_a_recorded_body_stands_where_it_is_put(recordings: Path) -> None:
    motion = BvhMotion(
        str(recordings / "mocap" / "01_01.bvh"), position=(1.0, 2.0, -0.8), yaw_deg=90, from_s=1.0, start_s=0.5
    )
    body = RecordedBody(Person(height_m=1.75), motion)
    before, start = body.ends(-3.0), body.ends(0.5)
    np.testing.assert_array_equal(before, start)
    np.testing.assert_allclose(start[0, 0, :2], [1.0, 2.0], atol=1e-9)  # the hips carry the first bone
    everywhere = np.stack([body.ends(t) for t in np.arange(0, 22, 0.25)])
    assert everywhere[..., 2].min() > -0.81
    tall = np.percentile(np.ptp(everywhere[..., 2], axis=(1, 2)), 50)
    assert 1.4 < tall < 2.1
    np.testing.assert_allclose(body.ends(2.0), (body.ends(1.999) + body.ends(2.001)) / 2, atol=2e-3)


def test_people_in_scenarios_follow_files_beside_them(tmp_path: Path) -> None:
    world = World(load_scenario("reach_in"))
    solids = [solid for solid in world.moving(world.scenario.start_ns) if solid.owner in world.people_owners]
    radii = {solid.placed.shape.size[0] for solid in solids}
    assert {HAND_RADIUS, LEG_RADIUS} < radii
    assert all(solid.placed.shape.form is Form.CAPSULE for solid in solids)
    text = resources.find("sim/reach_in.yaml").read_text().replace("extends: cell", "cameras: [{name: one}]")
    (tmp_path / "mine.yaml").write_text(text)
    with pytest.raises(CellError, match=r"mine\.yaml: motion: no file 'reach\.bvh' beside the scenario"):
        load_scenario(tmp_path / "mine.yaml")
    (tmp_path / "reach.bvh").write_text(ONE_ARM)
    assert load_scenario(tmp_path / "mine.yaml").people[0].motion is not None


def test_people_taken_over_from_another_folder_follow_the_files_there(tmp_path: Path) -> None:
    """The file was looked for beside the scenario that extends theirs alone."""
    (tmp_path / "theirs").mkdir()
    text = resources.find("sim/reach_in.yaml").read_text().replace("extends: cell", "cameras: [{name: one}]")
    (tmp_path / "theirs" / "reaches.yaml").write_text(text)
    (tmp_path / "theirs" / "reach.bvh").write_text(ONE_ARM)
    (tmp_path / "mine.yaml").write_text("extends: theirs/reaches\nduration_s: 1.0\n")
    assert load_scenario(tmp_path / "mine.yaml").people == load_scenario(tmp_path / "theirs" / "reaches.yaml").people


def test_seeds_vary_the_pace() -> None:
    scenario = replace(
        load_scenario("reach_in"), variation=replace(load_scenario("reach_in").variation, time_s=0.0, position_m=0.0)
    )
    stamp = scenario.start_ns + 1_400_000_000
    worlds = [World(scenario.with_seed(seed)).moving(stamp) for seed in (1, 2)]
    apart = [
        np.linalg.norm(a.placed.T_base_shape[:3, 3] - b.placed.T_base_shape[:3, 3])
        for a, b in zip(*worlds, strict=True)
    ]
    assert max(apart) > 0.005


@pytest.mark.parametrize("from_s", [0.15, 0.33, 0.6])
def test_a_motion_begins_and_ends_where_it_is_asked_to(from_s: float) -> None:
    file = str(resources.find("sim/walk.bvh"))
    whole = RecordedBody(Person(), BvhMotion(file))
    body = RecordedBody(Person(), BvhMotion(file, from_s=from_s, to_s=from_s + 1.01))
    shift = body.ends(0.0)[0, 0] - whole.ends(from_s)[0, 0]
    for t in (-1.0, 0.0, 0.4, 1.01, 3.0):
        there = whole.ends(from_s + np.clip(t, 0.0, 1.01)) + shift
        np.testing.assert_allclose(body.ends(t), there, atol=1e-9)
    np.testing.assert_allclose(body.ends(0.0)[0, 0, :2], BvhMotion(file).position[:2], atol=1e-9)


def test_a_motion_is_turned_about_z_and_goes_at_its_pace() -> None:
    """At no yaw who walks goes along x, at 90 degrees along y."""
    file = str(resources.find("sim/walk.bvh"))

    def hips(motion: BvhMotion, t: float) -> Float64:
        place: Float64 = RecordedBody(Person(), motion).ends(t)[0, 0]
        return place

    ways = [hips(BvhMotion(file, yaw_deg=yaw), 2.0) - hips(BvhMotion(file, yaw_deg=yaw), 1.0) for yaw in (0, 90)]
    assert ways[0][0] > 0.5
    np.testing.assert_allclose(ways[1], [-ways[0][1], ways[0][0], ways[0][2]], atol=1e-9)
    np.testing.assert_allclose(hips(BvhMotion(file, pace=2.0), 1.0), hips(BvhMotion(file), 2.0), atol=1e-9)


@pytest.mark.parametrize("change", [{"file": ""}, {"pace": 0.0}, {"from_s": 2.0, "to_s": 1.0}])
def test_motions_that_make_no_sense_are_refused(change: dict[str, object]) -> None:
    with pytest.raises(CellError, match="motion"):
        BvhMotion(**{"file": "walk.bvh", **change})


def test_a_motion_that_begins_after_its_recording_is_refused() -> None:
    file = str(resources.find("sim/walk.bvh"))
    with pytest.raises(CellError, match=r"walk\.bvh: from_s .* found 5\.5; the recording lasts 5 s"):
        RecordedBody(Person(), BvhMotion(file, from_s=5.5))
    assert len(RecordedBody(Person(), BvhMotion(file, from_s=4.0)).ends(0.0))
