"""Canonical Gaussians under training: parameters, their Adam states, and rows that come and go."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn

from twin_node.model.ply import StoredGaussians
from twin_node.model.sequence.parameters import RateParameters

PLACES = ("means", "quats", "log_scales", "logits", "colours", "harmonics")
"""The tensors of a `CanonicalGaussians`, each a parameter group of the optimiser."""
MOMENTS = ("exp_avg", "exp_avg_sq")
"""Adam's states that have a row per Gaussian."""


@dataclass(frozen=True)
class Offspring:
    """Copies of Gaussians, moved and resized."""

    rows: Tensor
    """[n] what they are copies of."""
    means: Tensor
    """[n, 3] m."""
    log_scales: Tensor
    """[n, 3] log of metres."""


class CanonicalGaussians:
    """N Gaussians as 3DGS trains them, with one Adam over their six tensors."""

    def __init__(self, stored: StoredGaussians, rates: RateParameters, extent: float, device: torch.device) -> None:
        def leaf(values: np.ndarray) -> nn.Parameter:
            return nn.Parameter(torch.tensor(values, dtype=torch.float32, device=device))

        self._rates = rates
        self._extent = extent
        self.means = leaf(stored.means)
        """[N, 3] m."""
        self.quats = leaf(stored.quats)
        """[N, 4] w, x, y, z, not normalised."""
        self.log_scales = leaf(stored.log_scales)
        """[N, 3] log of metres."""
        self.logits = leaf(stored.logits)
        """[N] logit of the opacity."""
        self.colours = leaf(stored.sh[:, :1])
        """[N, 1, 3] constant harmonic."""
        self.harmonics = leaf(stored.sh[:, 1:])
        """[N, K - 1, 3] the others."""
        groups = [{"params": [getattr(self, name)], "lr": self._rate(name, 0.0), "name": name} for name in PLACES]
        self.optimizer = torch.optim.Adam(groups, eps=1e-15, fused=True)

    def __len__(self) -> int:
        return len(self.means)

    @property
    def sh(self) -> Tensor:
        """[N, K, 3] all harmonic coefficients."""
        return torch.cat([self.colours, self.harmonics], 1)

    @property
    def parameters_count(self) -> int:
        """Learned numbers."""
        return sum(getattr(self, name).numel() for name in PLACES)

    def schedule(self, share: float) -> None:
        """Sets the rates for a share of the run: those of the means fall exponentially."""
        for group in self.optimizer.param_groups:
            group["lr"] = self._rate(group["name"], share)

    def keep(self, rows: Tensor) -> None:
        """Only `rows` [n] stay, in that order."""
        for name in PLACES:
            values: Tensor = getattr(self, name)
            self._swap(name, values.detach()[rows], lambda moment: moment[rows])

    def add(self, born: Offspring) -> None:
        """Appends copies with moments of zero."""
        changed = {"means": born.means, "log_scales": born.log_scales}
        n = len(born.rows)
        for name in PLACES:
            values: Tensor = getattr(self, name)
            copies = changed.get(name, values.detach()[born.rows])
            self._swap(name, torch.cat([values.detach(), copies]), lambda moment: _grown(moment, n))

    def cap_opacity(self, ceiling: float) -> None:
        """No opacity stays above `ceiling`; their moments are forgotten (Kerbl et al., TOG 2023, section 5.2)."""
        highest = float(np.log(ceiling / (1 - ceiling)))
        self._swap("logits", self.logits.detach().clamp(max=highest), torch.zeros_like)

    def stored(self) -> StoredGaussians:
        """As files hold them."""

        def array(tensor: Tensor) -> np.ndarray:
            return tensor.detach().cpu().numpy().copy()

        return StoredGaussians(
            array(self.means), array(self.quats), array(self.log_scales), array(self.logits), array(self.sh)
        )

    def states(self) -> Iterator[tuple[str, Tensor]]:
        """Adam's states by name, for checkpoints; none before the first step."""
        for group in self.optimizer.param_groups:
            for name, value in self.optimizer.state[group["params"][0]].items():
                yield f"{group['name']}.{name}", value

    def restore(self, states: Mapping[str, Tensor]) -> None:
        """Takes Adam's states as `states` gave them."""
        for group in self.optimizer.param_groups:
            parameter = group["params"][0]
            prefix = f"{group['name']}."
            own = {name.removeprefix(prefix): value for name, value in states.items() if name.startswith(prefix)}
            if own:
                self.optimizer.state[parameter] = {name: value.to(parameter.device) for name, value in own.items()}

    def _swap(self, name: str, values: Tensor, change_moment: Callable[[Tensor], Tensor]) -> None:
        """A tensor's new values, and what becomes of its moments."""
        group = next(group for group in self.optimizer.param_groups if group["name"] == name)
        state = self.optimizer.state.pop(group["params"][0], {})
        parameter = nn.Parameter(values.clone())
        setattr(self, name, parameter)
        group["params"] = [parameter]
        for moment in MOMENTS:
            if moment in state:
                state[moment] = change_moment(state[moment])
        if state:
            self.optimizer.state[parameter] = state

    def _rate(self, name: str, share: float) -> float:
        if name == "means":
            return self._extent * float(self._rates.means ** (1 - share) * self._rates.means_final**share)
        rate: float = getattr(self._rates, name)
        return rate


def _grown(moment: Tensor, count: int) -> Tensor:
    return torch.cat([moment, moment.new_zeros(count, *moment.shape[1:])])
