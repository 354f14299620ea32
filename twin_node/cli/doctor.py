"""`twin_node doctor`: what is installed, what is on the network, and how the graph is doing now."""

from __future__ import annotations

import argparse
from typing import Any

from twin_node.cli.arguments import positive


def add_doctor(commands: Any) -> None:
    """Adds `doctor` to the subcommands."""
    doctor = commands.add_parser(
        "doctor",
        help="look the live graph over",
        description="Listen to the live graph for some seconds: who is there, what comes how regularly, what "
        "/diagnostics and the twin's status say. Exit status: 0 sound, 1 something found.",
    )
    doctor.add_argument("--seconds", type=positive, default=3.0, metavar="S", help="how long to listen (default 3)")
    doctor.add_argument("--devices", action="store_true", help="list OAK cameras that are plugged in, and end")
    doctor.set_defaults(run=_doctor)


def _doctor(options: argparse.Namespace) -> int:
    if options.devices:
        return _list_devices()
    from twin_node.nodes.live.doctor import examine
    from twin_node.nodes.live.single import open_wire

    with open_wire() as wire:
        findings = examine(wire, options.seconds)
    for line in findings.lines:
        print(line)
    for fault in findings.faults:
        print(f"found: {fault}")
    print("not sound: see above" if findings.faults else "sound")
    return 1 if findings.faults else 0


def _list_devices() -> int:
    from twin_node.rig.cameras.oak import plugged_in

    devices = plugged_in()
    for device in devices:
        print(device)
    if not devices:
        print("no OAK camera is plugged in, or this user may not open it (udev rules)")
    return 0 if devices else 1
