"""The camera's own image before: no model, and for a held-out camera no rival, as it needs the camera itself."""

from __future__ import annotations

from twin_node.bench.methods.following import no_motion
from twin_node.bench.methods.protocol import Budget, Fitted, Progress
from twin_node.model.sequence import Recording
from twin_node.model.sequence.recording import nearest
from twin_node.nodes.report.quality import unit
from twin_node.scene import Camera, Float32, View


def fit_previous(recording: Recording, budget: Budget, progress: Progress) -> Fitted:
    """Shows, in place of each image, the one that the same camera took before it; nothing in place of its first."""
    del budget
    by_camera: dict[str, list[View]] = {}
    for view in (*recording.train, *recording.held_out):
        by_camera.setdefault(view.camera.name, []).append(view)

    def render(camera: Camera, stamp: int) -> Float32 | None:
        views = by_camera[camera.name]
        index = nearest([view.stamp for view in views], stamp)
        return unit(views[index - 1]) if index else None

    progress(1.0)
    return Fitted(render, no_motion, None, None)
