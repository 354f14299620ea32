"""The forecast's kernels under the address and undefined-behaviour sanitizers, over cases of the other tests."""

from __future__ import annotations

from pathlib import Path

from sanitizers import assert_clean

from twin_node import native_build

PROGRAM = """
import sys
from pathlib import Path
from twin_node import native_build
found = native_build.KernelSources.best_library
given = Path(sys.argv[1])
native_build.KernelSources.best_library = lambda of, variant: given if of.name == "forecast" else found(of, variant)
import numpy as np
import test_agreement, test_ahead, test_bits, test_boxes, test_concealing, test_error_scale, test_growth, test_hiding
import test_judgement, test_leading, test_nearest, test_outlook, test_own_space, test_parts, test_past_errors
import test_reaches, test_reckoning, test_resting, test_shown, test_sights, test_static, test_things, test_verdicts


def once(test, *given):
    test.hypothesis.inner_test(*given)


for seed in (0, 1, 2):
    once(test_agreement.test_compiled_velocities_are_the_plain_ones, seed, seed, 10 * seed)
    once(test_ahead.test_compiled_layers_are_the_plain_ones_bit_by_bit, seed, (0.0, 0.1, 2.0)[seed])
    once(test_bits.test_compiled_lists_and_runs_are_the_plain_ones, ((1, 1, 1), (3, 5, 64), (2, 7, 65))[seed], seed)
    once(test_boxes.test_compiled_covers_are_the_plain_ones, seed, 6 * seed, 1 + 20 * seed)
    once(test_concealing.test_compiled_concealed_space_is_the_plain_one, seed, seed > 0)
    once(test_growth.test_compiled_growth_is_the_plain_one_bit_by_bit, seed, (2, 9, 40)[seed])
    dims = ((1, 1, 1), (13, 9, 40), (8, 7, 140))[seed]
    once(test_hiding.test_compiled_hiding_places_are_the_plain_ones, seed, dims, 0.02)
    once(test_own_space.test_compiled_capsules_are_the_plain_ones, seed, 2 * seed)
    once(test_parts.test_compiled_parts_are_the_plain_ones, seed, ((1, 1, 1), (20, 3, 7), (9, 9, 9))[seed], 0.03, 0.5)
    once(test_shown.test_compiled_images_are_the_plain_ones, seed)
    once(test_shown.test_compiled_visible_voxels_are_the_plain_ones, seed, 100 * seed)
    once(test_shown.test_what_compiled_pixels_tell_is_what_plain_ones_do, seed)
    once(test_sights.test_compiled_sights_are_the_plain_ones, seed, seed, (0.7, 1.5, 3.2)[seed])
    once(test_sights.test_compiled_backdrops_are_the_plain_ones, seed)
    once(test_static.test_compiled_marks_are_the_plain_ones, seed, 0.05)
    once(test_things.test_compiled_pieces_are_the_plain_ones, seed, 60 * seed)
    once(test_things.test_compiled_things_are_the_plain_ones, seed, 0.02, 0.3)
    once(test_verdicts.test_compiled_verdicts_are_the_plain_ones, seed, 2 * seed, 7)
    test_judgement.test_measured_points_are_found_compiled_as_reference(seed)
    test_resting.test_compiled_memory_is_the_plain_one(seed)
for count in (1, 9):
    test_error_scale.test_compiled_as_reference(count)
    test_leading.test_compiled_as_reference(count, 3, 0.3)
    test_nearest.test_compiled_as_reference(40, 7, count, 0.3)
    test_outlook.test_compiled_as_reference(count, 5)
    test_past_errors.test_compiled_as_reference(0.5, count)
    test_reckoning.test_compiled_as_reference(count, (3, 3, 2, 0), True)
test_reaches.test_compiled_to_the_bit_as_reference(test_reaches.HORIZONS, 1.0, True, True)
from twin_node.forecast.kernels import kernels
assert kernels() is not None
print("clean")
"""


def test_the_forecasts_kernels_are_clean(tmp_path: Path) -> None:
    assert_clean(native_build.FORECAST, PROGRAM, Path(__file__).parent, tmp_path)
