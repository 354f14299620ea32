"""Names of a namespace's own, and on the graph."""

from __future__ import annotations

import pytest

from twin_node.runtime.names import ROOT, full_name, is_namespace, within, without
from twin_node.runtime.zenoh_session import WireError, ZenohParameters


@pytest.mark.parametrize(
    ("namespace", "own", "on_graph"),
    [
        (ROOT, "/twin/status", "/twin/status"),
        ("/cell", "/twin/status", "/cell/twin/status"),
        ("/line_2/cell", "/tf", "/line_2/cell/tf"),
        ("/cell", "/clock", "/clock"),
        ("/cell", "/rosout", "/rosout"),
    ],
)
def test_names_go_onto_the_graph_and_come_back(namespace: str, own: str, on_graph: str) -> None:
    assert within(namespace, own) == on_graph
    assert without(namespace, on_graph) == own


@pytest.mark.parametrize("topic", ["/other/twin/status", "/cellar/status", "/cell", "/twin/status", "/cell/clock"])
def test_what_is_of_another_namespace_has_no_name_here(topic: str) -> None:
    """Nor has what no node of this one could have said: its `/clock` is that of all."""
    assert without("/cell", topic) is None


def test_nodes_are_told_by_their_full_names() -> None:
    assert full_name("arm") == "/arm"
    assert full_name("arm", "/cell") == "/cell/arm"


@pytest.mark.parametrize("text", ["/", "/cell", "/line_2/cell"])
def test_namespaces_are_those_of_ros(text: str) -> None:
    assert is_namespace(text)
    assert ZenohParameters(namespace=text).namespace == text


@pytest.mark.parametrize("text", ["", "cell", "/cell/", "//cell", "/2", "/a-b", "/a b", "/a%b", "/zelle\n"])
def test_what_is_no_namespace_is_refused(text: str) -> None:
    assert not is_namespace(text)
    with pytest.raises(WireError, match=r"namespace: expected one such as /cell, .* found"):
        ZenohParameters(namespace=text)
