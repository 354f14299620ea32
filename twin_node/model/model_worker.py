"""The process that `ModelProcess` begins: it takes a window model, and follows with it what it is handed."""

from __future__ import annotations

import gc
import os
import traceback
from multiprocessing.connection import Connection

from twin_node.errors import TwinError
from twin_node.model.kernels import kernels
from twin_node.model.model_process import Followed
from twin_node.model.window_model import WindowModel
from twin_node.runtime.copies import receive, send
from twin_node.runtime.image_threads import image_loops_alone
from twin_node.runtime.memory import peak_mb
from twin_node.runtime.worker_process import READY, Failed, run
from twin_node.scene import TwinState

NICENESS = 5
"""Of a processor that both want, who hands it sets gets three quarters: that is what the arm waits for. On two
processors it is told of up to a tenth more sets than without, and as many are followed."""
LEAST = 8
"""Slices of what can wait after each set: the next is here as soon as one is out, so that there is hardly time."""


def main(connection: Connection) -> None:
    """The process's work."""
    image_loops_alone()
    os.nice(NICENESS)
    kernels()
    send(connection, READY)
    serve(connection)


def serve(connection: Connection) -> None:
    """Takes a model and then sets, until the other end is closed, or something fails that no set is to blame for.

    Another model takes the place of the one before.
    """
    model = _lasting(receive(connection))
    while True:
        seen = receive(connection)
        if isinstance(seen, WindowModel):
            gc.unfreeze()
            model = _lasting(seen)
            continue
        try:
            send(connection, follow(model, seen))
            model.refine(lambda: not connection.poll(), LEAST)
        except ConnectionError:
            raise
        except Exception:  # whatever it is ends this process, and who has begun it raises it
            return send(connection, Failed(traceback.format_exc()))


def _lasting(model: WindowModel) -> WindowModel:
    """The model; what is there now lives as long as it, and is never gone through in search of what can go."""
    gc.collect()
    gc.freeze()
    return model


def follow(model: WindowModel, seen: TwinState) -> Followed | Failed:
    """Follows a set, and says what has become of the model, or what is wrong with the set."""
    try:
        state = model.follow(seen)
    except TwinError as error:
        return Failed(error)
    return Followed(state.gaussians, state.nodes, state.warnings, model.parameters_count, peak_mb())


if __name__ == "__main__":
    run(main)
