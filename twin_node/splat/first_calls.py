"""Calls torch's vector functions once before two threads do so at the same time.

The MKL that torch 2.13 brings (2024.2) chooses the kernel of such a function when it is first called. Where two threads
come at once, one of them may get the kernel of least accuracy for its whole part: half of a first `exp` over 4,800
numbers was 1.5e-4 off, relatively, in 5 of 356 fresh processes on a Xeon with AVX-512, and what followed was not to the
bit what it was in the others (https://github.com/pytorch/pytorch/issues/188792).
"""

from __future__ import annotations

import torch

VECTOR_FUNCTIONS = (
    *(torch.acos, torch.asin, torch.atan, torch.cos, torch.sin, torch.tan, torch.cosh, torch.sinh, torch.tanh),
    *(torch.exp, torch.exp2, torch.expm1, torch.log, torch.log10, torch.log1p, torch.log2, torch.sqrt, torch.rsqrt),
    *(torch.erf, torch.erfc, torch.erfinv),
)
"""Those that torch hands to MKL where it has one, and their kin: two kinds of number take some 2 ms, once."""


def settle() -> None:
    """Has the kernels chosen by one thread: numbers so few are not shared out."""
    for kind in (torch.float32, torch.float64):
        few = torch.full((1,), 0.5, dtype=kind)
        for function in VECTOR_FUNCTIONS:
            function(few)
