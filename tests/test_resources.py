"""Data files are found as they are named, and what was meant by a name that is none is told."""

from __future__ import annotations

import pytest

from twin_node.resources import ResourceError, find


def test_a_name_without_its_folder_is_answered_with_what_there_is() -> None:
    with pytest.raises(ResourceError, match=r"^demo\.yaml: no such file .*did you mean launch/demo\.yaml or sim/demo"):
        find("demo.yaml")
    assert find("launch/demo.yaml").is_file() and find("sim/demo.yaml").is_file()


@pytest.mark.parametrize("name", ["nosuch.yaml", "/nosuch/folder/nosuch.yaml"])
def test_a_name_that_nothing_has_is_answered_plainly(name: str) -> None:
    with pytest.raises(ResourceError, match=r"check the spelling of the path$"):
        find(name)


def test_a_misspelt_name_is_answered_with_the_nearest_and_any_other_with_all() -> None:
    with pytest.raises(ResourceError, match=r"did you mean sim/thrown_ball\.yaml\?$"):
        find("sim/thrown_bal.yaml")
    with pytest.raises(ResourceError, match=r"sim has .*conveyor, cross, demo, .*thrown_ball.*$"):
        find("sim/nothing.yaml")
    with pytest.raises(ResourceError, match=r"check the spelling of the path$"):
        find("sim/nothing.nosuch")
