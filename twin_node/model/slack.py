"""Whether there is time, after a set's state is out, for what can wait: what is left of it is let be, in turn."""

from __future__ import annotations

from typing import Any

from twin_node.model.stages import Proceed, unhurried

AT_EASE = 3
"""Sets in a row after which none waited, before one that comes meanwhile puts off what is left. Where sets wait oftener
each does all that it has begun: births that are put off cost what moves half a decibel there."""


class Slack:
    """The time between two sets, set by set."""

    def __init__(self) -> None:
        self.put_off = 0
        """Sets in a row after which there was no time, or not for all."""
        self._at_ease = 0
        """Sets in a row after which none waited."""
        self._gives_way = False
        self._proceed: Proceed = unhurried

    def __getstate__(self) -> dict[str, Any]:
        """In another process nobody asks what was asked here."""
        return {**vars(self), "_proceed": unhurried}

    @property
    def is_at_ease(self) -> bool:
        """Whether no set has waited of late: there is more time between two than they take."""
        return self._at_ease >= AT_EASE

    def begin(self, proceed: Proceed) -> None:
        """A set is out; `proceed()` says whether none waits."""
        was_put_off = self.put_off > 0
        self._proceed = proceed
        self.put_off = 0 if proceed() else self.put_off + 1
        self._at_ease = 0 if self.put_off else self._at_ease + 1
        self._gives_way = not was_put_off and self.is_at_ease

    def lasts(self) -> bool:
        """Whether there was time and still is; once a set has come meanwhile, there is none for what is left."""
        if not self.put_off and self._gives_way and not self._proceed():
            self.put_off = 1
        return not self.put_off
