"""Logs as `view`, `render` and `export` open them."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from twin_node.nodes.playback import Playback


@contextmanager
def open_playback(logs: Sequence[Path], width: int | None = None, rig: Path | None = None) -> Iterator[Playback]:
    """The logs of a run, open; says what of them cannot be read: at once, or at the end where only reading told.

    `width`: of the images, px; `rig`: a rig file.
    """
    from twin_node.nodes.playback import Playback

    with Playback(logs, width, rig) as playback:
        known = playback.damage
        _warn(known)
        try:
            yield playback
        finally:
            _warn([damage for damage in playback.damage if damage not in known])


def _warn(damages: Sequence[str]) -> None:
    for damage in damages:
        print(f"twin_node: warning: {damage}", file=sys.stderr)
