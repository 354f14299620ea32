"""What the controller's ports have in common, and the ports for RTDE and for scripts."""

from __future__ import annotations

import asyncio
import struct
from dataclasses import replace
from typing import Protocol, cast

import numpy as np

from twin_node.cell.ur_sim.control_script import ControlScript
from twin_node.cell.ur_sim.controller import PERIOD_S, Controller
from twin_node.cell.ur_sim.faults import Faults
from twin_node.cell.ur_sim.rtde_types import IN_USE, INPUTS, NOT_FOUND
from twin_node.cell.ur_sim.rtde_wire import InputRecipe, Kind, OutputRecipe, Package, PackageReader, encode, names_of

_MOST_UNSENT = 65536
"""Bytes that may wait for a client that reads slowly; further packages are left out, as the controller does."""
_PROTOCOL = 2
"""Version of RTDE; packages of the first one are laid out otherwise."""


class Served(Protocol):
    """What clients connect to: the stand-in."""

    version: tuple[int, int, int]
    """PolyScope."""
    controller: Controller
    faults: Faults
    connections: set[Connection]
    """Those that are open."""


class Connection(asyncio.Protocol):
    """A client's connection to one of the controller's ports; silent while a fault says so."""

    def __init__(self, stand_in: Served) -> None:
        self.stand_in = stand_in
        self._transport: asyncio.Transport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(asyncio.Transport, transport)
        self.stand_in.connections.add(self)
        self.refresh()

    def connection_lost(self, exc: Exception | None) -> None:
        self.stand_in.connections.discard(self)

    def refresh(self) -> None:
        """Read, or not, as the faults now say."""
        if self._transport is not None and not self._transport.is_closing():
            if self.stand_in.faults.is_silent:
                self._transport.pause_reading()
            else:
                self._transport.resume_reading()

    def send(self, data: bytes) -> None:
        """Send, unless nothing may pass or too much waits already."""
        transport = self._transport
        if transport is None or transport.is_closing() or self.stand_in.faults.is_silent:
            return
        if transport.get_write_buffer_size() < _MOST_UNSENT:
            transport.write(data)

    def close(self) -> None:
        """End the connection at once, as a controller that is switched off does."""
        if self._transport is not None:
            self._transport.abort()


class RtdeConnection(Connection):
    """One client of the Real-Time Data Exchange."""

    def __init__(self, stand_in: Served) -> None:
        super().__init__(stand_in)
        self._reader = PackageReader()
        self._outputs: OutputRecipe | None = None
        self._inputs: list[InputRecipe] = []
        self._is_started = False
        self._due = 0.0

    def connection_lost(self, exc: Exception | None) -> None:
        super().connection_lost(exc)
        self.stand_in.controller.inputs.release(self)

    def data_received(self, data: bytes) -> None:
        try:
            for package in self._reader.feed(data):
                self._handle(package)
        except (ValueError, IndexError, struct.error) as error:
            self.stand_in.controller.note(f"RTDE client dropped: {error}")
            self.close()

    def push(self) -> None:
        """Send a data package, if one is due at the controller's clock."""
        clock = self.stand_in.controller.clock
        if not self._is_started or self._outputs is None or clock < self._due - PERIOD_S / 2:
            return
        self._due = max(self._due + 1 / self._outputs.rate_hz, clock)
        outputs, faults = self.stand_in.controller.outputs, self.stand_in.faults
        if faults.sends_nan:
            outputs = replace(outputs, actual_q=np.full(6, np.nan), actual_qd=np.full(6, np.nan))
        pack = self._outputs.pack_short if faults.sends_five_joints else self._outputs.pack
        self.send(encode(Kind.DATA_PACKAGE, pack(outputs)))

    def _handle(self, package: Package) -> None:
        if package.kind == Kind.DATA_PACKAGE:
            self._take(package.payload)
        elif package.kind == Kind.REQUEST_PROTOCOL_VERSION:
            self._answer(Kind.REQUEST_PROTOCOL_VERSION, struct.unpack(">H", package.payload)[0] == _PROTOCOL)
        elif package.kind == Kind.GET_URCONTROL_VERSION:
            self.send(encode(Kind.GET_URCONTROL_VERSION, struct.pack(">4I", *self.stand_in.version, 0)))
        elif package.kind == Kind.SETUP_OUTPUTS:
            self._set_up_outputs(package.payload)
        elif package.kind == Kind.SETUP_INPUTS:
            self._set_up_inputs(package.payload)
        elif package.kind == Kind.START:
            is_ready = self._outputs is not None and self._outputs.is_complete
            self._answer(Kind.START, is_ready)
            self._is_started = is_ready
            self._due = self.stand_in.controller.clock
        elif package.kind == Kind.PAUSE:
            self._is_started = False
            self._answer(Kind.PAUSE, True)

    def _answer(self, kind: Kind, is_accepted: bool) -> None:
        self.send(encode(kind, bytes([is_accepted])))

    def _set_up_outputs(self, payload: bytes) -> None:
        (rate_hz,) = struct.unpack_from(">d", payload)
        if not 1 <= rate_hz <= 1 / PERIOD_S:
            raise ValueError(f"output rate of {rate_hz:g} Hz")
        self._outputs = OutputRecipe(names_of(payload[8:]), rate_hz)
        self.send(encode(Kind.SETUP_OUTPUTS, b"\x01" + ",".join(self._outputs.types).encode()))

    def _set_up_inputs(self, payload: bytes) -> None:
        names = names_of(payload)
        claim = self.stand_in.controller.inputs.claim
        types = [
            NOT_FOUND if name not in INPUTS else INPUTS[name].label if claim(name, self) else IN_USE for name in names
        ]
        is_granted = NOT_FOUND not in types and IN_USE not in types
        if is_granted:
            self._inputs.append(InputRecipe(names))
        number = len(self._inputs) if is_granted else 0
        self.send(encode(Kind.SETUP_INPUTS, bytes([number]) + ",".join(types).encode()))

    def _take(self, payload: bytes) -> None:
        recipe = self._inputs[payload[0] - 1] if payload[0] else None
        if recipe is None:
            raise ValueError("input package for a recipe that was not granted")
        controller = self.stand_in.controller
        for name, value in zip(recipe.names, recipe.unpack(payload[1:]), strict=True):
            controller.inputs.write(name, value, controller.clock)


class ScriptConnection(Connection):
    """Takes programs as the primary, secondary and real-time ports do, and streams nothing."""

    def __init__(self, stand_in: Served) -> None:
        super().__init__(stand_in)
        self._text = b""

    def data_received(self, data: bytes) -> None:
        self._text += data
        if self._text.endswith(b"\nend\n"):
            text, self._text = self._text, b""
            if text.lstrip().startswith(b"def rtde_control():"):
                self.stand_in.controller.replace(ControlScript())
            else:
                first = text.lstrip().split(b"\n", 1)[0][:60].decode(errors="replace")
                self.stand_in.controller.note(f"script refused, URScript is not interpreted: {first}")
