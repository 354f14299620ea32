"""Gaussians from the frames of what carries them to where they are drawn: one call of the compiled library."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from twin_node.native_library import thread_count
from twin_node.splat import library as native
from twin_node.splat.arguments import require_layout
from twin_node.splat.request import fill


@dataclass(frozen=True)
class Placed:
    """n Gaussians at T times, as `rasterize` takes them."""

    means: Tensor
    """[T, n, 3]."""
    quats: Tensor
    """[T, n, 4] w, x, y, z."""
    scales: Tensor
    """[n, 3] linear."""
    opacities: Tensor
    """[n] 0 to 1."""
    rgb: Tensor
    """[n, 3]."""


def place(values: Tensor, carriers: Tensor, positions: Tensor, quats: Tensor, rows: Tensor | None = None) -> Placed:
    """Carries Gaussians to where their nodes are at T times; nothing is differentiated.

    `values` [n, 14] float32: mean, quaternion, log scale, opacity logit and colour in the frames of the nodes,
    `carriers` [n] int64 rows of these, -1 for none, `positions` [T, M, 3] and `quats` [T, M, 4] float64 their poses.
    With `rows` [n] int64 both are a store of more, of which those are wanted. On the CPU; see `has_kernels`.
    Raises `ValueError` naming what is of another shape or kind.
    """
    library = native.kernels()
    assert library is not None
    count, (times, nodes) = len(values if rows is None else rows), (*positions.shape, 0, 0)[:2]
    require_layout("values", values, (len(values), 14), values.dtype)
    require_layout("carriers", carriers, (len(values),), torch.int64)
    require_layout("positions", positions, (times, nodes, 3), positions.dtype)
    require_layout("quats", quats, (times, nodes, 4), quats.dtype)
    require_layout("rows", rows, (count,), torch.int64)
    values, carriers = values.float().contiguous(), carriers.contiguous()
    empty = values.new_empty  # whatever torch makes by default
    placed = Placed(empty(times, count, 3), empty(times, count, 4), empty(count, 3), empty(count), empty(count, 3))
    positions, quats = positions.double().contiguous(), quats.double().contiguous()
    rows = None if rows is None else rows.contiguous()
    request = fill(
        native.PlaceRequest,
        count=count,
        times=times,
        nodes=nodes,
        threads=thread_count(),
        rows=rows,
        values=values,
        carriers=carriers,
        positions=positions,
        rotations=quats,
        **vars(placed),
    )
    library.run(request)
    return placed
