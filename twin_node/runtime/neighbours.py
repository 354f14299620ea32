"""Who is on the network before a graph joins it, and the names that the graph takes there."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any, Self

from twin_node.runtime.rmw_zenoh import ADMIN_SPACE, node_of_token
from twin_node.runtime.zenoh_session import WireError, ZenohParameters, open_session

CLAIM_SPACE = "@twin_node"
"""First part of a token that says: this launch is about to begin a node of that name, or has done so."""
CONNECT_S = 2.0
"""How long a router on this host may take to answer, s; it takes milliseconds."""
LOOK_S = 0.05
TELL_S = 1.0
"""How long routers may take to tell a new session of what they know, s; without any news, so long is waited."""


class NodeNames:
    """The names of a graph's nodes in its domain, claimed for as long as this is open.

    Nodes take seconds to load before anybody sees them: of two launches that begin at once, claims tell.
    """

    def __init__(self, parameters: ZenohParameters, nodes: Sequence[str]) -> None:
        """Claims the names. Raises `WireError` where no router answers: something else listens there, or nothing can."""
        self._parameters = parameters
        self._nodes = frozenset(nodes)
        self._session = open_session(parameters)
        try:
            _await_router(self._session, parameters.endpoint)
            self._id = str(self._session.info.zid())
            space = f"{CLAIM_SPACE}/{parameters.domain_id}/{self._id}"
            # Before anybody looks: of two that do so at once, at least the later one sees the other.
            self._tokens = [self._session.liveliness().declare_token(f"{space}/{node}") for node in sorted(self._nodes)]
        except BaseException:
            self._session.close()
            raise

    def taken(self) -> str | None:
        """One of the names that a node has which is alive, or that another launch claims; None: all are free.

        Of two launches that claim it at once, the one whose session has the lower number gets it.
        """
        until = time.monotonic() + TELL_S
        while True:
            alive, claims = self._alive(), self._claims()
            wanted = {name: by for by, name in claims if name in self._nodes}
            if alive & self._nodes or any(by < self._id for by in wanted.values()):
                return min({*wanted, *(alive & self._nodes)})
            is_told = bool(alive or claims) and not any(self._parameters.routers)  # of others' nodes it takes longer
            if (is_told and not wanted) or time.monotonic() > until:
                return min(wanted, default=None)
            time.sleep(LOOK_S)

    def close(self) -> None:
        """Gives the names up."""
        self._session.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _alive(self) -> frozenset[str]:
        tokens = _tokens(self._session, f"{ADMIN_SPACE}/{self._parameters.domain_id}/**")
        return frozenset(name for token in tokens if (name := node_of_token(token)) is not None)

    def _claims(self) -> frozenset[tuple[str, str]]:
        """Of other launches: number of the session, and name."""
        tokens = _tokens(self._session, f"{CLAIM_SPACE}/{self._parameters.domain_id}/*/*")
        return frozenset((by, name) for _, _, by, name in (token.split("/") for token in tokens) if by != self._id)


def _await_router(session: Any, endpoint: str) -> None:
    until = time.monotonic() + CONNECT_S
    while not session.info.routers_zid():
        if time.monotonic() > until:
            raise WireError(
                f"{endpoint}: expected a zenoh router there, or a place where one can be started, found neither: what "
                "listens is no zenoh router, or the address is wrong; end it, or correct the address "
                "(launch: zenoh: {endpoint})"
            )
        time.sleep(LOOK_S)


def _tokens(session: Any, pattern: str) -> list[str]:
    return [str(reply.ok.key_expr) for reply in session.liveliness().get(pattern) if reply.ok is not None]
