"""The command `twin_node`: one function per subcommand; wrong input becomes one line and exit status 2."""

from __future__ import annotations

import argparse
import json
import math
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import yaml
from tqdm import tqdm

from twin_node import __version__
from twin_node.errors import TwinError


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; returns the exit status: 0 done, 2 wrong input, 130 interrupted."""
    options = _parser().parse_args(arguments)
    try:
        options.run(options)
    except TwinError as error:
        print(f"twin_node: error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("twin_node: interrupted", file=sys.stderr)
        return 130
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="twin_node", description="A live 4D Gaussian twin of a robot cell.")
    parser.add_argument("--version", action="version", version=f"twin_node {__version__}")
    commands = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")
    _add_replay(commands)
    _add_import(commands)
    _add_demo(commands)
    _add_bench(commands)
    return parser


def _add_replay(commands: Any) -> None:
    replay = commands.add_parser("replay", help="run the twin on a recorded log")
    replay.add_argument("log", type=Path, metavar="LOG", help="MCAP file or rosbag2 folder")
    replay.add_argument("-o", "--output", type=Path, metavar="OUT.mcap", help="write the /twin topics here")
    replay.add_argument("--report", type=Path, metavar="DIR", help="write report.json and report.html here")
    pace = replay.add_mutually_exclusive_group()
    pace.add_argument("--rate", type=_positive, default=1.0, metavar="R", help="speed of the clock (default 1)")
    pace.add_argument("--lockstep", action="store_true", help="every set in turn, repeatable to the byte")
    _add_source_options(replay)
    replay.add_argument("--params", type=Path, metavar="FILE.yaml", help="ROS parameter file")
    replay.set_defaults(run=_replay)


def _add_source_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--start-offset", type=_not_negative, default=0.0, metavar="S", help="skip the first S seconds")
    parser.add_argument("--duration", type=_positive, metavar="S", help="stop after S seconds of the log")
    parser.add_argument("--max-rate", type=_positive, metavar="HZ", help="take at most so many image sets per second")
    parser.add_argument("--width", type=_width, metavar="PX", help="working width of the images")
    parser.add_argument("--rig", type=Path, metavar="RIG.yaml", help="calibration, instead of the log's own")
    parser.add_argument("--remap", action="append", default=[], metavar="A:=B", help="read topic A as B; repeatable")


def _add_import(commands: Any) -> None:
    importers = commands.add_parser("import", help="turn foreign recordings into logs")
    kinds = importers.add_subparsers(required=True, metavar="KIND")
    video = kinds.add_parser("video", help="calibrated videos, as a rig file names them")
    video.add_argument("rig", type=Path, metavar="RIG.yaml", help="rig file: calibration/README.md documents it")
    video.add_argument("-o", "--output", type=Path, required=True, metavar="LOG.mcap")
    video.set_defaults(run=_import_video)


def _add_demo(commands: Any) -> None:
    demo = commands.add_parser("demo", help="make a log of a simulated cell and replay it")
    demo.add_argument("--out", type=Path, default=Path("out/demo"), metavar="DIR", help="folder for log and report")
    demo.set_defaults(run=_demo)


def _add_bench(commands: Any) -> None:
    benches = commands.add_parser("bench", help="measure").add_subparsers(required=True, metavar="WHAT")
    occupancy = benches.add_parser("occupancy", help="score a log's forecasts, beside the baselines")
    occupancy.add_argument("log", type=Path, metavar="LOG")
    occupancy.add_argument("--markers", type=Path, metavar="FILE.trc", help="reference markers as truth")
    occupancy.add_argument("--hue", type=int, metavar="H", help="truth: pixels of this OpenCV hue (orange 8)")
    occupancy.add_argument("--json", action="store_true", help="print one JSON object")
    _add_source_options(occupancy)
    occupancy.set_defaults(run=_bench_occupancy)
    raster = benches.add_parser("raster", help="speed of the rasteriser's backends")
    raster.add_argument("--json", action="store_true", help="print one JSON object")
    raster.set_defaults(run=_bench_raster)


def _import_video(options: argparse.Namespace) -> None:
    from twin_node.bag.import_video import VideoCamera, import_video
    from twin_node.rig import load_rig
    from twin_node.rig.stamps import read_stamps

    rig_file = load_rig(options.rig)
    cameras = [
        VideoCamera(camera, source.video, None if source.stamps is None else read_stamps(source.stamps), source.fps)
        for camera, source in zip(rig_file.rig.cameras, rig_file.videos(), strict=True)
    ]
    with tqdm(unit="frame", desc="import", disable=None) as bar:

        def show(done: int, total: int) -> None:
            bar.total = total
            bar.update(done - bar.n)

        imported = import_video(cameras, options.output, show, workspace=rig_file.rig.workspace)
    for warning in imported.warnings:
        print(f"twin_node: warning: {warning}", file=sys.stderr)
    print(f"{options.output}: {sum(imported.frames)} images of {len(cameras)} cameras")


def _replay(options: argparse.Namespace) -> None:
    from twin_node.nodes.chain import load_parameters
    from twin_node.nodes.topics import parse_remaps

    parameters = _with_source_options(load_parameters(options.params), options)
    _check_output(options.output, options.log)
    session = _open_session(options, parse_remaps(options.remap))
    _run(session, parameters, None if options.lockstep else options.rate, options.output, options.report)


def _demo(options: argparse.Namespace) -> None:
    from twin_node.cell import load_scenario, write_log
    from twin_node.nodes.chain import load_parameters
    from twin_node.nodes.log_source import LogSession

    options.out.mkdir(parents=True, exist_ok=True)
    log = options.out / "demo.mcap"
    with tqdm(unit="image", desc="simulate", disable=None) as bar:

        def show(done: int, total: int) -> None:
            bar.total = total
            bar.update(done - bar.n)

        write_log(load_scenario("demo"), log, show)
    parameters = load_parameters(Path("launch/demo.yaml"))
    _run(LogSession(log), parameters, 1.0, options.out / "twin.mcap", options.out / "report")


def _run(session: Any, parameters: Any, rate: float | None, output: Path | None, report: Path | None) -> None:
    """Replay a session with a progress bar, then write its report, and say where everything is."""
    from twin_node.nodes.chain import make_model
    from twin_node.nodes.replay import replay
    from twin_node.nodes.report import STEPS, write_report

    with session, tqdm(total=round(session.span.seconds, 2), unit="s", desc="replay", disable=None) as bar:

        def show(seconds: float) -> None:
            bar.update(min(seconds, session.span.seconds) - bar.n)

        with replay(session, parameters, rate, output, report is not None, show) as run:
            bar.close()
            if run.damage:
                print(f"twin_node: warning: {run.damage}", file=sys.stderr)
            print(f"{session.log.path}: {run.sets} sets, {run.dropped} dropped, in {run.seconds:.1f} s")
            if output is not None:
                print(f"topics: {output}")
            if report is not None:
                with tqdm(total=STEPS, desc="report", unit="step", disable=None) as steps:
                    write_report(run, session, lambda: make_model(parameters), report, steps.update)
                print(f"report: {report / 'report.html'}")


def _open_session(options: argparse.Namespace, remaps: dict[str, str]) -> Any:
    from twin_node.nodes.log_source import LogSession

    return LogSession(options.log, options.rig, remaps, options.start_offset, options.duration)


def _with_source_options(parameters: Any, options: argparse.Namespace) -> Any:
    """Chain parameters with the command line's width and rate in place of the file's."""
    given = {"width": options.width, "max_rate_hz": options.max_rate}
    changed = {name: value for name, value in given.items() if value is not None}
    return replace(parameters, synchronizer=replace(parameters.synchronizer, **changed))


def _check_output(output: Path | None, log: Path) -> None:
    if output is not None and output.resolve() == log.resolve():
        raise TwinError(f"-o {output}: expected another file than the log that is read; choose a new name")


def _bench_occupancy(options: argparse.Namespace) -> None:
    from twin_node.bench.occupancy import OccupancyBenchParameters, run
    from twin_node.bench.truth import ColourOf
    from twin_node.nodes.log_source import DEFAULT_WIDTH
    from twin_node.nodes.topics import parse_remaps

    parameters = OccupancyBenchParameters(
        width=options.width or DEFAULT_WIDTH,
        max_rate_hz=options.max_rate,
        rig=options.rig,
        remaps=parse_remaps(options.remap),
        start_offset_s=options.start_offset,
        duration_s=options.duration,
    )
    colour = None if options.hue is None else ColourOf(options.hue)
    bench = run(options.log, options.markers, colour, parameters, lambda sets: tqdm(sets, unit="set", disable=None))
    figures = bench.as_json()
    print(json.dumps(figures) if options.json else yaml.safe_dump(figures, sort_keys=False).rstrip())


def _bench_raster(options: argparse.Namespace) -> None:
    from twin_node.bench import raster

    report = raster.run()
    print(json.dumps(report) if options.json else raster.table(report))


def _positive(text: str) -> float:
    value = _number(text)
    if value <= 0:
        raise argparse.ArgumentTypeError(f"{text}: expected a number above 0")
    return value


def _not_negative(text: str) -> float:
    value = _number(text)
    if value < 0:
        raise argparse.ArgumentTypeError(f"{text}: expected 0 or more")
    return value


def _width(text: str) -> int:
    value = _number(text)
    if value != int(value) or value < 16:
        raise argparse.ArgumentTypeError(f"{text}: expected a whole number of pixels, 16 or more")
    return int(value)


def _number(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text}: expected a number") from None
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{text}: expected a finite number")
    return value
