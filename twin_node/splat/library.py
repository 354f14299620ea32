"""Loads the compiled CPU rasteriser and calls it; the structs mirror `native/interface.h` field by field.

Their empty `__slots__` refuse the name of a field that there is not, which ctypes would take for an attribute.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from ctypes import c_float, c_int32, c_int64, c_void_p
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from twin_node import native_build
from twin_node.native_library import (
    KernelRequest,
    NativeLibrary,
    is_told,
    keep_to_threads,
    kernel_threads,
    thread_count,
)
from twin_node.splat.errors import SplatError

if TYPE_CHECKING:
    import torch

INTERFACE_VERSION = 13
STATUS_OK, STATUS_TOO_MANY_INTERSECTIONS, STATUS_BAD_FOCAL_LENGTH, STATUS_SINGULAR_VIEW = 0, 2, 3, 4
STATUS_NON_FINITE = 100


class Request(ctypes.Structure):
    """`splat::Request`."""

    __slots__ = ()
    _fields_ = (
        *((name, c_int32) for name in ("batches", "cameras", "gaussians", "width", "height", "color_channels")),
        *((name, c_int32) for name in ("sh_bases", "sh_degree", "colors_per_camera", "depth_mode", "antialiased")),
        ("threads", c_int32),
        *((name, c_float) for name in ("near_plane", "far_plane", "radius_clip", "eps2d")),
        *((name, c_float) for name in ("max_alpha", "min_compensation")),
        *((f"{name}_stride", c_int64) for name in ("means", "quats", "scales", "opacities", "colors")),
        *((name, c_void_p) for name in ("means", "quats", "scales", "opacities", "colors", "viewmats", "Ks")),
        *((name, c_void_p) for name in ("backgrounds", "backdrop", "seen", "pixel_mask")),
        *((name, c_void_p) for name in ("renders", "alphas", "radii", "means2d", "depths")),
    )


class Gradients(ctypes.Structure):
    """`splat::Gradients`."""

    __slots__ = ()
    _fields_ = (
        *((name, c_void_p) for name in ("v_renders", "v_alphas", "v_means", "v_quats", "v_scales", "v_opacities")),
        *((name, c_void_p) for name in ("v_colors", "v_viewmats")),
        ("first_row", c_int32),
        ("learns", c_void_p),
    )


class MissRequest(ctypes.Structure):
    """`splat::MissRequest`."""

    __slots__ = ()
    _fields_ = (
        ("scene", Request),
        ("gradients", Gradients),
        *((name, c_void_p) for name in ("target", "depth", "surface")),
        *((name, c_float) for name in ("outlier", "depth_gain", "nearest")),
        *((name, c_void_p) for name in ("pull", "pull_alpha")),
    )


class LossRequest(KernelRequest):
    """`splat::LossRequest`."""

    __slots__ = ()
    KERNEL = "image_loss"
    _fields_ = (
        *((name, c_int32) for name in ("images", "height", "width", "channels", "threads")),
        *((name, c_float) for name in ("l1", "ssim", "depth_weight")),
        *((name, c_void_p) for name in ("render", "target", "weights", "target_depth", "gradient", "loss")),
    )


class DescentRequest(ctypes.Structure):
    """`splat::DescentRequest`."""

    __slots__ = ()
    _fields_ = (
        ("scene", Request),
        ("gradients", Gradients),
        ("loss", LossRequest),
        *((name, c_int32) for name in ("standing", "learned", "steps")),
        ("smallest_log_scale", c_float),
        *((name, c_void_p) for name in ("means", "quats", "scales", "opacities", "colors")),
        *((name, c_void_p) for name in ("rows", "values", "moment1", "moment2", "steps_taken", "ceilings", "rates")),
        ("carriages", c_int64),
        *((name, c_void_p) for name in ("turns", "shifts", "products", "carriers")),
        *((name, c_float) for name in ("first_decay", "second_decay")),
        *((name, c_void_p) for name in ("refused", "losses")),
    )


class PlaceRequest(KernelRequest):
    """`splat::PlaceRequest`."""

    __slots__ = ()
    KERNEL, RETURNS = "place", None
    _fields_ = (
        *((name, c_int64) for name in ("count", "times", "nodes")),
        ("threads", c_int32),
        *((name, c_void_p) for name in ("rows", "values", "carriers", "positions", "rotations")),
        *((name, c_void_p) for name in ("means", "quats", "scales", "opacities", "rgb")),
    )


class NonFiniteError(Exception):
    """An argument holds a NaN or an infinity; `index` counts the arguments as the library does."""

    def __init__(self, index: int) -> None:
        super().__init__(index)
        self.index = index


class Workspace:
    """What a forward pass leaves for its backward pass; goes back to the library's pool when it is dropped."""

    def __init__(self, library: SplatLibrary) -> None:
        self._library = library
        self.handle = library.acquire()

    def __del__(self) -> None:
        if hasattr(self, "handle"):
            self._library.release(self.handle)


class SplatLibrary(NativeLibrary):
    """One compiled variant. Safe from several threads; a forked child gets `SplatError`."""

    KERNELS, VERSION, ERROR = native_build.SPLAT, INTERFACE_VERSION, SplatError
    WITHOUT = "the CPU rasteriser runs in plain torch, about 20 times slower"

    def __init__(self, path: Path) -> None:
        """Loads the library file; raises `OSError` where it cannot be loaded, or is of another interface version."""
        super().__init__(path)
        self._dll.splat_acquire.restype = c_void_p
        self._dll.splat_release.argtypes = [c_void_p]
        self._dll.splat_release.restype = None
        self._dll.splat_forward.argtypes = [c_void_p, ctypes.POINTER(Request)]
        self._dll.splat_backward.argtypes = [c_void_p, ctypes.POINTER(Request), ctypes.POINTER(Gradients)]
        self._dll.splat_descend.argtypes = [c_void_p, ctypes.POINTER(DescentRequest)]
        self._dll.splat_add_missed.argtypes = [c_void_p, ctypes.POINTER(MissRequest)]
        self._dll.splat_weigh.argtypes = [c_void_p, ctypes.POINTER(Request), c_void_p]

    def acquire(self) -> int:
        """A workspace's handle. Raises `MemoryError`."""
        self._require_not_forked()
        handle = self._dll.splat_acquire()
        if not handle:
            raise MemoryError("no memory for a workspace of the rasteriser")
        return int(handle)

    def release(self, handle: int) -> None:
        """Gives a workspace back; in a forked child it is left alone, as its lock may be held."""
        if not self._forked:
            self._dll.splat_release(handle)

    def forward(self, workspace: Workspace, request: Request) -> None:
        """Renders. Raises `NonFiniteError`, `ValueError` or `MemoryError`."""
        self._require_not_forked()
        _check(self._dll.splat_forward(workspace.handle, request))

    def backward(self, workspace: Workspace, request: Request, gradients: Gradients) -> None:
        """Differentiates the workspace's last forward pass. Raises `MemoryError`."""
        self._require_not_forked()
        _check(self._dll.splat_backward(workspace.handle, request, gradients))

    def image_loss(self, request: LossRequest) -> None:
        """Writes the loss and its gradient. Raises `NonFiniteError` or `MemoryError`."""
        _check(self.call(request))

    def add_missed(self, workspace: Workspace, request: MissRequest) -> None:
        """Adds what a view misses. Raises `NonFiniteError` as `forward`, `ValueError` or `MemoryError`."""
        self._require_not_forked()
        _check(self._dll.splat_add_missed(workspace.handle, request))

    def weigh(self, workspace: Workspace, request: Request, weights: int) -> None:
        """Writes how much each Gaussian shows in one image. Raises as `forward`."""
        self._require_not_forked()
        _check(self._dll.splat_weigh(workspace.handle, request, weights))

    def descend(self, workspace: Workspace, request: DescentRequest) -> None:
        """Takes steps of Adam. Raises `NonFiniteError` as `image_loss`, `ValueError` or `MemoryError`."""
        self._require_not_forked()
        _check(self._dll.splat_descend(workspace.handle, request))


def _check(status: int) -> None:
    if status == STATUS_OK:
        return
    if status >= STATUS_NON_FINITE:
        raise NonFiniteError(status - STATUS_NON_FINITE)
    if status == STATUS_BAD_FOCAL_LENGTH:
        raise ValueError("Ks: expected positive focal lengths, found one that is not")
    if status == STATUS_SINGULAR_VIEW:
        raise ValueError("viewmats: expected invertible matrices, found one that is not")
    if status == STATUS_TOO_MANY_INTERSECTIONS:
        raise ValueError(
            "scales: the Gaussians cover more than 2^31 image tiles; expected smaller ones or a smaller image"
        )
    raise MemoryError("no memory for the rasteriser's lists")


@cache
def kernels() -> SplatLibrary | None:
    """The best library for this processor; None, with one warning, where there is none."""
    return SplatLibrary.best()


def kernels_for(device: torch.device) -> SplatLibrary | None:
    """`kernels` for tensors on this device: None for those that are not on the CPU."""
    return kernels() if device.type == "cpu" else None


def has_kernels(device: torch.device) -> bool:
    """Whether what has no other form than compiled works for tensors on this device."""
    return kernels_for(device) is not None


@contextmanager
def torch_alone() -> Iterator[None]:
    """Torch's own loops take no other thread meanwhile, as far as this one begins them; compiled kernels still do.

    Over images of some ten thousand pixels a loop of torch's is done before the second thread has woken up, and then
    waits for it: a set took half as long again.
    """
    threads = thread_count()
    if kernels() is None or is_told():
        yield
        return
    limit_torch(1)
    try:
        with kernel_threads(threads):
            yield
    finally:
        limit_torch(threads)


def stay_alone() -> None:
    """What this thread calls from now on takes no other: neither compiled kernels nor, beside these, torch's loops."""
    keep_to_threads(1)
    if kernels() is not None:
        limit_torch(1)


def limit_torch(threads: int) -> None:
    """How many threads the loops of torch take from now on that the calling thread begins.

    `torch.set_num_threads` says it for all threads at once. Nothing where torch does not run on OpenMP.
    """
    runtime = _runtime()
    if runtime is not None:
        runtime.omp_set_num_threads(threads)


@cache
def _runtime() -> ctypes.CDLL | None:
    """Torch's OpenMP runtime; None where none is found.

    Torch shows it to the whole process, but not on ARM: there it is that of the loaded ones which torch heeds.
    """
    import torch  # noqa: F401  (before it is loaded there is none, and that would be kept)

    return _shown() or next((runtime for runtime in _loaded() if _is_torchs(runtime)), None)


def _shown() -> ctypes.CDLL | None:
    """What the whole process sees, where an OpenMP runtime is among it."""
    everything = ctypes.CDLL(None)
    return everything if hasattr(everything, "omp_set_num_threads") else None


def _loaded() -> Iterator[ctypes.CDLL]:
    """The OpenMP runtimes that this process has loaded, of GCC, LLVM and Intel; none where it cannot tell."""
    try:
        lines = Path("/proc/self/maps").read_text(errors="surrogateescape").splitlines()
    except OSError:
        return
    for path in dict.fromkeys(line[line.index("/") :] for line in lines if "/" in line):
        if Path(path).name.startswith(("libgomp", "libomp", "libiomp")):
            with suppress(OSError):  # since removed
                yield ctypes.CDLL(path)


def _is_torchs(runtime: ctypes.CDLL) -> bool:
    """Whether torch takes as many threads as this runtime is told to; the calling thread's are as before then."""
    import torch

    before = torch.get_num_threads()
    runtime.omp_set_num_threads(before + 1)
    is_torchs = torch.get_num_threads() == before + 1
    runtime.omp_set_num_threads(before)
    return is_torchs
