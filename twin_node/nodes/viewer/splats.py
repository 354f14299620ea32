"""Gaussians in the browser: those that move are sent at every picture, those that stand as often as they are few."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin_node.geometry import rotation_from_quat
from twin_node.nodes.cloud_updates import is_same, rows_of
from twin_node.nodes.snapshot import Snapshot
from twin_node.scene import Float64, GaussianCloud, Tier

SENT_SCALE = 10.0
"""Clouds are sent so many times as large, and shown so many times as small: the browser holds covariances as float16,
which has no digits left for a Gaussian of 1 mm (1e-6 m^2)."""
LARGEST_SENT = float(np.finfo(np.float16).max)
"""Of a covariance as it is sent: a Gaussian wider than 25 m (1 sigma), as scenes of elsewhere have for their skies, is
shown so wide, for it would not be shown at all."""
STILL, MOVING = "/gaussians/static", "/gaussians/moving"


STILL_NS = 20_000
"""Time of the log between two sendings of what stands, ns per Gaussian: 10,000 go out every 0.2 s, 2 MB per second. Of
more than 50,000 each whole cloud is sent."""


class SplatLayers:
    """Two layers of native splats, standing and moving.

    What has begun to move since what stands was last sent is in both until it is sent again, and what has gone is still
    there; what has come to rest is shown with what moves until then.
    """

    def __init__(self, server: Any) -> None:
        self._server = server
        self._layers: dict[str, Any] = {}
        self._still: GaussianCloud | None = None
        """Those in the layer of what stands, in the order of their ids."""
        self._whole_stamp: int | None = None
        self._still_stamp = 0
        self.is_shown = True

    def show(self, snapshot: Snapshot) -> None:
        """Brings both layers up to date."""
        for layer in self._layers.values():
            layer.visible = self.is_shown
        cloud = snapshot.cloud_now
        if cloud is None:  # before the first: those that are there are of later
            self._still = self._whole_stamp = None
            for name in tuple(self._layers):
                self._layers.pop(name).remove()
            return
        stands = cloud.tiers == Tier.STATIC
        if self._is_due(snapshot, int(stands.sum())):
            self._whole_stamp, self._still_stamp = snapshot.whole_stamp, snapshot.stamp
            still = cloud.only(stands)
            still = still.only(np.argsort(still.ids))
            if self._still is None or not is_same(still, self._still):
                self._still = still
                self._send(STILL, still)
        elif self._still is not None:
            stands &= rows_of(cloud.ids, self._still.ids)[1]
        self._send(MOVING, cloud.only(~stands))

    def _is_due(self, snapshot: Snapshot, count: int) -> bool:
        """Whether what stands, so many Gaussians, is sent again: also when time has gone back."""
        since = snapshot.stamp - self._still_stamp
        return self._still is None or snapshot.whole_stamp != self._whole_stamp or since < 0 or since > count * STILL_NS

    def set_visible(self, is_shown: bool) -> None:
        """Shows or hides both layers from the next picture on."""
        self.is_shown = is_shown

    def _send(self, name: str, cloud: GaussianCloud) -> None:
        if not len(cloud.means):
            if name in self._layers:
                self._layers.pop(name).remove()
            return
        centers = cloud.means.astype(np.float32) * np.float32(SENT_SCALE)
        covariances = covariances_of(cloud) * SENT_SCALE**2
        largest = covariances.max(axis=(1, 2), keepdims=True)
        covariances = (covariances * np.minimum(1, LARGEST_SENT / np.maximum(largest, 1))).astype(np.float32)
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
