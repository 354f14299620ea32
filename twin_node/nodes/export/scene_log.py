"""Gaussians of files, as logs that viewer, films and exports read: a scene edited elsewhere, a model over its time."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from twin_node.bag import LogWriter
from twin_node.messages import convert
from twin_node.model.parameters import ModelError
from twin_node.model.ply import cloud_from_stored
from twin_node.model.sequence import is_baked, load_baked
from twin_node.nodes.export.checkpoint import CheckpointSource
from twin_node.nodes.export.scene_files import read_scene
from twin_node.nodes.topics import GAUSSIANS
from twin_node.scene import GaussianCloud


def import_ply(path: Path, output: Path) -> int:
    """Writes the Gaussians of a file (see `read_scene`) as one latched `/twin/gaussians`, all STATIC; returns how many.

    Colours become those of all sides, in 8 bits; the stamp is 0. Raises `ModelError` or `BagError` for a wrong path,
    `ModelError` for Gaussians that are nowhere, or of no size, shape or colour, and where there are none.
    """
    cloud = cloud_from_stored(read_scene(path))
    if not len(cloud.means):
        raise ModelError(f"{path}: expected Gaussians, found none; export the scene again")
    _require_finite(cloud, path)
    with LogWriter(output) as log:
        log.write(GAUSSIANS, convert.gaussians_to_pointcloud2(cloud, 0), 0)
    return len(cloud.means)


def import_model(path: Path, output: Path) -> int:
    """Writes a checkpoint of `twin_node train`, as many moments as it saw sets, evenly, or all of what `bake` made.

    Each is one latched `/twin/gaussians` with the time's stamp, in colours of all sides in 8 bits; returns how many. A
    data set's times that begin before 0 begin at 0 in the log, which has no others. Raises as `import_ply` does.
    """
    begin, count = 0, 0
    with LogWriter(output) as log:
        for stamp, cloud in _baked_clouds(path) if is_baked(path) else _trained_clouds(path):
            _require_finite(cloud, path)
            begin = begin if count else min(stamp, 0)
            log.write(GAUSSIANS, convert.gaussians_to_pointcloud2(cloud, stamp - begin), stamp - begin)
            count += 1
    return count


def _baked_clouds(path: Path) -> Iterator[tuple[int, GaussianCloud]]:
    baked = load_baked(path)
    for step, stamp in enumerate(baked.stamps):
        yield stamp, cloud_from_stored(baked.stored(step))


def _trained_clouds(path: Path) -> Iterator[tuple[int, GaussianCloud]]:
    source = CheckpointSource(path)
    for moment in source.moments(source.stamps, None, with_clouds=True):
        assert moment.cloud is not None
        yield moment.stamp, moment.cloud


def _require_finite(cloud: GaussianCloud, path: Path) -> None:
    """Raises `ModelError` for Gaussians that no reader of a log would take."""
    finite = np.isfinite(np.column_stack([cloud.means, cloud.quats, cloud.scales, cloud.opacities, cloud.rgb])).all(1)
    fit = finite & cloud.quats.any(1)
    if not fit.all():
        bad = f"{np.sum(~fit)} of {len(cloud.means)} Gaussians, the first at {int(fit.argmin())}"
        raise ModelError(
            f"{path}: expected finite numbers and quaternions that are not 0, found others in {bad}; take them out "
            "where it was made"
        )
