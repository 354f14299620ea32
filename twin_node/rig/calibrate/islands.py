"""Which cameras hang together: those that a chain of pairs links."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components


def islands(cameras: int, links: Collection[tuple[int, int]]) -> list[list[int]]:
    """Groups of cameras that links between two of them hold together, in order of their first camera."""
    ends = np.array(list(links), dtype=np.intp).reshape(-1, 2)
    graph = csr_matrix((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(cameras, cameras))
    _, labels = connected_components(graph, directed=False)
    groups: dict[int, list[int]] = {}
    for camera in range(cameras):
        groups.setdefault(int(labels[camera]), []).append(camera)
    return list(groups.values())
