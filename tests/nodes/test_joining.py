"""What a launch says of the routers of other machines."""

from __future__ import annotations

import contextlib
import time
from types import SimpleNamespace

import pytest

from twin_node.bench.graph_run import free_endpoint
from twin_node.nodes.launch.joining import PATIENCE_S, SETTLES_S, Joining
from twin_node.runtime.zenoh_session import ZenohParameters, open_router

ADDRESS = "tcp/10.0.0.2:7447"


def told(joining: Joining, is_joined: bool, now: float) -> str | None:
    return joining.news(SimpleNamespace(info=SimpleNamespace(routers_zid=lambda: ["b"] if is_joined else [])), now)


def test_a_router_that_never_answers_is_told_once_and_that_it_is_joined_later() -> None:
    """A launch with a wrong address, or behind a firewall, said that it was active, and nothing else."""
    joining = Joining(("", ADDRESS))
    assert told(joining, False, 10.0) is None and told(joining, False, 10.0 + PATIENCE_S / 2) is None
    line = told(joining, False, 10.1 + PATIENCE_S)
    assert line is not None and line.startswith(f"{ADDRESS}: no router answers there, so nothing comes")
    assert told(joining, False, 60.0) is None
    assert told(joining, True, 61.0) == f"{ADDRESS}: joined"
    assert told(joining, True, 62.0) is None


def test_a_link_that_is_cut_is_told_and_one_that_is_there_from_the_start_is_not() -> None:
    joining = Joining((ADDRESS,))
    assert told(joining, True, 0.0) is None
    line = told(joining, False, 1.0)
    assert line is not None and "no router answers there any more" in line
    assert told(joining, True, 2.0) == f"{ADDRESS}: joined"


def test_it_is_fresh_for_a_while_after_it_was_first_joined() -> None:
    joining = Joining((ADDRESS,))
    told(joining, False, 0.0)
    assert not joining.is_fresh(0.0)
    told(joining, True, 50.0)
    assert joining.is_fresh(50.0) and joining.is_fresh(50.0 + SETTLES_S) and not joining.is_fresh(50.1 + SETTLES_S)
    told(joining, False, 100.0)
    told(joining, True, 101.0)
    assert not joining.is_fresh(101.0)  # who is there has seen it before


def test_a_launch_of_one_machine_waits_for_nobody() -> None:
    assert told(Joining(("",)), False, 0.0) is None and told(Joining(()), False, 100.0) is None


def test_a_router_is_known_to_have_joined_another() -> None:
    pytest.importorskip("zenoh")
    here, there = (ZenohParameters(router="builtin", endpoint=free_endpoint(), domain=0) for _ in range(2))
    first = open_router(there)
    second = open_router(ZenohParameters(router="builtin", endpoint=here.endpoint, routers=(there.endpoint,), domain=0))
    assert first is not None and second is not None
    joining = Joining((there.endpoint,))
    with contextlib.closing(second):
        with contextlib.closing(first):
            until = time.monotonic() + 10.0
            while not second.info.routers_zid() and time.monotonic() < until:
                time.sleep(0.01)
            assert joining.news(second, 0.0) is None
        while (line := joining.news(second, 1.0)) is None and time.monotonic() < until + 10.0:
            time.sleep(0.01)
        assert line is not None and "any more" in line
