"""`twin_node param` and `twin_node lifecycle` on a graph of the test's own."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from twin_node.bench.graph_run import free_endpoint
from twin_node.cli import main
from twin_node.nodes.chain_parameters import ChainParameters, load_parameters
from twin_node.nodes.launch.kinds import CHAIN_SECTIONS, KINDS
from twin_node.nodes.live import asking
from twin_node.nodes.live.asking import as_file
from twin_node.nodes.topics import GraphError, kind_of_own
from twin_node.runtime.lifecycle_services import STEPS, Transition, serve_lifecycle
from twin_node.runtime.node import LifecycleState
from twin_node.runtime.parameter_services import serve_parameters
from twin_node.runtime.parameter_values import parameters_of
from twin_node.runtime.zenoh_session import ZenohParameters, open_router
from twin_node.runtime.zenoh_wire import ZenohWire
from twin_node.yaml_file import parse_yaml, yaml_text

pytest.importorskip("zenoh")

PATIENCE_S = 60.0
GOALS = {
    Transition.DEACTIVATE: LifecycleState.INACTIVE,
    Transition.ACTIVATE: LifecycleState.ACTIVE,
    Transition.CLEANUP: LifecycleState.UNCONFIGURED,
}


class Obedient:
    """A node that is active, and goes where it is told to but for what it refuses."""

    lifecycle = LifecycleState.ACTIVE
    refuses = False
    is_over = False

    def change(self, transition: Transition, done: Callable[[bool], None]) -> None:
        self.is_over = STEPS[transition].is_shutdown
        if not self.refuses and not self.is_over:
            self.lifecycle = GOALS[transition]
        done(not self.refuses)


def twin_parameters(chain: ChainParameters) -> dict[str, object]:
    return {name: getattr(chain, name) for name in CHAIN_SECTIONS if name not in KINDS}


@pytest.fixture
def node(monkeypatch: pytest.MonkeyPatch) -> Iterator[Obedient]:
    """The twin of a graph with another program's node, which serves nothing."""
    endpoint = free_endpoint()
    parameters = ZenohParameters(router="builtin", endpoint=endpoint, domain=0)
    router = open_router(parameters)
    assert router is not None
    monkeypatch.setattr(asking, "ZenohParameters", lambda: parameters)
    found = Obedient()
    with contextlib.closing(router), contextlib.closing(ZenohWire(parameters)) as wire:
        wire.subscribe("alien", "/joint_states", kind_of_own("/joint_states"), lambda _: None)
        serve_parameters(wire, "twin", parameters_of({"use_sim_time": False, **twin_parameters(ChainParameters())}))
        serve_lifecycle(wire, "twin", found)
        with asking.Asking() as graph:
            until = time.monotonic() + PATIENCE_S
            while not _is_known(graph):
                assert time.monotonic() < until, "the graph does not know of its nodes"
                time.sleep(0.01)
        yield found


def _is_known(graph: asking.Asking) -> bool:
    """Whether the router knows of all that is there by now."""
    with contextlib.suppress(GraphError):
        return graph.nodes() == ("/alien", "/twin") and bool(graph.state("/twin") and graph.parameters("/twin"))
    return False


def printed(capsys: pytest.CaptureFixture[str], *arguments: str, status: int = 0) -> list[str]:
    assert main(list(arguments)) == status
    out, err = capsys.readouterr()
    return (err if status else out).splitlines()


def test_parameters_are_listed_read_and_explained(node: Obedient, capsys: pytest.CaptureFixture[str]) -> None:
    everything = printed(capsys, "param", "list")
    assert everything[:2] == ["/twin:", "  use_sim_time"]
    assert printed(capsys, "param", "list", "twin") == [line.strip() for line in everything[1:]]
    assert printed(capsys, "param", "get", "/twin", "grid.voxel_size") == ["0.02"]
    assert printed(capsys, "param", "get", "twin", "model.device") == ["cpu"]
    assert printed(capsys, "param", "describe", "twin", "grid.voxel_size", "forecast.bound.coverage") == [
        "grid.voxel_size: double, 0.02",
        "  Edge of a voxel, m; longer where it would take more than 1.5 million: two CPU cores follow no more.",
        "forecast.bound.coverage: double, 0.99",
        "  Share of the moving space, and of the nodes, that the forecast made for it must hold.",
    ]
    assert len(printed(capsys, "param", "describe", "twin")) > len(everything)


def test_a_graph_is_dumped_as_a_file_that_it_can_be_started_with(
    node: Obedient, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "twin.yaml"
    assert printed(capsys, "param", "dump", "twin", "-o", str(path)) == []
    assert load_parameters(path) == ChainParameters()
    assert printed(capsys, "param", "dump", "twin") == path.read_text().splitlines()


def test_a_size_given_by_name_is_dumped_as_what_it_made_of_the_model(tmp_path: Path) -> None:
    small = tmp_path / "small.yaml"
    small.write_text("size: {ros__parameters: {name: small}}")
    chain = load_parameters(small)
    assert chain.model != ChainParameters().model
    told = {name: one.value for name, one in parameters_of(twin_parameters(chain)).items()}
    (tmp_path / "dumped.yaml").write_text(yaml_text(as_file("/twin", told)))
    assert load_parameters(tmp_path / "dumped.yaml").model == chain.model


def test_lists_of_lists_are_dumped_as_they_were() -> None:
    told = {name: one.value for name, one in parameters_of({"tool": ((0.0, 0.1), (1.0, 2.0)), "note": "[odd"}).items()}
    assert as_file("/arm", told) == {"arm": {"ros__parameters": {"tool": [[0.0, 0.1], [1.0, 2.0]], "note": "[odd"}}}


def test_a_node_of_ours_is_dumped_as_a_launch_names_it_whatever_its_namespace(tmp_path: Path) -> None:
    """What was dumped of one in a namespace was refused as an unknown node's."""
    told = {name: one.value for name, one in parameters_of(twin_parameters(ChainParameters())).items()}
    path = tmp_path / "dumped.yaml"
    path.write_text(yaml_text(as_file("/line/cell/twin", told)))
    assert load_parameters(path) == ChainParameters()
    path.write_text(path.read_text().replace("forecast:", "/line/cell/forecast:", 1))
    with pytest.raises(GraphError, match=r"unknown node '/line/cell/forecast'; write 'forecast': a file has no namesp"):
        load_parameters(path)


def test_another_programs_node_is_dumped_as_ros_does() -> None:
    dumped = as_file("/line/planner", {"use_sim_time": True, "ompl.range": 0.1, "text": "[1]", "none": None})
    inside = {"use_sim_time": True, "ompl": {"range": 0.1}, "text": "[1]"}
    assert parse_yaml(yaml_text(dumped)) == {"/line/planner": {"ros__parameters": inside}}


def test_a_node_is_led_through_its_life(node: Obedient, capsys: pytest.CaptureFixture[str]) -> None:
    assert printed(capsys, "lifecycle", "get") == ["/twin: active"]
    assert printed(capsys, "lifecycle", "list", "twin") == ["deactivate (4)", "shutdown (7)"]
    assert printed(capsys, "lifecycle", "set", "twin", "deactivate") == ["/twin: inactive"]
    assert printed(capsys, "lifecycle", "get", "twin") == ["inactive"]
    assert printed(capsys, "lifecycle", "set", "twin", "3") == ["/twin: active"]
    assert printed(capsys, "lifecycle", "set", "twin", "shutdown") == ["/twin: finalized"]
    assert node.is_over


@pytest.mark.parametrize("service", ["get_state", "list_parameters"])
def test_a_node_that_hangs_is_named_among_all(
    node: Obedient, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, service: str
) -> None:
    """It was left out, as one of another program's that has no such service."""
    ask = asking.ServiceClient.ask

    def in_vain(self: Any, name: str, *more: Any, **fields: Any) -> Any:
        return None if name == f"/twin/{service}" else ask(self, name, *more, **fields)

    monkeypatch.setattr(asking.ServiceClient, "ask", in_vain)
    states, listed = printed(capsys, "lifecycle", "get"), printed(capsys, "param", "list")
    if service == "get_state":
        assert states == ["/twin: does not answer"]
    else:
        assert listed == ["/twin:", "  does not answer"]
    assert not any("alien" in line for line in states + listed)


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("param", "get", "twinn", "x"), "expected a node of the graph, found 'twinn'; did you mean '/twin'?"),
        (
            ("param", "get", "twin", "voxel_size"),
            "/twin has no parameter 'voxel_size'; did you mean 'grid.voxel_size'?",
        ),
        (("param", "get", "twin", "xyz"), "/twin has no parameter 'xyz'; 'twin_node param list /twin' names them"),
        (("param", "list", "alien"), "/alien: expected its service list_parameters to answer within 10 s, but it did"),
        (("lifecycle", "set", "twin", "fly"), "/twin is active: expected deactivate, shutdown, found 'fly'"),
        (("lifecycle", "set", "twin", "activate"), "/twin is active: expected deactivate, shutdown, found 'activate'"),
        (("param", "dump", "twin", "-o", "/nowhere/x.yaml"), "/nowhere"),
    ],
)
def test_what_cannot_be_asked_is_one_error(
    node: Obedient, capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], told: str
) -> None:
    [line] = printed(capsys, *arguments, status=2)
    assert line.startswith(f"twin_node: error: {told}")


def test_a_transition_that_fails_is_an_error(node: Obedient, capsys: pytest.CaptureFixture[str]) -> None:
    node.refuses = True
    [line] = printed(capsys, "lifecycle", "set", "twin", "deactivate", status=2)
    assert line == "twin_node: error: /twin could not deactivate; its log and 'twin_node doctor' say why"


@pytest.mark.parametrize("command", ["get", "describe"])
def test_another_program_that_answers_less_than_was_asked_is_told(
    node: Obedient, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, command: str
) -> None:
    """rclcpp leaves all values out where it has not one of them by now."""
    whole = asking.ServiceClient.ask

    def forgetful(self: Any, name: str, *more: Any, **fields: Any) -> Any:
        answer = whole(self, name, *more, **fields)
        if name.endswith("/get_parameters"):
            answer.values = []
        return answer

    monkeypatch.setattr(asking.ServiceClient, "ask", forgetful)
    [line] = printed(capsys, "param", command, "twin", "grid.voxel_size", status=2)
    assert line == "twin_node: error: /twin: expected an answer about each of 1 parameters, found 0"


def test_without_a_graph_nobody_can_be_asked(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    nowhere = ZenohParameters(endpoint=free_endpoint())
    monkeypatch.setattr(asking, "ZenohParameters", lambda: nowhere)
    [line] = printed(capsys, "lifecycle", "get", status=2)
    assert line.startswith(f"twin_node: error: expected a graph at {nowhere.endpoint}, found none there: start it")
