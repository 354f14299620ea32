"""A file or folder that cannot be read is told in the words of the system, without Python's."""

from __future__ import annotations

from pathlib import Path

import pytest

from twin_node.bag import LogWriter
from twin_node.cli import main
from twin_node.errors import reason
from twin_node.messages import message_type


@pytest.mark.parametrize(
    "arguments",
    [
        ["bench", "forecast", "{folder}/walk.trc"],
        ["bench", "forecast", "{folder}/walk.bvh"],
        ["calibrate", "import", "colmap", "{folder}/empty", "-o", "{folder}/rig.yaml"],
        ["calibrate", "import", "colmap", "{folder}/none", "-o", "{folder}/rig.yaml"],
        ["calibrate", "import", "qualisys", "{folder}/none.txt", "-o", "{folder}/rig.yaml"],
        ["calibrate", "import", "toml", "{folder}/none.toml", "-o", "{folder}/rig.yaml"],
        ["calibrate", "import", "opencv", "{folder}/none.json", "-o", "{folder}/rig.yaml"],
        ["calibrate", "import", "opencv", "{folder}/none.xml", "-o", "{folder}/rig.yaml"],
    ],
)
def test_what_is_not_there_is_one_line_without_a_number(
    arguments: list[str], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "empty").mkdir()
    assert main([one.format(folder=tmp_path) for one in arguments]) == 2
    (line,) = capfd.readouterr().err.splitlines()
    assert next(one for one in arguments if one.startswith("{folder}")).format(folder=tmp_path) in line
    assert "No such file or directory" in line
    assert "Errno" not in line


LONG = 300 * "n"
"""A name that no file can have: whether one is there cannot even be asked, as in a folder that is closed."""


@pytest.mark.parametrize(
    "arguments",
    [
        ["info", f"{LONG}.mcap"],
        ["check", "log.mcap", "--repair", f"{LONG}.mcap"],
        ["record", "-o", LONG],
        ["replay", "log.mcap", "--params", f"{LONG}.yaml"],
        ["render", "log.mcap", "-o", f"{LONG}.mp4"],
        ["replay", "log.mcap", "--report", f"{LONG}/report"],
    ],
)
def test_names_that_no_file_can_have_are_one_line(
    arguments: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    with LogWriter(tmp_path / "log.mcap") as log:
        log.write("/text", message_type("std_msgs/msg/String")(data="a"), 1)
    assert main(arguments) == 2
    (line,) = capfd.readouterr().err.splitlines()
    assert LONG in line and "File name too long" in line and "Errno" not in line


@pytest.mark.parametrize("command", [["calibrate", "rig", "-o", "rig.yaml"], ["bench", "collision", "--reference"]])
def test_what_is_no_folder_is_told_once(
    command: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("file").write_text("text")
    for name, found in (("file", "a file"), ("none", "none")):
        assert main([*command, name]) == 2
        (line,) = capfd.readouterr().err.splitlines()
        assert f"{name}: expected a folder" in line and line.endswith(f"found {found}; check the path")


def test_a_reason_is_one_line_of_words() -> None:
    assert reason(FileNotFoundError(2, "No such file or directory", "a.txt")) == "No such file or directory"
    assert reason(OSError("cut\n off")) == "cut off"
    assert reason(UnicodeDecodeError("utf-8", b"\xff", 0, 1, "invalid start byte")) == "what is no text"
