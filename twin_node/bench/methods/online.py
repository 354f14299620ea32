"""The live model of this project, following the sets one by one."""

from __future__ import annotations

import numpy as np

from twin_node.bench.methods.following import Population, follow_populations
from twin_node.bench.methods.protocol import Budget, Fitted, Progress
from twin_node.model import WindowModel
from twin_node.model.sequence import Recording
from twin_node.model.sequence.baking import bake_steps, moved_from_cloud
from twin_node.scene import GaussianCloud, Tier


def fit_online(recording: Recording, budget: Budget, progress: Progress) -> Fitted:
    """Every set in turn; what it published at each is what is scored."""
    model = WindowModel(budget.online, seed=budget.seed)
    sets = recording.sets()
    clouds: list[GaussianCloud] = []
    sent, deformable = 0, 0
    for index, one in enumerate(sets):
        clouds.append(model.update(one).gaussians)
        sent += model.bytes_per_frame
        deformable = max(deformable, model.tier_counts[Tier.DEFORMABLE])
        progress((index + 1) / len(sets))
    stamps = [one.stamp for one in sets]
    baked = bake_steps(stamps, [moved_from_cloud(one) for one in clouds], (0.0, 0.0, 0.0), recording.cameras)

    def population(step: int) -> Population:
        cloud = clouds[step]
        order = np.argsort(cloud.ids)
        return Population(
            cloud.ids[order].astype(np.int64),
            cloud.means[order].astype(np.float64),
            cloud.opacities[order].astype(np.float64),
        )

    notes = {f"{tier.name.lower()}": float(count) for tier, count in model.tier_counts.items()}
    notes["most_deformable"] = float(deformable)
    follow = follow_populations(len(sets), population)
    return Fitted(baked.render, follow, model.parameters_count, sent, notes)
