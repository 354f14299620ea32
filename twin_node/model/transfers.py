"""Images on their way between NumPy and the model's device: what a GPU takes or gives goes through pinned memory.

Its driver copies other memory to such memory first, piece by piece; and what torch has pinned it gives out again, whose
pages need not be found anew.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor


def on_host(tensor: Tensor) -> NDArray[Any]:
    """A tensor's numbers for NumPy: its own memory on a CPU, else a copy, which is waited for."""
    held = tensor.detach()
    if held.device.type != "cuda":
        return np.asarray(held.cpu().numpy())
    staged = torch.empty(held.shape, dtype=held.dtype, pin_memory=True)
    staged.copy_(held, non_blocking=True)
    torch.cuda.current_stream(held.device).synchronize()
    return np.asarray(staged.numpy())


def sent(images: Sequence[NDArray[Any]], size: tuple[int, int], device: torch.device) -> Tensor:
    """[C, *size, ...] images [H, W, ...] on a device, with zeros below and to the right of smaller ones."""
    shape = (len(images), *size, *images[0].shape[2:])
    kind = torch.from_numpy(np.empty(0, images[0].dtype)).dtype
    together = torch.empty(shape, dtype=kind, pin_memory=device.type == "cuda")
    for image, own in zip(images, together.numpy(), strict=True):
        if image.shape[:2] != size:
            own[:] = 0
        own[: image.shape[0], : image.shape[1]] = image
    return together.to(device, non_blocking=True)
