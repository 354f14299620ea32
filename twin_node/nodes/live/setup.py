"""What a live node is given to be made of."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from twin_node.errors import told
from twin_node.nodes.live.rig_source import RigParameters
from twin_node.runtime.clock import Clock
from twin_node.runtime.executor import Timers
from twin_node.runtime.names import ROOT
from twin_node.runtime.parameter_values import Parameter, named_parameters
from twin_node.runtime.parameters import EVERY_NODE, ParameterError, Sections, fill, merged, values_of
from twin_node.runtime.rmw_zenoh import Endpoint
from twin_node.runtime.wire_bus import WireBus

if TYPE_CHECKING:
    from twin_node.nodes.chain_parameters import ChainParameters

T = TypeVar("T")


def _print(line: str) -> None:
    print(line, flush=True)


@dataclass(frozen=True)
class Setup:
    """A node's surroundings."""

    name: str
    bus: WireBus
    clock: Clock
    timers: Timers
    sections: Sections
    where: str
    """What errors about parameters name: the launch file, or the command."""
    finish: Callable[[], None]
    """The node calls this when it has nothing more to do."""
    endpoints: Callable[[], tuple[Endpoint, ...]]
    """What nodes of the whole graph send, hear, serve and ask, as far as it is known by now."""
    say: Callable[[str], None] = _print
    """Tells the user something, in a line."""
    kept: Path | None = None
    """Folder in which a node leaves what the node of another process has to know that takes its place in this launch;
    None: none does."""
    is_ending: Callable[[], bool] = lambda: False
    """Whether the node is to end as soon as what it does now is done."""
    namespace: str = ROOT
    """That of the node."""
    taken: dict[str, Any] = field(default_factory=dict)
    """What the node has read of its parameters, as dataclasses: its own section without a name, others by theirs."""

    def parameters(self, kind: type[T], section: str | None = None) -> T:
        """The dataclass `kind` filled from the node's section and, for keys that it has, from `/**`.

        Raises `ParameterError` for an unknown key of the node's own section, with the nearest known one.
        """
        name = self.name if section is None else section
        filled = fill(kind, values_of(kind, name, self.sections), f"{self.where}: {name}")
        if name == self.name:
            self.taken[""] = filled
        return filled

    def read(self, follows_clock: bool) -> dict[str, Parameter]:
        """By name, the parameters that the node has read so far, and `use_sim_time`: what others are told of it."""
        return named_parameters(self.taken, follows_clock)

    def rig(self) -> RigParameters:
        """Where the rig is, as `/**` says in `rig`: all nodes of a graph work with the same.

        The topics of a log that the graph's player plays have the names that it gives them. Raises `ParameterError` for
        what is no `RigParameters`.
        """
        shared = self.sections.get(EVERY_NODE, {})
        where, given = f"{self.where}: {EVERY_NODE}: rig", shared.get("rig", {})
        if not isinstance(given, Mapping):
            wanted = "keys and values such as {file: my_rig.yaml}"
            raise ParameterError(f"{where}: expected {wanted}, found {told(given)}")
        played = merged(shared, self.sections.get("player", {}))
        if given.get("log") and given["log"] == played.get("log"):
            given = {"remap": played.get("remap", ()), **given}
        rig = fill(RigParameters, given, where)
        self.taken["rig"] = rig
        return rig

    def chain_parameters(self, *own: str) -> ChainParameters:
        """The parameters of the chain's nodes; `own`: sections that are this node's, beside the one of its name."""
        from twin_node.nodes.chain_parameters import chain_parameters  # much to load where no node of it runs

        chain = chain_parameters(self.sections, self.where)
        if hasattr(chain, self.name):
            self.taken[""] = getattr(chain, self.name)
        self.taken.update({name: getattr(chain, name) for name in own})
        return chain
