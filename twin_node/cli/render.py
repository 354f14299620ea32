"""`twin_node render`: a log as a film or a picture."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tqdm import tqdm

from twin_node.cli.arguments import add_arm, add_remap, arm_of, check_output, not_negative, rate, refuse_given, width
from twin_node.cli.playback import open_playback

if TYPE_CHECKING:
    from twin_node.nodes.export import ExportSpan

FILM = ".mp4"


def add_render(commands: Any) -> None:
    """Adds `render` to the subcommands."""
    render = commands.add_parser("render", help="make a film or a picture of a log")
    render.add_argument(
        "log", type=Path, nargs="+", metavar="LOG", help="the twin's log; also the one it was made from"
    )
    render.add_argument(
        "-o", "--output", type=Path, required=True, metavar="OUT", help="film (.mp4) or picture (.png, .jpg) to write"
    )
    render.add_argument(
        "--view",
        metavar="VIEW",
        help="beside (image, twin, error, forecast), cameras, forecast or orbit; default what the log allows",
    )
    render.add_argument("--camera", metavar="NAME", help="only this camera")
    render.add_argument("--at", type=not_negative, metavar="S", help="time of a picture (default 0)")
    render.add_argument("--start", type=not_negative, metavar="S", help="film: from here (default 0)")
    render.add_argument("--stop", type=not_negative, metavar="S", help="film: up to here (default the log's end)")
    render.add_argument("--rate", type=rate, metavar="HZ", help="film: pictures per second (default 30)")
    render.add_argument(
        "--width",
        type=width,
        default=480,
        metavar="PX",
        help="width of one camera's picture, as wide as its images at most (default 480)",
    )
    render.add_argument("--rig", type=Path, metavar="RIG.yaml", help="calibration, instead of the log's own")
    add_remap(render)
    add_arm(render)
    render.set_defaults(run=_render)


def _render(options: argparse.Namespace) -> None:
    from twin_node.nodes.film import PICTURES, Film, write_film, write_picture

    check_output(options.output, FILM, *PICTURES)
    is_film = options.output.suffix == FILM
    span, arm = _span_of(options, is_film), arm_of(options).arm()
    with open_playback(options.log, options.width, options.rig, remaps=options.remap) as playback:
        view = options.view or ("beside" if playback.cameras else "orbit")
        film = Film(playback, view, options.width, arm, options.camera)
        stamps = span.stamps(playback.start_ns, playback.end_ns)
        if not is_film:
            write_picture(film.picture(playback.at(stamps[0])), options.output)
        else:

            def pictures() -> Iterator[Any]:
                for stamp in tqdm(stamps, unit="picture", desc="render", disable=None):
                    yield film.picture(playback.at(stamp))

            write_film(pictures(), span.rate_hz, options.output)
    print(f"{options.output}: {len(stamps)} picture{'s' if len(stamps) > 1 else ''}, {view}")


def _span_of(options: argparse.Namespace, is_film: bool) -> ExportSpan:
    """The times to draw. Raises `TwinError` for options of a film with a picture, and the other way round."""
    from twin_node.nodes.export import ExportSpan

    if not is_film:
        refuse_given(options, ("start", "stop", "rate"), "expected with a film (.mp4); a picture has one time, --at")
        return ExportSpan.one(options.at or 0.0)
    refuse_given(options, ("at",), "expected with a picture (.png or .jpg); a film goes from --start to --stop")
    return ExportSpan(options.start or 0.0, options.stop, options.rate or 30.0)
