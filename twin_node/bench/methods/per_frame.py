"""3DGS for each set of images by itself, from scratch (Kerbl et al., TOG 2023): no motion, no memory."""

from __future__ import annotations

from twin_node.bench.methods.following import no_motion
from twin_node.bench.methods.protocol import Budget, Fitted, Progress
from twin_node.bench.methods.whole_sequence import train_parameters
from twin_node.model.sequence import Recording, Trainer
from twin_node.model.sequence.baking import bake_steps


def fit_per_frame(recording: Recording, budget: Budget, progress: Progress) -> Fitted:
    """A static model per set, all with the same steps."""
    sets = recording.sets()
    steps, parameters = [], 0
    for index, one in enumerate(sets):
        alone = Recording(recording.name, one.views, background=recording.background)
        trainer = Trainer(alone, train_parameters(budget, "static", budget.per_frame_steps))
        while not trainer.finished:
            trainer.advance()
        moved = trainer.model.at([one.stamp])
        steps.append(moved.detached())
        parameters += trainer.model.parameters_count
        progress((index + 1) / len(sets))
    baked = bake_steps([one.stamp for one in sets], steps, recording.background, recording.cameras)
    return Fitted(baked.render, no_motion, parameters, 4 * parameters)
