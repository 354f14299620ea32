"""`twin_node train`: a whole recording becomes a 4D model, offline."""

from __future__ import annotations

import argparse
import contextlib
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any

from tqdm import tqdm

from twin_node.cli.arguments import add_remap, check_output, refuse_given, seed, whole, width, with_given
from twin_node.cli.ending import SIGNALS, ended_by
from twin_node.errors import several

if TYPE_CHECKING:
    from twin_node.model.sequence import Recording, Trainer

DEFAULT_WIDTH = 320
"""Width in pixels at which a few thousand steps take minutes on two CPU cores."""
SAVE_EVERY_S = 60.0
"""Time from one checkpoint to the next, s: what a power cut costs, for less than a hundredth of the work."""
SCORED = 60
"""Held-out images that the closing score is taken over, at most, evenly over time."""


def add_train(commands: Any) -> None:
    """Adds `train` to the subcommands."""
    train = commands.add_parser("train", help="learn a whole recording offline: 4DGS on planes or a hash grid")
    train.add_argument(
        "data",
        type=Path,
        metavar="DATA",
        help="log, or folder in the layout of Neural 3D Video, D-NeRF or COLMAP with images per time",
    )
    train.add_argument(
        "-o", "--output", type=Path, required=True, metavar="OUT.safetensors", help="checkpoint to write"
    )
    train.add_argument(
        "--method", choices=("hexplane", "hash", "static"), help="field of deformation (default hexplane)"
    )
    train.add_argument("--steps", type=whole, metavar="N", help="steps with the field (default 3000)")
    train.add_argument(
        "--width",
        type=width,
        default=DEFAULT_WIDTH,
        metavar="PX",
        help=f"width of the images (default {DEFAULT_WIDTH})",
    )
    train.add_argument("--frames", type=whole, metavar="N", help="take the first N time steps only")
    train.add_argument(
        "--hold-out", action="append", metavar="CAMERA", help="never train on this camera, score on it; repeatable"
    )
    train.add_argument("--gaussians", type=whole, metavar="N", help="at most N Gaussians (default 20000)")
    train.add_argument("--rig", type=Path, metavar="RIG.yaml", help="calibration, instead of the log's own")
    add_remap(train)
    train.add_argument("--resume", type=Path, metavar="FILE", help="go on from this checkpoint; exactly, on its device")
    train.add_argument("--device", metavar="NAME", help="torch device, such as cuda (default cpu, or that of --resume)")
    train.add_argument("--seed", type=seed, metavar="N", help="seed of all random numbers (default 0)")
    train.set_defaults(run=_train)


def _train(options: argparse.Namespace) -> None:
    from twin_node.model.sequence import SUFFIX, ReadOptions, save_checkpoint
    from twin_node.nodes.recordings import read_recording
    from twin_node.nodes.synchronizer import SynchronizerParameters
    from twin_node.nodes.topics import parse_remaps

    check_output(options.output, SUFFIX)
    trainer_of = _trainer_of(options)
    hold_out = None if options.hold_out is None else tuple(options.hold_out)
    reading = ReadOptions(options.width, options.frames, hold_out)
    parameters = SynchronizerParameters(width=options.width)
    recording = read_recording(options.data, reading, parameters, options.rig, parse_remaps(options.remap))
    print(
        f"{options.data}: {several(len(recording.train), 'image')} at {several(recording.steps, 'time')} to learn "
        f"from, {len(recording.held_out)} held out"
    )
    trainer = trainer_of(recording)
    with (
        _ended_between_steps() as ended_by_signal,
        tqdm(total=trainer.parameters.all_steps, initial=trainer.step, unit="step", disable=None) as bar,
    ):
        saved_s = time.monotonic()
        while not trainer.finished and ended_by_signal() is None:
            loss = trainer.advance()
            bar.update()
            bar.set_postfix(loss=f"{loss:.4f}", gaussians=len(trainer.model.gaussians), refresh=False)
            if time.monotonic() - saved_s >= SAVE_EVERY_S:
                save_checkpoint(trainer, options.output)
                saved_s = time.monotonic()
        save_checkpoint(trainer, options.output)
        number = ended_by_signal()
        if number is not None:
            raise ended_by(number)
    _report(trainer, options.output)


@contextlib.contextmanager
def _ended_between_steps() -> Iterator[Callable[[], int | None]]:
    """What ends a command, Ctrl-C or a terminal that was closed, waits for the end of a step: what is saved in the
    middle of one would not go on as if nothing had been.

    Gives what tells the signal that came; a second one waits for nothing, and leaves the last checkpoint as it is: but
    of a terminal that was closed both itself and the shell tell. One that is ignored (`nohup`) stays so.
    """
    came: list[int] = []

    def wait(number: int, _: FrameType | None) -> None:
        came.append(number)
        restore()
        if number == signal.SIGHUP:
            signal.signal(number, signal.SIG_IGN)

    def restore() -> None:
        for number, handler in before.items():
            signal.signal(number, handler)

    before = {number: signal.getsignal(number) for number in (signal.SIGINT, *SIGNALS)}
    for number, handler in before.items():
        if handler is not signal.SIG_IGN:
            signal.signal(number, wait)
    try:
        yield lambda: came[0] if came else None
    finally:
        restore()


def _trainer_of(options: argparse.Namespace) -> Callable[[Recording], Trainer]:
    """What gives a recording a new trainer, or the one of `--resume`; what the options leave out stays as it is.

    Refuses what is wrong with any of them at once: images may take minutes to be read.
    """
    from twin_node.model.devices import usable_device
    from twin_node.model.sequence import Trainer, TrainParameters, load_checkpoint

    if options.resume is not None:
        why = f"expected without --resume, which goes on as {options.resume} began"
        refuse_given(options, ("method", "seed", "gaussians"), why)
        checkpoint = load_checkpoint(options.resume)
        usable_device(checkpoint.continued(options.steps, options.device).device)
        return lambda recording: checkpoint.resume(recording, options.steps, options.device)
    parameters = with_given(
        TrainParameters(),
        method=options.method,
        steps=options.steps,
        seed=options.seed,
        device=options.device,
        most_gaussians=options.gaussians,
        start_gaussians=options.gaussians and min(TrainParameters.start_gaussians, options.gaussians),
    )
    usable_device(parameters.device)
    return lambda recording: Trainer(recording, parameters)


def _report(trainer: Trainer, path: Path) -> None:
    """Says what came of it, on images that were held out or else on those learnt from."""
    from twin_node.model.sequence.scoring import evenly, mean_psnr

    recording, model = trainer.recording, trainer.model
    views = recording.held_out or recording.train
    kind = "held-out" if recording.held_out else "training"
    chosen = evenly(views, SCORED)
    print(
        f"{path}: {len(model.gaussians)} Gaussians, {model.parameters_count} parameters, "
        f"PSNR {mean_psnr(model, chosen):.2f} dB on {several(len(chosen), f'{kind} image')}"
    )
    if trainer.refused:
        print(f"not taken: {several(trainer.refused, 'step')} whose gradients were not finite")
