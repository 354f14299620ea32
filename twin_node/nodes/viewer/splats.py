"""Gaussians in the browser: those that stand are sent with each whole cloud, those that move at every picture."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin_node.geometry import rotation_from_quat
from twin_node.nodes.snapshot import Snapshot
from twin_node.scene import Float64, GaussianCloud, Tier

SENT_SCALE = 10.0
"""Clouds are sent so many times as large, and shown so many times as small: the browser holds covariances as float16,
which has no digits left for a Gaussian of 1 mm (1e-6 m^2)."""
STILL, MOVING = "/gaussians/static", "/gaussians/moving"


class SplatLayers:
    """Two layers of native splats, standing and moving.

    What begins to move between two whole clouds is in both until the next: sent anew, all that stands would be sent
    several times per second for a few Gaussians.
    """

    def __init__(self, server: Any) -> None:
        self._server = server
        self._layers: dict[str, Any] = {}
        self._still_stamp: int | None = None
        self._shown_at = 0
        self.is_shown = True

    def show(self, snapshot: Snapshot) -> None:
        """Brings both layers up to date."""
        for layer in self._layers.values():
            layer.visible = self.is_shown
        cloud = snapshot.cloud
        if cloud is None:  # before the first: those that are there are of later
            self._still_stamp = None
            for name in tuple(self._layers):
                self._layers.pop(name).remove()
            return
        still = cloud.tiers == Tier.STATIC
        is_back = snapshot.stamp < self._shown_at  # what began to move since then stands again
        self._shown_at = snapshot.stamp
        if snapshot.whole_stamp != self._still_stamp or is_back:
            self._send(STILL, cloud.only(still))
            self._still_stamp = snapshot.whole_stamp
        self._send(MOVING, cloud.only(~still))

    def set_visible(self, is_shown: bool) -> None:
        """Shows or hides both layers from the next picture on."""
        self.is_shown = is_shown

    def _send(self, name: str, cloud: GaussianCloud) -> None:
        if not len(cloud.means):
            if name in self._layers:
                self._layers.pop(name).remove()
            return
        centers = cloud.means.astype(np.float32) * np.float32(SENT_SCALE)
        covariances = (covariances_of(cloud) * SENT_SCALE**2).astype(np.float32)
        opacities = cloud.opacities[:, None]
        if name in self._layers:
            self._layers[name].set_gaussians(centers, covariances, cloud.rgb, opacities)
        else:
            self._layers[name] = self._server.scene.add_gaussian_splats(
                name, centers, covariances, cloud.rgb, opacities, scale=1 / SENT_SCALE, visible=self.is_shown
            )


def covariances_of(cloud: GaussianCloud) -> Float64:
    """[N, 3, 3] m^2."""
    axes: NDArray[np.float64] = rotation_from_quat(cloud.quats.astype(np.float64)) * cloud.scales[:, None, :]
    return axes @ np.swapaxes(axes, -1, -2)
