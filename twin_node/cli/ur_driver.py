"""`twin_node ur-driver`: drive a UR arm by the twin's speed decisions, or watch it."""

from __future__ import annotations

import argparse
import contextlib
import math
import signal
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from twin_node.cli.arguments import add_namespace, add_ur_arm, positive, refuse_given, whole, with_given
from twin_node.cli.keyboard import enter_pressed

if TYPE_CHECKING:
    from twin_node.arm.ur import UrParameters
    from twin_node.nodes.driver_log import DriverLog
    from twin_node.nodes.ur_driver import UrDriverNode
    from twin_node.runtime.bus import Bus
    from twin_node.runtime.clock import Clock

_DESCRIPTION = """\
Drive a UR controller through ur_rtde in a process of its own, as a node of the graph that runs on this machine.

  slider     (default) the robot runs its own program; the driver sets the speed slider to the twin's speed fraction and
             beats an input register that the program watches, so that the arm pauses by itself when the beat ends.
             The program needs four lines before its moves:
               while read_input_integer_register(20) == 0:
                 sync()
               end
               rtde_set_watchdog("input_int_register_20", 10, "pause")
  servo      the driver makes the arm follow /arm/follow by servoJ, slowed along its path; one without points
             makes it brake there and stay
  read-only  the driver writes nothing

Without forecasts the arm stands. Whatever goes wrong halts it until somebody acknowledges: press Enter, or run
`twin_node acknowledge`. This is not a safety function: the controller's own safety configuration protects people.
"""


def add_ur_driver(commands: Any) -> None:
    """Adds `ur-driver` to the subcommands."""
    parser = commands.add_parser(
        "ur-driver",
        help="drive a UR arm by the twin's decisions, or watch it",
        description=_DESCRIPTION,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--robot", required=True, metavar="HOST", help="address of the controller")
    parser.add_argument(
        "--mode",
        choices=["slider", "servo", "read-only"],
        default="slider",
        help="how the arm is driven (default slider)",
    )
    add_ur_arm(parser)
    parser.add_argument(
        "--joints",
        nargs="+",
        metavar="NAME",
        help="how its joints are called, from base to tool, where others have a prefix",
    )
    parser.add_argument(
        "--register", type=whole, metavar="N", help="input register of the heartbeat, 18 to 22 (default 20)"
    )
    parser.add_argument("--no-reconnect", action="store_true", help="end when the connection is lost")
    parser.add_argument("--resume", action="store_true", help="go on by itself when the cause of a halt is over")
    parser.add_argument("--play", action="store_true", help="press play when a halt has left the program paused")
    parser.add_argument("--decisions", type=Path, metavar="LOG.mcap", help="play /twin/separation of this log")
    parser.add_argument("-o", "--output", type=Path, metavar="OUT.mcap", help="record what it publishes in a new log")
    parser.add_argument("--duration", type=positive, metavar="S", help="end after S seconds")
    add_namespace(parser, "obey the twin of this namespace")
    parser.set_defaults(run=_run)


def _run(options: argparse.Namespace) -> None:
    from twin_node.arm.errors import ArmError
    from twin_node.arm.ur import DriverMode, UrParameters
    from twin_node.nodes.recorder import RecorderNode
    from twin_node.nodes.topics import DIAGNOSTICS, JOINT_STATES, SEPARATION, TRAJECTORY
    from twin_node.nodes.ur_driver import UrDriverNode

    _refuse_of_other_modes(options)
    if options.output is not None and options.output.exists():
        raise ArmError(f"-o {options.output}: exists already; remove it or choose another name")
    if options.decisions is not None and options.namespace:
        raise ArmError("--namespace: expected where the graph decides; leave it out with --decisions")
    parameters = UrParameters(
        robot=options.robot,
        model=options.model,
        kinematics=options.kinematics,
        joints=tuple(options.joints or ()),
        mode=DriverMode(options.mode),
        reconnects=not options.no_reconnect,
        resumes=options.resume,
        plays=options.play,
    )
    parameters = with_given(parameters, heartbeat_register=options.register)
    with contextlib.ExitStack() as stack:
        pace: _Pace = _pace(options, stack)
        pace.last(options.duration)
        hangs_up = signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN  # as with nohup
        for number in (signal.SIGINT, signal.SIGTERM, *([signal.SIGHUP] if hangs_up else [])):
            signal.signal(number, pace.end)  # all end the arm in order, and keep what was recorded
        if options.output is not None:
            log = stack.enter_context(_recording(options.output))
            topics = (JOINT_STATES, TRAJECTORY, SEPARATION, DIAGNOSTICS)
            recorder = RecorderNode(pace.recorder_bus, pace.clock, log, topics, is_live=True)
            recorder.configure()
            recorder.activate()
        node = UrDriverNode(pace.bus, pace.clock, parameters, offer=partial(pace.offer, parameters))
        node.configure()
        node.activate()
        stack.callback(node.deactivate)
        lost = _watch(node, pace, is_ending_when_lost=options.no_reconnect)
    if lost is not None:
        raise ArmError(lost)


def _refuse_of_other_modes(options: argparse.Namespace) -> None:
    """Raises `TwinError` for options that only other modes heed."""
    if options.mode != "slider":
        refuse_given(
            options, ("register", "play"), "expected with --mode slider, whose program they are for; leave them out"
        )
    if options.mode == "read-only":
        refuse_given(options, ("resume",), "expected with a mode in which halts wait for somebody; leave it out")


def _pace(options: argparse.Namespace, stack: contextlib.ExitStack) -> _Pace:
    if options.decisions is None:
        return _GraphPace(options.namespace, stack)
    return _LogPace(options.decisions, stack)


@contextlib.contextmanager
def _recording(path: Path) -> Iterator[DriverLog]:
    """A log of what happens once, kept however the driver ends, unless there never was an arm."""
    from twin_node.errors import TwinError
    from twin_node.nodes.driver_log import DriverLog
    from twin_node.nodes.topics import JOINT_STATES

    log = DriverLog(path, partial(print, flush=True))
    try:
        yield log
    except TwinError:
        if JOINT_STATES in log.topics:
            with contextlib.suppress(TwinError):  # what ended the driver is told
                log.close()
        else:
            log.discard()
        raise
    except BaseException:
        with contextlib.suppress(TwinError):  # the same
            log.close()
        raise
    log.close()


class _Pace(ABC):
    """Lets time pass for the driver's node, until it is up."""

    bus: Bus
    recorder_bus: Bus
    """The bus of who records what the driver says and hears."""
    clock: Clock

    def __init__(self) -> None:
        from twin_node.nodes.ur_driver import TICK_S

        self._tick_s = TICK_S
        self._until = math.inf
        self._is_ended = False

    def last(self, duration_s: float | None) -> None:
        """Let time be up so many seconds from now; None: never."""
        self._until = math.inf if duration_s is None else time.monotonic() + duration_s

    def end(self, *_: object) -> None:
        """Let time be up, as a handler of signals; the next SIGINT waits for nothing."""
        self._is_ended = True
        signal.signal(signal.SIGINT, signal.default_int_handler)

    @abstractmethod
    def offer(self, parameters: UrParameters, node: UrDriverNode) -> None:
        """Let others ask the node, whose `parameters` these are."""

    def step(self, is_ready: bool) -> bool:
        """Wait for the next moment; `is_ready`: whether the arm is. False when time is up."""
        self._wait(is_ready)
        return not self._is_ended and time.monotonic() < self._until

    @abstractmethod
    def _wait(self, is_ready: bool) -> None:
        """Let a tick pass; `is_ready`: whether the arm is."""


class _GraphPace(_Pace):
    """Hears the graph, by the time of day."""

    def __init__(self, namespace: str | None, stack: contextlib.ExitStack) -> None:
        from twin_node.nodes.live.single import open_wire
        from twin_node.nodes.topics import kind_of
        from twin_node.nodes.ur_driver import DRIVER
        from twin_node.runtime.clock import SystemClock
        from twin_node.runtime.executor import Executor
        from twin_node.runtime.wire_bus import WireBus

        super().__init__()
        wire = stack.enter_context(open_wire(sole=DRIVER, namespace=namespace))
        self._wire, self._executor, self.clock = wire, Executor(), SystemClock()
        self.bus = self._bus = WireBus(wire, self._executor, DRIVER, kind_of)
        # Under another name: by what the driver's node listens to, others know how it drives.
        self.recorder_bus = WireBus(wire, self._executor, f"{DRIVER}_recorder", kind_of)

    def offer(self, parameters: UrParameters, node: UrDriverNode) -> None:
        from twin_node.nodes.live.arm_driver import serve_acknowledgement
        from twin_node.nodes.live.single import serve
        from twin_node.runtime.parameter_values import named_parameters

        serve_acknowledgement(self._bus, node)
        serve(self._wire, node, named_parameters({"": parameters}, follows_clock=False), self._finish)

    def _finish(self) -> None:
        """Let time be up, from any thread."""
        self._is_ended = True

    def _wait(self, is_ready: bool) -> None:
        until = time.monotonic() + self._tick_s
        while not self._is_ended and (left_s := until - time.monotonic()) > 0:
            self._executor.step(left_s)


class _LogPace(_Pace):
    """Steps through a log's decisions in real time, from when the arm is ready."""

    def __init__(self, decisions: Path, stack: contextlib.ExitStack) -> None:
        from twin_node.runtime.bus import LocalBus
        from twin_node.runtime.clock import PacedClock

        super().__init__()
        self.bus = self.recorder_bus = LocalBus()
        player, start_ns = _player(decisions, self.bus, stack)
        self._is_started = False
        self.clock = self._paced = PacedClock(start_ns, 1.0)
        self._steps = player.steps(self.clock, self._tick_s)

    def offer(self, parameters: UrParameters, node: UrDriverNode) -> None:
        """Without a graph nobody asks."""

    def _wait(self, is_ready: bool) -> None:
        if not self._is_started and is_ready:
            self._paced.start()
            self._is_started = True
        if not self._is_started or next(self._steps, None) is None:
            time.sleep(self._tick_s)


def _player(decisions: Path, bus: Any, stack: contextlib.ExitStack) -> Any:
    """What plays a log's decisions, and the log's start, ns."""
    from twin_node.bag import open_log
    from twin_node.errors import TwinError
    from twin_node.nodes.player import Player, span_of
    from twin_node.nodes.topics import SEPARATION

    log = stack.enter_context(open_log(decisions))
    if SEPARATION not in {topic.name for topic in log.topics}:
        raise TwinError(
            f"--decisions {decisions}: expected a log with {SEPARATION}, found none; make one with "
            "'twin_node replay LOG -o OUT.mcap'"
        )
    span = span_of(log)
    return Player(log, bus, {SEPARATION: SEPARATION}, span), span.start_ns


class _News:
    """What a driver says, once per change: numbers that go on changing are none."""

    def __init__(self) -> None:
        self._said = ""

    def of(self, report: Any) -> str | None:
        """The line that tells a report; None where it says the same as the one before."""
        from twin_node.nodes.ur_driver import without_numbers

        line = f"{report.state.value}: {report.reason}"
        if report.refusal is not None:
            line += f" (refused: {report.refusal})"
        words = without_numbers(line)
        if words == self._said:
            return None
        self._said = words
        return line


def _watch(node: Any, pace: _Pace, is_ending_when_lost: bool) -> str | None:
    """Tick, say what changes, and take Enter for an acknowledgement, until time is up or Ctrl-C.

    Gives back how a connection was lost that is not to be made anew: what was recorded until then is kept. Raises
    `ArmError` where there never was one.
    """
    from twin_node.arm.errors import ArmError
    from twin_node.arm.ur import DriverState

    news, was_connected = _News(), False
    while pace.step(node.report.state is DriverState.READY):
        node.tick()
        report = node.report
        line = news.of(report)
        if line is not None:
            print(line, flush=True)
        was_connected |= report.sample is not None
        if report.state is DriverState.LOST and is_ending_when_lost:
            if not was_connected:
                raise ArmError(report.reason)
            return str(report.reason)
        if enter_pressed():
            node.acknowledge(lambda _, words: print(f"acknowledge: {words}", flush=True))
    return None
