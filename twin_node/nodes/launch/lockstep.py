"""A launch in lockstep: the graph's nodes in one thread, as `twin_node replay --lockstep` runs them."""

from __future__ import annotations

import threading
from collections.abc import Callable, Collection
from pathlib import Path

from twin_node.nodes.calibration import load_base_rig
from twin_node.nodes.chain_parameters import chain_parameters
from twin_node.nodes.live.player import PlayParameters
from twin_node.nodes.live.recorder import RecordParameters
from twin_node.nodes.live.rig_source import RigParameters
from twin_node.nodes.log_source import LogSession
from twin_node.nodes.replay import replay
from twin_node.nodes.topics import RECORDED, GraphError, parse_remaps
from twin_node.runtime.parameters import EVERY_NODE, Sections, fill, values_of


def run_in_lockstep(sections: Sections, where: str, stop: threading.Event, say: Callable[[str], None]) -> None:
    """Replays the player's log through the chain into the recorder's output; `stop` ends it with nothing written.

    `say(line)` tells the user what of the log is doubtful, or was not to be had.

    Raises `GraphError` for what the player and the recorder are asked for and cannot do in lockstep.
    """
    player = fill(PlayParameters, values_of(PlayParameters, "player", sections), f"{where}: player")
    if not player.log:
        raise GraphError(f"{where}: player: expected 'log', the file or folder to play; give log:=LOG")
    _refuse(player, ("rate", "loop", "topics", "start_paused"), f"{where}: player")
    recorder = fill(RecordParameters, values_of(RecordParameters, "recorder", sections), f"{where}: recorder")
    _refuse(recorder, ("all", "split", "compression"), f"{where}: recorder")
    rig = fill(RigParameters, sections.get(EVERY_NODE, {}).get("rig", {}), f"{where}: {EVERY_NODE}: rig")
    _refuse_other_cameras(rig, player.log, f"{where}: {EVERY_NODE}: rig")
    output = recorder.output
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
        for line in session.doubts:
            say(line)
        _check_recorded(recorder.topics, {*RECORDED, *session.topics.values()}, where)
        parameters = chain_parameters(sections, where)
        to, topics = Path(output) if output else None, recorder.topics
        with replay(session, parameters, rate=None, output=to, progress=check, recorded=topics) as run:
            for line in (*([run.damage] if run.damage else []), *run.missed(session)):
                say(line)
            print(f"{player.log}: {run.sets} sets in lockstep, in {run.seconds:.1f} s", flush=True)


def _refuse(parameters: object, names: Collection[str], where: str) -> None:
    """Raises `GraphError` for a parameter that is not as by default, and would have no effect."""
    usual = type(parameters)()
    for name in names:
        if getattr(parameters, name) != getattr(usual, name):
            raise GraphError(
                f"{where}: {name}: expected none in lockstep, where all is dealt with in turn and once, found one; "
                "leave it out"
            )


def _refuse_other_cameras(rig: RigParameters, log: str, where: str) -> None:
    """Raises `GraphError` for a rig that is neither the played log's own nor a file's."""
    is_other_log = bool(rig.log) and Path(rig.log).resolve() != Path(log).resolve()
    if rig.scenario or is_other_log:
        raise GraphError(
            f"{where}: expected a rig file, or the log that is played, in lockstep, whose images these are, found "
            f"{rig.scenario or rig.log}; leave it out"
        )


def _check_recorded(topics: Collection[str], heard: Collection[str], where: str) -> None:
    for topic in topics:
        if topic not in heard:
            raise GraphError(
                f"{where}: recorder: topics: expected some of {', '.join(sorted(heard))}, which are all in lockstep, "
                f"found {topic!r}; take it out"
            )
