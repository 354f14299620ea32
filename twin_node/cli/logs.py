"""`twin_node info` and `twin_node check`: what a log holds, and what is wrong with it."""

from __future__ import annotations

import argparse
import dataclasses
import math
import sys
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

from tqdm import tqdm

from twin_node.cli.arguments import add_log
from twin_node.cli.output import add_json
from twin_node.errors import several
from twin_node.json_text import json_text


def add_info(commands: Any) -> None:
    """Adds `info` to the subcommands."""
    info = commands.add_parser("info", help="say what a log holds")
    add_log(info)
    add_json(info)
    info.set_defaults(run=_info)


def add_check(commands: Any) -> None:
    """Adds `check` to the subcommands."""
    check = commands.add_parser(
        "check",
        help="look a log over: gaps, jitter, skew, calibration, units",
        description="Read a whole log and name what would trouble the twin. Exit status: 0 sound, 1 something found. "
        "An unfinished or damaged log is read as far as it goes; --repair writes that as a log that is whole, "
        "and looks that over.",
    )
    add_log(check)
    add_json(check)
    check.add_argument(
        "--images", action="store_true", help="decode every image and count the damaged ones, not just look at some"
    )
    check.add_argument(
        "--repair", type=Path, metavar="OUT", help="write what can be read to a new .mcap file or folder"
    )
    check.set_defaults(run=_check)


def _info(options: argparse.Namespace) -> None:
    from twin_node.bag import open_log

    with open_log(options.log) as log:
        seconds = (log.end_ns - log.start_ns) / 1e9
        messages = sum(topic.count for topic in log.topics)
        if options.json:
            topics = [dataclasses.asdict(topic) for topic in log.topics]
            print(
                json_text(
                    {
                        "start_ns": log.start_ns,
                        "seconds": seconds,
                        "messages": messages,
                        "topics": topics,
                        "metadata": {k: dict(v) for k, v in log.metadata.items()},
                        "left_out": log.left_out,
                        "damage": log.damage,
                    }
                )
            )
            return
        start = datetime.fromtimestamp(log.start_ns / 1e9, tz=UTC)
        print(f"{log.path}: {seconds:.2f} s from {start:%Y-%m-%d %H:%M:%S} UTC, {several(messages, 'message')}")
        width = max(len(topic.name) for topic in log.topics)
        for topic in log.topics:
            kept = ", latched" if topic.latched else ""
            print(f"  {topic.name:{width}}  {topic.count:7d}  {topic.msgtype}{kept}")
        for name in log.metadata:
            print(f"  metadata: {name}")
        for line in log.left_out:
            print(f"  not read: {line}")
        if log.damage:
            print(f"damage: {log.damage}")


def _check(options: argparse.Namespace) -> int:
    from twin_node.bag import open_log
    from twin_node.nodes.log_check import check_log

    if options.repair is not None:
        _repair(options.log, options.repair)
    with open_log(options.repair or options.log) as log:
        count = sum(topic.count for topic in log.topics)
        shown = partial(tqdm, total=count, unit="message", desc="check", disable=None)
        found = check_log(log, options.images, shown if options.images else iter)
    if options.json:
        print(json_text({"sound": found.is_sound, **dataclasses.asdict(found)}))
    else:
        width = max(len(topic.name) for topic in found.topics)
        for topic in found.topics:
            rate = f"{topic.statistics.rate_hz:8.2f} Hz" if math.isfinite(topic.statistics.rate_hz) else ""
            print(f"{topic.name:{width}}  {topic.statistics.count:7d}  {rate:>11}  {'; '.join(topic.faults) or 'ok'}")
        for fault in found.faults:
            print(f"found: {fault}")
        print("sound" if found.is_sound else "not sound: see above")
    return 0 if found.is_sound else 1


def _repair(source: Path, output: Path) -> None:
    """Tells on the error stream, so that `--json` stays one object."""
    from twin_node.bag.repair import repair

    found = repair(source, output)
    print(f"{output}: {several(found.messages, 'message')}; {found.damage or 'the log was whole'}", file=sys.stderr)
    for line in found.left_out:
        print(f"left out: {line}", file=sys.stderr)
