"""What cameras do not see: space that is told as unknown, and space that something may hide in."""

from __future__ import annotations

from typing import NamedTuple

from twin_node.forecast.bits import Bits
from twin_node.forecast.kernel_requests import ConcealRequest
from twin_node.forecast.kernels import kernels
from twin_node.forecast.verdicts import Carved
from twin_node.native_library import addresses_of


class Concealed(NamedTuple):
    """What one state does not show."""

    hiding: Bits
    """Unknown, and nothing stands there."""
    unseen: Bits
    """The same, what all views see on the arm but is not, and rims that were unseen before.

    What moves passes before its rims, and leaves them unseen.
    """


def concealed(carved: Carved, knows_arm: bool, stands: Bits, before: Bits) -> Concealed:
    """What a carved state does not show, where some space `stands`, and some was unseen `before`.

    What all views see on the arm counts as the arm, unless its own space is known. It is told as unknown then, and is
    no hiding place: it surrounds the arm closely, and would join all of its shadows. Compiled; `concealed_reference`
    where that cannot be.
    """
    compiled = kernels()
    if compiled is None:
        return concealed_reference(carved, knows_arm, stands, before)
    on_arm = carved.on_arm.words if knows_arm else None
    found = Concealed(Bits.room(stands.dims), Bits(stands.dims, before.words.copy()))
    masks = (carved.unknown.words, carved.may_move.words, carved.likely_moves.words, on_arm, stands.words)
    compiled.run(ConcealRequest(stands.words.size, *addresses_of(*masks, found.hiding.words, found.unseen.words)))
    return found


def concealed_reference(carved: Carved, knows_arm: bool, stands: Bits, before: Bits) -> Concealed:
    """What `concealed` does."""
    hiding = carved.unknown.without(stands)
    behind = carved.may_move.without(carved.likely_moves) & before
    if knows_arm:
        behind = behind | carved.on_arm
    return Concealed(hiding, hiding | behind.without(stands))
