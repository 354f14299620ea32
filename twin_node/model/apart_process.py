"""The process that `Apart` begins: it takes a window model, and follows with it what it is handed, set by set."""

from __future__ import annotations

import contextlib
import gc
import os
import resource
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

NICENESS = 5
"""Of a processor that both want, who hands it sets gets three quarters: that is what the arm waits for. On two
processors it is told of up to a tenth more sets than without, and as many are followed."""
LEAST = 8
"""Slices of what can wait after each set: the next is here as soon as one is out, so that there is hardly time."""


def main() -> int:
    """The process; the only argument is the file descriptor of its end of the pipe, whose other end's close ends it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # of a terminal's group: who has begun it ends it
    image_loops_alone()
    os.nice(NICENESS)
    kernels()
    connection = Connection(int(sys.argv[1]))
    with contextlib.suppress(EOFError, ConnectionError):  # nobody hands it anything more
        send(connection, READY)
        serve(connection)
    return 0


def serve(connection: Connection) -> None:
    """Takes a model and then sets, until the other end is closed, or something fails that no set is to blame for."""
    model = connection.recv()
    gc.collect()
    gc.freeze()  # what is there now lives as long as the process
    while True:
        seen = connection.recv()
        try:
            send(connection, follow(model, seen))
            model.refine(lambda: not connection.poll(), LEAST)
        except ConnectionError:
            raise
        except Exception:  # whatever it is ends this process, and who has begun it raises it
            return send(connection, Failed(traceback.format_exc()))


def follow(model: WindowModel, seen: TwinState) -> Followed | Failed:
    """Follows a set, and says what has become of the model, or what is wrong with the set."""
    try:
        state = model.follow(seen)
    except TwinError as error:
        return Failed(error)
    peak_rss_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return Followed(state.gaussians, state.nodes, state.warnings, model.parameters_count, peak_rss_mb)


if __name__ == "__main__":
    status = main()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(status)  # without the second that torch takes to end
