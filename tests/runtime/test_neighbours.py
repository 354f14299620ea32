"""Names of nodes on a router of the test's own, claimed by what takes itself for launches."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import pytest

from twin_node.bench.graph_run import free_endpoint
from twin_node.nodes.topics import SEPARATION, kind_of_own
from twin_node.runtime import neighbours
from twin_node.runtime.neighbours import NodeNames
from twin_node.runtime.rmw_zenoh import NodeIdentity, node_token
from twin_node.runtime.zenoh_session import ZenohParameters, open_router, open_session
from twin_node.runtime.zenoh_wire import ZenohWire

pytest.importorskip("zenoh")


@pytest.fixture(scope="module")
def network() -> Iterator[ZenohParameters]:
    """A network on which a recorder is."""
    parameters = ZenohParameters(router="builtin", endpoint=free_endpoint(), domain=0)
    router = open_router(parameters)
    assert router is not None
    with contextlib.closing(router), contextlib.closing(ZenohWire(parameters)) as wire:
        wire.subscribe("recorder", SEPARATION, kind_of_own(SEPARATION), lambda _: None)
        yield parameters


@pytest.fixture(autouse=True)
def looks_briefly(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(neighbours, "TELL_S", 0.6)


def test_of_two_launches_that_begin_at_once_one_gets_the_names(network: ZenohParameters) -> None:
    """Before any of their nodes is there to be seen, and whatever else they begin."""
    have_claimed = threading.Barrier(2)

    def begin(other: str) -> str | None:
        names = NodeNames(network, ["twin", other])
        have_claimed.wait()
        taken = names.taken()
        if taken is not None:
            names.close()
        return taken

    with ThreadPoolExecutor() as pool:
        assert sorted(map(str, pool.map(begin, ("arm", "page")))) == ["None", "twin"]


def test_names_that_are_claimed_or_alive_are_taken_until_their_owner_ends(network: ZenohParameters) -> None:
    with NodeNames(network, ["twin"]) as first:
        assert first.taken() is None
        with NodeNames(network, ["twin"]) as second, NodeNames(network, ["arm"]) as other:
            assert second.taken() == "twin"
            assert other.taken() is None
    with NodeNames(network, ["twin"]) as again, NodeNames(network, ["recorder"]) as alive:
        assert again.taken() is None
        assert alive.taken() == "recorder"


def test_a_node_of_that_name_in_a_namespace_is_another_one(network: ZenohParameters) -> None:
    """An arm of another program's, `/line/arm`, kept launches from beginning."""
    with contextlib.closing(open_session(network)) as session, NodeNames(network, ["arm"]) as names:
        tokens = [session.liveliness().declare_token(node_token(NodeIdentity("a1", 0, "arm", "/line")))]
        assert names.taken() is None
        tokens.append(session.liveliness().declare_token(node_token(NodeIdentity("a1", 1, "arm"))))
        until = time.monotonic() + 20.0
        while names.taken() is None and time.monotonic() < until:
            time.sleep(0.01)
        assert names.taken() == "arm"


def test_launches_of_two_namespaces_have_nodes_of_the_same_names(network: ZenohParameters) -> None:
    cell = replace(network, namespace="/cell")
    with NodeNames(network, ["twin"]) as first, NodeNames(cell, ["twin", "recorder"]) as other:
        assert first.taken() is None
        assert other.taken() is None, "the recorder that is alive is not of this namespace"
        with NodeNames(cell, ["twin"]) as third:
            assert third.taken() == "twin"
            until = time.monotonic() + 20.0
            while third.claimed() is None and time.monotonic() < until:
                time.sleep(0.01)
            assert third.claimed() == "twin"
    with contextlib.closing(ZenohWire(cell)) as wire, NodeNames(cell, ["arm"]) as names:
        wire.subscribe("arm", SEPARATION, kind_of_own(SEPARATION), lambda _: None)
        until = time.monotonic() + 20.0
        while names.taken() is None and time.monotonic() < until:
            time.sleep(0.01)
        assert names.taken() == "arm"


def test_a_name_is_free_as_soon_as_the_node_that_had_it_ends(network: ZenohParameters) -> None:
    """Who begins a node again at once is not told that it is there still: what ended is seen for a moment more."""
    ending = ZenohWire(network)
    ending.subscribe("page", SEPARATION, kind_of_own(SEPARATION), lambda _: None)
    with NodeNames(network, ["page"]) as names:
        ends = threading.Timer(0.1, ending.close)
        ends.start()
        assert names.taken() is None
        ends.join()


def test_who_is_on_a_network_that_is_joined_later_is_heard_of(network: ZenohParameters) -> None:
    """Of two twins on machines whose link was slow, or came later, both went on: two arms, two speeds."""
    endpoint = free_endpoint()
    router = open_router(ZenohParameters(router="builtin", endpoint=endpoint, routers=(network.endpoint,), domain=0))
    assert router is not None
    elsewhere = ZenohParameters(router="external", endpoint=endpoint, domain=0)
    with contextlib.closing(router), NodeNames(elsewhere, ["late", "arm"]) as names, NodeNames(network, ["late"]):
        until = time.monotonic() + 20.0
        while names.claimed() is None and time.monotonic() < until:
            time.sleep(0.01)
        assert names.claimed() == "late"
