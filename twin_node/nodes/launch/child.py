"""A process of a launch as its launcher sees it."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

from twin_node.nodes.launch.order import Order

GRACE_S = 5.0
"""How long a process may take to deactivate and clean up its nodes before it is killed."""


LAST_WORDS_S = 1.0
"""How long a process that has ended is listened to, s; what it has said takes no time, unless somebody else holds its
pipe open."""


class Child:
    """A spawned process: its orders go down a pipe, its events come up one, its output goes to a log."""

    def __init__(
        self, name: str, order: Order, log: Path, on_news: Callable[[], None], on_word: Callable[[str], None]
    ) -> None:
        """`on_news()` is called, in a thread of the child's, when it has loaded or configured nodes, and at its end.

        `on_word(line)` is called there with what its nodes tell the user, and here where `log` cannot be written to.
        Raises `OSError` where there is no room for another process.
        """
        self.name = name
        self.is_loaded = False
        self.is_configured = False
        self.is_active = False
        self.error: str | None = None
        """What it failed of, as far as it could say."""
        self.has_pulsed = False
        """Whether it has told that it does not hang since this was last made false."""
        self.silence_s = 0.0
        """For how long its launcher has heard nothing of it, s."""
        self._lock = threading.Lock()
        self._is_wanted = False
        """Whether it is to make its nodes as soon as it has loaded them: till then it holds nothing."""
        self._on_news = on_news
        self._on_word = on_word
        read_fd, write_fd = os.pipe()
        try:
            with _opened(log, on_word) as output:
                self._process = subprocess.Popen(
                    [sys.executable, "-u", "-m", "twin_node.nodes.launch.host", str(write_fd)],
                    stdin=subprocess.PIPE,
                    stdout=output,
                    stderr=subprocess.STDOUT,
                    pass_fds=(write_fd,),
                    process_group=0,  # not a session: Linux shares processors among these first, then by niceness
                )
        except BaseException:
            os.close(read_fd)
            raise
        finally:
            os.close(write_fd)
        self._say(order.to_json())
        self._listener = threading.Thread(target=self._listen, args=(read_fd,), name=f"{name} events", daemon=True)
        self._listener.start()

    @property
    def pid(self) -> int:
        """Process identifier."""
        return self._process.pid

    @property
    def status(self) -> int | None:
        """Exit status; None while it runs."""
        return self._process.poll()

    def hear_out(self) -> None:
        """Waits until all is heard that a process has said which has ended: its end may be known before its reason."""
        self._listener.join(LAST_WORDS_S)

    def configure(self) -> None:
        """Lets its nodes join the graph, once it has loaded them."""
        with self._lock:
            self._is_wanted = True
            if self.is_loaded:
                self._say("configure")

    def activate(self) -> None:
        """Lets its nodes begin."""
        self.is_active = True
        self._say("activate")

    def stop(self) -> None:
        """Leads its nodes through deactivate and cleanup; kills it where that takes too long, or there are none yet."""
        with self._lock:
            self._is_wanted = False
            if not self.is_loaded:
                self.discard()
                return
        if self._process.stdin is not None and not self._process.stdin.closed:
            with contextlib.suppress(BrokenPipeError):  # it has gone by itself
                self._process.stdin.close()
        try:
            self._process.wait(GRACE_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def give_up(self) -> None:
        """Ends a process that hangs, without waiting for that: it has failed of it."""
        self.error = "it hung, and was ended"
        self._process.kill()

    def discard(self) -> None:
        """Ends a process whose nodes were never configured: it holds nothing that must be led down."""
        self._process.kill()
        self._process.wait()

    def _say(self, line: str) -> None:
        assert self._process.stdin is not None
        with contextlib.suppress(BrokenPipeError):  # it has ended; its listener tells
            self._process.stdin.write(line.encode() + b"\n")
            self._process.stdin.flush()

    def _listen(self, read_fd: int) -> None:
        with os.fdopen(read_fd) as events:
            for line in events:
                if not line.endswith("\n"):
                    break  # it was killed in the middle of it
                event = json.loads(line)
                if event["event"] == "loaded":
                    self._on_loaded()
                elif event["event"] == "configured":
                    self.is_configured = True
                elif event["event"] == "pulse":
                    self.has_pulsed = True
                    continue
                elif event["event"] == "said":
                    self._on_word(event["text"])
                else:
                    self.error = event["error"]
                self._on_news()
        self._process.wait()
        self._on_news()

    def _on_loaded(self) -> None:
        with self._lock:
            self.is_loaded = True
            if self._is_wanted:
                self._say("configure")


def _opened(log: Path, on_word: Callable[[str], None]) -> BinaryIO:
    """The log, in a folder that is made anew where it was cleared away; nowhere, and told, where none can be."""
    try:
        log.parent.mkdir(parents=True, exist_ok=True)
        return log.open("ab")
    except OSError as error:
        on_word(f"no log is kept: {log} cannot be written ({error.strerror})")
        return Path(os.devnull).open("ab")
