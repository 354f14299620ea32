"""Exports read back by the programs they are for."""

from __future__ import annotations

import ast
import csv
import warnings
import weakref
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from plyfile import PlyData
from twin_logs import PERIOD, START, cloud_at, obstacles_at

from twin_node.arm import ArmCollisionChecker
from twin_node.bag import LogWriter, RecordingWriter, open_log
from twin_node.cli import main
from twin_node.messages import convert
from twin_node.model.ply import StoredGaussians, cloud_from_stored, read_ply, stored_from_cloud, write_ply
from twin_node.nodes.export import ExportError, ExportSpan, LogSource, Moment, export
from twin_node.nodes.export import usd as stages
from twin_node.nodes.export.clouds import write_spz
from twin_node.nodes.playback import Playback
from twin_node.nodes.report.quality import render_cloud
from twin_node.nodes.snapshot import in_force
from twin_node.nodes.topics import GAUSSIANS, JOINT_STATES, OBSTACLES
from twin_node.robot import ArmModel, ur_model
from twin_node.scene import Camera, GaussianCloud

SH_C0 = 0.28209479177387814


def run(*arguments: object) -> int:
    return main(["export", *map(str, arguments), "--arm", "ur5e"])


def test_ply_holds_the_cloud_for_a_second_reader(twin_log: Path, tmp_path: Path) -> None:
    assert run(twin_log, "--to", "ply", "--at", 0.35, "-o", tmp_path / "a.ply") == 0
    expected = cloud_at(3, True).moved(0.05)
    vertex = PlyData.read(tmp_path / "a.ply")["vertex"]
    means = np.stack([vertex[axis] for axis in "xyz"], axis=1)
    assert np.allclose(means, expected.means, atol=1e-6)
    assert np.array_equal(read_ply(tmp_path / "a.ply").means, means)
    colours = np.stack([vertex[f"f_dc_{c}"] for c in range(3)], axis=1) * SH_C0 + 0.5
    assert np.allclose(colours, expected.rgb, atol=1e-6)


def test_a_second_reader_of_ply_draws_the_same_picture(twin_log: Path, tmp_path: Path) -> None:
    """Every property by another reader, and the log's own cloud and the read one from the same side."""
    assert run(twin_log, "--to", "ply", "--at", 0, "-o", tmp_path / "a.ply") == 0
    vertex = PlyData.read(tmp_path / "a.ply")["vertex"]

    def columns(*names: str) -> np.ndarray:
        return np.stack([vertex[name] for name in names], axis=1)

    expected = cloud_at(0, True)
    read = replace(
        expected,
        means=columns("x", "y", "z"),
        quats=columns("rot_0", "rot_1", "rot_2", "rot_3"),
        scales=np.exp(columns("scale_0", "scale_1", "scale_2")),
        opacities=1 / (1 + np.exp(-columns("opacity")[:, 0])),
        rgb=columns("f_dc_0", "f_dc_1", "f_dc_2") * np.float32(SH_C0) + np.float32(0.5),
    )
    for name in ("means", "quats", "scales", "opacities", "rgb"):
        assert np.allclose(getattr(read, name), getattr(expected, name), rtol=1e-5, atol=1e-6), name
    T = np.eye(4)
    T[:3, 3] = [1.0, 0.0, -1.0]
    camera = Camera("side", 160, 120, np.array([[150.0, 0, 80], [0, 150, 60], [0, 0, 1]]), T)
    error = ((render_cloud(read, camera) - render_cloud(expected, camera)) ** 2).mean()
    assert render_cloud(expected, camera).max() > 0.3
    assert -10 * np.log10(error + 1e-20) >= 60


def test_a_range_of_ply_is_a_folder(twin_log: Path, tmp_path: Path) -> None:
    assert run(twin_log, "--to", "ply", "--start", 0, "--stop", 0.5, "--rate", 10, "-o", tmp_path / "a.ply") == 0
    names = sorted(path.name for path in (tmp_path / "a.ply").iterdir())
    assert names == [f"{k:05d}.ply" for k in range(6)]
    assert np.array_equal(read_ply(tmp_path / "a.ply" / names[5]).means, cloud_at(5, True).means)


def test_spz_is_the_same_cloud_to_its_precision(twin_log: Path, tmp_path: Path) -> None:
    gsply = pytest.importorskip("gsply")
    assert run(twin_log, "--to", "spz", "--at", 0, "-o", tmp_path / "a.spz") == 0
    read = gsply.read_spz(str(tmp_path / "a.spz"))
    assert np.abs(np.asarray(read.means) - cloud_at(0, True).means).max() < 1 / 2048


@pytest.mark.parametrize(("metres", "step"), [(2000, 1 / 4096), (2100, 1 / 2048), (30_000, 1 / 256)])
def test_spz_has_a_place_for_what_is_far_away(metres: float, step: float, tmp_path: Path) -> None:
    gsply = pytest.importorskip("gsply")
    stored = stored_from_cloud(cloud_at(0, True))
    means = stored.means.copy()
    means[3] = metres, -metres, 0.1
    write_spz(replace(stored, means=means), tmp_path / "a.spz")
    assert np.abs(np.asarray(gsply.read_spz(str(tmp_path / "a.spz")).means) - means).max() <= step


def test_what_spz_has_no_place_for_is_told(tmp_path: Path) -> None:
    pytest.importorskip("gsply")
    stored = stored_from_cloud(cloud_at(0, True))
    means = stored.means.copy()
    means[3:5, 1] = -1e6, 4e4
    with pytest.raises(ExportError, match=r"spz: expected Gaussians within 32768 m .* found 2 beyond.* 1e\+06 m away"):
        write_spz(replace(stored, means=means), tmp_path / "a.spz")
    assert not list(tmp_path.iterdir())


def test_arrays_hold_every_moment(twin_log: Path, tmp_path: Path) -> None:
    assert run(twin_log, "--to", "npz", "--stop", 1.2, "--rate", 5, "-o", tmp_path / "a.npz") == 0
    arrays = np.load(tmp_path / "a.npz")
    assert len(arrays["stamps"]) == 7 and arrays["starts"][-1] == len(arrays["means"]) == 350
    rows = slice(arrays["starts"][6], arrays["starts"][7])
    order = np.argsort(arrays["ids"][rows])
    assert np.array_equal(arrays["means"][rows][order], cloud_at(12, True).means)


def test_mujoco_finds_the_distances_of_the_checker(twin_log: Path, tmp_path: Path) -> None:
    assert run(twin_log, "--to", "mjcf", "--rate", 10, "-o", tmp_path / "cell.xml") == 0
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "cell.xml"))
    data = mujoco.MjData(model)
    arm = ur_model("ur5e")
    checker = ArmCollisionChecker(arm)
    assert model.nkey == 15 and model.nq == 6
    assert np.allclose(model.key_time, 0.1 * np.arange(15), atol=1e-9)  # at which the player shows them
    for key in range(model.nkey):
        mujoco.mj_resetDataKeyframe(model, data, key)
        mujoco.mj_kinematics(model, data)
        stamp = START + key * PERIOD
        checker.update(in_force(obstacles_at(key, stamp), stamp))
        assert _smallest(model, data) == pytest.approx(checker.distance(data.qpos).distance, abs=1e-6)
    compile((tmp_path / "cell_play.py").read_text(), "cell_play.py", "exec")


def test_an_arm_is_exported_as_a_parameter_file_has_it(twin_log: Path, tmp_path: Path) -> None:
    """Its tool too: simulated without it the arm would stay farther from everything than it does."""
    tool = "{start: [0, 0, 0.05], end: [0, 0, 0.25], radius: 0.04}"
    (tmp_path / "p.yaml").write_text(f"arm: {{ros__parameters: {{model: ur5e, tool: [{tool}]}}}}\n")
    out = tmp_path / "a.xml"
    given = ["--to", "mjcf", "--at", 0, "-o", out, "--params", tmp_path / "p.yaml"]
    assert main(["export", *map(str, [twin_log, *given])]) == 0
    model = mujoco.MjModel.from_xml_path(str(out))
    assert np.count_nonzero(model.body_mocapid[model.geom_bodyid] < 0) == len(ur_model("ur5e").capsules.radii) + 1


def _smallest(model: mujoco.MjModel, data: mujoco.MjData) -> float:
    is_obstacle = model.body_mocapid[model.geom_bodyid] >= 0
    carried = [g for g in np.flatnonzero(~is_obstacle) if model.body(model.geom_bodyid[g]).name != "base_link"]
    pairs = [(int(a), int(b)) for a in carried for b in np.flatnonzero(is_obstacle)]
    return min(mujoco.mj_geomDistance(model, data, a, b, 10.0, None) for a, b in pairs)


def test_an_arm_whose_joints_come_late_stands_as_it_is_first_seen(twin_log: Path, tmp_path: Path) -> None:
    """The log without the first half second of joints, as a recorder that was quicker than the arm writes it."""
    pytest.importorskip("pxr")
    from pxr import Usd, UsdGeom

    late = tmp_path / "late.mcap"
    with open_log(twin_log) as whole, RecordingWriter(late) as part:
        for message in whole.messages():
            if message.topic != JOINT_STATES or message.stamp >= START + 5 * PERIOD:
                part.write(message.topic, message.msgtype, bytes(message.data), message.stamp, message.types)
    assert run(late, "--to", "mjcf", "--rate", 10, "-o", tmp_path / "late.xml") == 0
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "late.xml"))
    assert model.key_qpos[:, 0] == pytest.approx([0.5] * 6 + [0.1 * k for k in range(6, 15)])
    assert run(late, "--to", "usd", "--rate", 10, "-o", tmp_path / "late.usda") == 0
    stage = Usd.Stage.Open(str(tmp_path / "late.usda"))
    link = UsdGeom.Xformable(stage.GetPrimAtPath("/World/Arm/forearm_link"))
    assert link.ComputeLocalToWorldTransform(0) == link.ComputeLocalToWorldTransform(5)
    assert link.ComputeLocalToWorldTransform(5) != link.ComputeLocalToWorldTransform(9)


@pytest.mark.parametrize("form", ["ply", "npz"])
def test_a_long_range_is_never_held_whole(form: str, tmp_path: Path) -> None:
    alive: list[weakref.ref[GaussianCloud]] = []
    most = [0]

    class Long:
        """A source of clouds that counts how many of them somebody still holds."""

        start_ns, end_ns = 0, 10**10

        def require(self, topic: str, purpose: str) -> None:
            """Has everything."""

        def moments(self, stamps: Sequence[int], arm: ArmModel, with_clouds: bool) -> Iterator[Moment]:
            for k, stamp in enumerate(stamps):
                cloud = cloud_at(k, True)
                alive.append(weakref.ref(cloud))
                yield Moment(stamp, stamp / 1e9, in_force(None, stamp), None, cloud)
                del cloud
                most[0] = max(most[0], sum(ref() is not None for ref in alive))

    told: list[int] = []
    span = ExportSpan(0, 1.9, 10)
    count = export(Long(), form, span, ur_model("ur5e"), tmp_path / f"a.{form}", lambda done, _total: told.append(done))
    assert count == len(told) == len(alive) == 20
    assert most[0] <= 3


def test_a_range_that_goes_on_beyond_the_log_ends_with_it() -> None:
    assert ExportSpan(0.5, 9.0, 10).stamps(0, 800_000_000) == [500_000_000, 600_000_000, 700_000_000, 800_000_000]


@pytest.mark.parametrize(
    ("span", "told"),
    [
        (ExportSpan(0.9, 9.0, 10), "0.9 to 9 s"),
        (ExportSpan(0.9), "from 0.9 s"),
        (ExportSpan.one(0.9), "at 0.9 s"),
        (ExportSpan(0.5, 0.2), "0.5 to 0.2 s"),
    ],
)
def test_a_span_that_is_not_in_the_log_is_told_as_it_was_asked_for(span: ExportSpan, told: str) -> None:
    with pytest.raises(ExportError, match=rf"^{told}: expected a span inside the log's 0 to 0\.800 s; correct "):
        span.stamps(0, 800_000_000)


def test_usd_is_metres_with_colliders_that_come_and_go(twin_log: Path, tmp_path: Path) -> None:
    pytest.importorskip("pxr")
    from pxr import Usd, UsdGeom, UsdPhysics, UsdValidation

    assert run(twin_log, "--to", "usd", "--rate", 10, "-o", tmp_path / "cell.usda") == 0
    stage = Usd.Stage.Open(str(tmp_path / "cell.usda"))
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1 and UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.z
    assert stage.GetEndTimeCode() == 14 and stage.GetTimeCodesPerSecond() == 10
    obstacles = stage.GetPrimAtPath("/World/Obstacles").GetChildren()
    assert {prim.GetName() for prim in obstacles} == {"MOVING_7", "MOVING_8_sphere", "STATIC_9"}
    assert all(prim.HasAPI(UsdPhysics.CollisionAPI) for prim in obstacles)
    box = UsdGeom.Xformable(stage.GetPrimAtPath("/World/Obstacles/MOVING_7"))
    matrix = np.array(box.ComputeLocalToWorldTransform(5)).T
    assert np.allclose(matrix[:3, 3], [0.95, 0.4, 0.5])
    assert np.allclose(np.linalg.norm(matrix[:3, :3], axis=0), [0.05, 0.1, 0.16])
    moving = UsdGeom.Points(stage.GetPrimAtPath("/World/Gaussians/Moving"))
    assert np.allclose(moving.GetPointsAttr().Get(7), cloud_at(7, False).means)
    assert not UsdValidation.ValidationContext(UsdValidation.ValidationRegistry().GetOrLoadAllValidators()).Validate(
        stage
    )


def test_obstacles_of_a_stage_are_hidden_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Cells of space get new ids as things move on: to hide at every frame all that ever were takes a log's square."""
    usd = pytest.importorskip("pxr.Usd")
    hidden: list[int] = []
    hide = stages._Collider.hide
    monkeypatch.setattr(stages._Collider, "hide", lambda self, frame: (hidden.append(frame), hide(self, frame)))
    obstacles = stages._Obstacles(usd.Stage.CreateInMemory())
    for k in range(9):
        said = obstacles_at(0, START)
        said = replace(said, ids=said.ids + np.uint32(10 * k)).only(np.arange(3))
        obstacles.place(k, Moment(START, 0.0, said, None, None))
    assert hidden == sorted([*range(1, 9)] * 3)


def stage_of(clouds: Mapping[int, GaussianCloud], folder: Path) -> Any:
    """The stage of a log that has these whole clouds at its frames, of 15 at 10 Hz."""
    from pxr import Usd

    with LogWriter(folder / "clouds.mcap") as log:
        for k in range(15):
            stamp = START + k * PERIOD
            if k in clouds:
                log.write(GAUSSIANS, convert.gaussians_to_pointcloud2(clouds[k], stamp), stamp)
            log.write(OBSTACLES, convert.obstacles_to_message(obstacles_at(k, stamp)), stamp)
    assert run(folder / "clouds.mcap", "--to", "usd", "--rate", 10, "-o", folder / "a.usda") == 0
    return Usd.Stage.Open(str(folder / "a.usda"))


def points_of(stage: Any, name: str) -> Any:
    from pxr import UsdGeom

    return UsdGeom.Points(stage.GetPrimAtPath(f"/World/Gaussians/{name}"))


def test_standing_points_do_not_slide_to_where_others_stand_later(tmp_path: Path) -> None:
    pytest.importorskip("pxr")
    first = cloud_at(0, True)
    stage = stage_of({0: first, 10: replace(first, means=first.means + np.float32(1))}, tmp_path)
    points = points_of(stage, "Static")
    for frame, shift in ((0, 0), (5, 0), (9, 0), (10, 1), (14, 1)):
        assert np.allclose(points.GetPointsAttr().Get(frame), first.means[:40] + shift), frame


def test_standing_points_that_only_grow_or_fade_do_so_in_a_stage(tmp_path: Path) -> None:
    pytest.importorskip("pxr")
    first = cloud_at(0, True)
    later = replace(first, scales=5 * first.scales, opacities=first.opacities / 10)
    stage = stage_of({0: first, 10: later}, tmp_path)
    points = points_of(stage, "Static")
    widths, opacities = points.GetWidthsAttr(), points.GetDisplayOpacityPrimvar()
    assert np.allclose(widths.Get(10), 5 * np.array(widths.Get(9)))
    assert np.allclose(opacities.Get(10), np.array(opacities.Get(9)) / 10)


def test_a_stage_has_no_points_before_the_log_has(tmp_path: Path) -> None:
    pytest.importorskip("pxr")
    stage = stage_of({5: cloud_at(0, True)}, tmp_path)
    for name, count in (("Static", 40), ("Moving", 10)):
        points = points_of(stage, name).GetPointsAttr()
        assert [len(points.Get(frame)) for frame in (0, 4, 5, 14)] == [0, 0, count, count]


def test_colours_of_a_stage_are_linear(twin_log: Path, tmp_path: Path) -> None:
    """As USD takes them where nothing else is said; USD's own conversion gives those of the log."""
    pytest.importorskip("pxr")
    from pxr import Gf, Usd, UsdGeom

    assert run(twin_log, "--to", "usd", "--rate", 10, "--stop", 0.5, "-o", tmp_path / "cell.usda") == 0
    stage = Usd.Stage.Open(str(tmp_path / "cell.usda"))
    moving = UsdGeom.Points(stage.GetPrimAtPath("/World/Gaussians/Moving"))
    shown = [as_on_screen(Gf, colour) for colour in moving.GetDisplayColorAttr().Get(3)]
    assert np.allclose(shown, cloud_at(3, False).rgb, atol=1e-3)
    box = UsdGeom.Gprim(stage.GetPrimAtPath("/World/Obstacles/MOVING_7"))
    assert np.allclose(as_on_screen(Gf, box.GetDisplayColorAttr().Get()[0]), [0.85, 0.19, 0.15], atol=1e-3)


def as_on_screen(gf: Any, colour: Any) -> list[float]:
    """A colour of a stage, in USD's default space, in that of screens."""
    names = gf.ColorSpaceNames
    there = gf.Color(gf.Vec3f(colour), gf.ColorSpace(names.LinearRec709))
    return list(gf.Color(there, gf.ColorSpace(names.SRGBRec709)).GetRGB())


def test_links_may_be_called_what_usd_and_xml_do_not_take(twin_log: Path, tmp_path: Path) -> None:
    """As those of arms in other people's files are: with slashes, ampersands, quotes and dashes."""
    pytest.importorskip("pxr")
    from pxr import Usd

    plain = ur_model("ur5e")
    strange = tuple(f'r&d/"{name}-<{k}>' for k, name in enumerate(plain.link_names))
    arm = replace(plain, name="tom & jerry", link_names=strange)
    with Playback([twin_log]) as playback:
        for form, name in (("mjcf", "a.xml"), ("usd", "a.usda")):
            export(LogSource(playback), form, ExportSpan.one(1.0), arm, tmp_path / name, lambda *_: None)
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "a.xml"))
    assert [model.body(k).name for k in range(1, 8)] == list(strange)
    stage = Usd.Stage.Open(str(tmp_path / "a.usda"))
    assert len(stage.GetPrimAtPath("/World/Arm").GetChildren()) == 7


def test_links_that_usd_would_call_alike_stay_apart() -> None:
    pytest.importorskip("pxr")
    from twin_node.nodes.export.usd import _prim_names

    assert len(set(_prim_names(["a-b", "a b", "a_b", "1"]))) == 4


def test_a_player_plays_a_model_of_any_name(twin_log: Path, tmp_path: Path) -> None:
    name = 'it\'s "here" \\ now.xml'
    assert run(twin_log, "--to", "mjcf", "--stop", 0.1, "-o", tmp_path / name) == 0
    tree = ast.parse((tmp_path / f"{name[:-4]}_play.py").read_text(encoding="utf-8"))
    named = [node.value for node in ast.walk(tree) if isinstance(node, ast.Constant)]
    assert name in named


def test_tables_hold_every_obstacle_in_force(twin_log: Path, tmp_path: Path) -> None:
    assert run(twin_log, "--to", "csv", "--rate", 10, "-o", tmp_path / "tables") == 0
    with (tmp_path / "tables" / "obstacles.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 45 and {row["kind"] for row in rows} == {"MOVING", "STATIC"}
    assert float(rows[3]["x_m"]) == pytest.approx(0.91)
    first_ns = int(rows[0]["stamp_ns"])
    assert all(row["seconds"] == f"{(int(row['stamp_ns']) - first_ns) * 1e-9:.6f}" for row in rows)
    assert rows[-1]["seconds"] == "1.400000"
    with (tmp_path / "tables" / "arm.csv").open() as file:
        assert float(list(csv.DictReader(file))[14]["shoulder_pan_joint_rad"]) == pytest.approx(1.4)


def test_an_edited_scene_comes_back(twin_log: Path, tmp_path: Path) -> None:
    """Out as PLY, one Gaussian taken away, in again, and out: nothing else has changed."""
    assert run(twin_log, "--to", "ply", "--at", 0, "-o", tmp_path / "scene.ply") == 0
    stored = read_ply(tmp_path / "scene.ply")
    edited = StoredGaussians(**{name: values[1:] for name, values in vars(stored).items()})
    write_ply(edited, tmp_path / "edited.ply")
    assert main(["import", "ply", str(tmp_path / "edited.ply"), "-o", str(tmp_path / "edited.mcap")]) == 0
    assert run(tmp_path / "edited.mcap", "--to", "ply", "--at", 0, "-o", tmp_path / "again.ply") == 0
    again = read_ply(tmp_path / "again.ply")
    for name, values in vars(edited).items():
        assert np.allclose(getattr(again, name), values, atol=1e-5 if name != "sh" else 0.5 / 255 / SH_C0), name


def test_opacities_beyond_all_logits_are_those_of_solid_and_clear() -> None:
    stored = stored_from_cloud(cloud_at(0, True))
    logits = stored.logits.copy()
    logits[:3] = np.inf, -np.inf, -1000
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert cloud_from_stored(replace(stored, logits=logits)).opacities[:3].tolist() == [1, 0, 0]
