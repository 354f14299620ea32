"""What the launcher tells a process of a launch to do."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from twin_node.runtime.parameters import Sections


@dataclass(frozen=True)
class Order:
    """What a process is to do."""

    nodes: tuple[str, ...]
    sections: Sections
    follows_clock: bool
    is_lockstep: bool
    zenoh: Mapping[str, Any]
    remaps: Mapping[str, str]
    """The nodes' own names of topics -> those on the wire."""
    where: str
    """What errors about parameters name."""
    kept: str = ""
    """Folder of what the launch's processes leave to those that take their places; empty: there is none."""
    niceness: int = 0
    """How far it gives way to others; see `ProcessPlan`."""

    def to_json(self) -> str:
        """One line."""
        return json.dumps(dataclasses.asdict(self))
