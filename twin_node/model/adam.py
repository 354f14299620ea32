"""Adam for the few parameters of a live model."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

FIRST, SECOND, EPSILON = 0.9, 0.999, 1e-8
"""Decays of the moments, and what keeps a step finite (Kingma and Ba, ICLR 2015, algorithm 1)."""


class Adam:
    """Steps as `torch.optim.Adam` takes them with its defaults; each tensor has a rate of its own.

    Not torch's own, whose first optimiser imports torch's compiler: a second and 74 MB of every twin that starts, for
    parameters that most scenes never use.
    """

    def __init__(self, rates: Sequence[tuple[Tensor, float]]) -> None:
        """`rates`: tensors that hold gradients, and how far each may go in a step."""
        self._rates = list(rates)
        self._moments = [(torch.zeros_like(tensor), torch.zeros_like(tensor)) for tensor, _ in self._rates]
        self._steps = 0

    @torch.no_grad()
    def step(self) -> None:
        """One step along the gradients of those that have one."""
        self._steps += 1
        short, long = 1 - FIRST**self._steps, 1 - SECOND**self._steps
        for (tensor, rate), (first, second) in zip(self._rates, self._moments, strict=True):
            if tensor.grad is not None:
                first.lerp_(tensor.grad, 1 - FIRST)
                second.mul_(SECOND).addcmul_(tensor.grad, tensor.grad, value=1 - SECOND)
                tensor.addcdiv_(first, (second / long).sqrt() + EPSILON, value=-rate / short)

    def forget_gradients(self) -> None:
        """Lets all gradients go."""
        for tensor, _ in self._rates:
            tensor.grad = None
