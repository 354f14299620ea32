"""How the command line is read: options anywhere between the other arguments, and `~` wherever a path is."""

from __future__ import annotations

import argparse
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any


class Parser(argparse.ArgumentParser):
    """Takes a command's arguments before, after and between its options: `render TWIN -o FILM LOG`."""

    _is_within = False

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        # argparse takes -1e-3, -5. and -inf for options, of which it knows none.
        self._negative_number_matcher = re.compile(r"-(\.?[0-9]|inf|nan)")

    def parse_known_args(  # type: ignore[override]
        self, args: Sequence[str] | None = None, namespace: argparse.Namespace | None = None
    ) -> tuple[argparse.Namespace, list[str]]:
        """Options and arguments, and what is neither.

        Read in order are commands of commands, and those one of whose options stands in for an argument.
        """
        if self._is_within or self._subparsers is not None:
            return super().parse_known_args(args, namespace)
        self._is_within = True  # what takes them in any order comes back here, for the options and for the rest
        try:
            return self.parse_known_intermixed_args(args, namespace)
        except TypeError:  # argparse's, before it reads anything, of a group that holds an argument
            return super().parse_known_args(args, namespace)
        finally:
            self._is_within = False


def with_home(options: argparse.Namespace) -> argparse.Namespace:
    """The options with the home folder where a path begins with `~`: no shell fills it in after `=` or `:=`."""
    return argparse.Namespace(**{name: _with_home(value) for name, value in vars(options).items()})


def _with_home(value: Any) -> Any:
    if isinstance(value, list):
        return [_with_home(one) for one in value]
    return at_home(value) if isinstance(value, Path) else value


def at_home(path: Path) -> Path:
    """The path with the home folder in place of a `~` that it begins with; no other `~` means one."""
    return path.expanduser() if path.parts[:1] == ("~",) else path
