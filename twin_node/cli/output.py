"""What commands print: warnings, and figures to read or as JSON."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping

from twin_node.json_text import json_text


def warn(*lines: object) -> None:
    """Tells what a user must know of work that goes on all the same, apart from what commands print."""
    for line in lines:
        print(f"twin_node: warning: {line}", file=sys.stderr)


def add_json(parser: argparse.ArgumentParser) -> None:
    """Whether figures are for a program."""
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def print_figures(figures: Mapping[str, object], as_json: bool) -> None:
    """Prints figures that have no form of their own to be read in."""
    import yaml

    print(json_text(figures) if as_json else yaml.safe_dump(figures, sort_keys=False).rstrip())
