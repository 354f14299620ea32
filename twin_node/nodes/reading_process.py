"""The process that `Reading` begins: it plays a log at its pace, and hands over the sets and messages."""

from __future__ import annotations

import traceback
from multiprocessing.connection import Connection

from twin_node.errors import TwinError
from twin_node.nodes.reading import Finished, NamingCameras, Order, Play
from twin_node.runtime.clock import PacedClock
from twin_node.runtime.copies import receive, send
from twin_node.runtime.image_threads import image_loops_alone
from twin_node.runtime.memory import peak_mb
from twin_node.runtime.worker_process import READY, Failed, run


def main(connection: Connection) -> None:
    """The process's work: it takes an `Order`, and a clock when there is somebody to read for."""
    image_loops_alone()
    try:
        order = receive(connection)
        with order.session:
            send(connection, READY)
            send(connection, read(connection, order, receive(connection)))
    except (ConnectionError, EOFError):
        raise
    except TwinError as error:
        send(connection, Failed(error))
    except Exception:  # whatever it is ends this process, and who has begun it raises it
        send(connection, Failed(traceback.format_exc()))


def read(connection: Connection, order: Order, clock: PacedClock) -> Finished:
    """Reads to the end, and hands over what comes."""

    def tell(thing: object) -> None:
        send(connection, thing, NamingCameras)

    play = Play(order, clock, tell, lambda topic, message: tell((topic, message)))
    for _ in play.steps():
        pass
    return play.finished(peak_mb())


if __name__ == "__main__":
    run(main)
