"""A device that is not the CPU, for machines that have none: tensors that say so, and keep what they hold on the CPU.

Torch's dispatch is what CUDA tensors meet as well: `numpy()` is refused, so are a tensor's address and operations on
tensors of both devices, and what goes from one to the other is counted. The device is called `meta`, the only one that
torch can differentiate on without drivers; that nothing ends up as one of torch's own `meta` tensors, which hold
nothing, is checked. What is left to find on a real device are its kernels, its memory and its speed.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from importlib import import_module
from inspect import signature
from typing import Any

import gsplat
import numpy as np
import pytest
import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves, tree_map

from twin_node.native_library import kernel_threads
from twin_node.splat import cuda, rasterize

NAME = "meta"
DEVICE, HOST = torch.device(NAME), torch.device("cpu")
WAITING = frozenset(("_local_scalar_dense", "nonzero", "masked_select", "_unique2", "unique_dim", "equal"))
"""Operations whose result, or its size, the host waits for."""
FROM_EITHER = frozenset(("copy_", "_to_copy"))
INDEXING = frozenset(("index", "index_put", "index_put_", "_index_put_impl_"))


OTHERS = [
    NAME,
    pytest.param(
        "cuda", marks=pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device here: one is pretended")
    ),
]
"""Devices that are not the CPU: the pretended one, and a real one where it is there."""


@dataclass
class Traffic:
    """What has gone between the host and the device."""

    waits: int = 0
    """Times that the host has waited for what the device found out."""
    sent: int = 0
    """Tensors copied from the host to the device."""


class OnDevice(Tensor):
    """A tensor of the device."""

    held: Tensor

    @staticmethod
    def __new__(cls, held: Tensor) -> OnDevice:
        """What `held` holds, on the device."""
        made: OnDevice = torch.Tensor._make_wrapper_subclass(
            cls,
            held.size(),
            strides=held.stride(),
            storage_offset=held.storage_offset(),
            dtype=held.dtype,
            device=DEVICE,
        )
        made.held = held
        return made

    is_cuda = property(lambda self: True)
    is_meta = property(lambda self: False)

    def numpy(self, *_: Any, **__: Any) -> Any:
        """Refused, as by CUDA."""
        raise TypeError("cannot convert a tensor of the device to numpy; use Tensor.cpu() first")

    __array__ = numpy

    def tolist(self) -> Any:
        """The numbers, by way of the host."""
        return self.cpu().tolist()

    @classmethod
    def __torch_dispatch__(cls, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        raise AssertionError(f"{func} of a tensor of the device outside of `pretended`")


class _Made(TorchFunctionMode):
    """What torch would make as a `meta` tensor before anything is dispatched."""

    def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        kwargs = dict(kwargs or {})
        if func in (torch.tensor, torch.as_tensor) and kwargs.get("device") is not None:
            return func(*args, **{**kwargs, "device": HOST}).to(kwargs["device"])
        if func is Tensor.new_tensor and args[0].device == DEVICE:
            return torch.tensor(*args[1:], **{"dtype": args[0].dtype, **kwargs}).to(DEVICE)
        if func in (Tensor.__getitem__, Tensor.__setitem__) and args[0].device == DEVICE:
            where = args[1] if isinstance(args[1], tuple) else (args[1],)
            where = tuple(torch.as_tensor(w).to(DEVICE) if isinstance(w, list | np.ndarray) else w for w in where)
            args = (args[0], where, *args[2:])
        return func(*args, **kwargs)


class _Dispatched(TorchDispatchMode):
    """Does on the CPU what is asked of the device."""

    def __init__(self, traffic: Traffic) -> None:
        super().__init__()
        self._traffic = traffic

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        kwargs = dict(kwargs or {})
        name = func.overloadpacket.__name__
        tensors = [leaf for leaf in tree_leaves((args, kwargs)) if isinstance(leaf, Tensor)]
        ours = [one for one in tensors if isinstance(one, OnDevice)]
        assert all(one.device == HOST for one in tensors if not isinstance(one, OnDevice)), f"{name}: of nothing"
        target = None if kwargs.get("device") is None else torch.device(kwargs["device"])
        if not ours and target != DEVICE:
            return func(*args, **kwargs)
        _require_one_device(name, args, tensors)
        assert kwargs.get("generator") is None, f"{name}: a generator of the host's"
        self._count(name, args, tensors, ours, target)
        if target is not None:
            kwargs["device"] = HOST
        result = func(*tree_map(_held, args), **tree_map(_held, kwargs))
        if name == "_to_copy" and target == HOST:
            return result
        known = {id(_held(one)): one for one in tensors}  # what has been changed in place is what it was

        def on_device(one: Any) -> Any:
            return known[id(one)] if id(one) in known else OnDevice(one) if isinstance(one, Tensor) else one

        return tree_map(on_device, result)

    def _count(
        self, name: str, args: Any, tensors: Sequence[Tensor], ours: Sequence[Tensor], target: torch.device | None
    ) -> None:
        masked = name in INDEXING and any(one is not None and one.dtype == torch.bool for one in args[1])
        across = name in FROM_EITHER and (target == HOST or not isinstance(args[0], OnDevice))
        self._traffic.waits += name in WAITING or masked or (bool(ours) and across)
        self._traffic.sent += name in FROM_EITHER and len(ours) < len(tensors) and not (ours and across)


@contextmanager
def pretended() -> Iterator[Traffic]:
    """The device `NAME` is there, for this thread; the work of others is done by it."""
    traffic = Traffic()
    with pytest.MonkeyPatch.context() as patch, kernel_threads(1), _Made(), _Dispatched(traffic):
        patch.setattr(cuda, "gsplat_module", lambda: _Gsplat)
        patch.setattr(import_module("torch.optim.adam"), "_device_dtype_check_for_fused", lambda *_, **__: None)
        yield traffic


@contextmanager
def at_hand(device: str) -> Iterator[None]:
    """One of `OTHERS` is there."""
    with pretended() if device == NAME else nullcontext():
        yield


class _Gsplat:
    """Stands in for gsplat's kernels."""

    @staticmethod
    def rasterization(*args: Any, **kwargs: Any) -> tuple[Tensor, Tensor, Mapping[str, Tensor]]:
        """What the CPU draws, for a call that gsplat would take."""
        given = signature(gsplat.rasterization).bind(*args, **kwargs).arguments
        assert given.pop("packed") is False
        batch = given["means"].shape[:-2]
        for name in ("quats", "scales", "opacities", "viewmats", "Ks"):
            assert given[name].shape[: len(batch)] == batch, f"gsplat: {name} has other leading dimensions"
        renders, alphas, *meta = _Drawn.apply(list(given), *given.values())
        return renders, alphas, dict(zip(("radii", "means2d", "depths"), meta, strict=True))


class _Drawn(torch.autograd.Function):
    """Draws on the CPU, and takes gradients back."""

    @staticmethod
    def forward(ctx: Any, names: list[str], *values: Any) -> tuple[Tensor, ...]:
        held = [_held(v).detach() if isinstance(v, Tensor) else v for v in values]
        ctx.leaves = [v.requires_grad_(v.is_floating_point()) if isinstance(v, Tensor) else None for v in held]
        with torch.enable_grad():
            renders, alphas, meta = rasterize(**dict(zip(names, held, strict=True)))
        ctx.drawn = renders, alphas
        rest = tuple(OnDevice(one) for one in (meta.radii, meta.means2d, meta.depths))
        ctx.mark_non_differentiable(*rest)
        return OnDevice(renders.detach()), OnDevice(alphas.detach()), *rest

    @staticmethod
    def backward(ctx: Any, *pulls: Tensor) -> tuple[Tensor | None, ...]:
        leaves = [leaf for leaf in ctx.leaves if leaf is not None]
        found = iter(torch.autograd.grad(ctx.drawn, leaves, [_held(pull) for pull in pulls[:2]], allow_unused=True))
        gradients = [None if leaf is None else next(found) for leaf in ctx.leaves]
        return None, *(None if one is None else OnDevice(one) for one in gradients)


def _require_one_device(name: str, args: Any, tensors: Sequence[Tensor]) -> None:
    """Torch takes numbers of the host's everywhere, and its indices into tensors of the device."""
    if name in FROM_EITHER or all(isinstance(one, OnDevice) for one in tensors):
        return
    indices = tree_leaves(args[1]) if name in INDEXING and isinstance(args[0], OnDevice) else []
    for one in tensors:
        if not isinstance(one, OnDevice) and one.dim() and not any(one is index for index in indices):
            raise RuntimeError(f"{name}: expected all tensors on one device, found {list(one.shape)} on the host")


def _held(value: Any) -> Any:
    return value.held if isinstance(value, OnDevice) else value
