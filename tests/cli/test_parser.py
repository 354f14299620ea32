"""The command line as people write it: arguments between options, and paths from home."""

from __future__ import annotations

import io
import sys
from pathlib import Path

import pytest

from twin_node import cli
from twin_node.cli import main
from twin_node.cli.arguments import file_to_write, finite
from twin_node.cli.parser import Parser, with_home


def test_arguments_stand_anywhere_between_options() -> None:
    parser = Parser()
    launch = parser.add_subparsers().add_parser("launch")
    launch.add_argument("file")
    launch.add_argument("arguments", nargs="*")
    launch.add_argument("-p", action="append", default=[])
    options = parser.parse_args(["launch", "a.yaml", "-p", "x", "b:=1", "-p", "y", "c:=2"])
    assert (options.file, options.arguments, options.p) == ("a.yaml", ["b:=1", "c:=2"], ["x", "y"])
    assert parser.parse_args(["launch", "-p", "x", "a.yaml", "b:=1"]).arguments == ["b:=1"]
    for wrong in (["launch", "-p", "x"], ["launch", "a.yaml", "--nope"], ["nope"]):
        with pytest.raises(SystemExit):
            parser.parse_args(wrong)


def test_numbers_below_zero_are_numbers_however_they_are_written(capsys: pytest.CaptureFixture[str]) -> None:
    """argparse took those with an exponent for options, and said how many numbers it expected."""
    parser = Parser()
    parser.add_argument("--move", type=finite, nargs=3)
    assert parser.parse_args(["--move", "-1e-3", "-.5", "-5."]).move == [-1e-3, -0.5, -5.0]
    for wrong in ("-inf", "-nan", "-1e400"):
        with pytest.raises(SystemExit):
            parser.parse_args(["--move", "0", wrong, "0"])
        assert f"argument --move: {wrong}: expected a finite number" in capsys.readouterr().err


def test_paths_begin_at_home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """`--report=~/run` would else make a folder of the name `~`, which nobody dares to remove."""
    monkeypatch.setenv("HOME", str(tmp_path))
    parser = Parser()
    parser.add_argument("--report", type=Path)
    parser.add_argument("logs", type=Path, nargs="+")
    options = with_home(parser.parse_args(["--report=~/run", "~/a.mcap", "~b.mcap", "c/~"]))
    assert options.report == tmp_path / "run"
    assert options.logs == [tmp_path / "a.mcap", Path("~b.mcap"), Path("c/~")]
    assert file_to_write("~/film.mp4") == tmp_path / "film.mp4"


@pytest.mark.parametrize(
    ("arguments", "name"),
    [
        (["export", "a.mcap", "--to", "csv", "-o", "out"], "--arm"),
        (["ur-driver", "--robot", "127.0.0.2"], "--model"),
        (["ur-driver", "--robot", "127.0.0.2"], "--kinematics"),
        (["ur-sim"], "--model"),
        (["ur-sim"], "--kinematics"),
        (["calibrate", "intrinsics", "pictures"], "--board"),
        (["calibrate", "rig", "folder", "-o", "rig.yaml"], "--board"),
        (["calibrate", "check", "rig.yaml"], "--board"),
        (["calibrate", "check", "rig.yaml"], "--arm"),
        (["calibrate", "report", "rig.yaml", "-o", "page.html"], "--board"),
        (["calibrate", "hand-eye", "views"], "--board"),
        (["calibrate", "hand-eye", "views"], "--arm"),
        (["calibrate", "refine", "a.mcap", "-o", "rig.yaml"], "--arm"),
        (["calibrate", "time", "a.mcap"], "--arm"),
        (["bench", "graph"], "--scenario"),
    ],
    ids=lambda value: value if isinstance(value, str) else " ".join(value),
)
def test_what_may_be_a_file_or_a_name_begins_at_home_too(
    arguments: list[str], name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`--model=~/arm.xml` was no file."""
    monkeypatch.setenv("HOME", str(tmp_path))
    for given, meant in (("~/arm.xml", str(tmp_path / "arm.xml")), ("ur5e", "ur5e"), ("./a//b", "./a//b")):
        options = cli._parser().parse_args([*arguments, f"{name}={given}"])
        assert getattr(options, name.removeprefix("--")) == meant


def test_a_name_that_the_terminal_has_no_letters_for_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    raw = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(raw, "ascii"))
    monkeypatch.setattr("twin_node.cli.logs._info", lambda options: print(options.log))
    assert main(["info", "ü.mcap"]) == 0
    assert raw.getvalue() == b"\\xfc.mcap\n"
