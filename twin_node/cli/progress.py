"""Progress of what counts how far it is."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Iterator
from typing import Any

from tqdm import tqdm


@contextlib.contextmanager
def counted(description: str, unit: str) -> Iterator[Callable[[int, int], None]]:
    """A bar that is told how many of how many are done; none where nobody looks."""
    with tqdm(desc=description, unit=unit, disable=None) as bar:

        def show(done: int, total: int) -> None:
            bar.total = total
            bar.update(done - bar.n)

        yield show


def over(unit: str) -> Callable[..., Any]:
    """What goes through things, so many in all, under a bar that counts them; none where nobody looks."""

    def bar(things: Iterable[Any], total: int | None = None) -> Any:
        return tqdm(things, total=total, unit=unit, disable=None)

    return bar
