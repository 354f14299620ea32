"""`bench stability`, `bench pareto` and a replay of a size by need, as a user gives them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from twin_node.bench.pareto import suite
from twin_node.cli import main


def refused(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """The one line that a command that cannot run gives."""
    assert main(list(arguments)) == 2
    (line,) = capsys.readouterr().err.splitlines()
    return line


def test_a_failure_or_method_that_is_none_is_refused_with_those_that_are(capsys: pytest.CaptureFixture[str]) -> None:
    assert "--only fire: expected one of undisturbed" in refused(capsys, "bench", "stability", "--only", "fire")
    assert "found 'magic'" in refused(capsys, "bench", "pareto", "--methods", "frozen,magic")


def test_what_is_of_logs_is_refused_without_one(capsys: pytest.CaptureFixture[str]) -> None:
    line = refused(capsys, "bench", "pareto", "--quick", "--frames", "5", "--start-offset", "0", "--methods", "magic")
    assert "--frames, --start-offset: expected with a LOG" in line


def test_a_method_that_is_named_twice_is_measured_once(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    measured: list[tuple[str, ...]] = []
    monkeypatch.setattr(
        suite, "run", lambda parameters, progress: measured.append(parameters.rivals) or suite.Pareto(())
    )
    assert main(["bench", "pareto", "--methods", "frozen,previous,frozen"]) == 0
    assert measured == [("frozen", "previous")]


def test_a_log_that_is_not_there_is_named(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    for command in ("pareto", "ablations"):
        assert "nowhere.mcap" in refused(capsys, "bench", command, str(tmp_path / "nowhere.mcap"))


def test_a_folder_that_cannot_be_made_is_told_before_anything_is_run(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    (tmp_path / "file").write_text("")
    for command in ("stability", "pareto"):
        line = refused(capsys, "bench", command, "--out", str(tmp_path / "file" / "new"))
        assert "cannot be made" in line and "choose another folder" in line
        line = refused(capsys, "bench", command, "--out", "/proc/self")
        assert "--out /proc/self: cannot write into it" in line and "choose another folder" in line


def test_figures_that_cannot_be_written_are_told_nevertheless(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Hours of measuring are not lost to a full disk."""
    monkeypatch.setattr(suite, "run", lambda parameters, progress: suite.Pareto(()))
    for name in ("sizes.yaml", "pareto.json"):
        out = tmp_path / f"no {name}"
        (out / name).mkdir(parents=True)
        assert main(["bench", "pareto", "--quick", "--out", str(out)]) == 2
        said = capsys.readouterr()
        assert f"{name}: cannot be written (Is a directory)" in said.err and said.out.strip()


def test_a_size_that_is_measured_cannot_repeat_itself_to_the_byte(
    capsys: pytest.CaptureFixture[str], cell_log: Callable[..., Path]
) -> None:
    log = str(cell_log(0.5))
    assert "use --target" in refused(capsys, "replay", log, "--lockstep", "--budget-ms", "30")
    assert "leave one of them out" in refused(capsys, "replay", log, "--width", "80", "--target", "10")
    assert "the best of launch/sizes.yaml" in refused(capsys, "replay", log, "--lockstep", "--target", "90")


def test_a_replay_of_a_quality_says_its_size(capsys: pytest.CaptureFixture[str], cell_log: Callable[..., Path]) -> None:
    assert main(["replay", str(cell_log(0.5)), "--lockstep", "--target", "1"]) == 0
    assert "twin_node: size tiny: the fastest that reached 1 dB" in capsys.readouterr().err
