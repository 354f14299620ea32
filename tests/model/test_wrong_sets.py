"""Sets that nothing can be made of are refused before anything is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from model_scenes import rig, sliding

from twin_node.model import ModelError, ModelParameters, SeedParameters, WindowModel

QUICK = ModelParameters(seed=SeedParameters(steps=24), gaussians_per_pixel=0.5)
CAMERAS = rig()


def test_wrong_sets_are_refused_in_one_line() -> None:
    model = WindowModel(QUICK)
    sets = sliding(2, CAMERAS)
    with pytest.raises(ModelError, match="no set has been seen"):
        model.render_frozen(CAMERAS[0])
    with pytest.raises(ModelError, match="follow: no set has been seen"):
        model.follow(WindowModel(QUICK).look(sets[0]))
    with pytest.raises(ModelError, match="at least one view"):
        model.update(replace(sets[0], views=()))
    model.update(sets[1])
    with pytest.raises(ModelError, match="sort the source"):
        model.update(sets[0])


@pytest.mark.parametrize(
    ("name", "shape", "kind"),
    [
        ("rgb", (30, 40, 3), np.uint8),
        ("rgb", (60, 80), np.uint8),
        ("rgb", (60, 80, 3), np.float32),
        ("depth", (30, 40), np.float32),
        ("depth", (60, 80), np.float64),
        ("valid", (80, 60), np.bool_),
    ],
)
def test_images_that_are_not_of_their_cameras_size_are_refused(name: str, shape: tuple[int, ...], kind: type) -> None:
    """Compiled code takes sizes from the camera: it would read what lies beyond the image."""
    model, one = WindowModel(QUICK), sliding(1, CAMERAS)[0]
    wrong = replace(one.views[1], **{name: np.ones(shape, kind)})
    with pytest.raises(ModelError, match=f"camera cam1: expected {name} .*, found .* of {np.dtype(kind)}; give images"):
        model.update(replace(one, views=(one.views[0], wrong, *one.views[2:])))


def test_cameras_of_one_name_are_refused() -> None:
    """Each was compared with what the last of them sees, and all of it moved."""
    model, one = WindowModel(QUICK), sliding(1, CAMERAS)[0]
    views = tuple(replace(view, camera=replace(view.camera, name="cam")) for view in one.views)
    with pytest.raises(ModelError, match="set 0: expected one view of a camera, found 3 of cam; give every camera a"):
        model.update(replace(one, views=views))


def test_stamps_in_seconds_are_refused() -> None:
    model, one = WindowModel(QUICK), sliding(1, CAMERAS)[0]
    wrong = replace(one.views[1], stamp=1.7e9)
    with pytest.raises(ModelError, match=r"camera cam1: expected a stamp in whole nanoseconds, found 1700000000\.0"):
        model.update(replace(one, stamp=1.7e9, views=(one.views[0], wrong, *one.views[2:])))


@pytest.mark.parametrize("kind", [np.int64, np.uint64])
def test_stamps_that_numpy_counts_are_stamps(kind: type[np.integer]) -> None:
    """Signed ones ended in a traceback, and the differences of unsigned ones wrapped around."""
    plain, counted = WindowModel(QUICK), WindowModel(QUICK)
    for one in sliding(3, CAMERAS, depth=True):
        early = [replace(view, stamp=view.stamp - 1_000_000 * i) for i, view in enumerate(one.views)]
        views = tuple(replace(view, stamp=kind(view.stamp)) for view in early)
        expected = plain.update(replace(one, views=tuple(early)))
        found = counted.update(replace(one, stamp=kind(one.stamp), views=views))
    assert type(found.stamp) is int
    np.testing.assert_array_equal(found.gaussians.means, expected.gaussians.means)


@pytest.mark.parametrize("wild", [np.nan, np.inf, -np.inf, -1.0])
def test_depth_that_no_camera_measures_is_refused_before_anything_is_made_of_the_set(wild: float) -> None:
    """Of a moving thing with -1 where nothing was measured, a fifth was held by no voxel."""
    model, sets = WindowModel(QUICK), sliding(3, CAMERAS, depth=True)
    depth = sets[1].views[1].depth
    assert depth is not None
    torn = depth.copy()
    torn[7, 5] = wild
    views = (sets[1].views[0], replace(sets[1].views[1], depth=torn), sets[1].views[2])
    model.update(sets[0])
    with pytest.raises(ModelError, match=f"camera cam1: expected depth .*, found {wild} at row 7, column 5; put 0"):
        model.update(replace(sets[1], views=views))
    assert np.isfinite(model.update(sets[1]).gaussians.means).all()
