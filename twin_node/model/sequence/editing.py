"""Edits of a trained model's canonical Gaussians: made once, they hold at all of its times."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import torch
from torch import Tensor

from twin_node.model.parameters import ModelError
from twin_node.model.ply import SH_C0
from twin_node.model.sequence.checkpoint import HOMES, Checkpoint

PER_GAUSSIAN = ("gaussians.", "gradients.", HOMES)
OF_TRAINING = ("adam.", "field_adam.")
"""How names of tensors begin that have a row per Gaussian, and of those that only training needs: they are let go."""


@dataclass(frozen=True)
class Edit:
    """What becomes of the Gaussians that are in a box at one time."""

    lower: tuple[float, float, float]
    upper: tuple[float, float, float]
    """Corners of the box, m."""
    stamp: int
    """When they are in it, ns."""
    is_removed: bool = False
    move: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """By which they are farther on at all times, m; they go on to move as they did."""
    rgb: tuple[float, float, float] | None = None
    """Their mean colour afterwards, 0 to 1: all are brighter or darker by the same; None leaves colours alone."""


def edited(checkpoint: Checkpoint, edit: Edit, path: Path) -> Checkpoint:
    """The checkpoint after an edit, to be written to `path`; it can be edited again, and not be trained on.

    Raises `ModelError` where no Gaussian is in the box, where none would be left, and where they would be nowhere.
    """
    with torch.no_grad():
        means = checkpoint.model.at([edit.stamp]).means[0]
    chosen = ((means >= torch.tensor(edit.lower)) & (means <= torch.tensor(edit.upper))).all(-1)
    _check(checkpoint, edit, means, chosen)
    tensors = {name: value for name, value in checkpoint.tensors.items() if not name.startswith(OF_TRAINING)}
    tensors.setdefault(HOMES, tensors["gaussians.means"])
    tensors["gaussians.means"] = tensors["gaussians.means"] + chosen[:, None] * torch.tensor(edit.move)
    if not tensors["gaussians.means"].isfinite().all():
        raise ModelError(f"{checkpoint.path}: expected a move to where float32 reaches, found {edit.move} m")
    if edit.rgb is not None:
        tensors["gaussians.sh"] = _recoloured(tensors["gaussians.sh"], chosen, torch.tensor(edit.rgb))
    if edit.is_removed:
        tensors = {name: value[~chosen] if name.startswith(PER_GAUSSIAN) else value for name, value in tensors.items()}
    return replace(checkpoint, path=path, tensors=tensors)


def _recoloured(sh: Tensor, chosen: Tensor, rgb: Tensor) -> Tensor:
    """Harmonics [N, K, 3] of which those `chosen` [N] are of a mean colour [3]."""
    changed = sh.clone()
    constant = changed[chosen, 0]
    changed[chosen, 0] = constant + ((rgb - 0.5) / SH_C0 - constant.mean(0))
    return changed


def _check(checkpoint: Checkpoint, edit: Edit, means: Tensor, chosen: Tensor) -> None:
    if not chosen.any():
        corners = (", ".join(f"{value:.2f}" for value in corner.tolist()) for corner in (means.amin(0), means.amax(0)))
        raise ModelError(
            f"{checkpoint.path}: expected Gaussians in the box, found none; they are from ({') to ('.join(corners)}) m"
        )
    if edit.is_removed and chosen.all():
        raise ModelError(f"{checkpoint.path}: expected some Gaussians outside of the box, found none; make it smaller")
