"""Ours beside 4DGS on planes that is trained on the window, where both are equally good."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from twin_node.bench.pareto.front import is_ours
from twin_node.bench.pareto.measure import OURS, Point
from twin_node.nodes.sizes import SHIPPED

HEXPLANE = "4dgs_hexplane"
MEASURES = ("psnr_moving_db", "psnr_left_out_db")
"""Of `Point`: what the two are equal in."""
PLATEAU_DB = 0.1
"""A training that reaches the best of all but for so much has reached what more of it brings."""


@dataclass(frozen=True)
class AgainstHexplane:
    """One of our sizes and one training of the planes that do equally well on the same data."""

    data: str
    measure: str
    """In `MEASURES`."""
    at: str
    """`ours`: the shortest training that reaches ours as shipped; `plateau`: the fastest of our sizes that reaches what
    the planes reach however long they are trained."""
    ours: str
    ours_db: float
    hexplane: str
    hexplane_db: float
    times_faster_per_set: float
    """Training of the planes over our time per set: what a new set costs a method that is trained on the window."""
    times_faster_amortised: float
    """The same with the training spread over all sets of the window, so that the newest comes a window late."""
    times_fewer_parameters: float | None


def against_hexplane(points: Sequence[Point]) -> list[AgainstHexplane]:
    """All pairs of equals; none where one of the two never reaches the other."""
    found: list[AgainstHexplane] = []
    for data in dict.fromkeys(point.data for point in points):
        of_data = sorted((p for p in points if p.data == data), key=lambda one: one.ms_per_frame)
        for measure in MEASURES:
            ours = [p for p in of_data if is_ours(p) and getattr(p, measure) is not None]
            planes = [p for p in of_data if p.name.split(":")[0] == HEXPLANE and getattr(p, measure) is not None]
            if ours and planes:
                found += _equals(measure, ours, planes)
    return found


def _equals(measure: str, ours: Sequence[Point], planes: Sequence[Point]) -> Iterator[AgainstHexplane]:
    """Pairs on one data set; both lists rise in time."""

    def db(point: Point) -> float:
        return float(getattr(point, measure))

    shipped = next((p for p in ours if p.name == f"{OURS}_{SHIPPED}"), None)
    trained = None if shipped is None else next((p for p in planes if db(p) >= db(shipped)), None)
    if shipped is not None and trained is not None:
        yield _pair(measure, "ours", shipped, trained)
    best = max(db(p) for p in planes)
    plateau = next(p for p in planes if db(p) >= best - PLATEAU_DB)
    size = next((p for p in ours if db(p) >= db(plateau)), None)
    if size is not None:
        yield _pair(measure, "plateau", size, plateau)


def _pair(measure: str, at: str, ours: Point, planes: Point) -> AgainstHexplane:
    fewer = None if not ours.parameters or not planes.parameters else planes.parameters / ours.parameters
    return AgainstHexplane(
        data=ours.data,
        measure=measure,
        at=at,
        ours=ours.name,
        ours_db=getattr(ours, measure),
        hexplane=planes.name,
        hexplane_db=getattr(planes, measure),
        times_faster_per_set=(planes.latency_ms or 0.0) / ours.ms_per_frame,
        times_faster_amortised=planes.ms_per_frame / ours.ms_per_frame,
        times_fewer_parameters=fewer,
    )


def said(one: AgainstHexplane) -> str:
    """A pair in a line."""
    where = "moving pixels" if one.measure == MEASURES[0] else "cameras left out"
    line = (
        f"{one.data}, {where}: {one.ours} reaches {one.ours_db:.1f} dB, {one.hexplane} {one.hexplane_db:.1f} dB"
        f"{' (its plateau)' if one.at == 'plateau' else ''}; training takes {one.times_faster_per_set:.0f} times as "
        f"long as one of our sets, {one.times_faster_amortised:.1f} times where it is spread over the window"
    )
    fewer = one.times_fewer_parameters
    return line if fewer is None else f"{line}; {fewer:.1f} times our parameters"
