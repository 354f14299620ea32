"""A zenoh router of the test's own, on a port of loopback that is free."""

from __future__ import annotations

import socket
from collections.abc import Iterator

import pytest

from twin_node.runtime.zenoh_session import ZenohParameters, open_router


@pytest.fixture
def zenoh_router() -> Iterator[ZenohParameters]:
    """Parameters that lead to a running router."""
    pytest.importorskip("zenoh")
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    parameters = ZenohParameters(router="builtin", endpoint=f"tcp/127.0.0.1:{port}", domain=0)
    router = open_router(parameters)
    assert router is not None
    yield parameters
    router.close()
