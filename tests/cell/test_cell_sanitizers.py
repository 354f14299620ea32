"""The cell's kernels under the address and undefined-behaviour sanitizers, over cases of the other tests."""

from __future__ import annotations

from pathlib import Path

from sanitizers import assert_clean

from twin_node import native_build

PROGRAM = """
import sys
from pathlib import Path
from twin_node import native_build
given = Path(sys.argv[1])
native_build.KernelSources.best_library = lambda self, variant: given
import test_casting
for shape in test_casting.SHAPES:
    for pattern in test_casting.PATTERNS:
        test_casting.test_every_form_in_every_pattern_is_as_in_numpy(shape, pattern)
    for position in ((0.0, 0, 0), (0, 0, -2), (9, 0, 1), (0, 0, 0.24)):
        test_casting.test_solids_about_behind_beside_and_at_the_camera_are_as_in_numpy(shape, position)
test_casting.test_rays_within_faces_and_along_axes_are_as_in_numpy()
for seed, solids in ((0, 0), (1, 3), (2, 12)):
    test_casting.test_crowds_before_furniture_are_as_in_numpy.hypothesis.inner_test(seed, solids)
test_casting.test_what_sensors_make_of_images_is_as_in_numpy()
from twin_node.cell.kernels import kernels
assert kernels() is not None
print("clean")
"""


def test_the_cells_kernels_are_clean(tmp_path: Path) -> None:
    assert_clean(native_build.CELL, PROGRAM, Path(__file__).parent, tmp_path)
