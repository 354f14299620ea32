"""What a run in the cell is judged by: contacts, distances, work, and how quickly the arm is slowed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin_node.arm.narrow import segment_distances
from twin_node.bench.cell_case import CellCase
from twin_node.cell.closed_loop import STEP_NS, LoopRecord
from twin_node.cell.shadow import Shadow
from twin_node.robot import ArmModel, forward_kinematics, place_capsules
from twin_node.scene import HORIZONS_NS, Bool, Float64

MOVES_M_S = 0.01
"""An arm no point of which is faster than this stands."""
_SAME_CONTACT_S = 0.5
"""Touches less than this apart are one contact."""
_SLOWER = 0.02
"""Drop of the speed share that counts as slowing down."""
_FALSE_STOP_SHARE = 0.5
"""A stop is false where the law with unlimited foresight would have allowed more than this share at the same moment."""
_JUST_BEFORE = 25
"""Steps, 0.2 s: an arm that dwelt in its program when it was stopped was not stopped by it."""
_AWAIT_S = 0.5
"""How long a slow-down is waited for after a person's entry, s."""


@dataclass(frozen=True)
class Outcome:
    """How one run went."""

    contacts: int
    """Contacts of arm and person while the arm moved, first sight at least reaction and stopping time before."""
    unwarned_contacts: int
    """Those that came sooner after the first sight, or without any."""
    standing_contacts: int
    """Times that a person touched the arm while it stood."""
    progress_s: float
    """Program time gone through, s."""
    min_distance_m: float
    """Smallest distance of arm and people while the arm moved; infinite without people or motion."""
    stop_distances_m: tuple[float, ...]
    """Distance of arm and people whenever the arm had come to rest for somebody."""
    false_stops: int
    """Stops that unlimited foresight would not have made."""
    delays_s: tuple[float, ...]
    """From each entry into the required separation to the next slower command."""
    unanswered: int
    """Entries that no slower command followed, one that came before them or none at all."""


def score(case: CellCase, record: LoopRecord, first_seen_s: float = 0.0, with_delays: bool = False) -> Outcome:
    """Judges a run against the truth; `with_delays` also measures slow-downs, which takes as long as the run itself.

    `first_seen_s` is when perception first saw anybody, after the start.
    """
    q = case.joints(record)
    moves = _speeds(case, q) > MOVES_M_S
    distances = distances_to_people(case, record, q)
    seconds = (record.stamps - case.scenario.start_ns) * 1e-9
    warned = seconds >= first_seen_s + (case.timing.latency_ns + case.timing.until_standstill_ns) * 1e-9
    touching = distances <= 0
    stops = _stops(record, moves)
    delays = _delays(case, record) if with_delays else np.empty(0)
    return Outcome(
        contacts=_episodes(touching & moves & warned),
        unwarned_contacts=_episodes(touching & moves & ~warned),
        standing_contacts=_episodes(touching & ~moves),
        progress_s=record.progress_s,
        min_distance_m=float(distances[moves].min(initial=np.inf)),
        stop_distances_m=tuple(float(distance) for distance in distances[stops] if np.isfinite(distance)),
        false_stops=sum(_is_false(case, record, int(stop)) for stop in stops),
        delays_s=tuple(float(delay) for delay in delays[np.isfinite(delays)]),
        unanswered=int((~np.isfinite(delays)).sum()),
    )


def distances_to_people(case: CellCase, record: LoopRecord, q: Float64) -> Float64:
    """Exact distances [T] (m) of the arm's moving links to the nearest person; infinite without people."""
    return gaps_to_people(case.arm.model, case.shadow, record.stamps, q)


def gaps_to_people(model: ArmModel, shadow: Shadow, stamps: NDArray[np.int64], q: Float64) -> Float64:
    """The same [T] of joint angles [T, J] (rad) at stamps [T] (ns) of the people's clock."""
    placed = place_capsules(model, forward_kinematics(model, q))
    links = placed.links > 0
    ends, radii = placed.ends[:, links], placed.radii[links]
    frames = np.array([shadow.frame(int(stamp)) for stamp in stamps], np.int64)
    limbs = shadow.limbs(frames)
    if not len(limbs.radii) or not len(stamps):
        return np.full(len(stamps), np.inf)
    gaps = segment_distances(ends[:, :, None], limbs.ends[:, None]) - radii[:, None] - limbs.radii
    nearest: Float64 = gaps.min(axis=(1, 2))
    return nearest


def _speeds(case: CellCase, q: Float64) -> Float64:
    """Speed [T] of the arm's fastest point, m/s."""
    ends = place_capsules(case.arm.model, forward_kinematics(case.arm.model, q)).ends
    ways = np.linalg.norm(np.diff(ends, axis=0, append=ends[-1:]), axis=-1).max(axis=(1, 2))
    speeds: Float64 = ways / (STEP_NS * 1e-9)
    return speeds


def _episodes(flags: Bool) -> int:
    """Number of runs of True, those close together counted once."""
    rows = np.flatnonzero(flags)
    return int((np.diff(rows, prepend=-(10**9)) * STEP_NS * 1e-9 > _SAME_CONTACT_S).sum())


def _stops(record: LoopRecord, moves: Bool) -> NDArray[np.int64]:
    """Rows at which the arm, having moved just before, is at rest because it was told to be."""
    stands = np.flatnonzero((record.shares[1:] <= 0) & (record.shares[:-1] > 0)) + 1
    moved = [bool(moves[max(row - _JUST_BEFORE, 0) : row].any()) for row in stands]
    return np.asarray(stands[np.array(moved, dtype=bool)], dtype=np.int64)


def _is_false(case: CellCase, record: LoopRecord, stop: int) -> bool:
    """Whether unlimited foresight would have gone on when the stop was commanded."""
    row = stop
    while row > 0 and record.told[row - 1] <= 0:
        row -= 1
    ahead_ns = case.timing.until_standstill_ns
    return case.share_by_truth(int(record.stamps[row]), float(record.phases_ns[row]), ahead_ns) > _FALSE_STOP_SHARE


def _delays(case: CellCase, record: LoopRecord) -> Float64:
    """Per entry into the required separation, the time [n] to the slower command (s); infinite where none came.

    Entered is what the law, without latency, with true obstacles and their true motion for 200 ms, forbids at the speed
    that the arm has been told.
    """
    every = case.parameters.decision_steps
    forbidden = np.array([_is_forbidden(case, record, row) for row in range(0, len(record.stamps), every)])
    entries = np.flatnonzero(forbidden[1:] & ~forbidden[:-1]) + 1
    return np.array([_delay(case, record, int(entry) * every) for entry in entries])


def _delay(case: CellCase, record: LoopRecord, entry: int) -> float:
    """Time from an entry, known to a step, to the command that was slower than the one before it."""
    for row in range(entry - 1, entry - case.parameters.decision_steps, -1):
        if not _is_forbidden(case, record, row):
            break
        entry = row
    last = min(entry + int(_AWAIT_S * 1e9 / STEP_NS), len(record.told) - 1)
    slower = np.flatnonzero(record.told[entry : last + 1] < _told_before(record, entry) - _SLOWER)
    return float(slower[0]) * STEP_NS * 1e-9 if len(slower) else np.inf


def _told_before(record: LoopRecord, row: int) -> float:
    return float(record.told[max(row - 1, 0)])


def _is_forbidden(case: CellCase, record: LoopRecord, row: int) -> bool:
    """Whether the true separation at a row is less than required at the speed that the arm was told until then."""
    told = _told_before(record, row)
    if told <= _SLOWER:
        return False
    allowed = case.share_by_truth(int(record.stamps[row]), float(record.phases_ns[row]), HORIZONS_NS[-1])
    return allowed < told - _SLOWER
