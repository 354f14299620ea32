"""The process that `Apart` begins: it takes a window model, and follows with it what it is handed, set by set."""

from __future__ import annotations

import contextlib
import gc
import os
import signal
import sys
import traceback
from multiprocessing.connection import Connection

from twin_node.errors import TwinError
from twin_node.model.apart import READY, Failed, Followed, send
from twin_node.model.kernels import kernels
from twin_node.model.window_model import WindowModel
from twin_node.runtime.image_threads import image_loops_alone
from twin_node.scene import TwinState


def main() -> int:
    """The process; the only argument is the file descriptor of its end of the pipe, whose other end's close ends it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # of a terminal's group: who has begun it ends it
    image_loops_alone()
    kernels()
    connection = Connection(int(sys.argv[1]))
    with contextlib.suppress(EOFError, ConnectionError):  # nobody hands it anything more
        send(connection, READY)
        serve(connection)
    return 0


def serve(connection: Connection) -> None:
    """Takes a model and then sets, until the other end is closed or something goes wrong with one."""
    model = connection.recv()
    gc.collect()
    gc.freeze()  # what is there now lives as long as the process
    while True:
        seen = connection.recv()
        try:
            followed = follow(model, seen)
        except TwinError as error:
            return send(connection, Failed(error))
        except Exception:
            return send(connection, Failed(traceback.format_exc()))
        send(connection, followed)
        model.refine(lambda: not connection.poll())


def follow(model: WindowModel, seen: TwinState) -> Followed:
    """Follows a set, and says what has become of the model."""
    state = model.follow(seen)
    return Followed(state.gaussians, state.nodes, state.warnings, model.parameters_count)


if __name__ == "__main__":
    status = main()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(status)  # without the second that torch takes to end
