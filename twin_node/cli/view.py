"""`twin_node view`: a log, or the running graph, in the browser."""

from __future__ import annotations

import argparse
import contextlib
import signal
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any

from twin_node.cli.arguments import (
    add_arm,
    add_namespace,
    add_remap,
    arm_of,
    not_negative,
    port,
    refuse_given,
    width,
)
from twin_node.cli.ending import SIGNALS, ended_by
from twin_node.cli.playback import open_playback
from twin_node.errors import TwinError
from twin_node.ranges import within_s

if TYPE_CHECKING:
    from twin_node.nodes.arm_parameters import ArmParameters


def add_view(commands: Any) -> None:
    """Adds `view` to the subcommands."""
    view = commands.add_parser(
        "view",
        help="look at a log, or at the running graph, in the browser",
        description="Opens a page for any number of visitors, who all see the same time. With --live it joins the "
        "graph that runs on this machine, or behind --endpoint, and learns of its cameras from the graph itself.",
    )
    view.add_argument("log", type=Path, nargs="*", metavar="LOG", help="the twin's log; also the one it was made from")
    view.add_argument("--live", action="store_true", help="the running graph instead of a log")
    view.add_argument(
        "--endpoint", metavar="ADDRESS", help="with --live: the graph's router (default tcp/127.0.0.1:7447)"
    )
    add_namespace(view, "with --live: the twin of this namespace")
    view.add_argument("--rig", type=Path, metavar="RIG.yaml", help="calibration, instead of what log or graph say")
    add_remap(view)
    add_arm(view)
    view.add_argument("--width", type=width, metavar="PX", help="width of the images (default 320 of logs, 160 live)")
    view.add_argument("--at", type=not_negative, metavar="S", help="begin S seconds into the log (default 0)")
    view.add_argument(
        "--host", default="127.0.0.1", metavar="ADDRESS", help="address to listen on (default: this machine only)"
    )
    view.add_argument("--port", type=port, default=8080, metavar="PORT", help="port to listen on (default 8080)")
    view.set_defaults(run=_view)


def _view(options: argparse.Namespace) -> None:
    if options.live == bool(options.log):
        raise TwinError("view: expected a LOG, or --live for the running graph; give one of them")
    if options.live:
        refuse_given(options, ("at",), "expected with a LOG; the running graph has no other time than now")
        if options.remap:
            raise TwinError("--remap: expected with a LOG; a graph's topics are renamed where they are launched")
        _view_graph(options)
        return
    for name in ("endpoint", "namespace"):
        if getattr(options, name):
            raise TwinError(f"view: --{name} is for --live; leave it out to look at a log")
    view_log(
        options.log,
        arm_of(options),
        options.rig,
        options.width or 320,
        options.at or 0.0,
        options.host,
        options.port,
        options.remap,
    )


def view_log(
    logs: list[Path],
    arm: ArmParameters,
    rig: Path | None = None,
    images_px: int = 320,
    at_s: float = 0.0,
    host: str = "127.0.0.1",
    port: int = 8080,
    remaps: Sequence[str] = (),
) -> None:
    """Shows the logs of a run until interrupted; says where."""
    with _interrupts() as is_interrupted:
        from twin_node.nodes.viewer import CellPage, LogViewer

        model = arm.arm()
        with open_playback(logs, images_px, rig, remaps=remaps) as playback:
            length_s = (playback.end_ns - playback.start_ns) / 1e9
            if at_s > length_s:
                raise TwinError(f"--at {at_s:g}: expected a time inside the log's {within_s(length_s)}")
            page = CellPage(model, playback.cameras, host, port)
            viewer = LogViewer(playback, page)
            viewer.seek(at_s)
            if not playback.has_twin:
                print(f"{playback.name}: no /twin topics; add the log that 'twin_node replay LOG -o FILE' writes")
            print(f"{page.url} (Ctrl-C ends)", flush=True)
            try:
                viewer.run(is_interrupted)
            finally:
                page.close()


@contextlib.contextmanager
def _interrupts() -> Iterator[Callable[[], bool]]:
    """Tells whether there was a Ctrl-C or the like: what loads for seconds, some of it at the first picture, may
    swallow what that raised; it is raised again in the end."""
    came: list[int] = []

    def interrupt(number: int, frame: FrameType | None) -> None:
        came.append(number)
        handler = before[signal.Signals(number)]
        if callable(handler):
            handler(number, frame)

    before = {number: signal.getsignal(number) for number in (signal.SIGINT, *SIGNALS)}
    for number, handler in before.items():
        if callable(handler) or number is signal.SIGINT:
            signal.signal(number, interrupt)
    try:
        yield lambda: bool(came)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    if came:
        raise ended_by(came[0])


def _view_graph(options: argparse.Namespace) -> None:
    from twin_node.nodes.live.single import run_single
    from twin_node.runtime.zenoh_session import ZenohParameters

    parameters = {"host": options.host, "port": options.port, "rig_file": str(options.rig or "")}
    if options.width:
        parameters["width"] = options.width
    zenoh = ZenohParameters(endpoint=options.endpoint) if options.endpoint else None
    arm = {"arm": asdict(arm_of(options))}
    run_single("viewer", parameters, "view", None, zenoh, arm, follows_clock=True, namespace=options.namespace)
