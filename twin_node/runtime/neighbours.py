"""Who is on the network before a graph joins it, and the names that the graph takes there."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import Any, Self

from twin_node.runtime.names import full_name
from twin_node.runtime.rmw_zenoh import ADMIN_SPACE, mangled, node_of_token
from twin_node.runtime.zenoh_session import ZenohParameters, close_session, open_client

CLAIM_SPACE = "@twin_node"
"""First part of a token that says: this launch is about to begin a node of that name, or has done so."""
LOOK_S = 0.05
TELL_S = 1.0
"""How long a graph looks for others, s: routers and sessions that have just begun do not know of all at once."""
LEAVE_SHARE = 0.5
"""After what share of `TELL_S` the later of two that claim a name leaves: well before the other has waited for it."""


class NodeNames:
    """The names of a graph's nodes in its domain, claimed for as long as this is open.

    Nodes take seconds to load before anybody sees them: of two launches that begin at once, claims tell.
    """

    def __init__(self, parameters: ZenohParameters, nodes: Sequence[str]) -> None:
        """Claims the names, in the namespace of `parameters`. Raises `WireError` where no router answers."""
        self._parameters = parameters
        self._full = {mangled(full_name(node, parameters.namespace)): node for node in nodes}
        """Names with their namespace, as tokens have them -> those without it."""
        self._session = open_client(parameters)
        self._id = str(self._session.info.zid())
        space = f"{CLAIM_SPACE}/{parameters.domain_id}/{self._id}"
        # Before anybody looks: of two that do so at once, at least the later one sees the other.
        self._tokens = [self._session.liveliness().declare_token(f"{space}/{node}") for node in sorted(self._full)]
        self._claims = _Claims(self._id, self._full)
        self._ear: Any | None = None

    def taken(self) -> str | None:
        """One of the names that a node has which is alive, or that another launch claims; None: all are free.

        Of two launches that claim it at once, the one whose session has the lower number gets it. Who has just ended
        is seen for a few looks more: only who stays has the name.
        """
        until = time.monotonic() + TELL_S
        since: dict[tuple[str, str], float] = {}
        while True:
            before, now = since, time.monotonic()
            since = {owner: before.get(owner, now) for owner in self._contested()}
            stay = [name for (by, name), seen in since.items() if now - seen >= self._patience_s(by)]
            if stay:
                return min(stay)
            if now > until and not before and not since:
                return None
            time.sleep(LOOK_S)

    def claimed(self) -> str | None:
        """One of the names that another launch claims, and not only for a moment; None: nobody does.

        It listens from the first call on and asks nobody, so that it can be called again and again: of another network,
        which is joined later than this has looked for who is alive, claims come by themselves.
        """
        if self._ear is None:
            everyone = f"{CLAIM_SPACE}/{self._parameters.domain_id}/*/*"
            self._ear = self._session.liveliness().declare_subscriber(everyone, self._claims, history=True)
        now = time.monotonic()
        names = [name for name, since in self._claims.since() if now - since >= TELL_S]
        return min(names, default=None)

    def close(self) -> None:
        """Gives the names up."""
        if self._ear is not None:
            self._ear.undeclare()
        close_session(self._session)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _patience_s(self, by: str) -> float:
        """How long to wait for another to give a name up that this claims too, s."""
        return LEAVE_SHARE * TELL_S if by < self._id else TELL_S

    def _contested(self) -> frozenset[tuple[str, str]]:
        """Who has one of the names, and which: the number of another launch's session, nothing where it is alive."""
        domain = self._parameters.domain_id
        alive = {node_of_token(token) for token in _tokens(self._session, f"{ADMIN_SPACE}/{domain}/**")}
        claimed = [token.split("/")[2:] for token in _tokens(self._session, f"{CLAIM_SPACE}/{domain}/*/*")]
        others = {(by, self._full[name]) for by, name in claimed if by != self._id and name in self._full}
        alive_here = {name for name in self._full.values() if full_name(name, self._parameters.namespace) in alive}
        return frozenset(others | {("", name) for name in alive_here})


class _Claims:
    """Hears, in zenoh's threads, who else claims names that a launch has."""

    def __init__(self, own: str, nodes: Mapping[str, str]) -> None:
        """`own`: the number of the launch's session; `nodes`: their names, by those that tokens have."""
        self._own = own
        self._nodes = nodes
        self._tokens: dict[str, float] = {}

    def __call__(self, sample: Any) -> None:
        import zenoh

        token = str(sample.key_expr)
        *_, by, name = token.split("/")
        if sample.kind == zenoh.SampleKind.DELETE:
            self._tokens.pop(token, None)
        elif by != self._own and name in self._nodes:
            self._tokens.setdefault(token, time.monotonic())

    def since(self) -> list[tuple[str, float]]:
        """Names that others claim now, and since when each was heard to be claimed, monotonic, s."""
        heard = tuple(self._tokens.items())
        return [(self._nodes[token.rpartition("/")[2]], since) for token, since in heard]


def _tokens(session: Any, pattern: str) -> list[str]:
    return [str(reply.ok.key_expr) for reply in session.liveliness().get(pattern) if reply.ok is not None]
