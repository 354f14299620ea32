"""Who is on the network before a graph joins it."""

from __future__ import annotations

import time
from typing import Any

from twin_node.runtime.rmw_zenoh import ADMIN_SPACE, node_of_token
from twin_node.runtime.zenoh_session import WireError, ZenohParameters, open_session

CONNECT_S = 2.0
"""How long a router on this host may take to answer, s; it takes milliseconds."""
LOOK_S = 0.05
TELL_S = 1.0
"""How long a router may take to tell a new session of the nodes that it knows, s; without any, so long is waited."""


def node_names(parameters: ZenohParameters) -> frozenset[str]:
    """Nodes of the domain that are alive, as the router at `parameters.endpoint` knows them.

    Raises `WireError` where no router answers: something else listens there, or nothing can.
    """
    session = open_session(parameters)
    try:
        until = time.monotonic() + CONNECT_S
        while not session.info.routers_zid():
            if time.monotonic() > until:
                raise WireError(
                    f"{parameters.endpoint}: expected a zenoh router there, or a place where one can be started, found "
                    "neither: what listens is no zenoh router, or the address is wrong; end it, or correct the address "
                    "(launch: zenoh: {endpoint})"
                )
            time.sleep(LOOK_S)
        until = time.monotonic() + TELL_S
        while not (names := _alive(session, parameters.domain_id)) and time.monotonic() < until:
            time.sleep(LOOK_S)
        return names
    finally:
        session.close()


def _alive(session: Any, domain: int) -> frozenset[str]:
    replies = session.liveliness().get(f"{ADMIN_SPACE}/{domain}/**")
    tokens = [str(reply.ok.key_expr) for reply in replies if reply.ok is not None]
    return frozenset(name for token in tokens if (name := node_of_token(token)) is not None)
