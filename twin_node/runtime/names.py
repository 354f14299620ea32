"""Names on the graph of what nodes of a namespace know by names of their own."""

from __future__ import annotations

import re

ROOT = "/"
"""The namespace of all that has no other."""
OF_ALL = frozenset({"/clock", "/parameter_events", "/rosout"})
"""Topics that a graph has once, whatever namespaces its nodes are in."""
_NAMESPACE = re.compile(r"/|(/[A-Za-z_][A-Za-z0-9_]*)+")


def is_namespace(text: str) -> bool:
    """Whether a text is `/`, or a slash and a name of letters, digits and underscores, once or several times."""
    return _NAMESPACE.fullmatch(text) is not None


def full_name(node: str, namespace: str = ROOT) -> str:
    """A node's name with its namespace: `/cell/twin`, or `/twin` in that of all."""
    return f"{namespace.rstrip('/')}/{node}"


def within(namespace: str, topic: str) -> str:
    """The name on the graph of a topic that nodes of a namespace know by an absolute one of their own."""
    return topic if topic in OF_ALL else f"{namespace.rstrip('/')}{topic}"


def without(namespace: str, topic: str) -> str | None:
    """The name that nodes of a namespace have for a topic of the graph; None: it is none of theirs."""
    if topic in OF_ALL:
        return topic
    own = topic.removeprefix(namespace.rstrip("/"))
    return own if within(namespace, own) == topic and own.startswith("/") else None
