"""What the sets of a run held of each camera, and what they had to do without."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Sequence

from twin_node.nodes.topics import CameraTopics
from twin_node.scene import FrameSet

LEAST_SHARE = 0.5
"""Share of all sets in which a camera is expected to have an image, and of its images with depth where it measures."""


class SetContents:
    """Counts, set by set."""

    def __init__(self) -> None:
        self.sets = 0
        self.images: Counter[str] = Counter()
        """By camera."""
        self.depths: Counter[str] = Counter()
        """The same of images with depth."""

    def add(self, frames: FrameSet) -> None:
        """Takes note of a set."""
        self.sets += 1
        self.images.update(view.camera.name for view in frames.views)
        self.depths.update(view.camera.name for view in frames.views if view.depth is not None)

    def lacking(self, names: Collection[str], cameras: Sequence[CameraTopics], rate: float = 1.0) -> tuple[str, ...]:
        """A line for each camera of the names that most sets had to do without, or its images without their depth.

        `rate`: speed of the clock by that of the recording; where it is higher, images may come too late by it.
        """
        hurried = f"; or {rate:g} times the recording's speed is too fast here: lower --rate" if rate > 1 else ""
        lines = [
            f"camera {name}: in only {self.images[name]} of {self.sets} sets: its images' stamps lie too far from the "
            f"others', or it sends more slowly; see their times with 'twin_node check'{hurried}"
            for name in names
            if self.images[name] < LEAST_SHARE * self.sets
        ]
        for camera in cameras:
            images, depths = self.images[camera.name], self.depths[camera.name]
            if camera.name in names and camera.depth and depths < LEAST_SHARE * images:
                lines.append(
                    f"camera {camera.name}: depth with only {depths} of its {images} images: stamps of {camera.depth} "
                    "lie too far from theirs (synchronizer.depth_tolerance_ms), or fewer came; see their times with "
                    f"'twin_node check'{hurried}"
                )
        return tuple(lines)
