"""Loads the compiled kernels of the model and calls them; what is asked of them is in `kernel_requests`."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from functools import cache
from pathlib import Path

from twin_node import native_build
from twin_node.model.kernel_requests import (
    INTERFACE_VERSION,
    BackdropRequest,
    BirthRequest,
    BirthRules,
    BirthView,
    CompareRequest,
    DampedRequest,
    FlowRequest,
    FlowRules,
    FlowView,
    HeldRequest,
    HeldView,
    MaskRequest,
    MaskRequests,
    ObservedView,
    ObserveRequest,
    ObserveRules,
    OccluderRequest,
    OccluderView,
    RatioRequest,
    RefutedRequest,
    RestRequest,
    SmoothRequest,
    StaticRequest,
)
from twin_node.model.node_requests import (
    AdvanceRequest,
    CarryRequest,
    CellRequest,
    CreepRequest,
    ExtentRequest,
    GroupRequest,
    JudgeRequest,
    MotionRequest,
    MovedRequest,
    MoveRequest,
    NearestRequest,
    NewbornRequest,
    PixelsRequest,
    PublishRequest,
    SumRequest,
    VelocityRequest,
)
from twin_node.model.parameters import ModelError
from twin_node.native_library import NativeLibrary, best_or_none, load, thread_count


class Kernels(NativeLibrary):
    """One compiled variant. Safe from several threads; a forked child gets `ModelError`."""

    KERNELS, VERSION, ERROR = native_build.MODEL, INTERFACE_VERSION, ModelError

    def __init__(self, path: Path) -> None:
        """Loads the library file; raises `OSError` where it cannot be loaded, or is of another interface version."""
        super().__init__(path)
        self._declare(
            ctypes.c_int32,  # not 0: there was no memory
            mask=MaskRequests,
            births=BirthRequest,
            flow=FlowRequest,
            refute=RefutedRequest,
            judge=StaticRequest,
            observe=ObserveRequest,
            ratios=RatioRequest,
            occluders=OccluderRequest,
            held=HeldRequest,
            cells=CellRequest,
            compare=CompareRequest,
            smooth=SmoothRequest,
            creep=CreepRequest,
        )
        self._declare(
            None,
            advance=AdvanceRequest,
            moved=MovedRequest,
            carry=CarryRequest,
            store_newborns=NewbornRequest,
            find_pixels=PixelsRequest,
            gather_motion=MotionRequest,
            nearest=NearestRequest,
            publish=PublishRequest,
            extents=ExtentRequest,
            judge_velocities=JudgeRequest,
            solve_velocities=VelocityRequest,
            move_velocities=MoveRequest,
            take_damped=DampedRequest,
            group=GroupRequest,
            add_up=SumRequest,
            put_before=BackdropRequest,
            remember=RestRequest,
        )

    def mask(self, requests: Sequence[MaskRequest]) -> None:
        """Brings the moving masks of some cameras up to date. Raises `MemoryError`."""
        self._require_not_forked()
        cameras = (MaskRequest * len(requests))(*requests)
        _check(self._dll.model_mask(MaskRequests(len(requests), thread_count(), cameras)))

    def observe(self, rules: ObserveRules, views: Sequence[ObservedView]) -> None:
        """Puts some views beside their backgrounds. Raises `MemoryError`."""
        self._require_not_forked()
        given = (ObservedView * len(views))(*views)
        _check(self._dll.model_observe(ObserveRequest(len(views), thread_count(), ctypes.pointer(rules), given)))

    def ratios(self, request: RatioRequest) -> None:
        """Finds how bright an image is; takes one thread. Raises `MemoryError`."""
        _check(self._dll.model_ratios(request))

    def remember(self, request: RestRequest) -> None:
        """Takes in what an image shows at rest; takes one thread."""
        self._dll.model_remember(request)

    def put_before(self, request: BackdropRequest) -> None:
        """Puts images before what stands behind; takes one thread."""
        self._dll.model_put_before(request)

    def occluders(self, request: OccluderRequest, views: Sequence[OccluderView]) -> None:
        """Finds what can stand before something that moves; takes one thread. Raises `MemoryError`."""
        request.view_count, request.views = len(views), (OccluderView * len(views))(*views)
        _check(self._dll.model_occluders(request))

    def held(self, request: HeldRequest, views: Sequence[HeldView]) -> None:
        """Finds the pixels that a rendering is held to in some views. Raises `MemoryError`."""
        self._require_not_forked()
        given = (HeldView * len(views))(*views)
        request.count, request.threads, request.views = len(views), thread_count(), given
        _check(self._dll.model_held(request))

    def add_up(self, request: SumRequest) -> None:
        """Adds rows up by their owners; takes one thread."""
        self._dll.model_add_up(request)

    def births(self, rules: BirthRules, views: Sequence[BirthView]) -> None:
        """Finds what is born of some views that see each other's things. Raises `MemoryError`."""
        self._require_not_forked()
        given = (BirthView * len(views))(*views)
        request = BirthRequest(len(views), thread_count(), ctypes.pointer(rules), given)
        _check(self._dll.model_births(request))

    def flow(self, rules: FlowRules, views: Sequence[FlowView]) -> None:
        """Finds the optical flow of some views. Raises `MemoryError`."""
        self._require_not_forked()
        given = (FlowView * len(views))(*views)
        _check(self._dll.model_flow(FlowRequest(len(views), thread_count(), ctypes.pointer(rules), given)))

    def refute(self, request: RefutedRequest) -> None:
        """Finds which moving Gaussians views see through. Raises `MemoryError`."""
        self._require_not_forked()
        _check(self._dll.model_refute(request))

    def judge(self, request: StaticRequest) -> None:
        """Finds which STATIC Gaussians have left, or are part of something that moves. Raises `MemoryError`."""
        self._require_not_forked()
        _check(self._dll.model_judge(request))

    def advance(self, request: AdvanceRequest) -> None:
        """Moves nodes on; takes one thread."""
        self._dll.model_advance(request)

    def moved(self, request: MovedRequest) -> None:
        """Finds how nodes have moved; takes one thread."""
        self._dll.model_moved(request)

    def carry(self, request: CarryRequest) -> None:
        """Writes what nodes do to what they carry; takes one thread."""
        self._dll.model_carry(request)

    def store_newborns(self, request: NewbornRequest) -> None:
        """Stores what is born; takes one thread."""
        self._dll.model_store_newborns(request)

    def find_pixels(self, request: PixelsRequest) -> None:
        """Finds the pixels of points; takes one thread."""
        self._dll.model_find_pixels(request)

    def gather_motion(self, request: MotionRequest) -> None:
        """Adds to the normal equations of nodes; takes one thread."""
        self._dll.model_gather_motion(request)

    def nearest(self, request: NearestRequest) -> None:
        """Finds what is nearest; takes one thread."""
        self._dll.model_nearest(request)

    def take_damped(self, request: DampedRequest) -> None:
        """Takes a step of what stands; takes one thread."""
        self._dll.model_take_damped(request)

    def group(self, request: GroupRequest) -> None:
        """Deals places out to groups; takes one thread."""
        self._dll.model_group(request)

    def publish(self, request: PublishRequest) -> None:
        """Writes Gaussians as other rooms read them."""
        self._require_not_forked()
        self._dll.model_publish(request)

    def extents(self, request: ExtentRequest) -> None:
        """Finds how far nodes reach; takes one thread."""
        self._dll.model_extents(request)

    def judge_velocities(self, request: JudgeRequest) -> None:
        """Judges bodies by what was said of their velocities; takes one thread."""
        self._dll.model_judge_velocities(request)

    def solve_velocities(self, request: VelocityRequest) -> None:
        """Finds the most likely velocities; takes one thread."""
        self._dll.model_solve_velocities(request)

    def move_velocities(self, request: MoveRequest) -> None:
        """Tells equations about other points; takes one thread."""
        self._dll.model_move_velocities(request)

    def cells(self, request: CellRequest) -> None:
        """Deals Gaussians out to cells; takes one thread. Raises `MemoryError`."""
        _check(self._dll.model_cells(request))

    def compare(self, request: CompareRequest) -> None:
        """Finds points along rays in another view. Raises `MemoryError`."""
        self._require_not_forked()
        request.threads = thread_count()
        _check(self._dll.model_compare(request))

    def smooth(self, request: SmoothRequest) -> None:
        """Makes the labels of neighbours alike. Raises `MemoryError`."""
        self._require_not_forked()
        request.threads = thread_count()
        _check(self._dll.model_smooth(request))

    def creep(self, request: CreepRequest) -> None:
        """Finds how far the Gaussians of cells have crept; takes one thread. Raises `MemoryError`."""
        _check(self._dll.model_creep(request))


def _check(status: int) -> None:
    if status:
        raise MemoryError("no memory for what the model finds in images")


def load_variant(variant: str) -> Kernels:
    """The kernels of one instruction set. Raises `native_build.CompileError` or `OSError`."""
    return load(Kernels, native_build.MODEL, variant)


@cache
def kernels() -> Kernels | None:
    """The best kernels for this processor; None, with one warning, where there are none."""
    return best_or_none(load_variant, "the model finds what moves in plain NumPy, ten times slower")
