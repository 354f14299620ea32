"""`twin_node replay` and `twin_node demo`: the twin on a log, recorded or made."""

from __future__ import annotations

import argparse
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tqdm import tqdm

from twin_node.cli.arguments import (
    add_log,
    add_source_options,
    in_the_way,
    port,
    positive,
    refuse_given,
    refuse_same,
    speed,
    with_source_options,
)
from twin_node.cli.output import warn
from twin_node.cli.progress import counted
from twin_node.cli.view import view_log
from twin_node.errors import TwinError, several
from twin_node.unfinished import refuse_taken

if TYPE_CHECKING:
    from twin_node.nodes.chain_parameters import ChainParameters
    from twin_node.nodes.log_source import LogSession

PORT = 8080


def add_replay(commands: Any) -> None:
    """Adds `replay` to the subcommands."""
    replay = commands.add_parser("replay", help="run the twin on a recorded log")
    add_log(replay)
    replay.add_argument("-o", "--output", type=Path, metavar="OUT.mcap", help="write the /twin topics here")
    replay.add_argument("--report", type=Path, metavar="DIR", help="write report.json and report.html here")
    pace = replay.add_mutually_exclusive_group()
    pace.add_argument("--rate", type=speed, default=1.0, metavar="R", help="speed of the clock (default 1)")
    pace.add_argument("--lockstep", action="store_true", help="take every image set in turn; repeatable to the byte")
    size = replay.add_mutually_exclusive_group()
    size.add_argument(
        "--budget-ms", type=positive, metavar="MS", help="the largest size whose sets take at most MS here"
    )
    size.add_argument("--target", type=positive, metavar="DB", help="the fastest size that reaches DB on moving pixels")
    add_source_options(replay)
    replay.set_defaults(run=_replay)


def add_demo(commands: Any) -> None:
    """Adds `demo` to the subcommands."""
    demo = commands.add_parser("demo", help="make a log of a simulated cell and replay it")
    demo.add_argument(
        "--out",
        type=Path,
        default=Path("out/demo"),
        metavar="DIR",
        help="folder for log and report (default %(default)s)",
    )
    demo.add_argument("--viewer", action="store_true", help="afterwards show the run in the browser, until Ctrl-C")
    demo.add_argument("--port", type=port, metavar="PORT", help=f"with --viewer: its port (default {PORT})")
    demo.set_defaults(run=_demo)


def _replay(options: argparse.Namespace) -> None:
    from twin_node.nodes.chain_parameters import load_parameters
    from twin_node.nodes.topics import parse_remaps

    parameters = with_source_options(load_parameters(options.params), options)
    if options.output is not None:
        refuse_same(options.output, options.log)
    _check_report(options.report, options.output)
    _check_size(options)
    session = _open_session(options, parse_remaps(options.remap))
    session.warn(session.doubts)
    if options.budget_ms is not None or options.target is not None:
        parameters = _sized(session, parameters, options)
    _run(session, parameters, None if options.lockstep else options.rate, options.output, options.report)


def _demo(options: argparse.Namespace) -> None:
    from twin_node.cell import load_scenario, write_log
    from twin_node.nodes.chain_parameters import load_parameters
    from twin_node.nodes.log_source import LogSession

    if not options.viewer:
        refuse_given(options, ("port",), "expected with --viewer, whose port it is; add it")
    chosen_port = options.port or PORT
    has_viser = find_spec("viser") is not None
    if options.viewer and has_viser:
        from twin_node.nodes.viewer import LOOPBACK, check_address

        check_address(LOOPBACK, chosen_port)  # a port that is taken is told now, not after the run
    try:
        options.out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise TwinError(f"--out {options.out}: cannot be made ({error.strerror}); choose another folder") from None
    log = options.out / "demo.mcap"
    with counted("simulate", "image") as show:
        write_log(load_scenario("demo"), log, show)
    parameters = load_parameters(Path("launch/demo.yaml"))
    twin = options.out / "twin.mcap"
    _run(LogSession(log), parameters, 1.0, twin, options.out / "report")
    if not has_viser:
        print("viewer: expected the package viser; install it with pip install 'twin-node[viewer]'")
    elif options.viewer:
        view_log([twin, log], parameters.arm, port=chosen_port)
    else:
        print(f"viewer: twin_node view {twin} {log} --arm {parameters.arm.model}")


def _run(
    session: LogSession, parameters: ChainParameters, rate: float | None, output: Path | None, report: Path | None
) -> None:
    """Replay a session with a progress bar, then write its report, and say where everything is."""
    from twin_node.nodes.replay import replay

    if report is not None:
        from twin_node.nodes.report import STEPS, write_report

    with session, tqdm(total=round(session.span.seconds, 2), unit="s", desc="replay", disable=None) as bar:

        def show(seconds: float) -> None:
            bar.update(min(seconds, session.span.seconds) - bar.n)

        with replay(session, parameters, rate=rate, output=output, keep_ticks=report is not None, progress=show) as run:
            bar.close()
            if run.damage:
                warn(run.damage)
            strayed = run.collector.drift[-1].warnings if run.collector.drift else ()
            warn(*run.missed(session), *strayed)
            told = f"{several(run.sets, 'set')} ({run.followed} followed by the model), {run.dropped} dropped"
            print(f"{session.log.path}: {told}, in {run.seconds:.1f} s")
            if output is not None:
                print(f"topics: {output}")
            if report is not None:
                with tqdm(total=STEPS, desc="report", unit="step", disable=None) as steps:
                    write_report(run, session, report, steps.update)
                print(f"report: {report / 'report.html'}")


def _open_session(options: argparse.Namespace, remaps: dict[str, str]) -> LogSession:
    from twin_node.nodes.calibration import load_base_rig
    from twin_node.nodes.log_source import LogSession

    if options.rig is not None:
        load_base_rig(options.rig)
    return LogSession(options.log, options.rig, remaps, options.start_offset or 0.0, options.duration)


def _check_size(options: argparse.Namespace) -> None:
    """A size says how wide the images are; one that was measured is not the same in every run."""
    if options.budget_ms is not None and options.lockstep:
        raise TwinError("--budget-ms with --lockstep: what is measured differs between runs; use --target, or --params")
    if options.width is not None and (options.budget_ms is not None or options.target is not None):
        raise TwinError("--width with --budget-ms or --target: a size has a width of its own; leave one of them out")


def _sized(session: LogSession, parameters: ChainParameters, options: argparse.Namespace) -> ChainParameters:
    """The parameters at the size that is asked for, which is said."""
    from twin_node.nodes.chain_parameters import at_size
    from twin_node.nodes.size_choice import by_budget, by_target

    choice = (
        by_target(options.target) if options.target is not None else by_budget(session, parameters, options.budget_ms)
    )
    print(f"twin_node: {choice.reason}", file=sys.stderr)
    return at_size(parameters, choice.size)


def _check_report(folder: Path | None, output: Path | None) -> None:
    """Refuses before the run what cannot be written after it; the folder is made only then."""
    if folder is not None and output is not None and folder.resolve() == output.resolve():
        raise TwinError(f"--report {folder}: expected another place than that of -o; give another folder")
    there = None if folder is None else in_the_way(folder)
    if there is not None:
        raise TwinError(f"--report {folder}: expected a folder, or a place to make one, found {there}; give another")
    if folder is not None:
        from twin_node.nodes.report import FILES

        for name in FILES:
            refuse_taken(folder / name, TwinError)
