"""`twin_node launch`: the graph of a launch file, in processes."""

from __future__ import annotations

import argparse
import itertools
import signal
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from twin_node.cli.arguments import add_namespace, add_params_file

if TYPE_CHECKING:
    from twin_node.nodes.launch.launch_file import LaunchPlan

LOGS = Path("out/log")
"""Where each launch has a folder for its logs, unless told."""


def add_launch(commands: Any) -> None:
    """Adds `launch` to the subcommands."""
    parser = commands.add_parser(
        "launch",
        help="start the processes of a launch file",
        description="Start the nodes of a launch file, each process by itself; Ctrl-C deactivates and cleans up. "
        "Exit status: 0 done or interrupted, 2 wrong input, 10 + N: process N of the file (from 0) was given up.",
    )
    parser.add_argument("file", type=Path, metavar="FILE.yaml", help="launch file, for example launch/replay.yaml")
    parser.add_argument(
        "arguments", nargs="*", metavar="NAME:=VALUE", help="arguments of the file; --show-args lists them"
    )
    parser.add_argument(
        "-p", "--param", action="append", default=[], metavar="NODE.KEY:=VALUE", help="set a parameter; repeatable"
    )
    add_params_file(parser)
    parser.add_argument(
        "-r", "--remap", action="append", default=[], metavar="FROM:=TO", help="rename a topic of all nodes; repeatable"
    )
    add_namespace(parser, "put all nodes and their topics into a namespace, as -r __ns:=/NAME does")
    parser.add_argument("-s", "--show-args", action="store_true", help="list the file's arguments and end")
    parser.add_argument("--one-process", action="store_true", help="all nodes in one process, a thread each")
    parser.add_argument(
        "--log-dir", type=Path, metavar="DIR", help="folder for the logs of the processes (default out/log/TIME-NAME)"
    )
    parser.set_defaults(run=_launch)


def _launch(options: argparse.Namespace) -> int | None:
    from twin_node.nodes.launch.launch_file import read_arguments

    if options.show_args:
        for argument in read_arguments(options.file):
            default = "required" if argument.is_required else f"default: {argument.default!r}"
            print(f"{argument.name}:=  {argument.told} ({default})")
        return None
    from twin_node.nodes.launch.launch_file import NAMESPACE, in_one_process, read_launch_file, remapped

    plan = read_launch_file(options.file, options.arguments, options.param, options.params_file)
    given = [] if options.namespace is None else [f"{NAMESPACE}:={options.namespace}"]
    plan = remapped(plan, [*options.remap, *given])
    return _run(in_one_process(plan) if options.one_process else plan, options.log_dir)


def launch(file: Path, arguments: Sequence[str], parameter_files: Sequence[Path] = ()) -> int | None:
    """Runs a launch file's graph until it ends or is interrupted; returns the exit status.

    `parameter_files`: win over the launch file's values.
    """
    from twin_node.nodes.launch.launch_file import read_launch_file

    return _run(read_launch_file(file, arguments, (), parameter_files), None)


def _run(plan: LaunchPlan, log_dir: Path | None) -> int | None:
    from twin_node.nodes.launch.launcher import Launcher

    folder = log_dir or _folder_of_its_own(plan.path.stem)
    print(f"logs: {folder}", flush=True)
    launcher = Launcher(plan, folder, lambda line: print(line, flush=True))
    hangs_up = signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN  # as with nohup
    for interrupting in (signal.SIGINT, signal.SIGTERM, *([signal.SIGHUP] if hangs_up else [])):
        signal.signal(interrupting, lambda *_: launcher.interrupt())
    result = launcher.run()
    if result.failed is not None:
        print(f"twin_node: error: process '{result.failed}' {result.error}; see {folder}", file=sys.stderr)
    return result.status


def _folder_of_its_own(name: str) -> Path:
    """Where the processes' logs go: launches that begin in the same second, in two domains, would mix theirs up."""
    first = folder = LOGS / f"{time.strftime('%Y%m%d-%H%M%S')}-{name}"
    for number in itertools.count(2):
        try:
            folder.mkdir(parents=True)
        except FileExistsError:
            folder = first.with_name(f"{first.name}-{number}")
        except OSError:  # which the launcher refuses
            break
        else:
            break
    return folder
