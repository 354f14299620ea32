"""`twin_node export`: what a log says, for other programs."""

from __future__ import annotations

import argparse
import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from twin_node.cli.arguments import add_arm, add_remap, arm_of, not_negative, rate, refuse_given
from twin_node.cli.playback import open_playback
from twin_node.cli.progress import counted
from twin_node.errors import TwinError


def add_export(commands: Any) -> None:
    """Adds `export` to the subcommands."""
    export = commands.add_parser("export", help="take a log or a trained model to other viewers and simulators")
    export.add_argument(
        "log", type=Path, nargs="+", metavar="LOG", help="the twin's log, and the one it was made from; or a checkpoint"
    )
    export.add_argument("--to", required=True, metavar="FORMAT", help="ply, spz, npz, mjcf, usd or csv")
    export.add_argument(
        "-o",
        "--output",
        type=Path,
        required=True,
        metavar="FILE",
        help="file to write; a folder for csv, and for ranges of ply and spz",
    )
    export.add_argument("--at", type=not_negative, metavar="S", help="one time, seconds after the log's start")
    export.add_argument("--start", type=not_negative, metavar="S", help="range: from here (default 0)")
    export.add_argument("--stop", type=not_negative, metavar="S", help="range: up to here (default the log's end)")
    export.add_argument("--rate", type=rate, metavar="HZ", help="range: moments per second (default 30)")
    add_remap(export)
    add_arm(export)
    export.set_defaults(run=_export)


def _export(options: argparse.Namespace) -> None:
    from twin_node.nodes.export import ExportSpan, export

    if options.at is not None:
        refuse_given(options, ("start", "stop", "rate"), "expected with a range; leave --at out, or them")
        span = ExportSpan.one(options.at)
    else:
        span = ExportSpan(options.start or 0.0, options.stop, options.rate or 30.0)
    arm = arm_of(options).arm()
    with _open(options.log, options.remap) as source, counted("export", "moment") as show:
        count = export(source, options.to, span, arm, options.output, show)
    print(f"{options.output}: {count} moment{'s' if count > 1 else ''}")


@contextlib.contextmanager
def _open(paths: list[Path], remaps: list[str]) -> Iterator[Any]:
    """The source that the paths name: a checkpoint alone, or the logs of a run."""
    from twin_node.model.sequence import SUFFIX
    from twin_node.nodes.export import LogSource
    from twin_node.nodes.export.checkpoint import CheckpointSource

    if len(paths) == 1 and paths[0].suffix == SUFFIX:
        if remaps:
            raise TwinError(f"--remap: expected with a log; {paths[0]} is a checkpoint, which has no topics")
        yield CheckpointSource(paths[0])
        return
    with open_playback(paths, with_images=False, remaps=remaps) as playback:
        yield LogSource(playback)
