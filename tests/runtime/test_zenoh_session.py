"""Where routers listen."""

from __future__ import annotations

import contextlib
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from twin_node.bench.graph_run import free_endpoint
from twin_node.runtime import zenoh_session
from twin_node.runtime.zenoh_session import WireError, ZenohParameters, open_client, open_router
from twin_node.runtime.zenoh_wire import ZenohWire

pytest.importorskip("zenoh")


@pytest.fixture
def usual(monkeypatch: pytest.MonkeyPatch) -> ZenohParameters:
    """Where commands look for a router that are told nothing, at an address of the test's own."""
    endpoint = free_endpoint()
    monkeypatch.setattr(zenoh_session, "ROUTER_ENDPOINT", endpoint)
    return ZenohParameters(router="builtin", endpoint=endpoint, domain=0)


def of_network() -> ZenohParameters:
    return ZenohParameters(router="builtin", endpoint=free_endpoint().replace("127.0.0.1", "0.0.0.0"), domain=0)


def test_a_graph_that_is_open_to_the_network_is_found_by_the_commands_of_its_machine(usual: ZenohParameters) -> None:
    """`record`, `play` and `doctor` beside a launch of two_machines.yaml were alone, each with a router of its own."""
    router = open_router(of_network())
    assert router is not None
    with contextlib.closing(router), contextlib.closing(open_client(usual)) as command:
        assert command.info.routers_zid() == [router.info.zid()]


def test_it_leaves_that_place_to_a_router_that_has_it(usual: ZenohParameters) -> None:
    first = open_router(usual)
    assert first is not None
    with contextlib.closing(first):
        router = open_router(of_network())
        assert router is not None
        with contextlib.closing(router), contextlib.closing(open_client(usual)) as command:
            assert command.info.routers_zid() == [first.info.zid()]


def test_a_graph_does_without_shared_memory_where_there_is_none(
    usual: ZenohParameters, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """In a read-only container zenoh opened neither, and the address of the router was said to be wrong."""
    asked = []
    monkeypatch.setattr(zenoh_session, "_open", asked.append)
    for folder in (tmp_path, tmp_path / "missing"):
        monkeypatch.setattr(zenoh_session, "SHARED_MEMORY", folder)
        open_router(usual)
        zenoh_session.open_session(usual)
    found = [config.get_json("transport/shared_memory/enabled") for config in asked]
    assert found == ["true", "true", "false", "false"]


def test_what_the_environment_sets_counts_as_for_other_ros_nodes(
    usual: ZenohParameters, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A twin beside nodes that were led to another machine's router by it looked for one on its own machine."""
    there = ZenohParameters(router="builtin", endpoint=free_endpoint(), domain=0)
    router = open_router(there)
    assert router is not None
    with contextlib.closing(router):
        monkeypatch.setenv("ZENOH_CONFIG_OVERRIDE", f'mode="client"; connect/endpoints=["{there.endpoint}"];')
        for opened in (open_client(usual), zenoh_session.open_session(usual), open_router(usual)):
            assert opened is not None
            with contextlib.closing(opened):
                assert opened.info.routers_zid() == [router.info.zid()]
    with pytest.raises(WireError, match=r"^ZENOH_CONFIG_OVERRIDE: expected a zenoh router there"):
        open_client(usual)


@pytest.mark.parametrize("odd", ["mode", "no/such/key=1", "connect/endpoints=tcp/10.0.0.2:7447"])
def test_what_zenoh_does_not_know_is_named(usual: ZenohParameters, monkeypatch: pytest.MonkeyPatch, odd: str) -> None:
    monkeypatch.setenv("ZENOH_CONFIG_OVERRIDE", f'mode="peer";{odd}')
    for opens in (zenoh_session.open_session, open_router):
        with pytest.raises(WireError, match=f"^ZENOH_CONFIG_OVERRIDE: expected keys.*, found {odd} "):
            opens(usual)


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost"])
def test_one_on_loopback_listens_where_it_is_told_alone(usual: ZenohParameters, host: str) -> None:
    elsewhere = ZenohParameters(router="builtin", endpoint=free_endpoint().replace("127.0.0.1", host), domain=0)
    router = open_router(elsewhere)
    assert router is not None
    with contextlib.closing(router), pytest.raises(WireError, match="expected a zenoh router there"):
        open_client(usual)


@pytest.mark.parametrize(
    "address", ["tcp/10.0.0.2", "tcp/twin:", "tcp/:7447", "tls/twin:99999", "tcp/fd00::2:7447", "tcp/[fd00::2]"]
)
def test_an_address_without_a_port_is_refused(address: str) -> None:
    """zenoh takes it and tries it for ever: a launch said that it was active, and reached nobody."""
    for given in ({"endpoint": address}, {"routers": ("", address)}):
        with pytest.raises(WireError, match=r"expected a host and a port \(1 to 65535\).*; correct the address"):
            ZenohParameters(**given)


def test_addresses_of_every_protocol_are_taken() -> None:
    one = "tls/twin.local:7447?iface=eth0#so_rcvbuf=65000"
    ZenohParameters(endpoint=one, routers=("tcp/[fe80::1%eth0]:7447", "unixsock-stream//tmp/router"))


def test_why_no_router_is_reached_is_told_without_places_in_zenoh_s_source(usual: ZenohParameters) -> None:
    with pytest.raises(WireError, match=r"found neither \(Unable to connect to any of \[[^]]*\]\): what") as told:
        open_client(usual)
    assert ".rs" not in str(told.value)


ATTEMPTS, JOINING_S = 20, 60.0
HANGING = """
import sys, time
from twin_node.runtime.zenoh_session import ZenohParameters, open_session
session = open_session(ZenohParameters(endpoint=sys.argv[1]))
print("joined", flush=True)
time.sleep(600)
"""


def test_a_session_ends_though_one_hangs_that_it_is_joining(
    usual: ZenohParameters, monkeypatch: pytest.MonkeyPatch
) -> None:
    """zenoh's own close waited for ten seconds, and failed: a command that had done all it should ended in a trace."""
    monkeypatch.setenv(zenoh_session.OVERRIDE_VARIABLE, "transport/unicast/open_timeout=60000")  # as rmw_zenoh has it
    router = open_router(usual)
    assert router is not None
    with contextlib.closing(router):
        hanging = subprocess.Popen([sys.executable, "-c", HANGING, usual.endpoint], stdout=subprocess.PIPE)
        try:
            assert hanging.stdout is not None
            hanging.stdout.readline()
            until = time.monotonic() + JOINING_S
            while not router.info.peers_zid() and time.monotonic() < until:
                time.sleep(0.01)
            hanging.send_signal(signal.SIGSTOP)
            for _ in range(ATTEMPTS):  # on a busy machine one may be closed before it is told whom to join
                ZenohWire(usual).close()
                if any(thread.name == "end of a session" for thread in threading.enumerate()):
                    return
            raise AssertionError("no session was joining the one that hangs")
        finally:
            hanging.kill()
            hanging.wait()


ENDING = """
import sys
from twin_node.runtime import zenoh_session
zenoh_session.CLOSING_S = 0.0
router = zenoh_session.open_router(zenoh_session.ZenohParameters(router="builtin", endpoint=sys.argv[1], domain=0))
zenoh_session.close_session(router)
"""


def test_a_program_that_ends_while_a_session_does_has_its_own_exit_status() -> None:
    """On a busy machine, and beside somebody who hangs, it aborted once it had done all it should."""
    ended = subprocess.run([sys.executable, "-c", ENDING, free_endpoint()], capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stderr) == (0, "")
