"""Logs as `view`, `render` and `export` open them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from twin_node.cli.output import warn

if TYPE_CHECKING:
    from twin_node.nodes.playback import Playback


@contextmanager
def open_playback(
    logs: Sequence[Path],
    width: int | None = None,
    rig: Path | None = None,
    with_images: bool = True,
    *,
    remaps: Sequence[str],
) -> Iterator[Playback]:
    """The logs of a run, open; says what of them cannot be read: at once, or at the end where only reading told.

    Says too which of them are of another time, or stamped by another clock: what they show would be of no time of it.
    `width`: of the images, px; `rig`: a rig file; without images no calibration is needed; `remaps`: FROM:=TO.
    """
    from twin_node.nodes.playback import Playback
    from twin_node.nodes.topics import parse_remaps

    with Playback(logs, width, rig, with_images, parse_remaps(remaps)) as playback:
        known = playback.damage
        warn(*known, *playback.left_out, *playback.apart, *playback.doubts)
        try:
            yield playback
        finally:
            warn(*(damage for damage in playback.damage if damage not in known))
