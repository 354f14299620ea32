"""The kernels under the address and undefined-behaviour sanitizers, over cases of the other tests."""

from __future__ import annotations

from pathlib import Path

from sanitizers import assert_clean

from twin_node import native_build

PROGRAM = """
import sys
from pathlib import Path
from twin_node.splat import library as native
library = native.SplatLibrary(Path(sys.argv[1]))
native.kernels = lambda: library
import test_layouts, test_loss, test_missed, test_native, test_still
from splat_scenes import differentiate
from twin_node.splat import rasterize
for name in ("degree 3, expected depth", "nineteen channels", "mask", "huge", "flat and long", "tiny, antialiased"):
    differentiate(rasterize, test_native.CASES[name])
test_native.test_overflowing_projections_are_culled(library)
test_native.test_an_empty_mask_renders_nothing(library)
test_native.test_colors_per_camera(None, library)
for size in ((33, 47), (5, 3), (1, 1)):
    for channels in (3, 4):
        for weighted in (False, True):
            test_loss.test_agrees_with_the_plain_loss(size, channels, weighted, library)
for with_depth in (False, True):
    test_missed.test_agrees_with_the_plain_one(with_depth, library)
for call in test_layouts.CALLS:
    test_layouts.test_what_fits_is_taken(call)
for camera in (0, 1):
    test_still.test_weights_agree_with_the_plain_ones(camera, library)
print("clean")
"""


def test_kernels_are_clean(tmp_path: Path):
    assert_clean(native_build.SPLAT, PROGRAM, Path(__file__).parent, tmp_path)
