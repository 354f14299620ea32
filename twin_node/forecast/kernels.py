"""Loads the compiled kernels of the forecast and calls them."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from ctypes import c_int32, c_int64
from functools import cache
from pathlib import Path

from twin_node import native_build
from twin_node.forecast.errors import ForecastError
from twin_node.forecast.kernel_requests import (
    INTERFACE_VERSION,
    AheadRequest,
    CarveRequest,
    ConcealRequest,
    CoverRequest,
    GrowRequest,
    HideRequest,
    ListRequest,
    LookRequest,
    MarkRequest,
    PackRequest,
    RestRequest,
    ReviseRequest,
    RunsRequest,
    TakeRequest,
    TallyRequest,
)
from twin_node.forecast.part_requests import (
    GatherRequest,
    LeadRequest,
    LinkRequest,
    NearestRequest,
    OutlookRequest,
    QuantileRequest,
    ReachRequest,
    ReckonRequest,
    RegressRequest,
    SeeRequest,
    ShowRequest,
    SolveRequest,
    SplitRequest,
    SurfaceRequest,
    TellRequest,
)
from twin_node.native_library import NativeLibrary, best_or_none, load


class Kernels(NativeLibrary):
    """One compiled variant. Safe from several threads; a forked child gets `ForecastError`."""

    KERNELS, VERSION, ERROR = native_build.FORECAST, INTERFACE_VERSION, ForecastError

    def __init__(self, path: Path) -> None:
        """Loads the library file; raises `OSError` where it cannot be loaded, or is of another interface version."""
        super().__init__(path)
        self._declare(
            c_int32,  # not 0: there was no memory; of `pack`, a voxel was not in the grid
            grow=GrowRequest,
            grow_ahead=AheadRequest,
            pack=PackRequest,
            list=ListRequest,
            look=LookRequest,
            carve=CarveRequest,
            cover=CoverRequest,
            hide=HideRequest,
            mark=MarkRequest,
            split=SplitRequest,
            link=LinkRequest,
            gather=GatherRequest,
            outlook=OutlookRequest,
            regress=RegressRequest,
            nearest=NearestRequest,
            surface=SurfaceRequest,
        )
        self._declare(c_int64, tally=TallyRequest, find_quantile=QuantileRequest)
        self._declare(
            None,
            runs=RunsRequest,
            revise=ReviseRequest,
            conceal=ConcealRequest,
            solve=SolveRequest,
            lead=LeadRequest,
            reckon=ReckonRequest,
            reach=ReachRequest,
            rest=RestRequest,
            take=TakeRequest,
        )
        for name, request in (("see", SeeRequest), ("show", ShowRequest), ("tell", TellRequest)):  # one for each view
            getattr(self._dll, f"forecast_{name}").argtypes = [ctypes.POINTER(request), c_int64, c_int32]

    def grow(self, request: GrowRequest) -> None:
        """Unites balls about moved voxels, layer by layer. Raises `MemoryError`."""
        self._require_not_forked()
        _check(self._dll.forecast_grow(request))

    def grow_ahead(self, request: AheadRequest) -> None:
        """Unites balls about where parts are forecast, layer by layer. Raises `MemoryError`."""
        self._require_not_forked()
        _check(self._dll.forecast_grow_ahead(request))

    def pack(self, request: PackRequest) -> None:
        """Sets voxels of a mask; takes one thread. Raises `IndexError` for those that are not in its grid."""
        if self._dll.forecast_pack(request):
            raise IndexError("voxels: expected flat indices within the grid, found some beside it")

    def tally(self, request: TallyRequest) -> int:
        """Counts the set bits of a mask; takes one thread."""
        return int(self._dll.forecast_tally(request))

    def list(self, request: ListRequest) -> None:
        """Lists the voxels of masks. Raises `MemoryError`."""
        self._require_not_forked()
        _check(self._dll.forecast_list(request))

    def runs(self, request: RunsRequest) -> None:
        """Finds the runs of a mask; takes one thread."""
        self._dll.forecast_runs(request)

    def look(self, request: LookRequest) -> None:
        """Says what views show along the rays of their pixels. Raises `MemoryError`."""
        self._require_not_forked()
        _check(self._dll.forecast_look(request))

    def revise(self, request: ReviseRequest) -> None:
        """Takes one more depth image into a backdrop; takes one thread."""
        self._dll.forecast_revise(request)

    def conceal(self, request: ConcealRequest) -> None:
        """Says what cameras do not see; takes one thread."""
        self._dll.forecast_conceal(request)

    def carve(self, request: CarveRequest) -> None:
        """Says of every voxel what the views show. Raises `MemoryError`."""
        self._require_not_forked()
        _check(self._dll.forecast_carve(request))

    def cover(self, request: CoverRequest) -> None:
        """Finds few boxes about voxels; takes one thread. Raises `MemoryError`."""
        _check(self._dll.forecast_cover(request))

    def hide(self, request: HideRequest) -> None:
        """Follows what may be hidden by one state; takes one thread. Raises `MemoryError`."""
        _check(self._dll.forecast_hide(request))

    def mark(self, request: MarkRequest) -> None:
        """Marks the voxels that a view measures surfaces in; takes one thread. Raises `MemoryError`."""
        _check(self._dll.forecast_mark(request))

    def split(self, request: SplitRequest) -> None:
        """Finds the parts that voxels are of; takes one thread. Raises `MemoryError`."""
        _check(self._dll.forecast_split(request))

    def link(self, request: LinkRequest) -> None:
        """Finds which points hang together; takes one thread. Raises `MemoryError`."""
        _check(self._dll.forecast_link(request))

    def gather(self, request: GatherRequest) -> None:
        """Finds the things that parts are of; takes one thread. Raises `MemoryError`."""
        _check(self._dll.forecast_gather(request))

    def see(self, views: Sequence[SeeRequest], threads: int) -> None:
        """Says what images show to move, view by view. Raises `MemoryError`."""
        self._require_not_forked()
        _check(self._dll.forecast_see((SeeRequest * len(views))(*views), len(views), threads))

    def show(self, views: Sequence[ShowRequest], threads: int) -> None:
        """Lists the voxels that views show to move. Raises `MemoryError`."""
        self._require_not_forked()
        _check(self._dll.forecast_show((ShowRequest * len(views))(*views), len(views), threads))

    def tell(self, views: Sequence[TellRequest], threads: int) -> None:
        """Says what these show of their parts. Raises `MemoryError`."""
        self._require_not_forked()
        _check(self._dll.forecast_tell((TellRequest * len(views))(*views), len(views), threads))

    def solve(self, request: SolveRequest) -> None:
        """Finds the velocities that views agree on; takes one thread."""
        self._dll.forecast_solve(request)

    def lead(self, request: LeadRequest) -> None:
        """Says where experts lead nodes; takes one thread."""
        self._dll.forecast_lead(request)

    def outlook(self, request: OutlookRequest) -> None:
        """Says where experts lead nodes, by what and how weighed; takes one thread. Raises `MemoryError`."""
        _check(self._dll.forecast_outlook(request))

    def reckon(self, request: ReckonRequest) -> None:
        """Says what became of forecasts of nodes; takes one thread."""
        self._dll.forecast_reckon(request)

    def reach(self, request: ReachRequest) -> None:
        """Says how far nodes may be from where they are led; takes one thread."""
        self._dll.forecast_reach(request)

    def regress(self, request: RegressRequest) -> None:
        """Learns the scale of errors by their cues; takes one thread. Raises `MemoryError`."""
        _check(self._dll.forecast_regress(request))

    def find_quantile(self, request: QuantileRequest) -> int:
        """Says in which bin a quantile of errors lies; takes one thread. Raises `MemoryError`."""
        found = int(self._dll.forecast_find_quantile(request))
        _check(found < 0)
        return found

    def rest(self, request: RestRequest) -> None:
        """Says which standing voxels moved of late; takes one thread."""
        self._dll.forecast_rest(request)

    def nearest(self, request: NearestRequest) -> None:
        """Finds the nearest of points; takes one thread. Raises `MemoryError`."""
        _check(self._dll.forecast_nearest(request))

    def surface(self, request: SurfaceRequest) -> None:
        """Finds the measured points of what moves; takes one thread. Raises `MemoryError`."""
        _check(self._dll.forecast_surface(request))

    def take(self, request: TakeRequest) -> None:
        """Marks the voxels within capsules; takes one thread."""
        self._dll.forecast_take(request)


def _check(status: int) -> None:
    if status:
        raise MemoryError("no memory for the forecast's grids")


def load_variant(variant: str) -> Kernels:
    """The kernels of one instruction set. Raises `native_build.CompileError` or `OSError`."""
    return load(Kernels, native_build.FORECAST, variant)


@cache
def kernels() -> Kernels | None:
    """The best kernels for this processor; None, with one warning, where there are none."""
    return best_or_none(load_variant, "the forecast runs in plain NumPy, about ten times slower")
