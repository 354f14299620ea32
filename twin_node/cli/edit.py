"""`twin_node edit`: things removed from a trained model, moved or recoloured, for all of its times."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from twin_node.cli.arguments import check_output, finite, not_negative, refuse_same
from twin_node.errors import TwinError
from twin_node.ranges import within_s


def add_edit(commands: Any) -> None:
    """Adds `edit` to the subcommands."""
    edit = commands.add_parser("edit", help="remove, move or recolour things in a trained model, for all its times")
    edit.add_argument("model", type=Path, metavar="MODEL.safetensors", help="checkpoint of twin_node train")
    edit.add_argument("-o", "--output", type=Path, required=True, metavar="OUT.safetensors", help="checkpoint to write")
    edit.add_argument(
        "--box",
        type=finite,
        nargs=6,
        required=True,
        metavar="M",
        help="X Y Z of its lower and X Y Z of its upper corner, m: what is in it is edited",
    )
    edit.add_argument("--at", type=not_negative, default=0.0, metavar="S", help="when it is in the box (default 0)")
    edit.add_argument("--remove", action="store_true", help="take it away")
    edit.add_argument("--move", type=finite, nargs=3, metavar="M", help="X Y Z: by so much farther on, m")
    edit.add_argument("--colour", type=finite, nargs=3, metavar="C", help="red, green, blue, 0 to 1: its mean colour")
    edit.set_defaults(run=_edit)


def _edit(options: argparse.Namespace) -> None:
    from twin_node.model.sequence import SUFFIX, Edit, edited, load_checkpoint, write_checkpoint

    check_output(options.output, SUFFIX)
    refuse_same(options.output, options.model)
    lower, upper = options.box[:3], options.box[3:]
    if any(low > high for low, high in zip(lower, upper, strict=True)):
        raise TwinError(f"--box: expected its lower corner first, found {lower} and then {upper}; swap what is higher")
    if options.remove == bool(options.move or options.colour):
        raise TwinError("edit: expected --remove, or --move and --colour, or one of these; say what is to be done")
    if options.colour and not all(0 <= value <= 1 for value in options.colour):
        raise TwinError(f"--colour: expected values from 0 to 1, found {options.colour}")
    checkpoint = load_checkpoint(options.model)
    span = checkpoint.header.span
    length = (span.last - span.first) / 1e9
    if options.at > length:
        raise TwinError(f"--at {options.at:g}: expected a time inside the model's {within_s(length)}")
    edit = Edit(
        tuple(lower),
        tuple(upper),
        span.first + round(options.at * 1e9),
        options.remove,
        tuple(options.move or (0.0, 0.0, 0.0)),
        None if options.colour is None else tuple(options.colour),
    )
    done = edited(checkpoint, edit, options.output)
    write_checkpoint(done)
    print(f"{options.output}: {len(done.stored)} Gaussians of {len(checkpoint.stored)}")
