"""The parameters of a launch: their sections, and what is refused of their values."""

from __future__ import annotations

import importlib
import re
from pathlib import Path
from typing import Any, get_type_hints

import pytest

from twin_node.errors import TwinError
from twin_node.nodes.chain_parameters import ChainParameters, chain_parameters, load_parameters
from twin_node.nodes.launch.kinds import CHAIN_SECTIONS
from twin_node.nodes.launch.launch_file import read_launch_file


def test_the_chain_s_sections_are_those_of_its_parameters() -> None:
    assert list(CHAIN_SECTIONS) == list(get_type_hints(ChainParameters))
    for (name, place), kind in zip(CHAIN_SECTIONS.items(), get_type_hints(ChainParameters).values(), strict=True):
        module, _, attribute = place.partition(":")
        assert getattr(importlib.import_module(module), attribute) is kind, name


def test_a_launch_file_is_a_parameter_file_too() -> None:
    assert load_parameters(None).synchronizer.width == 160
    for name in ("sim_cell", "oak_rig", "two_machines"):
        assert load_parameters(Path(f"launch/{name}.yaml")).arm.model == "ur5e"


def test_what_parameters_refuse_names_where_they_came_from(tmp_path: Path) -> None:
    plan = read_launch_file("launch/replay.yaml", ["log:=a"], ["synchronizer.width:=80"], [Path("launch/demo.yaml")])
    assert plan.where == f"{plan.path} (with launch/demo.yaml, -p synchronizer.width:=80)"
    assert read_launch_file("launch/replay.yaml", ["log:=a"]).where == str(plan.path)
    given = tmp_path / "given.yaml"
    given.write_text("synchronizer: {ros__parameters: {width: -3}}")
    with pytest.raises(TwinError, match=r"given.yaml: synchronizer: width: expected 16 to 16384 pixels, found -3"):
        load_parameters(given)


@pytest.mark.parametrize(
    ("section", "values", "words"),
    [
        ("grid", {"voxel_size": 0}, "grid: voxel_size: expected more than 0 and at most 1, found 0"),
        (
            "synchronizer",
            {"grouping": {"queue_size": 0}},
            "synchronizer: grouping.queue_size: expected 1 to 1000, found 0",
        ),
        (
            "synchronizer",
            {"grouping": {"min_period_ns": [5, -1]}},
            "synchronizer: grouping.min_period_ns: expected 0 or",
        ),
        (
            "synchronizer",
            {"grouping": {"deadline_ns": -1}},
            "synchronizer: grouping.deadline_ns: expected a number of 0",
        ),
    ],
)
def test_values_that_a_later_use_would_refuse_are_refused_when_the_file_is_read(
    section: str, values: dict[str, Any], words: str
) -> None:
    """They were when cameras were there, without the file's name or the section's."""
    with pytest.raises(TwinError, match=f"^cell.yaml: {re.escape(words)}"):
        chain_parameters({section: values}, "cell.yaml")
