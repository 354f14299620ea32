"""A log on the page: play, pause, step, seek and speed."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

from twin_node.errors import TwinError
from twin_node.nodes.playback import Playback
from twin_node.nodes.viewer.page import CellPage

FRAME_S = 1 / 30
"""Time between two pictures while playing, s."""
SPEEDS = (0.1, 0.25, 0.5, 1.0, 2.0, 4.0)


class LogViewer:
    """Shows a playback on a page until it is stopped; at the end of the log it starts anew."""

    def __init__(self, playback: Playback, page: CellPage) -> None:
        self._playback = playback
        self._page = page
        self._length_s = (playback.end_ns - playback.start_ns) / 1e9
        self._at_s = 0.0
        self._is_playing = False
        self._speed = 1.0
        self._wanted: threading.Event = threading.Event()
        self._stopped = threading.Event()
        self._sought: float | None = 0.0
        with page.server.gui.add_folder("Time", order=-1):
            self._add_controls(page.server.gui)

    def run(self, is_over: Callable[[], bool] = lambda: False) -> None:
        """Draws until `stop` is called or `is_over()`; a picture takes as long as it takes, and time goes on meanwhile.

        `is_over()` is asked before every picture; unlike `stop` it may be decided in a handler of signals. What of a
        picture cannot be shown is told on the page.
        """
        drawn_s: float | None = None
        before = time.monotonic()
        while not (self._stopped.is_set() or is_over()):
            now = time.monotonic()
            self._advance((now - before) * self._speed)
            before = now
            if self._page.take_change() or drawn_s != self._at_s:
                self._draw()
                drawn_s = self._at_s
            self._wanted.wait(max(FRAME_S - (time.monotonic() - now), 0.001))
            self._wanted.clear()

    def _draw(self) -> None:
        problem = None
        try:
            self._page.show(self._playback.at(self._playback.start_ns + round(self._at_s * 1e9)))
        except TwinError as error:  # of one message: other times may be sound, and the page says what was wrong
            problem = str(error)
        self._page.tell(problem or "; ".join(self._playback.damage) or None)

    def stop(self) -> None:
        """Ends `run`; may be called from any thread."""
        self._stopped.set()
        self._wanted.set()

    def seek(self, seconds: float) -> None:
        """Shows a time, s after the log's start; may be called from any thread."""
        self._sought = min(max(seconds, 0.0), self._length_s)
        self._wanted.set()

    def play(self, is_playing: bool) -> None:
        """Plays or pauses; may be called from any thread."""
        self._is_playing = is_playing
        self._play.label = "Pause" if is_playing else "Play"

    def _advance(self, seconds: float) -> None:
        if self._sought is not None:
            self._at_s, self._sought = self._sought, None
            self._slider.value = round(self._at_s, 2)
        elif self._is_playing:
            self._at_s = self._at_s + seconds if self._at_s < self._length_s else 0.0
            self._at_s = min(self._at_s, self._length_s)
            self._slider.value = round(self._at_s, 2)

    def _add_controls(self, gui: Any) -> None:
        self._play = gui.add_button("Play")
        self._play.on_click(lambda _event: self.play(not self._is_playing))
        step = gui.add_button_group("Step", ("-1 s", "-1 frame", "+1 frame", "+1 s"))
        steps = {"-1 s": -1.0, "-1 frame": -FRAME_S, "+1 frame": FRAME_S, "+1 s": 1.0}
        step.on_click(lambda event: self._step(steps[event.target.value]))
        self._slider = gui.add_slider("s", 0.0, max(round(self._length_s, 2), 0.01), 0.01, 0.0)
        self._slider.on_update(self._on_slider)
        speed = gui.add_dropdown("Speed", [f"{s:g} x" for s in SPEEDS], initial_value="1 x")
        speed.on_update(lambda _event: setattr(self, "_speed", float(speed.value.removesuffix(" x"))))

    def _step(self, seconds: float) -> None:
        self.play(False)
        sought = self._sought  # by a step before, which is not drawn yet
        self.seek((self._at_s if sought is None else sought) + seconds)

    def _on_slider(self, event: Any) -> None:
        if event.client_id is not None:  # moved by a visitor, not by `_advance`
            self.seek(self._slider.value)
