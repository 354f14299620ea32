"""The stand-in as a whole: a controller, its ports, its clock, and the port by which faults are switched."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import ipaddress
from collections.abc import Callable
from dataclasses import dataclass, field

from twin_node.arm.ur.priority import ask_for_realtime
from twin_node.cell.errors import CellError
from twin_node.cell.ur_sim.connections import Connection, RtdeConnection, ScriptConnection
from twin_node.cell.ur_sim.controller import PERIOD_S, Controller, ControllerParameters
from twin_node.cell.ur_sim.dashboard import DashboardConnection
from twin_node.cell.ur_sim.faults import Faults, check, switch
from twin_node.cell.ur_sim.own_program import OwnProgram
from twin_node.cell.ur_sim.status import status_of, to_line

DASHBOARD_PORT = 29999
SCRIPT_PORTS = (30001, 30002, 30003)
"""Primary, secondary and real-time interface."""
RTDE_PORT = 30004
ADMIN_PORT = 29800
"""The stand-in's own: no controller has it."""
_MOST_LATE_S = 0.02
"""A computer that is busy elsewhere holds up the stand-in's clock by what goes beyond this: a real controller's periods
do not wait, so a watchdog must not count them."""

_PRIORITY = 10
"""A controller is a real-time system; below the driver's, which it must not hold up."""


@dataclass(frozen=True)
class TimedFault:
    """A fault switched some time after the start."""

    line: str
    after_s: float = 0.0

    def __post_init__(self) -> None:
        """Raises `CellError` for a line that is no fault, and a time that is none."""
        check(self.line)
        if not 0 <= self.after_s < float("inf"):
            raise CellError(f"fault {self.line!r}: expected seconds after the start, 0 or more, found {self.after_s:g}")


@dataclass(frozen=True)
class StandInParameters:
    """Where the stand-in listens and what it pretends to be."""

    host: str = "127.0.0.1"
    """A loopback address: nobody is asked for a password here."""
    version: tuple[int, int, int] = (5, 12, 0)
    """PolyScope."""
    admin_port: int | None = ADMIN_PORT
    """None: faults cannot be switched while it runs."""
    is_playing: bool = False
    """Whether its own program runs from the start."""
    faults: tuple[TimedFault, ...] = ()
    controller: ControllerParameters = field(default_factory=ControllerParameters)

    def __post_init__(self) -> None:
        """Raises `CellError` for an address that others can reach, and for an admin port of the controller's own."""
        try:
            is_loopback = self.host == "localhost" or ipaddress.ip_address(self.host).is_loopback
        except ValueError:
            is_loopback = False
        if not is_loopback:
            raise CellError(
                f"--host {self.host}: expected a loopback address such as 127.0.0.1 or 127.0.0.2, because the stand-in "
                "obeys whoever connects; to reach it from elsewhere, forward its ports yourself"
            )
        own = (DASHBOARD_PORT, *SCRIPT_PORTS, RTDE_PORT)
        if self.admin_port in own:
            raise CellError(
                f"--admin-port {self.admin_port}: expected none of the controller's own ports "
                f"({', '.join(map(str, own))}); choose another, such as {ADMIN_PORT}"
            )


class StandIn:
    """Runs until its task is cancelled; see `faults.Faulty` for what can be done to it."""

    def __init__(self, parameters: StandInParameters) -> None:
        self.parameters = parameters
        self.version = parameters.version
        self.controller = Controller(parameters.controller)
        self.faults = Faults()
        self.connections: set[Connection] = set()
        self._servers: list[asyncio.Server] = []
        self._restart_s: float | None = None
        self._timers: list[asyncio.TimerHandle] = []

    async def run(self, ready: Callable[[], None]) -> None:
        """Listen and tick for ever; `ready()` is called when every port is open.

        Raises `CellError` where a port is taken.
        """
        async with contextlib.AsyncExitStack() as stack:
            if self.parameters.admin_port is not None:
                admin = await self._listen(self.parameters.admin_port, lambda: AdminConnection(self))
                stack.callback(admin.close)
            await self._open()
            stack.callback(self._close)
            if self.parameters.is_playing:
                self.controller.play(OwnProgram())
            loop = asyncio.get_running_loop()
            for fault in self.parameters.faults:
                self._timers.append(loop.call_later(fault.after_s, self._switch, fault.line))
            ready()
            await self._tick_for_ever()

    def note(self, text: str) -> None:
        """Remember that something was done to it."""
        self.controller.note(text)

    def refresh(self) -> None:
        """Let bytes pass, or not, as the faults now say."""
        for connection in self.connections:
            connection.refresh()

    def drop_connections(self) -> None:
        """Close every client's RTDE connection."""
        for connection in list(self.connections):
            if isinstance(connection, RtdeConnection):
                connection.close()

    def restart(self, after_s: float) -> None:
        """End the controller with all its connections, and begin anew after a time."""
        self._restart_s = after_s

    def claim(self, variable: str) -> None:
        """Take an input variable as another client would."""
        if not self.controller.inputs.claim(variable, self):
            raise CellError(f"fault claim: {variable} is in use by a client already; switch it before one connects")

    def release(self, variable: str) -> None:
        """Give an input variable free that was claimed."""
        self.controller.inputs.release(self, variable)

    def protective_stop(self) -> None:
        """As if the arm had hit something."""
        self.controller.protective_stop("fault switch")

    def press_emergency_stop(self) -> None:
        """Press the button."""
        self.controller.emergency_stop()

    def release_emergency_stop(self) -> None:
        """Pull the button."""
        self.controller.release_emergency_stop()

    def _switch(self, line: str) -> None:
        """Carry out a fault of the start; there is nobody to tell that it could not be."""
        try:
            switch(self, line)
        except CellError as error:
            self.note(str(error))

    async def _tick_for_ever(self) -> None:
        """Period after period, by timers of the loop: a task that sleeps takes it twice the work."""
        ask_for_realtime(_PRIORITY)
        loop = asyncio.get_running_loop()
        while True:
            restart: asyncio.Future[float] = loop.create_future()
            self._tick(loop.time(), restart)
            await self._begin_anew(await restart)

    def _tick(self, due: float, restart: asyncio.Future[float]) -> None:
        """The period that is due at a time (s of the loop), and a timer for the next one.

        There is none where `restart` is cancelled, or is told here: after how long, or what was raised.
        """
        if restart.cancelled():
            return
        if self._restart_s is not None:
            restart.set_result(self._restart_s)
            return
        try:
            self._pass_period()
        except Exception as error:  # whoever waits ends by it
            restart.set_exception(error)
            return
        loop = restart.get_loop()
        due = max(due + PERIOD_S * self.faults.slowness, loop.time() - _MOST_LATE_S)
        loop.call_at(due, self._tick, due, restart)

    def _pass_period(self) -> None:
        if not self.faults.is_frozen:
            self.controller.tick()
            for connection in list(self.connections):
                if isinstance(connection, RtdeConnection):
                    connection.push()

    async def _begin_anew(self, after_s: float) -> None:
        self._restart_s = None
        self._close()
        self.controller = Controller(self.parameters.controller)  # what is done to it meanwhile holds when it is back
        self.faults = Faults()
        await asyncio.sleep(after_s)
        await self._open()

    async def _open(self) -> None:
        """Listen on the controller's own ports."""
        makers: list[tuple[int, Callable[[], Connection]]] = [
            (RTDE_PORT, lambda: RtdeConnection(self)),
            (DASHBOARD_PORT, lambda: DashboardConnection(self)),
            *((port, lambda: ScriptConnection(self)) for port in SCRIPT_PORTS),
        ]
        for port, make in makers:
            self._servers.append(await self._listen(port, make))

    async def _listen(self, port: int, make: Callable[[], asyncio.Protocol]) -> asyncio.Server:
        host = self.parameters.host
        try:
            return await asyncio.get_running_loop().create_server(make, host, port, reuse_address=True)
        except OSError as error:
            reason = "is taken" if error.errno == errno.EADDRINUSE else f"cannot be opened ({error.strerror})"
            self._close()
            raise CellError(
                f"{host}:{port} {reason}; stop the other stand-in, or choose another loopback address, for example "
                "--host 127.0.0.2"
            ) from error

    def _close(self) -> None:
        for server in self._servers:
            server.close()
        self._servers.clear()
        for connection in list(self.connections):
            connection.close()


class AdminConnection(asyncio.Protocol):
    """Switches faults and tells the state, a line for a line; goes on whatever the controller's faults are."""

    def __init__(self, stand_in: StandIn) -> None:
        self._stand_in = stand_in
        self._transport: asyncio.WriteTransport | None = None
        self._text = b""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = transport if isinstance(transport, asyncio.WriteTransport) else None

    def data_received(self, data: bytes) -> None:
        *lines, self._text = (self._text + data).split(b"\n")
        for line in lines:
            if self._transport is not None:
                self._transport.write(f"{self._answer(line.decode(errors='replace').strip())}\n".encode())

    def _answer(self, line: str) -> str:
        if line == "status":
            return to_line(status_of(self._stand_in.controller))
        try:
            switch(self._stand_in, line)
        except CellError as error:
            return f"error: {error}"
        return "ok"
