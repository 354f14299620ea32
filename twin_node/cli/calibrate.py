"""`twin_node calibrate`: from pictures of a board to a rig that the twin can trust."""

from __future__ import annotations

from typing import Any


def add_calibrate(commands: Any) -> None:
    """Adds `calibrate` to the subcommands."""
    calibrate = commands.add_parser("calibrate", help="calibrate cameras and rigs, check and draw the result")
    calibrate.add_subparsers(required=True, metavar="KIND")
