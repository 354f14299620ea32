from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

from twin_node import resources
from twin_node.cell import CellError, load_scenario
from twin_node.cell.bvh_body import RecordedBody
from twin_node.cell.shapes import cubes_meet
from twin_node.cell.world import World
from twin_node.errors import TwinError
from twin_node.resources import ResourceError

CAMERA = {"name": "cam", "position": [1.0, 0.0, 1.0], "look_at": [0.0, 0.0, 0.0]}
BALL = {"name": "ball", "parts": [{"form": "sphere", "size": [0.1]}]}


def written(tmp_path: Path, content: object) -> Path:
    path = tmp_path / "scenario.yaml"
    path.write_text(content if isinstance(content, str) else yaml.safe_dump(content))
    return path


@pytest.mark.parametrize("path", sorted(resources.find("sim").glob("*.yaml")), ids=lambda path: path.stem)
def test_every_scenario_that_ships_loads(path: Path) -> None:
    scenario = load_scenario(path)
    assert scenario.cameras
    assert World(scenario).static


@pytest.mark.parametrize("name", ["demo", "conveyor", "thrown_ball"])
def test_what_is_put_or_thrown_on_the_conveyor_stays_out_of_it(name: str) -> None:
    """The ball did not roll off it, but went on through it and the table."""
    scenario = load_scenario(name)
    slack_m, step_ns = 0.004, 10_000_000  # a parcel lies within a millimetre of it
    solid = [part.placed for part in World(scenario).static]
    for body in scenario.bodies:
        for step in range(round(scenario.duration_s * 1e9 / step_ns)):
            for part in body.parts:
                within = part.shape.half_extents.min() - slack_m
                centre = (body.path.pose(step * step_ns * 1e-9) @ part.T_body_part)[None, :3, 3]
                assert not any(cubes_meet(one, centre, within / np.sqrt(3))[0] for one in solid), (body.name, step)


@pytest.mark.parametrize("path", sorted(resources.find("sim").glob("*.yaml")), ids=lambda path: path.stem)
def test_nobody_ends_inside_a_wall(path: Path) -> None:
    """The passer-by of `cross` walked into the far one, and stood in it for the last second and a half."""
    scenario = load_scenario(path)
    world = World(scenario)
    walls = [part.placed for part in world.static if world.names[part.owner] == "walls"]
    for person in scenario.people:
        if person.motion is not None:
            ends = RecordedBody(person, person.motion).ends(scenario.duration_s).reshape(-1, 3)
            assert not any(cubes_meet(one, ends, 0.03).any() for one in walls), person.name


def test_a_scenario_is_found_by_its_bare_name() -> None:
    assert load_scenario("demo") == load_scenario("sim/demo.yaml")


def test_a_folder_of_the_same_name_does_not_hide_a_scenario(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "demo").mkdir()
    monkeypatch.chdir(tmp_path)
    assert load_scenario("demo").name == "demo"


def test_what_a_scenario_does_not_set_comes_from_the_one_it_extends() -> None:
    demo, cell = load_scenario("demo"), load_scenario("cell")
    assert demo.furniture == cell.furniture
    assert demo.cameras == cell.cameras
    assert [body.name for body in demo.bodies] == ["parcel"]


def test_a_scenario_may_extend_one_that_extends_another(tmp_path: Path) -> None:
    (tmp_path / "first.yaml").write_text(yaml.safe_dump({"name": "first", "duration_s": 3.0, "cameras": [CAMERA]}))
    (tmp_path / "second.yaml").write_text(yaml.safe_dump({"extends": "first", "name": "second", "bodies": [BALL]}))
    third = load_scenario(written(tmp_path, {"extends": "second", "duration_s": 5.0}))
    assert (third.name, third.duration_s) == ("second", 5.0)
    assert [camera.name for camera in third.cameras] == ["cam"]
    assert [body.name for body in third.bodies] == ["ball"]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ({"camera": []}, "did you mean 'cameras'"),
        ({"cameras": [{**CAMERA, "fov": 3}]}, "did you mean 'fov_deg'"),
        ({"cameras": []}, "at least one camera"),
        ({"cameras": [CAMERA, CAMERA]}, "name of its own, found 'cam'"),
        ({"cameras": [{**CAMERA, "name": "left cam"}]}, "'left cam'"),
        ({"cameras": [{**CAMERA, "fov_deg": 190.0}]}, "fov_deg"),
        ({"cameras": [{**CAMERA, "look_at": [1.0, 0.0, 1.0]}]}, "look_at"),
        ({"cameras": [CAMERA], "duration_s": 0.0}, "duration_s"),
        ({"cameras": [CAMERA], "duration_s": "long"}, "expected a number, found"),
        ({"cameras": [CAMERA], "workspace": [[0, 0, 0], [1, 0, 1]]}, "workspace"),
        ({"cameras": [CAMERA], "sensing": {"rate_hz": 0.0}}, "rate_hz"),
        ({"cameras": [CAMERA], "sensing": {"jitter_ms": 20.0}}, "jitter_ms"),
        (
            {"cameras": [CAMERA], "sensing": {"exposure_ms": 34.0}},
            r"exposure_ms must be at most the period \(33.33 ms\)",
        ),
        ({"cameras": [CAMERA], "bodies": [BALL, BALL]}, "found 'ball' as number 2"),
        ({"cameras": [CAMERA], "bodies": [{"name": "ball"}]}, "'ball'.*parts"),
        ({"cameras": [CAMERA], "bodies": [{"name": "b", "parts": [{"form": "cone"}]}]}, "'cone'"),
        ({"cameras": [CAMERA], "bodies": [{"name": "b", "parts": [{"form": "sphere"}]}]}, "takes 1 positive"),
        ({"cameras": [CAMERA], "bodies": [{"name": "b", "parts": [{"texture": {"pattern": "fur"}}]}]}, "'fur'"),
        (
            {
                "cameras": [CAMERA],
                "furniture": [{**BALL, "path": {"times_s": [0, 1], "positions": [[0, 0, 0], [1, 0, 0]]}}],
            },
            "under 'bodies'",
        ),
        ({"cameras": [CAMERA], "faults": [{"kind": "frozen", "camera": "cam2"}]}, "'cam2'; known cameras: cam"),
        ({"cameras": [CAMERA], "faults": [{"kind": "fog", "camera": "cam"}]}, "'fog'"),
        ({"extends": "cel", "cameras": [CAMERA]}, "extends 'cel'.*beside it are: none"),
        ({"cameras": [CAMERA], "seed": -1}, "seed: expected .* found -1"),
        ({"cameras": [CAMERA], "start_ns": 2**70}, "start_ns"),
        ({"cameras": [CAMERA], "duration_s": 0.02}, "one image set"),
        ({"cameras": [CAMERA], "voxel_size_m": 0.0}, "voxel_size_m"),
        ({"cameras": [CAMERA], "voxel_size_m": -0.02}, "voxel_size_m"),
        ({"cameras": [CAMERA], "voxel_size_m": 20.0}, "voxel_size_m"),
        ({"cameras": [CAMERA], "workspace": [[0, -600, 0], [1000, 600, 800]]}, "voxels.*metres"),
        ({"cameras": [{**CAMERA, "position": [1.0, float("inf"), 1.0]}]}, r"cameras\[0\]\.position\[1\].*found inf"),
        (
            {"cameras": [{**CAMERA, "position": [1e200, 0.0, 1.0]}]},
            "camera 'cam': expected position and look_at in met",
        ),
        (
            {"cameras": [{**CAMERA, "look_at": [0.0, 0.0, 1200.0]}]},
            "camera 'cam': expected position and look_at in met",
        ),
        (
            {"cameras": [CAMERA], "bodies": [{**BALL, "path": {"positions": [[780.0, -1300.0, 131.0]]}}]},
            r"path: expected positions in metres.* found \[780\.0, -1300\.0, 131\.0\]",
        ),
        (
            {"cameras": [CAMERA], "furniture": [{"name": "b", "parts": [{"size": [1150.0, 1700.0, 50.0]}]}]},
            "part: expected size and position in metres",
        ),
        (
            {"cameras": [CAMERA], "bodies": [{"name": "b", "parts": [{"position": [0.0, -1001.0, 0.0]}]}]},
            "part: expected size and position in metres",
        ),
        (
            {"cameras": [CAMERA], "people": [{"motion": {"file": "walk.bvh", "position": [1300.0, 0.0, -810.0]}}]},
            r"motion 'walk\.bvh': expected position in metres",
        ),
        ({"cameras": [CAMERA], "variation": {"position_m": 1e30}}, "variation: position_m"),
        ({"cameras": [{**CAMERA, "skew_ms": 1e12}]}, "skew_ms"),
        (
            {"cameras": [{**CAMERA, "skew_ms": -200.0}], "start_ns": 0},
            "camera 'cam': expected stamps from 0 ns on, found skew_ms -200 .* 186 ms before",
        ),
        (
            {"cameras": [CAMERA], "start_ns": 0, "faults": [{"kind": "unsorted_stamps", "camera": "cam"}]},
            "camera 'cam': expected stamps from 0 ns on",
        ),
        ({"cameras": [CAMERA], "seed": -(10**400)}, "seed: expected a number of 0 or more, found -1000"),
        ({"cameras": [CAMERA], "sensing": {"width": 10**12}}, "width"),
        ({"cameras": [CAMERA], "sensing": {"rate_hz": 1e9, "jitter_ms": 0.0}}, "rate_hz"),
        ({"cameras": [CAMERA], "sensing": {"rgb_sigma": -1.0}}, "rgb_sigma"),
        ({"cameras": [CAMERA], "sensing": {"depth_sigma_at_1m_mm": -2.0}}, "depth_sigma_at_1m_mm"),
        ({"cameras": [CAMERA], "sensing": {"depth_noise_px": -1.0}}, "depth_noise_px"),
        ({"cameras": [CAMERA], "sensing": {"depth_noise_px": 51.0}}, "depth_noise_px"),
        ({"cameras": [CAMERA], "sensing": {"depth_dropout": 5.0}}, "depth_dropout"),
        ({"cameras": [CAMERA], "sensing": {"edge_dropout": -0.1}}, "edge_dropout"),
        ({"cameras": [CAMERA], "arm": {"joint_rate_hz": -125.0}}, "joint_rate_hz"),
        ({"cameras": [CAMERA], "arm": {"cycle": {"speed": 0.0}}}, "arm: cycle.speed"),
        ({"cameras": [CAMERA], "arm": {"cycle": {"acceleration": -1.4}}}, "arm: cycle.acceleration"),
        ({"cameras": [CAMERA], "arm": {"cycle": {"dwell_s": -1.0}}}, "arm: cycle.dwell_s"),
        ({"cameras": [CAMERA], "arm": {"workspace": [[1, 0, 0], [0, 1, 1]]}}, "arm: workspace"),
        ({"cameras": [CAMERA], "people": [{"name": "p", "height_m": 0.0}]}, "person 'p': height_m"),
        ({"cameras": [CAMERA], "people": [{"name": "p", "height_m": 175.0}]}, "person 'p': height_m"),
        ({"cameras": [CAMERA], "bodies": [{"name": "b", "parts": [{"texture": {"color": [0, 300, 0]}}]}]}, "300"),
        ({"cameras": [CAMERA], "variation": {"time_s": -0.5}}, "variation: time_s"),
        ({"cameras": [CAMERA], "variation": {"pace": 15.0}}, "variation: pace"),
        (
            {"cameras": [CAMERA], "faults": [{"kind": "frozen", "camera": "cam", "from_s": 3.0, "to_s": 2.0}]},
            "from_s before to_s",
        ),
        (
            {"cameras": [CAMERA], "arm": {"model": "sim/ur5e.xml"}},
            "arm: model: expected one of .*ur16e, found 'sim/ur5e.xml'",
        ),
        ({"extends": "there/cell", "cameras": [CAMERA]}, "extends 'there/cell'"),
        ({"extends": "scenario", "cameras": [CAMERA]}, "in turn"),
        ("[1, 2", "YAML"),
        ("just words", "keys and values"),
    ],
)
def test_a_wrong_scenario_gives_one_line_that_says_what_is_wrong(tmp_path: Path, content: object, words: str) -> None:
    path = written(tmp_path, content)
    with pytest.raises(CellError, match=words) as caught:
        load_scenario(path)
    assert "scenario.yaml" in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("body", "words"),
    [
        (
            {"name": "b", "parts": [{"form": "sphere", "size": [0.1]}, {"form": "cone"}]},
            r"bodies[1].parts[1]: part: form",
        ),
        ({**BALL, "name": "b", "path": {"between": "bezier"}}, "bodies[1].path: path: between"),
        ({"name": "b", "parts": [{"size": "big"}]}, "bodies[1].parts[0].size: expected a list"),
    ],
)
def test_what_is_wrong_with_one_of_many_bodies_names_it(tmp_path: Path, body: object, words: str) -> None:
    """'path: times_s must be rising' was all that was told of a scenario of ten paths."""
    with pytest.raises(CellError) as caught:
        load_scenario(written(tmp_path, {"cameras": [CAMERA], "bodies": [BALL, body]}))
    assert f"scenario.yaml: {words}" in str(caught.value)


def test_a_scenario_that_extends_itself_by_another_spelling_of_its_path_is_told(tmp_path: Path) -> None:
    """It was read again and again, until its path was too long for any file."""
    path = written(tmp_path, {"extends": f"../{tmp_path.name}/scenario", "cameras": [CAMERA]})
    with pytest.raises(CellError, match="which extends it in turn"):
        load_scenario(path)


def test_a_seed_may_be_any_whole_number(tmp_path: Path) -> None:
    assert load_scenario(written(tmp_path, {"cameras": [CAMERA], "seed": 10**400})).seed == 10**400


def test_a_scenario_that_is_not_there_says_where_it_was_looked_for() -> None:
    with pytest.raises(ResourceError, match=r"sim/nowhere\.yaml"):
        load_scenario("nowhere")


@pytest.mark.parametrize("name", ["a" * 300, "a" * 5000, "/".join(["a" * 100] * 60)])
def test_a_name_that_no_file_can_have_is_told_as_that(name: str) -> None:
    """The processes of a launch ended with an OSError, and were begun again and again."""
    with pytest.raises(CellError, match="File name too long"):
        load_scenario(name)


def test_an_unknown_arm_is_refused(tmp_path: Path) -> None:
    with pytest.raises(TwinError, match="ur99"):
        World(load_scenario(written(tmp_path, {"cameras": [CAMERA], "arm": {"model": "ur99"}})))


def test_another_seed_moves_what_acts_only_where_the_scenario_varies() -> None:
    for name, varies in (("thrown_ball", True), ("demo", False)):
        scenario = load_scenario(name)
        stamp = scenario.start_ns + 1_200_000_000
        first, second = (World(scenario.with_seed(seed)).moving(stamp)[0].placed for seed in (1, 2))
        assert (first.T_base_shape != second.T_base_shape).any() == varies


def test_a_seed_shifts_a_person_as_a_whole(tmp_path: Path) -> None:
    person = {"shoulder": {"positions": [[1.3, 0.3, 0.5]]}, "hand": {"positions": [[1.0, 0.2, 0.3]]}}
    content = {"cameras": [CAMERA], "people": [person], "variation": {"position_m": 0.3}}
    scenario = load_scenario(written(tmp_path, content))
    bodies = [
        np.array([solid.placed.T_base_shape for solid in World(scenario.with_seed(seed)).moving(scenario.start_ns)])
        for seed in (1, 2)
    ]
    shifts = bodies[1] - bodies[0]
    assert np.linalg.norm(shifts[0, :3, 3]) > 0.05
    np.testing.assert_allclose(shifts, np.broadcast_to(shifts[0], shifts.shape), atol=1e-9)
