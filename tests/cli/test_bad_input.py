"""Whatever a user gives that is wrong: one clear line, exit status 2, and nothing half-written."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from twin_node.bag import open_log
from twin_node.cell.scenario import Fault
from twin_node.cli import main
from twin_node.nodes.player import span_of
from twin_node.nodes.topics import GraphError

RIG = """
cameras:
  - name: {name}
    size: [320, 240]
    K: [[250, 0, 160], [0, 250, 120], [0, 0, 1]]
    T_base_cam: [[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 2], [0, 0, 0, 1]]
"""


@pytest.fixture
def unplayed(refused: Callable[..., str], tmp_path: Path) -> Callable[..., str]:
    """`unplayed(arguments...)`: the error of a replay into `tmp_path` that is refused."""
    outputs = ("-o", tmp_path / "out.mcap", "--report", tmp_path / "report", "--width", "80")
    return lambda *arguments: refused("replay", *arguments, *outputs)


def test_rig_file_of_another_rig(unplayed: Callable[..., str], cell_log: Callable[..., Path], tmp_path: Path) -> None:
    rig = tmp_path / "rig.yaml"
    rig.write_text(RIG.format(name="cam_elsewhere"))
    line = unplayed(cell_log(0.5), "--rig", rig, "--lockstep")
    assert "no images of camera 'cam_elsewhere'" in line
    assert "cam_front" in line


def test_commands_that_advise_a_remap_take_one(
    cell_log: Callable[..., Path], tmp_path: Path, refused: Callable[..., str]
) -> None:
    log, rig = str(cell_log(0.5)), str(tmp_path / "rig.yaml")
    Path(rig).write_text(RIG.format(name="elsewhere"))
    of_rig = ["--rig", rig]
    for command in (
        ["calibrate", "check", rig, log],
        ["train", log, *of_rig, "-o", f"{rig}.safetensors"],
        ["render", log, *of_rig, "-o", f"{rig}.mp4"],
        ["view", log, *of_rig],
    ):
        assert "--remap the topic to /<camera>/image_raw" in refused(*command)
        assert "no topic /nowhere" in refused(*command, "--remap", "/nowhere:=/elsewhere/image_raw")


@pytest.mark.parametrize("frame", ["cam_front_optical_frame", "tool0", "base"])
def test_rig_file_that_is_not_tied_to_the_robot(
    unplayed: Callable[..., str], cell_log: Callable[..., Path], tmp_path: Path, frame: str
) -> None:
    """As a launch refuses it: the arm would be judged as if it stood in the camera, or half a turn away."""
    rig = tmp_path / "rig.yaml"
    rig.write_text(f"frame: {frame}\n" + RIG.format(name="cam_front"))
    line = unplayed(cell_log(0.5), "--rig", rig, "--lockstep")
    assert "expected cameras' poses in" in line
    assert f"found them in '{frame}'" in line
    assert ("negate the first two rows" if frame == "base" else "hand-eye") in line


def test_rig_file_that_is_none(unplayed: Callable[..., str], cell_log: Callable[..., Path], tmp_path: Path) -> None:
    rig = tmp_path / "rig.yaml"
    rig.write_text("cameras: 3\n")
    assert "rig.yaml" in unplayed(cell_log(0.5), "--rig", rig)


@pytest.mark.parametrize("pace", [["--lockstep"], ["--rate", "4"]])
def test_stamps_that_run_backwards(
    unplayed: Callable[..., str], cell_log: Callable[..., Path], pace: list[str]
) -> None:
    line = unplayed(cell_log(0.4, Fault("unsorted_stamps", "cam_left")), *pace)
    assert "camera 'cam_left'" in line
    assert "run backwards" in line


def test_log_without_images(unplayed: Callable[..., str], cell_log: Callable[..., Path]) -> None:
    cameras = ("cam_front", "cam_left", "cam_back")
    line = unplayed(cell_log(0.4, *(Fault("missing", camera) for camera in cameras)), "--lockstep")
    assert "no image topic" in line


@pytest.mark.parametrize(
    ("content", "said"),
    [(None, "nowhere.mcap"), (b"", "empty file"), (b"not a log at all", "found a file that begins")],
)
def test_a_file_that_is_no_log(unplayed: Callable[..., str], tmp_path: Path, content: bytes | None, said: str) -> None:
    path = tmp_path / "nowhere.mcap"
    if content is not None:
        path.write_bytes(content)
    assert said in unplayed(path)


def test_a_remap_of_a_topic_that_is_not_there(unplayed: Callable[..., str], cell_log: Callable[..., Path]) -> None:
    assert "has no topic /nothing" in unplayed(cell_log(0.5), "--remap", "/nothing:=/cam/image_raw")


def test_a_remap_to_a_name_that_another_topic_has(unplayed: Callable[..., str], cell_log: Callable[..., Path]) -> None:
    """One of the two would be left out, and nobody told which."""
    left, front = "/cam_left/image_raw/compressed", "/cam_front/image_raw/compressed"
    line = unplayed(cell_log(0.5), "--remap", f"{left}:={front}")
    assert f"as {front}, found {front} and {left}; rename one of them" in line


def test_a_start_past_the_end(unplayed: Callable[..., str], cell_log: Callable[..., Path]) -> None:
    assert "--start-offset 9 s is past its end" in unplayed(cell_log(0.5), "--start-offset", "9")


def test_an_unknown_parameter(unplayed: Callable[..., str], cell_log: Callable[..., Path], tmp_path: Path) -> None:
    file = tmp_path / "p.yaml"
    file.write_text("synchronizer: {ros__parameters: {widht: 80}}\n")
    assert "did you mean 'width'?" in unplayed(cell_log(0.5), "--params", file)


def test_the_log_is_never_its_own_output(
    cell_log: Callable[..., Path], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "log.mcap"
    shutil.copy(cell_log(0.5), log)
    before = log.read_bytes()
    assert main(["replay", str(log), "-o", str(log), "--lockstep"]) == 2
    assert log.read_bytes() == before
    assert "expected another file than the one that is read" in capfd.readouterr().err


@pytest.mark.parametrize(
    ("option", "value"),
    [("--rate", "0"), ("--rate", "1e300"), ("--width", "nan"), ("--max-rate", "-3"), ("--duration", "x")],
)
def test_numbers_that_make_no_sense(option: str, value: str, capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as exit_:
        main(["replay", "log.mcap", option, value])
    assert exit_.value.code == 2
    assert f"{value}: expected" in capfd.readouterr().err


def test_a_recording_is_never_written_over(tmp_path: Path, refused: Callable[..., str]) -> None:
    there = tmp_path / "run.mcap"
    there.write_bytes(b"a recording")
    assert "run.mcap: exists already" in refused("record", "-o", there)
    assert there.read_bytes() == b"a recording"


def test_a_report_that_has_no_place_is_refused_before_the_run(
    cell_log: Callable[..., Path], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """A run may last an hour: what is known to fail afterwards is told before."""
    (tmp_path / "file").touch()
    out = tmp_path / "out.mcap"
    for name in ("file", "file/below"):
        status = main(["replay", str(cell_log(0.5)), "--lockstep", "-o", str(out), "--report", str(tmp_path / name)])
        assert status == 2
        assert "expected a folder" in capfd.readouterr().err
        assert not out.exists()


@pytest.mark.parametrize(
    "command",
    ["intrinsics x --board x", "rig x", "hand-eye x", "refine x", "time x", "import kalibr x", "report x"],
)
@pytest.mark.parametrize("name", ["nowhere/rig.yaml", "."])
def test_a_calibration_that_has_no_place_is_refused_before_it_is_made(
    command: str, name: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as exit_:
        main(["calibrate", *command.split(), "-o", str(tmp_path / name)])
    assert exit_.value.code == 2
    assert "expected the name of a file in a folder that exists" in capfd.readouterr().err


def test_pictures_of_a_report_that_have_no_place_are_refused_before_it_is_made(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").touch()
    for name in ("file", "file/below"):
        with pytest.raises(SystemExit) as exit_:
            main(["calibrate", "report", "rig", "-o", str(tmp_path / "a.html"), "--pictures", str(tmp_path / name)])
        assert exit_.value.code == 2
        assert "expected a folder, or a place to make one" in capfd.readouterr().err


def test_a_demo_that_has_no_place(tmp_path: Path, refused: Callable[..., str]) -> None:
    (tmp_path / "file").touch()
    assert f"--out {tmp_path / 'file'}: cannot be made" in refused("demo", "--out", tmp_path / "file")


def test_a_picture_below_a_file(cell_log: Callable[..., Path], tmp_path: Path, refused: Callable[..., str]) -> None:
    (tmp_path / "file").touch()
    for name in ("picture.png", "film.mp4"):
        assert "expected the name of a file in a folder that exists" in refused(
            "render", cell_log(0.5), "--view", "orbit", "-o", tmp_path / "file" / name
        )


@pytest.mark.parametrize("option", ["--start-offset", "--duration"])
def test_times_beyond_all_logs(option: str, cell_log: Callable[..., Path]) -> None:
    path = cell_log(0.5)
    with open_log(path) as log:
        if option == "--duration":
            assert span_of(log, 0.0, 1e300).stop_ns == log.end_ns + 1
        else:
            with pytest.raises(GraphError, match="is past its end"):
                span_of(log, 1e300)


@pytest.mark.parametrize(
    "values",
    [
        "max_rate_hz: 0.0",
        "max_rate_hz: 1.0e-300",
        "max_rate_hz: -3.0",
        "depth_tolerance_ms: -1.0",
        "depth_tolerance_ms: .inf",
        "width: 0",
        "width: 1000000",
    ],
)
def test_rates_and_times_that_make_no_sense(
    unplayed: Callable[..., str], cell_log: Callable[..., Path], tmp_path: Path, values: str
) -> None:
    file = tmp_path / "p.yaml"
    file.write_text(f"synchronizer: {{ros__parameters: {{{values}}}}}\n")
    assert f"synchronizer: {values.partition(':')[0]}: expected" in unplayed(cell_log(0.5), "--params", file)


def test_who_reads_what_is_printed_may_go(cell_log: Callable[..., Path]) -> None:
    """As in `twin_node check LOG | head -1`."""
    reader, writer = os.pipe()
    os.close(reader)
    command = [sys.executable, "-c", "import sys; from twin_node.cli import main; sys.exit(main())", "check"]
    done = subprocess.run([*command, str(cell_log(0.5))], stdout=writer, stderr=subprocess.PIPE, check=False)
    os.close(writer)
    assert done.stderr == b""
    assert done.returncode == 141


@pytest.mark.parametrize("number", ["0", "-1", "1.5", "many"])
def test_a_queue_that_holds_nothing(number: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as exit_:
        main(["play", "no.mcap", "--read-ahead-queue-size", number])
    assert exit_.value.code == 2
    assert f"argument --read-ahead-queue-size: {number}: expected a" in capsys.readouterr().err


def test_more_than_anybody_counts(capsys: pytest.CaptureFixture[str]) -> None:
    """As who types nines for all of them: loops took no such number, and the command ended in a trace."""
    with pytest.raises(SystemExit) as exit_:
        main(["train", "no.mcap", "-o", "model.safetensors", "--frames", "9" * 20])
    assert exit_.value.code == 2
    assert "expected a whole number, 1 to 1e+18" in capsys.readouterr().err


def test_a_full_disk_that_takes_no_more_output_is_named() -> None:
    """A driver whose log filled the disk ended with a traceback."""
    with Path("/dev/full").open("w") as full:
        words = [sys.executable, "-c", "from twin_node.cli import main; raise SystemExit(main())", "ur-sim"]
        done = subprocess.run([*words, "--list-faults"], stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr == "twin_node: error: no room for what it writes: No space left on device; free some\n"


def test_a_report_where_the_log_goes_is_refused_before_the_run(
    cell_log: Callable[..., Path], tmp_path: Path, refused: Callable[..., str]
) -> None:
    out = str(tmp_path / "run")
    assert "expected another place than that of -o" in refused("replay", cell_log(0.5), "-o", out, "--report", out)
    assert not list(tmp_path.iterdir())
