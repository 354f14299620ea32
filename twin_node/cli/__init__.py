"""The command `twin_node`: a module per group of subcommands; wrong input becomes one line and exit status 2."""

from __future__ import annotations

import argparse
import errno
import io
import os
import select
import sys
import tempfile
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TextIO

from twin_node import __version__
from twin_node.cli.ending import Terminated, ended_in_order
from twin_node.cli.parser import Parser, with_home
from twin_node.collecting import collect_rarely
from twin_node.errors import TwinError, TwinWarning

_UNREACHABLE = (errno.EACCES, errno.ENAMETOOLONG)
"""Why nobody can tell whether there is something at a path, which is then asked for anywhere."""
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
"""Why what a command prints cannot be kept where the user sends it."""


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; returns the exit status: 0 done, 2 wrong input, 130 interrupted, or the command's own.

    143 and 129 where SIGTERM or SIGHUP has ended it, in order too; 141 where who reads what it prints has gone
    (`twin_node info LOG | head -1`), as if SIGPIPE had ended it.
    """
    collect_rarely()
    _replace_closed()
    if isinstance(sys.stdout, io.TextIOWrapper) and sys.stdout.errors == "strict":
        sys.stdout.reconfigure(errors="backslashreplace")  # names of files may hold what the terminal has no letter for
    try:
        with ended_in_order(), _warnings_in_words():
            options = with_home(_parser().parse_args(arguments))
            status = options.run(options)
            sys.stdout.flush()
    except TwinError as error:
        print(f"twin_node: error: {error}", file=sys.stderr)
        return 2
    except (KeyboardInterrupt, Terminated, ImportError) as error:
        end = _end_of(error)
        if end is None:
            raise
        print(f"twin_node: {'terminated' if isinstance(end, Terminated) else 'interrupted'}", file=sys.stderr)
        return end.status if isinstance(end, Terminated) else 130
    except BrokenPipeError:
        if not _is_unread():
            raise
        return 141
    except OSError as error:
        told = _told_of_disk(error)
        if told is None:
            raise
        print(f"twin_node: error: {told}", file=sys.stderr)
        return 2
    return status if isinstance(status, int) else 0


@contextmanager
def _warnings_in_words() -> Iterator[None]:
    """A `TwinWarning` is told in one line, as errors are; all others are told as Python does."""
    told = warnings.showwarning

    def tell(
        message: Warning | str,
        category: type[Warning],
        filename: str,
        lineno: int,
        file: TextIO | None = None,
        line: str | None = None,
    ) -> None:
        if issubclass(category, TwinWarning):
            from twin_node.cli.output import warn

            warn(message)
        else:
            told(message, category, filename, lineno, file, line)

    with warnings.catch_warnings():
        warnings.showwarning = tell
        yield


def _replace_closed() -> None:
    """What was closed by who started us (`<&-`, `>&-`) leads nowhere, and not to the next file that is opened."""
    if sys.stdin is None:
        sys.stdin = os.fdopen(os.open(os.devnull, os.O_RDONLY), encoding="utf-8")
    if sys.stdout is None:
        sys.stdout = os.fdopen(os.open(os.devnull, os.O_WRONLY), "w", encoding="utf-8")
    if sys.stderr is None:
        sys.stderr = os.fdopen(os.open(os.devnull, os.O_WRONLY), "w", encoding="utf-8")


def _end_of(error: BaseException | None) -> KeyboardInterrupt | Terminated | None:
    """The interrupt that it is, or comes of: compiled modules make an `ImportError` of one while they load."""
    while not (error is None or isinstance(error, KeyboardInterrupt | Terminated)):
        error = error.__cause__
    return error


def _is_unread() -> bool:
    """Whether nobody reads the output any more; what waits for it is thrown away then."""
    output, poll = sys.stdout.fileno(), select.poll()
    poll.register(output, 0)
    if not any(event & select.POLLERR for _, event in poll.poll(0)):
        return False
    _throw_output_away()
    return True


def _told_of_disk(error: OSError) -> str | None:
    """What a user can do about a disk, or a place on it, that is to blame; None where another thing is."""
    if error.errno in _FULL and error.filename is None:
        _throw_output_away()
        return f"no room for what it writes: {error.strerror}; free some"
    if error.errno in _UNREACHABLE and error.filename is not None:
        return f"{error.filename}: {error.strerror}; check the path"
    try:
        tempfile.gettempdir()
    except OSError:  # then torch and Matplotlib do not load
        return "no folder takes temporary files ($TMPDIR, /tmp, /var/tmp); free space, or set TMPDIR to one that does"
    return None


def _throw_output_away() -> None:
    """What waits to be printed goes nowhere: it could not be written, and would not be at the end."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _parser() -> argparse.ArgumentParser:
    # Loaded here, where an interrupt meanwhile ends like one later.
    from twin_node.cli.acknowledge import add_acknowledge
    from twin_node.cli.bag import add_play, add_record
    from twin_node.cli.bake import add_bake
    from twin_node.cli.bench import add_bench
    from twin_node.cli.calibrate import add_calibrate
    from twin_node.cli.doctor import add_doctor
    from twin_node.cli.edit import add_edit
    from twin_node.cli.export import add_export
    from twin_node.cli.graph import add_lifecycle, add_param
    from twin_node.cli.imports import add_import
    from twin_node.cli.launch import add_launch
    from twin_node.cli.logs import add_check, add_info
    from twin_node.cli.render import add_render
    from twin_node.cli.replay import add_demo, add_replay
    from twin_node.cli.sim import add_sim
    from twin_node.cli.train import add_train
    from twin_node.cli.ur_driver import add_ur_driver
    from twin_node.cli.ur_sim import add_ur_sim
    from twin_node.cli.view import add_view

    parser = Parser(prog="twin_node", description="A live 4D Gaussian twin of a robot cell.")
    parser.add_argument("--version", action="version", version=f"twin_node {__version__}")
    commands = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")
    for add in (
        *(add_replay, add_launch, add_record, add_play, add_info, add_check, add_doctor, add_param, add_lifecycle),
        *(add_import, add_demo, add_bench, add_calibrate, add_export, add_render, add_view),
        *(add_ur_driver, add_acknowledge, add_ur_sim, add_sim, add_train, add_bake, add_edit),
    ):
        add(commands)
    return parser
