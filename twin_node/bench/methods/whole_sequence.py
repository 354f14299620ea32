"""4DGS as published (Wu et al., CVPR 2024), on planes and on a hash grid: offline, to its plateau."""

from __future__ import annotations

from copy import deepcopy
from functools import partial

from twin_node.bench.methods.following import follow_model
from twin_node.bench.methods.protocol import Budget, Fitted, Progress
from twin_node.model.sequence import Recording, Trainer, TrainParameters
from twin_node.model.sequence.scoring import evenly, mean_psnr

PLATEAU_SHARE = 0.8
"""Share of the run after which the gain of what is left is told: how flat the plateau is."""
PROBES = 12
"""Training images that the gain is measured on."""


def train_parameters(budget: Budget, method: str, steps: int) -> TrainParameters:
    """The budget as parameters of sequence training."""
    return TrainParameters(
        method=method,
        steps=steps,
        degree=0,  # the online model has no harmonics either
        start_gaussians=budget.gaussians * 3 // 4,
        most_gaussians=budget.gaussians,
        seed=budget.seed,
        hexplane=budget.hexplane,
        hash=budget.hash,
    )


def _fit(recording: Recording, budget: Budget, progress: Progress, method: str) -> Fitted:
    trainer = Trainer(recording, train_parameters(budget, method, budget.offline_steps))
    total = trainer.parameters.all_steps
    model = before = trainer.model
    while not trainer.finished:
        trainer.advance()
        progress(trainer.step / total)
        if trainer.step == round(PLATEAU_SHARE * total):
            before = deepcopy(model)  # scored afterwards: that is no part of the learning
    stamps, probes = [one.stamp for one in recording.sets()], evenly(recording.train, PROBES)
    gain_db = mean_psnr(model, probes) - mean_psnr(before, probes)
    notes = {"gain_of_last_fifth_db": gain_db, "gaussians": float(len(model.gaussians))}
    count = model.parameters_count
    return Fitted(model.render, follow_model(model, stamps), count, 4 * count, notes)


fit_hexplane = partial(_fit, method="hexplane")
fit_hash = partial(_fit, method="hash")
fit_plain = partial(_fit, method="static")
"""3DGS of the whole sequence without a field: the mean over time."""
