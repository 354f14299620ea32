"""`twin_node ur-sim`: a stand-in for a UR controller."""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import re
import signal
from typing import Any

from twin_node.cli.arguments import add_ur_arm, not_negative

_DESCRIPTION = """\
A stand-in for a UR controller on a loopback address: RTDE (port 30004), dashboard (29999) and script ports (30001 to
30003), as far as the unmodified ur_rtde needs them. Its arm moves by MuJoCo. It has a program of its own, which waits
for the first heartbeat, calls rtde_set_watchdog and then repeats a pick-and-place cycle at the speed slider's share;
'play' on the dashboard, or --play, starts it. Ports are fixed by ur_rtde: for several arms give each its own --host
(127.0.0.2, 127.0.0.3, ...).

What it does not do:
  - interpret URScript: RTDEControlInterface works by its registers (moveJ, servoJ, speedJ, their stops, setWatchdog,
    setTcp, forward kinematics, isSteady, protective stop); any other command of it ends the program, other programs are
    refused; the upper range of registers is not used
  - stream on the primary and secondary ports; speak ExternalControl, MODBUS, PROFINET or EtherNet/IP
  - know forces, currents, payloads, contacts, torque limits or joint temperatures, or check safety limits
  - slow servoJ by the speed slider
  - brake as a real arm does: speed follows slider and pause at 500 % per second, safety stops at 2000 %
  - wait for an operator: it is always in remote control
"""


def add_ur_sim(commands: Any) -> None:
    """Adds `ur-sim` to the subcommands."""
    parser = commands.add_parser(
        "ur-sim",
        help="a stand-in for a UR controller, with faults on demand",
        description=_DESCRIPTION,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--host", default="127.0.0.1", metavar="ADDRESS", help="loopback address (default 127.0.0.1)")
    add_ur_arm(parser)
    parser.add_argument(
        "--polyscope",
        default="5.12.0",
        type=_version,
        metavar="X.Y.Z",
        help="version that it says it has (default 5.12.0)",
    )
    parser.add_argument("--play", action="store_true", help="start its own program at once")
    parser.add_argument(
        "--watchdog-variable",
        default="input_int_register_20",
        metavar="NAME",
        help="input that its own program watches (default %(default)s)",
    )
    parser.add_argument(
        "--watchdog-hz",
        type=not_negative,
        default=10.0,
        metavar="HZ",
        help="least rate of its beats; 0: no watchdog (default 10)",
    )
    parser.add_argument(
        "--watchdog-action",
        choices=["pause", "stop", "ignore"],
        default="pause",
        help="what a missed beat does (default pause)",
    )
    parser.add_argument(
        "--unlock-delay",
        type=not_negative,
        default=5.0,
        metavar="S",
        help="how long a protective stop stays locked (default 5)",
    )
    parser.add_argument(
        "--fault", action="append", default=[], metavar="LINE[@S]", help="switch a fault after S seconds; repeatable"
    )
    parser.add_argument(
        "--admin-port",
        type=_port,
        default=29800,
        metavar="PORT",
        help="port that takes faults line by line; 0: none (default 29800)",
    )
    parser.add_argument("--list-faults", action="store_true", help="say what faults there are, and end")
    parser.set_defaults(run=_run)


def _run(options: argparse.Namespace) -> None:
    from twin_node.cell.ur_sim import (
        ControllerParameters,
        StandIn,
        StandInParameters,
        Watchdog,
        WatchdogAction,
        overview,
    )
    from twin_node.robot import arm_model

    if options.list_faults:
        print(overview())
        return
    model = arm_model(options.model, options.kinematics)
    action = WatchdogAction(options.watchdog_action)
    parameters = StandInParameters(
        host=options.host,
        version=options.polyscope,
        admin_port=options.admin_port or None,
        is_playing=options.play,
        faults=tuple(_timed(line) for line in options.fault),
        controller=ControllerParameters(
            model=model,
            watchdog=Watchdog(options.watchdog_variable, options.watchdog_hz, action),
            unlock_delay_s=options.unlock_delay,
        ),
    )
    admin = f", faults on port {options.admin_port}" if options.admin_port else ""
    with contextlib.suppress(asyncio.CancelledError):
        asyncio.run(
            _until_told(
                StandIn(parameters),
                f"ur-sim: {model.name} at {options.host}, PolyScope "
                f"{'.'.join(map(str, options.polyscope))}{admin}; Ctrl-C ends it",
            )
        )


async def _until_told(stand_in: Any, greeting: str) -> None:
    """Run until SIGINT or SIGTERM; both end the stand-in and leave the ports free."""
    task = asyncio.ensure_future(stand_in.run(lambda: print(greeting, flush=True)))
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, task.cancel)
    await task


def _timed(text: str) -> Any:
    from twin_node.cell.errors import CellError
    from twin_node.cell.ur_sim import TimedFault

    line, _, after = text.partition("@")
    try:
        return TimedFault(line.strip(), float(after or 0))
    except ValueError as error:
        raise CellError(f"--fault {text}: expected LINE@SECONDS, found {after!r} for the seconds") from error


def _version(text: str) -> tuple[int, int, int]:
    match = re.fullmatch(r"(5)\.(\d{1,4})\.(\d{1,4})", text)
    if match is None:
        raise argparse.ArgumentTypeError(f"{text}: expected a PolyScope 5 version such as 5.12.0")
    return (int(match[1]), int(match[2]), int(match[3]))


def _port(text: str) -> int:
    if re.fullmatch(r"\d{1,5}", text) is None or int(text) > 65535:
        raise argparse.ArgumentTypeError(f"{text}: expected a port, 1 to 65535, or 0 for none")
    return int(text)
