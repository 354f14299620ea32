"""Stamp files in every format and unit."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin_node.rig import RigError, StampsFile, read_stamps

EPOCH_NS = 1_763_612_345_678_901_234


@pytest.mark.parametrize(
    ("name", "text", "key", "unit"),
    [
        ("a.json", '{"timestamps": [0.5, 1, 1.25]}', "timestamps", "s"),
        ("a.json", "[500, 1000, 1250]", None, "ms"),
        ("a.csv", "frame,t\n0,0.5\n1,1\n2,1.25\n", "t", "s"),
        ("a.csv", "0.5,0\n1,1\n1.25,2\n", None, "s"),
        ("a.txt", "500000\n1000000\n\n1250000\n", None, "us"),
        ("a.txt", "5e8\n1e9\n1.25e9\n", None, "ns"),
    ],
)
def test_formats_and_units(tmp_path: Path, name: str, text: str, key: str | None, unit: str) -> None:
    (tmp_path / name).write_text(text)
    stamps = read_stamps(StampsFile(tmp_path / name, key, unit))
    assert stamps.tolist() == [500_000_000, 1_000_000_000, 1_250_000_000]


@pytest.mark.parametrize(
    ("name", "text", "key"),
    [
        ("a.csv", "t,frame\n0.5,0\n1,1\n", "t"),
        ("a.csv", "0.5,0\n1,1\n", None),
        ("a.txt", "0.5\n1\n", None),
        ("a.json", "[0.5, 1]", None),
    ],
)
def test_files_that_spreadsheets_write_are_read(tmp_path: Path, name: str, text: str, key: str | None) -> None:
    (tmp_path / name).write_text(text, encoding="utf-8-sig")
    assert read_stamps(StampsFile(tmp_path / name, key)).tolist() == [500_000_000, 1_000_000_000]


@given(stamps=st.lists(st.integers(0, 2**62), min_size=1, max_size=20))
def test_whole_nanoseconds_lose_nothing(tmp_path_factory: pytest.TempPathFactory, stamps: list[int]) -> None:
    folder = tmp_path_factory.mktemp("stamps")
    (folder / "a.json").write_text(json.dumps(stamps))
    (folder / "a.txt").write_text("\n".join(map(str, stamps)))
    for name in ("a.json", "a.txt"):
        assert read_stamps(StampsFile(folder / name, None, "ns")).tolist() == stamps


@pytest.mark.parametrize(
    ("name", "text", "key", "message"),
    [
        ("a.json", '{"times": [1]}', "timestamps", r"expected the key 'timestamps', found times"),
        ("a.json", '{"times": 1}', "times", r"expected a list of stamps, found a whole number"),
        ("a.json", "{", None, r"found no readable file"),
        ("a.json", "[]", None, r"expected stamps, found none"),
        ("a.json", "[NaN]", None, r"expected finite stamps"),
        ("a.json", "[true]", None, r"expected a number as a stamp, found True"),
        ("a.csv", "frame,t\n0,1\n", "time", r"expected the column 'time', found frame, t"),
        ("a.csv", "frame,t\n0\n", "t", r"expected a number as a stamp, found None"),
        ("a.txt", "one\n", None, r"expected a number as a stamp, found 'one'"),
        ("a.txt", f"{EPOCH_NS}\n", None, r"expected stamps in s, found 176.*give their unit"),
        ("a.txt", "10800000000\n", None, r"expected stamps in s, found 10800000000; give their unit"),  # 3 h in us
        ("a.txt", f"{'9' * 400}\n", None, r"expected stamps in s, found a number of 400 digits"),
        ("a.json", "[" * 100_000, None, r"found no readable file \(too many levels, one within the other\)"),
    ],
)
def test_mistakes(tmp_path: Path, name: str, text: str, key: str | None, message: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(RigError, match=message) as caught:
        read_stamps(StampsFile(tmp_path / name, key))
    assert str(caught.value).startswith(str(tmp_path / name))


def test_a_missing_file(tmp_path: Path) -> None:
    with pytest.raises(RigError, match=r"absent\.txt: expected stamps"):
        read_stamps(StampsFile(tmp_path / "absent.txt"))
