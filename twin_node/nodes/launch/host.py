"""A process of a launch: runs its nodes, each in a thread of its own, until it is told to stop.

Its first line of input is the order (JSON of `Order`): it makes the nodes. A line `configure` lets them join the graph,
a line `activate` starts them, and the end of its input ends them: when the launcher dies, so do its processes. What it
has to say goes to the file descriptor that it was given, one line of JSON each.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import sys
import threading
import time
import traceback
from typing import Any

from twin_node.collecting import collect_rarely
from twin_node.errors import TwinError
from twin_node.nodes.launch.order import Order
from twin_node.runtime.leaving import leave

FAILED, REFUSED = 1, 2
"""Exit statuses: a node failed; what it was given is wrong, before it had been active."""

LAST_S = 10.0
"""How long the nodes may take to end where the launcher has died, s: twice as long as it would wait."""


def main() -> int:
    """The process; the only argument is the file descriptor that events go to."""
    collect_rarely()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # of a terminal's group: the launcher leads through the shutdown
    events = os.fdopen(int(sys.argv[1]), "w", buffering=1)
    order = Order(**json.loads(sys.stdin.readline()))
    os.nice(order.niceness)
    try:
        if order.is_lockstep:
            from twin_node.nodes.launch.lockstep import run_in_lockstep

            told = _is_told_to_stop(events)
            run_in_lockstep(order.sections, order.where, told, lambda line: _say(events, event="said", text=line))
        else:
            _run_live(order, events)
    except TwinError as error:
        _say(events, event="refused", error=str(error))
        return REFUSED
    except Exception as error:  # the launcher names the process that failed, and the log holds the trace
        traceback.print_exc()
        is_told = isinstance(error.__cause__, TwinError)  # it says all that there is to know
        _say(events, event="failed", error=str(error) if is_told else f"{type(error).__name__}: {error}")
        return FAILED
    return 0


def _run_live(order: Order, events: Any) -> None:
    from twin_node.nodes.launch.node_thread import Graph

    graph = Graph(order, lambda line: _say(events, event="said", text=line))
    graph.make()
    _say(events, event="loaded")
    if sys.stdin.readline().strip() != "configure":
        return
    try:
        graph.configure()
        _say(events, event="configured")
        threading.Thread(target=_obey, args=(graph,), name="orders", daemon=True).start()
        graph.run(lambda: _pulse(events))
    finally:
        graph.close()


def _obey(graph: Any) -> None:
    for line in sys.stdin:
        if line.strip() == "activate":
            graph.activate()
    graph.stop()
    time.sleep(LAST_S)
    os._exit(FAILED)  # a node hangs, and who would have ended this process by now has died


def _is_told_to_stop(events: Any) -> threading.Event:
    """Set when the launcher closes this process's input."""
    for reached in ("loaded", "configured"):
        _say(events, event=reached)
    told = threading.Event()

    def wait() -> None:
        sys.stdin.read()
        told.set()

    threading.Thread(target=wait, name="orders", daemon=True).start()
    return told


def _pulse(events: Any) -> None:
    """Tells that nothing hangs, unless nobody listens: a launcher that is stopped must not stop its processes, too."""
    if select.select((), (events,), (), 0)[1]:
        _say(events, event="pulse")


def _say(events: Any, **what: str) -> None:
    with contextlib.suppress(OSError):  # the launcher is gone: nobody to tell
        events.write(json.dumps(what) + "\n")


if __name__ == "__main__":
    leave(main())  # libraries' threads must not keep a process alive that its launcher has given up
