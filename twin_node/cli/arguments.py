"""Arguments that several subcommands take, and the numbers in them."""

from __future__ import annotations

import argparse
import math
import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from twin_node.cli.parser import at_home
from twin_node.errors import TwinError
from twin_node.paths import is_there
from twin_node.ranges import NOT_NEGATIVE, PORTS, POSITIVE, WIDTHS_PX, Range
from twin_node.unfinished import is_taken, refuse_taken, taken

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

    from twin_node.nodes.arm_parameters import ArmParameters
    from twin_node.nodes.chain_parameters import ChainParameters

Parameters = TypeVar("Parameters", bound="DataclassInstance")

DEFAULT_ARM = "ur10e"

RATES = Range(0.001, 1000)
"""Of films and exports, Hz: the fastest of what they show, the arm's joints, come at 500 Hz."""

SPEEDS = Range(0.001, 1000)
"""Of clocks, by the recording's: at the least a camera of 15 Hz has an image a minute."""

COUNTS = Range(1, 10**18)
"""Of what is counted one by one: Python's loops take no more than 63 bits."""

SEEDS = Range(0, 2**63 - 1024)
"""Up to the last that is a float below 2**63, which torch does not take."""


def add_source_options(parser: argparse.ArgumentParser) -> None:
    """Which part of a log to read, and how, beside what the chain's parameters say."""
    add_part_options(parser)
    parser.add_argument("--params", type=Path, metavar="FILE.yaml", help="ROS parameter file of the chain")


def add_part_options(parser: argparse.ArgumentParser) -> None:
    """Which part of a log to read, and how."""
    parser.add_argument("--start-offset", type=not_negative, metavar="S", help="skip the first S seconds")
    parser.add_argument("--duration", type=positive, metavar="S", help="stop after S seconds of the log")
    parser.add_argument("--max-rate", type=positive, metavar="HZ", help="take at most so many image sets per second")
    parser.add_argument("--width", type=width, metavar="PX", help="working width of the images")
    parser.add_argument("--rig", type=Path, metavar="RIG.yaml", help="calibration, instead of the log's own")
    add_remap(parser)


def add_log(parser: argparse.ArgumentParser) -> None:
    """The log that a command is about."""
    parser.add_argument("log", type=Path, metavar="LOG", help="MCAP file or rosbag2 folder")


def add_namespace(parser: argparse.ArgumentParser, does: str) -> None:
    """The namespace of a twin on the graph; `does`: what the command does with it."""
    parser.add_argument("--namespace", metavar="/NAME", help=f"{does} (default: none)")


def add_params_file(parser: argparse.ArgumentParser) -> None:
    """Parameters of the nodes of a launch file."""
    parser.add_argument(
        "--params-file",
        type=Path,
        action="append",
        default=[],
        metavar="FILE.yaml",
        help="ROS parameter file that wins over the launch file's values; repeatable",
    )


def add_remap(parser: argparse.ArgumentParser) -> None:
    """New names for topics of a log."""
    parser.add_argument(
        "--remap", action="append", default=[], metavar="FROM:=TO", help="read topic FROM as TO; repeatable"
    )


def add_arm(parser: argparse.ArgumentParser) -> None:
    """Which arm's joints a log has, by its name or as the twin was told."""
    parser.add_argument(
        "--arm", type=file_or_name, metavar="ARM", help=f"arm of the joints in the log (default {DEFAULT_ARM})"
    )
    parser.add_argument(
        "--params", type=Path, metavar="FILE.yaml", help="ROS parameter file that says which arm it is, and its tool"
    )


def add_ur_arm(parser: argparse.ArgumentParser) -> None:
    """Which arm a UR controller moves."""
    parser.add_argument(
        "--model",
        type=file_or_name,
        default="ur5e",
        metavar="ARM",
        help="ur3e, ur5e (default), ur7e, ur10e, ur12e, ur16e, or an MJCF or URDF file",
    )
    parser.add_argument(
        "--kinematics", type=file_or_name, metavar="FILE.yaml", help="factory calibration of the arm (ur_calibration)"
    )


def arm_of(options: argparse.Namespace) -> ArmParameters:
    """The arm that `add_arm`'s options name. Raises `TwinError` for both of them, and for a wrong parameter file."""
    from twin_node.nodes.arm_parameters import ArmParameters

    if options.params is None:
        return ArmParameters(model=options.arm or DEFAULT_ARM)
    from twin_node.nodes.chain_parameters import load_parameters

    refuse_given(options, ("arm",), "expected without --params, whose section 'arm' names it; leave one of them out")
    return load_parameters(options.params).arm


def with_source_options(parameters: ChainParameters, options: argparse.Namespace) -> ChainParameters:
    """Chain parameters with the command line's width and rate in place of the file's."""
    read = with_given(parameters.synchronizer, width=options.width, max_rate_hz=options.max_rate)
    return replace(parameters, synchronizer=read)


def with_given(parameters: Parameters, **options: Any) -> Parameters:
    """Parameters, a dataclass, with the values of those options that were given: the others are None."""
    return replace(parameters, **{name: value for name, value in options.items() if value is not None})


def positive(text: str) -> float:
    """A number above 0."""
    return _within(text, POSITIVE, str(POSITIVE))


def not_negative(text: str) -> float:
    """A number of 0 or more."""
    return _within(text, NOT_NEGATIVE, "0 or more")


def finite(text: str) -> float:
    """Any number."""
    try:
        value = float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text}: expected a number") from None
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{text}: expected a finite number")
    return value


def whole(text: str) -> int:
    """A whole number of 1 or more, as things are counted."""
    return _whole_within(text, COUNTS, f"a whole number, {COUNTS}")


def seed(text: str) -> int:
    """What random numbers begin from."""
    value = _whole_within(text, SEEDS, "a whole number, 0 or more")
    return int(text) if text.isdecimal() else value  # a float does not hold every one


def port(text: str) -> int:
    """A TCP port that can be listened on."""
    return _whole_within(text, PORTS, f"a port, {PORTS}")


def rate(text: str) -> float:
    """Moments or pictures per second."""
    return _within(text, RATES, f"{RATES} per second")


def speed(text: str) -> float:
    """The speed of a clock, by that of the recording."""
    return _within(text, SPEEDS, f"{SPEEDS} times the recording's speed")


def width(text: str) -> int:
    """A width in pixels."""
    return _whole_within(text, WIDTHS_PX, f"a whole number of pixels, {WIDTHS_PX}")


def _within(text: str, allowed: Range, expected: str) -> float:
    value = finite(text)
    if not allowed.holds(value):
        raise argparse.ArgumentTypeError(f"{text}: expected {expected}")
    return value


def _whole_within(text: str, allowed: Range, expected: str) -> int:
    value = finite(text)
    if value != int(value) or not allowed.holds(value):
        raise argparse.ArgumentTypeError(f"{text}: expected {expected}")
    return int(value)


def file_or_name(text: str) -> str:
    """What may be a file, or a name that is none: a file's may begin with `~`, as a path's may."""
    return str(at_home(Path(text))) if text.startswith("~/") else text


def file_to_write(text: str) -> Path:
    """A file that can be made when the work is done: a wrong name is told before."""
    path = at_home(Path(text))
    if not _is_writable(path):
        raise argparse.ArgumentTypeError(f"{text}: {_WRITABLE}")
    if is_taken(path):
        raise argparse.ArgumentTypeError(taken(path))
    return path


def folder_to_write(text: str) -> Path:
    """A folder, there or not, that files can be written to when the work is done: a wrong name is told before."""
    path = at_home(Path(text))
    if (there := in_the_way(path)) is not None:
        raise argparse.ArgumentTypeError(f"{text}: expected a folder, or a place to make one, found {there}")
    return path


def in_the_way(folder: Path) -> Path | None:
    """What keeps a folder from being made, or files from being written to it; None where nothing does."""
    there = next(path for path in (folder, *folder.absolute().parents) if is_there(path))
    return None if there.is_dir() and os.access(there, os.W_OK) else there


def check_output(path: Path, *suffixes: str) -> None:
    """Raises `TwinError` where -o is no file that can be made when the work is done, or ends in none of `suffixes`."""
    if path.suffix not in suffixes:
        raise TwinError(f"-o {path}: expected a name that ends in {', '.join(suffixes)}")
    if not _is_writable(path):
        raise TwinError(f"-o {path}: {_WRITABLE}; choose another place")
    refuse_taken(path, TwinError)


def refuse_same(output: Path, source: Path) -> None:
    """Raises `TwinError` where -o would take the place of what is read."""
    if output.resolve() == source.resolve():
        raise TwinError(f"-o {output}: expected another file than the one that is read; choose a new name")


_WRITABLE = "expected the name of a file in a folder that exists and can be written to"


def _is_writable(path: Path) -> bool:
    return not (is_there(path) and path.is_dir()) and path.parent.is_dir() and os.access(path.parent, os.W_OK)


def refuse_given(options: argparse.Namespace, names: Sequence[str], why: str) -> None:
    """Raises `TwinError` that names those of some options that were given, where they would be ignored.

    `why`: when they are expected, and what to do.
    """
    given = given_of(options, names)
    if given:
        raise TwinError(f"{', '.join(given)}: {why}")


def given_of(options: argparse.Namespace, names: Sequence[str]) -> list[str]:
    """Those of some options that were given, as they are written; none of them has a default."""
    values = {f"--{name.replace('_', '-')}": getattr(options, name) for name in names}
    return [flag for flag, value in values.items() if value is not None and value is not False and value != []]
