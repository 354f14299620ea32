"""The scene of the first set of images, for ever: what every method has to beat."""

from __future__ import annotations

from twin_node.bench.methods.following import stand_still
from twin_node.bench.methods.protocol import Budget, Fitted, Progress
from twin_node.model import WindowModel
from twin_node.model.sequence import Recording


def fit_frozen(recording: Recording, budget: Budget, progress: Progress) -> Fitted:
    """The online model's Gaussians as it fits them to the first set."""
    model = WindowModel(budget.online, seed=budget.seed)
    sets = recording.sets()
    model.update(sets[0])
    progress(1.0)
    return Fitted(
        lambda camera, _: model.render_frozen(camera).rgb,
        stand_still(len(sets)),
        model.parameters_count,
        4 * model.parameters_count,
    )
