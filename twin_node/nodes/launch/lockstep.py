"""A launch in lockstep: the graph's nodes in one thread, as `twin_node replay --lockstep` runs them."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from twin_node.nodes.calibration import load_base_rig
from twin_node.nodes.chain_parameters import ChainParameters, sized
from twin_node.nodes.launch.kinds import CHAIN_SECTIONS
from twin_node.nodes.live.player import PlayParameters
from twin_node.nodes.live.rig_source import RigParameters
from twin_node.nodes.log_source import LogSession
from twin_node.nodes.replay import replay
from twin_node.nodes.topics import GraphError, parse_remaps
from twin_node.runtime.parameters import EVERY_NODE, fill


def run_in_lockstep(sections: Mapping[str, Mapping[str, Any]], where: str, stop: threading.Event) -> None:
    """Replays the player's log through the chain into the recorder's output; `stop` ends it with nothing written."""
    player = fill(PlayParameters, sections.get("player", {}), f"{where}: player")
    rig = fill(RigParameters, sections.get(EVERY_NODE, {}).get("rig", {}), f"{where}: {EVERY_NODE}: rig")
    chain = {name: sections[name] for name in CHAIN_SECTIONS if name in sections}
    output = sections.get("recorder", {}).get("output", "")
    if output and Path(output).resolve() == Path(player.log).resolve():
        raise GraphError(f"{where}: recorder: output: expected another file than the log that is played, {output}")
    if rig.file:
        load_base_rig(Path(rig.file))
    session = LogSession(
        Path(player.log),
        Path(rig.file) if rig.file else None,
        parse_remaps(list(player.remap)),
        player.start_offset,
        player.playback_duration or None,
    )

    def check(_: float) -> None:
        if stop.is_set():
            raise GraphError(f"{where}: stopped before the log's end; nothing was written")

    with session:
        parameters = sized(fill(ChainParameters, chain, where), where)
        with replay(session, parameters, None, Path(output) if output else None, False, check) as run:
            print(f"{player.log}: {run.sets} sets in lockstep, in {run.seconds:.1f} s", flush=True)
