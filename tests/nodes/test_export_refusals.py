"""Exports of what cannot be exported, or not there: one clear error, and what was there stays."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from twin_logs import START, cloud_at, obstacles_at, with_notes

from twin_node.bag import LogWriter, RecordingWriter, open_log
from twin_node.cli import main
from twin_node.messages import convert
from twin_node.model.ply import stored_from_cloud, write_ply
from twin_node.nodes.export import LogSource
from twin_node.nodes.topics import GAUSSIANS, JOINT_STATES, OBSTACLES
from twin_node.robot import ur_model
from twin_node.scene import GaussianCloud, JointSample


def run(*arguments: object) -> int:
    return main(["export", *map(str, arguments), "--arm", "ur5e"])


def test_a_stage_that_the_disk_refuses_is_one_error(
    twin_log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("pxr")
    from pxr import Tf, Usd

    class Refusing:
        @staticmethod
        def CreateNew(_: str) -> Any:
            raise Tf.ErrorException("Error occurred writing file: No space left on device")

    monkeypatch.setattr(Usd, "Stage", Refusing)
    assert run(twin_log, "--to", "usd", "-o", tmp_path / "cell.usdc") == 2
    assert "cell.usdc: cannot be written (" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_gaussians_that_the_disk_refuses_are_one_error_that_names_the_file(
    twin_log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def refuse(_path: Path, _data: bytes) -> int:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", refuse)
    out = tmp_path / "a.ply"
    assert run(twin_log, "--to", "ply", "--at", 0, "-o", out) == 2
    assert f"-o {out}: cannot be written (No space left on device); free space" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--to", "obj", "-o", "a.obj"], "expected one of ply, spz"),
        (["--to", "ply", "-o", "a.txt"], "ends in .ply"),
        (["--to", "ply", "-o", "a.ply", "--at", "99"], "expected a span inside the log's 0 to 1.400 s"),
        (["--to", "ply", "-o", "missing/a.ply", "--at", "1"], "cannot be written"),
        (["--to", "mjcf", "-o", "a.xml", "--start", "1", "--stop", "0.5"], "expected a span inside"),
        (["--to", "ply", "-o", "a.ply", "--at", "1", "--stop", "2"], "--stop: expected with a range"),
    ],
)
def test_wrong_wishes_are_one_line(
    twin_log: Path, refused: Callable[..., str], arguments: list[str], message: str
) -> None:
    assert message in refused("export", twin_log, *arguments, "--arm", "ur5e")


def test_where_gaussians_are_missing_is_told_by_the_times_of_the_options(
    tmp_path: Path, refused: Callable[..., str]
) -> None:
    with LogWriter(tmp_path / "late.mcap") as log:
        log.write(OBSTACLES, convert.obstacles_to_message(obstacles_at(0, START)), START)
        late = START + 2_000_000_000
        log.write(GAUSSIANS, convert.gaussians_to_pointcloud2(cloud_at(0, True), late), late)
    out = tmp_path / "a.ply"
    for times in (("--at", 1.25), ("--start", 1.25)):
        told = refused("export", tmp_path / "late.mcap", "--to", "ply", "-o", out, *times)
        assert "expected Gaussians at 1.250 s of the log, found none" in told


def test_a_log_that_breaks_off_is_told_and_read_as_far_as_it_goes(
    twin_log: Path, cell_log: Callable[..., Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = cell_log(1.2).read_bytes()
    (tmp_path / "broken.mcap").write_bytes(whole[: len(whole) * 2 // 3])
    assert run(twin_log, tmp_path / "broken.mcap", "--to", "csv", "--rate", 10, "-o", tmp_path / "tables") == 0
    said = capsys.readouterr().err
    assert "twin_node: warning: " in said and "broken.mcap: damaged at byte" in said


def test_topics_that_nobody_reads_are_told_once(
    twin_log: Path,
    cell_log: Callable[..., Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr("twin_node.cli.replay._run", lambda *_: None)
    twin, cell = with_notes(twin_log, tmp_path / "twin.mcap"), with_notes(cell_log(0.5), tmp_path / "cell.mcap")
    assert run(twin, "--to", "ply", "--at", 0, "-o", tmp_path / "a.ply") == 0
    told = ": not read: /notes: 1 message in json; expected cdr\n"
    assert capsys.readouterr().err == f"twin_node: warning: {twin}{told}"
    assert main(["replay", str(cell)]) == 0
    assert capsys.readouterr().err == f"twin_node: warning: {cell}{told}"


@pytest.mark.parametrize(("seconds", "is_told"), [(-100, True), (0, False), (100, True)])
def test_logs_of_different_runs_are_told(
    twin_log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], seconds: int, is_told: bool
) -> None:
    """Yesterday's images beside today's twin: the last of them would stand for all of its time."""
    with LogWriter(tmp_path / "other.mcap") as log:
        stamp = START + seconds * 10**9
        sample = JointSample(stamp, ur_model("ur5e").joint_names, np.zeros(6), np.zeros(6))
        log.write("/other/joint_states", convert.joint_sample_to_message(sample), stamp)
    assert run(twin_log, tmp_path / "other.mcap", "--to", "ply", "--at", 0, "-o", tmp_path / "a.ply") == 0
    assert ("other.mcap: it ends before the twin's log begins" in capsys.readouterr().err) == is_told


def test_damage_that_only_reading_tells_is_told(
    twin_log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A chunk in the middle is not what it was: what comes of its time is older, and nobody would know."""
    log = tmp_path / "twin.mcap"
    data = bytearray(twin_log.read_bytes())
    data[2000:2100] = bytes(100)
    log.write_bytes(data)
    with open_log(log) as opened:
        assert opened.damage is None
    assert run(log, "--to", "npz", "--rate", 10, "-o", tmp_path / "a.npz") in (0, 2)
    said = capsys.readouterr().err
    assert said.count("twin_node: warning: ") == 1 and "twin.mcap: damaged at byte" in said


@pytest.mark.parametrize(("form", "name"), [("csv", "mine"), ("csv", "."), ("ply", "mine.ply")])
def test_a_folder_that_exists_is_left_alone(
    twin_log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, form: str, name: str
) -> None:
    monkeypatch.chdir(tmp_path)
    Path(name).mkdir(exist_ok=True)
    (Path(name) / "thesis.txt").write_text("mine")
    assert run(twin_log, "--to", form, "--stop", 0.5, "-o", name) == 2
    assert [path.name for path in Path(name).iterdir()] == ["thesis.txt"]


@pytest.mark.parametrize(("form", "name"), [("csv", "tables"), ("npz", "cell.npz")])
def test_a_partial_export_of_somebody_else_stays(
    twin_log: Path, refused: Callable[..., str], tmp_path: Path, form: str, name: str
) -> None:
    mine = tmp_path / f"{name}.partial" / "thesis.txt"
    mine.parent.mkdir()
    mine.write_text("mine")
    said = refused("export", twin_log, "--to", form, "--stop", 0.5, "-o", tmp_path / name, "--arm", "ur5e")
    assert f"{name}.partial: exists already" in said
    assert mine.read_text() == "mine" and list(tmp_path.iterdir()) == [mine.parent]


@pytest.mark.parametrize(("form", "name"), [("csv", "mine.txt"), ("ply", "mine.ply")])
def test_a_file_where_a_folder_should_go_is_told_before_anything_is_read(
    twin_log: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    form: str,
    name: str,
) -> None:
    (tmp_path / name).write_text("mine")
    monkeypatch.setattr(LogSource, "moments", lambda *_: pytest.fail("it was read"))
    assert run(twin_log, "--to", form, "--stop", 0.5, "-o", tmp_path / name) == 2
    assert "expected the name of a new folder, found a file" in capsys.readouterr().err
    assert (tmp_path / name).read_text() == "mine"


@pytest.mark.parametrize("form", ["ply", "npz"])
def test_gaussians_are_exported_whatever_arm_the_log_has(form: str, tmp_path: Path) -> None:
    """Nothing of the arm goes into them: its name need not be known, nor be one of ours."""
    stamp, path = START, tmp_path / "other.mcap"
    with LogWriter(path) as log:
        log.write(GAUSSIANS, convert.gaussians_to_pointcloud2(cloud_at(0, True), stamp), stamp)
        sample = JointSample(stamp, ("panda_joint1", "panda_joint2"), np.zeros(2), np.zeros(2))
        log.write(JOINT_STATES, convert.joint_sample_to_message(sample), stamp)
    assert run(path, "--to", form, "--at", 0, "-o", tmp_path / f"a.{form}") == 0


def test_a_model_whose_player_has_no_place_replaces_nothing(
    twin_log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "cell.xml").write_text("mine")
    (tmp_path / "cell_play.py").mkdir()
    assert run(twin_log, "--to", "mjcf", "--at", 0, "-o", tmp_path / "cell.xml") == 2
    assert "cell_play.py too, found a folder of that name" in capsys.readouterr().err
    assert (tmp_path / "cell.xml").read_text() == "mine"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["cell.xml", "cell_play.py"]


def test_images_without_calibration_do_not_keep_from_an_export(
    twin_log: Path, cell_log: Callable[..., Path], tmp_path: Path
) -> None:
    """A recording that was replayed with --rig has none of its own, and no image goes into any export."""
    bare = tmp_path / "bare.mcap"
    with open_log(cell_log(0.5)) as whole, RecordingWriter(bare) as part:
        kept = [topic.name for topic in whole.topics if not topic.name.endswith("/camera_info")]
        for message in whole.messages(kept):
            part.write(message.topic, message.msgtype, bytes(message.data), message.stamp, message.types)
    assert run(twin_log, bare, "--to", "csv", "--at", 0, "-o", tmp_path / "tables") == 0


def test_a_log_without_obstacles_is_refused(
    cell_log: Callable[..., Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(cell_log(0.5), "--to", "mjcf", "-o", tmp_path / "a.xml") == 2
    assert "/twin/obstacles" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("means", np.nan),
        ("means", np.inf),
        ("quats", np.nan),
        ("quats", 0),
        ("log_scales", 200),
        ("logits", np.nan),
        ("sh", np.nan),
        ("sh", -np.inf),
    ],
)
@pytest.mark.filterwarnings("error")
def test_a_scene_with_numbers_that_are_none_is_refused(
    tmp_path: Path, refused: Callable[..., str], field: str, value: float
) -> None:
    """As training that went astray leaves them: what reads the log would draw nothing, or end."""
    stored = stored_from_cloud(cloud_at(0, True))
    values = getattr(stored, field).copy()
    values[3] = value
    write_ply(replace(stored, **{field: values}), tmp_path / "scene.ply")
    assert "in 1 of 50 Gaussians, the first at 3; take them out" in refused(
        "import", "ply", tmp_path / "scene.ply", "-o", tmp_path / "scene.mcap"
    )
    assert not (tmp_path / "scene.mcap").exists()


def test_a_scene_of_nothing_is_refused(tmp_path: Path, refused: Callable[..., str]) -> None:
    write_ply(stored_from_cloud(GaussianCloud.none()), tmp_path / "scene.ply")
    assert "expected Gaussians, found none" in refused(
        "import", "ply", tmp_path / "scene.ply", "-o", tmp_path / "scene.mcap"
    )
    assert not (tmp_path / "scene.mcap").exists()
