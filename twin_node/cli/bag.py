"""`twin_node record` and `twin_node play`: logs of a live graph, under the flags of `ros2 bag`."""

from __future__ import annotations

import argparse
import os
import sys
import threading
import time
from pathlib import Path
from typing import Any

from twin_node.cli.arguments import add_log, add_namespace, not_negative, positive, speed, whole
from twin_node.cli.keyboard import lines


def add_record(commands: Any) -> None:
    """Adds `record` to the subcommands."""
    record = commands.add_parser(
        "record",
        help="record topics of a live graph",
        description="Record until Ctrl-C. What was written can be read however the recorder's process ends.",
    )
    record.add_argument("topics", nargs="*", metavar="TOPIC", help="topics to record (default: what a twin publishes)")
    record.add_argument("-a", "--all", action="store_true", help="all topics, also those that come later")
    record.add_argument("-o", "--output", type=Path, metavar="OUT", help="new .mcap file or folder")
    record.add_argument(
        "-b", "--max-bag-size", type=not_negative, default=0.0, metavar="BYTES", help="begin a new file at this size"
    )
    record.add_argument(
        "-d", "--max-bag-duration", type=not_negative, default=0.0, metavar="S", help="begin a new file after this time"
    )
    record.add_argument(
        "--compression",
        choices=("none", "zstd", "lz4"),
        default="none",
        help="of the file's chunks; zstd makes what a twin says a quarter, for a twentieth of a core (default none)",
    )
    add_namespace(record, "record the topics of this namespace, under their names within it")
    record.set_defaults(run=_record)


def add_play(commands: Any) -> None:
    """Adds `play` to the subcommands."""
    play = commands.add_parser(
        "play",
        help="play a log to a live graph",
        description="Play a log under the flags of `ros2 bag play`. Enter pauses and goes on.",
    )
    add_log(play)
    play.add_argument("-r", "--rate", type=speed, default=1.0, metavar="R", help="speed of the clock (default 1)")
    play.add_argument("-l", "--loop", action="store_true", help="again and again; time jumps back each time")
    play.add_argument(
        "--start-offset",
        type=not_negative,
        default=0.0,
        metavar="S",
        help="skip the first S seconds; what latched topics had said by then is sent first",
    )
    play.add_argument(
        "--playback-duration", type=not_negative, default=0.0, metavar="S", help="stop after S seconds of the log"
    )
    play.add_argument(
        "--delay", type=not_negative, default=0.5, metavar="S", help="wait before the first message (default 0.5)"
    )
    play.add_argument(
        "--clock",
        type=positive,
        nargs="?",
        const=40.0,
        default=0.0,
        metavar="HZ",
        help="publish /clock, at HZ (40 if none is given)",
    )
    play.add_argument("--topics", nargs="+", default=[], metavar="TOPIC", help="play only these")
    play.add_argument("-m", "--remap", nargs="+", default=[], metavar="FROM:=TO", help="publish topic FROM as TO")
    play.add_argument("-p", "--start-paused", action="store_true", help="wait for Enter before the first message")
    play.add_argument(
        "--read-ahead-queue-size",
        type=whole,
        default=1000,
        metavar="N",
        help="messages read ahead, of 256 MiB together at most (default 1000)",
    )
    add_namespace(play, "publish in this namespace")
    play.set_defaults(run=_play)


def _record(options: argparse.Namespace) -> None:
    from twin_node.bag import BagError
    from twin_node.nodes.live.single import run_single

    if options.all and options.topics:
        given = ", ".join(options.topics)
        raise BagError(f"--all: expected instead of topics, found {given} too; leave one of the two out")
    output = options.output or Path(f"rosbag2_{time.strftime('%Y_%m_%d-%H_%M_%S')}")
    if os.path.lexists(output):
        raise BagError(f"{output}: exists already; remove it or choose another name")
    parameters: dict[str, Any] = {
        "output": str(output),
        "all": options.all,
        "ends_when_refused": True,
        "tells": True,
        "compression": options.compression,
        "split": {"max_size_mb": options.max_bag_size / 1e6, "max_duration_s": options.max_bag_duration},
    }
    if options.topics:
        parameters["topics"] = [topic if topic.startswith("/") else f"/{topic}" for topic in options.topics]
    run_single("recorder", parameters, "record", namespace=options.namespace)


def _play(options: argparse.Namespace) -> None:
    from twin_node.errors import TwinError
    from twin_node.nodes.live.single import run_single

    if options.start_paused and not sys.stdin.isatty():
        raise TwinError("--start-paused: expected a terminal in which Enter lets time run; leave it out")
    names = ("rate", "loop", "start_offset", "playback_duration", "delay", "clock", "topics", "remap", "start_paused")
    parameters = {name: getattr(options, name) for name in (*names, "read_ahead_queue_size")}

    def listen(node: Any) -> None:
        threading.Thread(target=_toggle_pause, args=(node,), name="keyboard", daemon=True).start()

    wanted = {"log": str(options.log), **parameters}
    keyboard = listen if sys.stdin.isatty() else None
    run_single("player", wanted, "play", keyboard, namespace=options.namespace)


def _toggle_pause(player: Any) -> None:
    for _ in lines():
        player.pause(not player.is_paused)
        print("paused" if player.is_paused else "playing", flush=True)
