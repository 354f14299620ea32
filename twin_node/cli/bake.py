"""`twin_node bake`: a model evaluated at its time steps into buffers that play at the rate of a static model."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tqdm import tqdm

from twin_node.cli.arguments import (
    add_source_options,
    check_output,
    refuse_given,
    refuse_same,
    whole,
    with_source_options,
)
from twin_node.cli.output import add_json
from twin_node.json_text import json_text

if TYPE_CHECKING:
    from twin_node.model.sequence import Baked
    from twin_node.scene import TwinState


def add_bake(commands: Any) -> None:
    """Adds `bake` to the subcommands."""
    bake = commands.add_parser("bake", help="evaluate a trained or live model into buffers for fast playback")
    bake.add_argument(
        "source", type=Path, metavar="CHECKPOINT|LOG", help="checkpoint of twin_node train, or a log to follow"
    )
    bake.add_argument("-o", "--output", type=Path, required=True, metavar="OUT.safetensors", help="buffers to write")
    bake.add_argument(
        "--steps",
        type=whole,
        metavar="N",
        help="bake N times, evenly over a checkpoint's span (default: as many as it has sets of images)",
    )
    bake.add_argument("--measure", action="store_true", help="compare speed and images with live evaluation")
    add_json(bake)
    add_source_options(bake)
    bake.set_defaults(run=_bake)


def _bake(options: argparse.Namespace) -> None:
    from twin_node.bench.methods.playback import measure
    from twin_node.errors import TwinError
    from twin_node.model.sequence import SUFFIX, bake_model, check_size, load_checkpoint, save_baked

    check_output(options.output, SUFFIX)
    refuse_same(options.output, options.source)
    model = None
    if options.source.suffix == SUFFIX:
        why = f"expected with a log; {options.source} is a checkpoint, which has its times and cameras"
        refuse_given(options, ("start_offset", "duration", "max_rate", "width", "rig", "params", "remap"), why)
        checkpoint = load_checkpoint(options.source)
        model, header = checkpoint.model, checkpoint.header
        steps = options.steps or header.steps
        check_size(model, steps)
        is_in_step = options.steps is None and len(header.stamps) <= steps  # else its cameras each have their own times
        stamps = header.stamps if is_in_step else model.span.evenly(steps)
        baked = bake_model(model, stamps, header.cameras)
    else:
        if options.measure or options.steps is not None:
            raise TwinError("--measure, --steps: expected with a checkpoint, whose model can be evaluated at any time")
        baked = _bake_log(options)
    save_baked(baked, options.output)
    figures: dict[str, object] = {"steps": len(baked.stamps), "gaussians": max(baked.counts), "bytes": baked.bytes}
    if options.measure and model is not None:
        figures |= measure(model, baked).as_json()
    if options.json:
        print(json_text(figures))
        return
    print(f"{options.output}: " + ", ".join(f"{name} {_shown(value)}" for name, value in figures.items()))


def _bake_log(options: argparse.Namespace) -> Baked:
    """Follows a log in lockstep and keeps every state."""
    from twin_node.model.first_light import once_lit
    from twin_node.model.sequence import bake_clouds
    from twin_node.nodes.chain import make_model
    from twin_node.nodes.chain_parameters import load_parameters
    from twin_node.nodes.log_source import LogSession, LogSource
    from twin_node.nodes.topics import parse_remaps

    chain = with_source_options(load_parameters(options.params), options)
    remaps = parse_remaps(options.remap)
    with LogSession(options.source, options.rig, remaps, options.start_offset or 0.0, options.duration) as session:
        model = make_model(chain)
        source = LogSource(session, chain.synchronizer, chain.arm.arm().joint_names)

        def states() -> Iterator[TwinState]:
            for frames in tqdm(once_lit(source), unit="set", desc="bake", disable=None):
                yield model.update(frames)

        return bake_clouds(states())


def _shown(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
