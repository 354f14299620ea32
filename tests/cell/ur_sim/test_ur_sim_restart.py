"""A stand-in that is begun anew."""

from __future__ import annotations

import asyncio

from twin_node.cell.ur_sim import StandIn, StandInParameters, free_loopback
from twin_node.cell.ur_sim.faults import switch
from twin_node.cell.ur_sim.states import SafetyMode


def test_what_is_done_to_it_while_it_is_away_holds_when_it_is_back() -> None:
    """Every such fault was answered with "ok", and gone: the button that somebody had pressed was not."""

    async def restart() -> StandIn:
        stand_in = StandIn(StandInParameters(host=free_loopback(), admin_port=None))
        away = asyncio.ensure_future(stand_in._begin_anew(0.01))
        await asyncio.sleep(0)
        for line in ("nan", "e-stop"):
            switch(stand_in, line)
        await away
        stand_in._close()
        return stand_in

    back = asyncio.run(restart())
    assert back.faults.sends_nan
    assert back.controller.safety_mode is SafetyMode.ROBOT_EMERGENCY_STOP
