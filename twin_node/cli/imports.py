"""`twin_node import`: foreign recordings, edited scenes and trained models become logs."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from twin_node.cli.output import warn
from twin_node.cli.progress import counted
from twin_node.errors import several


def add_import(commands: Any) -> None:
    """Adds `import` to the subcommands."""
    importers = commands.add_parser("import", help="turn foreign recordings, edited scenes and models into logs")
    kinds = importers.add_subparsers(required=True, metavar="KIND")
    video = kinds.add_parser("video", help="calibrated videos, as a rig file names them")
    video.add_argument("rig", type=Path, metavar="RIG.yaml", help="rig file: calibration/README.md documents it")
    video.add_argument("-o", "--output", type=Path, required=True, metavar="LOG.mcap", help="log to write")
    video.set_defaults(run=_import_video)
    ply = kinds.add_parser("ply", help="a scene of Gaussians in the 3DGS layout, edited elsewhere")
    ply.add_argument(
        "scene", type=Path, metavar="SCENE.ply", help="Gaussians in the 3DGS layout, also compressed, or SPZ"
    )
    ply.add_argument("-o", "--output", type=Path, required=True, metavar="LOG.mcap", help="log to write")
    ply.set_defaults(run=_import_ply)
    model = kinds.add_parser("model", help="what twin_node train or bake has written, at each of its times")
    model.add_argument("model", type=Path, metavar="MODEL.safetensors", help="checkpoint or baked model")
    model.add_argument("-o", "--output", type=Path, required=True, metavar="LOG.mcap", help="log to write")
    model.set_defaults(run=_import_model)


def _import_video(options: argparse.Namespace) -> None:
    from twin_node.bag.import_video import VideoCamera, import_video
    from twin_node.rig import load_rig
    from twin_node.rig.clock_kinds import SINCE_1970_NS, without_other_clocks
    from twin_node.rig.stamps import read_stamps

    rig_file = load_rig(options.rig)
    sources = rig_file.videos()
    stamps = [None if source.stamps is None else read_stamps(source.stamps) for source in sources]
    since_1970 = any(own is not None and own[0] >= SINCE_1970_NS for own in stamps)
    timed = without_other_clocks(rig_file.rig, since_1970)
    cameras = [
        VideoCamera(camera, source.video, own, source.fps)
        for camera, source, own in zip(timed.cameras, sources, stamps, strict=True)
    ]
    with counted("import", "frame") as show:
        imported = import_video(cameras, options.output, show, workspace=rig_file.rig.workspace)
    warn(*imported.warnings)
    print(f"{options.output}: {several(sum(imported.frames), 'image')} of {several(len(cameras), 'camera')}")


def _import_ply(options: argparse.Namespace) -> None:
    from twin_node.nodes.export.scene_log import import_ply

    print(f"{options.output}: {import_ply(options.scene, options.output)} Gaussians")


def _import_model(options: argparse.Namespace) -> None:
    from twin_node.nodes.export.scene_log import import_model

    count = import_model(options.model, options.output)
    print(f"{options.output}: {count} moment{'s' if count > 1 else ''}")
