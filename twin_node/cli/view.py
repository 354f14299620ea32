"""`twin_node view`: a log in the browser."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from twin_node.cli.arguments import not_negative, whole, width


def add_view(commands: Any) -> None:
    """Adds `view` to the subcommands."""
    view = commands.add_parser("view", help="look at a log in the browser")
    view.add_argument("log", type=Path, nargs="+", metavar="LOG", help="the twin's log; also the one it was made from")
    view.add_argument("--rig", type=Path, metavar="RIG.yaml", help="calibration, instead of the log's own")
    view.add_argument("--arm", default="ur10e", metavar="ARM", help="arm of the joints in the log (default ur10e)")
    view.add_argument("--width", type=width, default=320, metavar="PX", help="width of the images (default 320)")
    view.add_argument("--at", type=not_negative, default=0.0, metavar="S", help="begin so many seconds into the log")
    view.add_argument("--host", default="127.0.0.1", help="address to listen on (default: this machine only)")
    view.add_argument("--port", type=whole, default=8080, help="port to listen on (default 8080)")
    view.set_defaults(run=_view)


def _view(options: argparse.Namespace) -> None:
    from twin_node.nodes.playback import Playback
    from twin_node.nodes.viewer import CellPage, LogViewer
    from twin_node.robot import arm_model

    arm = arm_model(options.arm)
    with Playback(options.log, options.width, options.rig) as playback:
        page = CellPage(arm, playback.cameras, options.host, options.port)
        viewer = LogViewer(playback, page)
        viewer.seek(options.at)
        if not playback.has_twin:
            print(f"{playback.name}: no /twin topics; add the log that 'twin_node replay LOG -o FILE' writes")
        print(f"{page.url} (Ctrl-C ends)", flush=True)
        try:
            viewer.run()
        finally:
            page.close()
