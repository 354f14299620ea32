"""The torch device that a name stands for."""

from __future__ import annotations

import torch

from twin_node.model.parameters import ModelError


def usable_device(name: str) -> torch.device:
    """The torch device of a name. Raises `ModelError` where there is none."""
    try:
        return torch.empty(0, device=name).device
    except (RuntimeError, AssertionError):
        raise ModelError(f"device: expected cpu or a CUDA device that is there, found '{name}'; name another") from None
