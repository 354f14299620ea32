"""Opens zenoh sessions as rmw_zenoh does: peers that find each other through a router, on this host unless told."""

from __future__ import annotations

import atexit
import contextlib
import ipaddress
import json
import os
import re
import sys
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from twin_node.errors import TwinError
from twin_node.ranges import PORTS
from twin_node.runtime.names import ROOT, is_namespace
from twin_node.runtime.rmw_zenoh import HUMBLE_HASH

ROUTER_ENDPOINT = "tcp/127.0.0.1:7447"
"""Where rmw_zenoh looks for a router, on this host alone."""
SESSION_CONFIG_VARIABLE = "ZENOH_SESSION_CONFIG_URI"
ROUTER_CONFIG_VARIABLE = "ZENOH_ROUTER_CONFIG_URI"
"""Names of zenoh's own configuration files, as rmw_zenoh reads them."""
OVERRIDE_VARIABLE = "ZENOH_CONFIG_OVERRIDE"
"""Values in place of single ones of these files and of ours, as rmw_zenoh takes them: `key=value;key=value`."""
SHARED_MEMORY = "/dev/shm"
"""Where Linux has shared memory."""
CLOSING_S = 2.0
"""What a session may take to end: some milliseconds do, unless it is joining somebody who hangs."""
LATE_S = 3.0
"""What one may take longer on a busy machine, s; one that is joining somebody who hangs takes ten seconds in all."""
QUEUED_BATCHES = 16
"""Batches of 64 KiB that may wait on a session's link, zenoh's largest number (its default is 2): the images of three
cameras come at once, and a receiver that is busy for a moment on this host must not cost one of them."""
WITH_PORTS = ("tcp", "udp", "tls", "quic", "ws")
"""Protocols of zenoh whose addresses end in a port."""
_HOST_AND_PORT = re.compile(r"(\[[^]]+\]|[^][:]+):(?P<port>[0-9]+)")
"""An IPv6 address stands in brackets: without them its last part would be taken for the port."""
_SOURCE_PLACE = re.compile(r"[.!\s]*\bat \S+\.rs:\d+\.?")
DISTRIBUTION_VARIABLE = "ROS_DISTRO"
"""Set where a ROS 2 install has been sourced."""
DISTRIBUTIONS = ("humble", "jazzy", "kilted", "lyrical", "rolling")
"""Distributions of ROS 2 whose wire format is spoken."""


class WireError(TwinError):
    """The zenoh network cannot be opened, or is not configured as it must be."""


class NoRouterError(WireError):
    """No zenoh router answers where one is looked for."""


@dataclass(frozen=True)
class ZenohParameters:
    """How the graph reaches other processes."""

    router: str = "auto"
    """`builtin`: start a router; `external`: there is one; `auto`: start one unless its address is taken."""
    endpoint: str = ROUTER_ENDPOINT
    """The router's address; one that is not on this host opens the graph to the network."""
    routers: tuple[str, ...] = ()
    """Addresses of other machines' routers that the built-in one is joined to."""
    config: str = ""
    """zenoh's own configuration file (JSON5): TLS, access control. Empty: the environment's, else ours."""
    router_config: str = ""
    """The same for the built-in router."""
    domain: int | None = None
    """ROS domain; None: `ROS_DOMAIN_ID`, or 0."""
    namespace: str = ROOT
    """Of this process's nodes and of their topics; `/cell` has `/cell/twin` and `/cell/twin/obstacles`."""
    ros_distro: str | None = None
    """Whose wire format is spoken: humble knows no type hashes, all later ones do; None: that of `ROS_DISTRO`."""
    shared_memory: bool = True
    """Whether images go between processes of one host through shared memory, if there is any."""

    def __post_init__(self) -> None:
        if self.router not in ("auto", "builtin", "external"):
            raise WireError(f"zenoh router: expected auto, builtin or external, found '{self.router}'")
        if self.ros_distro not in (None, *DISTRIBUTIONS):
            raise WireError(f"ros_distro: expected one of {', '.join(DISTRIBUTIONS)}, found '{self.ros_distro}'")
        if not is_namespace(self.namespace):
            raise WireError(
                f"namespace: expected one such as /cell, of letters, digits and underscores, found '{self.namespace}'"
            )
        for endpoint in (self.endpoint, *filter(None, self.routers)):
            _check_port(endpoint)

    @property
    def speaks_hashes(self) -> bool:
        """Whether keys and tokens hold the hashes of types."""
        return (self.ros_distro or os.environ.get(DISTRIBUTION_VARIABLE)) != "humble"

    def spoken(self, type_hash: str) -> str:
        """What stands for a type's hash in keys and tokens."""
        return type_hash if self.speaks_hashes else HUMBLE_HASH

    @property
    def domain_id(self) -> int:
        """The ROS domain. Raises `WireError` where it, or `ROS_DOMAIN_ID` in its place, is no number from 0 to 232."""
        text, source = str(self.domain), "launch: zenoh: {domain}"
        if self.domain is None:
            text, source = os.environ.get("ROS_DOMAIN_ID") or "0", "ROS_DOMAIN_ID"
        if not text.isdecimal() or int(text) > 232:
            raise WireError(f"ROS domain: expected a number from 0 to 232, found '{text}'; correct {source}")
        return int(text)


def open_session(parameters: ZenohParameters) -> Any:
    """A peer's session. Raises `WireError` where zenoh is not installed or refuses its configuration."""
    return _open(_given_session_config(parameters))


def open_client(parameters: ZenohParameters) -> Any:
    """A session that speaks to the router alone, and is told at once all that the router knows.

    A peer misses some of that while it and others find each other. Raises `WireError` as `open_session`, and
    `NoRouterError` where no router answers.
    """
    config = _given_session_config(parameters)
    config.insert_json5("mode", json.dumps("client"))
    config.insert_json5("listen/endpoints", json.dumps([]))
    session, reason = None, ""
    try:
        session = _zenoh().open(config)
    except _zenoh().ZError as error:
        reason = f" ({_one_line(error)})"
    if session is None or not session.info.routers_zid():
        where = OVERRIDE_VARIABLE if os.environ.get(OVERRIDE_VARIABLE) else parameters.endpoint
        raise NoRouterError(
            f"{where}: expected a zenoh router there, or a place where one can be started, found "
            f"neither{reason}: what listens is no zenoh router, or the address is wrong; end it, or correct the "
            "address (launch: zenoh: {endpoint})"
        )
    return session


def open_router(parameters: ZenohParameters) -> Any | None:
    """The router's session; None where it is external, or `auto` finds its address taken.

    Raises `WireError` where a `builtin` one cannot listen.
    """
    if parameters.router == "external":
        return None
    path = parameters.router_config or os.environ.get(ROUTER_CONFIG_VARIABLE, "")
    config = _overridden(_from_file(path) if path else _router_config(parameters))
    try:
        return _open(config)
    except WireError:
        if parameters.router == "builtin":
            raise
        return None


def close_session(session: Any) -> None:
    """Ends a session, or a router: it waits no longer than `CLOSING_S`, and whatever comes of it is an end.

    zenoh waits with closing for as long as it is joining another session that it was told of, and fails after ten
    seconds: one that hangs, or ends meanwhile too, answers nothing. What is left open ends by itself; whoever else is
    joined sees that. (zenoh issue 2675.) The program's end waits for `LATE_S` more: where zenoh comes back to an
    interpreter that is going, the process aborts, whatever its exit status was to be.
    """

    def close() -> None:
        with contextlib.suppress(_zenoh().ZError):
            session.close()

    closing = threading.Thread(target=close, name="end of a session", daemon=True)
    closing.start()
    closing.join(CLOSING_S)
    if closing.is_alive():
        atexit.register(closing.join, LATE_S)


def _zenoh() -> Any:
    try:
        import zenoh
    except ImportError:
        raise WireError(
            "zenoh is not installed; it carries messages between processes: pip install 'twin-node[zenoh]'"
        ) from None
    return zenoh


def _open(config: Any) -> Any:
    zenoh = _zenoh()
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        raise WireError(f"zenoh: the session cannot be opened ({_one_line(error)}); check its endpoints") from None


def _given_session_config(parameters: ZenohParameters) -> Any:
    path = parameters.config or os.environ.get(SESSION_CONFIG_VARIABLE, "")
    return _overridden(_from_file(path) if path else _session_config(parameters))


def _from_file(path: str) -> Any:
    zenoh = _zenoh()
    try:
        return zenoh.Config.from_file(str(Path(path)))
    except zenoh.ZError as error:
        raise WireError(f"{path}: not a zenoh configuration ({_one_line(error)}); see zenoh's DEFAULT_CONFIG") from None


def _overridden(config: Any) -> Any:
    """A configuration with what the environment says in place of its own values."""
    for pair in filter(str.strip, os.environ.get(OVERRIDE_VARIABLE, "").split(";")):
        key, _, value = pair.partition("=")
        try:
            config.insert_json5(key.strip(), value)
        except _zenoh().ZError as error:
            raise WireError(
                f"{OVERRIDE_VARIABLE}: expected keys of zenoh's configuration and their values, as in "
                f'connect/endpoints=["{ROUTER_ENDPOINT}"];mode="client", found {pair.strip()} ({_one_line(error)})'
            ) from None
    return config


def _session_config(parameters: ZenohParameters) -> Any:
    return _config(
        {
            "mode": "peer",
            "connect/endpoints": [parameters.endpoint],
            "listen/endpoints": ["tcp/127.0.0.1:0"],
            "transport/shared_memory/enabled": parameters.shared_memory and _has_shared_memory(),
            "transport/link/tx/queue/size/data": QUEUED_BATCHES,
        }
    )


def _router_config(parameters: ZenohParameters) -> Any:
    """One that listens on an address of the network is found by the commands of its own machine, too.

    Where another router has that place already, it keeps it.
    """
    joined = [router for router in parameters.routers if router]
    own = [f"{ROUTER_ENDPOINT}#exit_on_failure=false"] if _is_of_network(parameters.endpoint) else []
    listened = [parameters.endpoint, *own]
    return _config(
        {
            "mode": "router",
            "listen/endpoints": listened,
            "connect/endpoints": joined,
            "transport/shared_memory/enabled": _has_shared_memory(),
        }
    )


def _has_shared_memory() -> bool:
    """Whether this machine gives any: where it does not, in containers, zenoh opens no session that is to use it."""
    return not sys.platform.startswith("linux") or os.access(SHARED_MEMORY, os.W_OK)


def _is_of_network(endpoint: str) -> bool:
    """Whether others than this host reach an address."""
    protocol, _, address = endpoint.partition("/")
    host = address.rpartition(":")[0].strip("[]")
    try:
        return protocol == "tcp" and not ipaddress.ip_address(host).is_loopback
    except ValueError:
        return protocol == "tcp" and host != "localhost"


def _check_port(endpoint: str) -> None:
    """Raises `WireError` where none stands, though the protocol has them: zenoh tries such an address for ever."""
    protocol, _, rest = endpoint.partition("/")
    found = _HOST_AND_PORT.fullmatch(re.split("[?#]", rest)[0])
    if protocol in WITH_PORTS and (found is None or not PORTS.holds(int(found["port"]))):
        raise WireError(
            f"zenoh: {endpoint}: expected a host and a port ({PORTS}), as in {ROUTER_ENDPOINT} or tcp/[fd00::1]:7447; "
            "correct the address"
        )


def _config(settings: dict[str, Any]) -> Any:
    """Multicast stays off, gossip on and samples stamped: as in rmw_zenoh's own default files."""
    zenoh = _zenoh()
    config = zenoh.Config()
    common = {"scouting/multicast/enabled": False, "scouting/gossip/enabled": True, "timestamping/enabled": True}
    for key, value in {**common, **settings}.items():
        try:
            config.insert_json5(key, json.dumps(value))
        except zenoh.ZError:
            raise WireError(
                f"zenoh {key}: expected addresses such as {ROUTER_ENDPOINT}, found {json.dumps(value)}; correct them"
            ) from None
    return config


def _one_line(error: BaseException) -> str:
    """What zenoh says, without the places in its source."""
    return _SOURCE_PLACE.sub("", " ".join(str(error).split()))
