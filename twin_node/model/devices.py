"""The torch device that a name stands for."""

from __future__ import annotations

import torch

from twin_node.model.parameters import ModelError


def usable_device(name: str) -> torch.device:
    """The torch device of a name. Raises `ModelError` where there is none."""
    try:
        held = torch.zeros(1, device=name)
        held.item()  # which "meta" cannot tell: it holds nothing
        return held.device
    except (RuntimeError, AssertionError, ImportError):
        raise ModelError(f"device: expected cpu or a CUDA device that is there, found '{name}'; name another") from None
