"""YAML that users write: what stands twice, or cannot be read, is one error of the room that reads it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from twin_node.cell import load_scenario
from twin_node.errors import TwinError
from twin_node.nodes.launch.launch_file import read_launch_file
from twin_node.rig import load_rig
from twin_node.robot import arm_model
from twin_node.runtime.parameters import read_parameters
from twin_node.yaml_file import parse_yaml, read_yaml, yaml_text

READERS: dict[str, Callable[[Path], object]] = {
    "a parameter file": read_parameters,
    "a launch file": lambda path: read_launch_file(path, [], []),
    "a scenario": load_scenario,
    "a rig file": load_rig,
    "a UR calibration file": lambda path: arm_model("ur5e", str(path)),
}


MERGED = """
deep: {own: &own {<<: &shared {depth: 1, rate: 2}, rate: 3}}
taken: {<<: *own, width: 4}
"""


def test_what_is_merged_may_be_set_otherwise(tmp_path: Path) -> None:
    path = tmp_path / "merged.yaml"
    path.write_text(MERGED)
    expected = {"deep": {"own": {"depth": 1, "rate": 3}}, "taken": {"depth": 1, "rate": 3, "width": 4}}
    assert read_yaml(path, "merged keys", TwinError) == expected


def test_what_has_an_alias_may_stand_in_many_places(tmp_path: Path) -> None:
    path = tmp_path / "shared.yaml"
    path.write_text("a: &x [&y {b: 1}, *y]\nc: {d: *x, e: *y}\n")
    b = {"b": 1}
    assert read_yaml(path, "shared values", TwinError) == {"a": [b, b], "c": {"d": [b, b], "e": b}}


@pytest.mark.parametrize("kind", ["a parameter file", "a scenario", "a rig file"])
@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("a text", "text"),
        ("- 1", "a list"),
        ("[]", "an empty list"),
        ("", "nothing"),
        ("5", "a whole number"),
        ("true", "true or false"),
        ("2026-11-23", "a date"),
    ],
)
def test_what_is_found_instead_is_said_in_words(tmp_path: Path, kind: str, content: str, words: str) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(content)
    with pytest.raises(TwinError, match=rf"mine\.yaml: expected .*, found {words}$"):
        READERS[kind](path)


LAUGHS = b"a: &a [ha, ha]\nb: &b [*a]\n" + b"".join(
    b"%c: &%c [%s]\n" % (name, name, b", ".join([b"*%c" % (name - 1)] * 10)) for name in b"cdefghijklm"
)
"""Ten times as much a line: a terabyte in the end."""
MERGES = LAUGHS.replace(b"[ha, ha]", b"{ha: 1}").replace(b"[", b"{<<: [").replace(b"]", b"]}")


def test_what_is_repeated_often_may_be(tmp_path: Path) -> None:
    path = tmp_path / "cameras.yaml"
    path.write_text(f"camera: &camera {{lens: {[0.5] * 100}}}\nall: [{', '.join(['*camera'] * 100)}]\n")
    cameras = read_yaml(path, "cameras", TwinError)
    assert isinstance(cameras, dict) and cameras["all"] == [{"lens": [0.5] * 100}] * 100


@pytest.mark.parametrize("kind", READERS)
@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"a: 1\nb:\n  c: 1\n  c: 2\n", "but it cannot be read as YAML: found the field 'c' a second time in line 4"),
        (b"? [1, 2]\n: 3\n", "found a list or a mapping as a key in line 1"),
        (b"[" * 5000, "but it cannot be read as YAML: too many levels, one within the other"),
        (b"a: [1\n", "but it cannot be read as YAML"),
        (b"a: 2026-02-30\n", "but it cannot be read as YAML: day (is out of|30 must be in) range"),
        (b'a: !!int ""\n', "but it cannot be read as YAML: expected what can be !!int, found '' in line 1"),
        (b"a:\n  b: !!bool maybe\n", "cannot be read as YAML: expected what can be !!bool, found 'maybe' in line 2"),
        (b"a: " + 200 * b"59:" + b"1.5\n", "expected what can be !!float, found '59:59:"),
        (b"a: !!timestamp soon\n", "cannot be read as YAML: expected what can be !!timestamp, found 'soon' in line 1"),
        (b"a: &x [*x]\n", "but it cannot be read as YAML: found the alias 'x' within what it stands for in line 1"),
        (b"a: &x\n  b: [{c: *x}]\n", "found the alias 'x' within what it stands for in line 2"),
        (b"a: &x {<<: *x}\n", "found the alias 'x' within what it stands for in line 1"),
        (LAUGHS, "found aliases that stand for more than 1000000 characters, '[fg]' among them in line [78]"),
        (MERGES, "found aliases that stand for more than 1000000 characters, '[fg]' among them in line [78]"),
        (b"\x89MCAP\r\n\xff", "found what is no text; is it a log"),
        (None, "but it cannot be read: No such file|no such file|does not exist|not found"),
    ],
)
def test_what_cannot_be_read_is_one_error(tmp_path: Path, kind: str, content: bytes | None, words: str) -> None:
    path = tmp_path / "mine.yaml"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(TwinError, match=words) as caught:
        READERS[kind](path)
    assert str(path) in str(caught.value)
    if content is not None:
        assert f"expected {kind}" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_numbers_of_numpy_are_written_as_such_that_are_read() -> None:
    content = {"rate": np.float64(-194.5), "width": np.float32(0.5), "count": np.int64(3), "certain": np.bool_(True)}
    assert parse_yaml(yaml_text(content)) == {"rate": -194.5, "width": 0.5, "count": 3, "certain": True}
