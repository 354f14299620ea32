"""The model's kernels under the address and undefined-behaviour sanitizers, over cases of the other tests."""

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
native_build.KernelSources.best_library = lambda self, variant: given if self.name == "model" else found(self, variant)
import test_arm_mask, test_births, test_carried, test_compiled_mask, test_exposure, test_flow, test_least_squares
import test_nodes, test_normal_equations, test_observation, test_rendering, test_semi_global, test_steps, test_sweep
import test_velocity_equations
test_arm_mask.test_compiled_and_plain_find_the_same()
test_carried.test_the_compiled_cloud_is_the_plain_one()
test_carried.test_compiled_cells_are_the_plain_ones()
test_carried.test_what_creeps_is_told_by_the_compiled_kernel_as_by_the_plain_one()
test_exposure.test_the_compiled_kernels_tell_and_remember_what_numpy_does.hypothesis.inner_test(0.7, 0.05, 0.6, 0)
test_least_squares.test_the_compiled_kernel_takes_the_step_that_torch_does()
test_nodes.test_groups_by_kernel_are_those_in_numpy(30)
test_nodes.test_how_nodes_have_moved_and_what_they_carry_are_by_kernel_what_they_are_in_torch()
test_rendering.test_compiled_images_before_their_backdrops_are_those_in_torch_to_the_bit()
test_velocity_equations.test_compiled_velocities_are_the_plain_ones()
test_velocity_equations.test_bodies_are_judged_by_the_compiled_kernel_as_by_the_plain_one()
test_steps.test_the_compiled_kernel_holds_a_rendering_to_the_pixels_that_numpy_does()
test_steps.test_the_compiled_kernel_finds_what_stands_before_as_numpy_does()
test_observation.test_views_are_compared_by_the_compiled_kernel_as_by_the_plain_one(True, (70, 14))
test_arm_mask.test_compiled_and_plain_tell_the_same_of_the_arms_pixels()
test_compiled_mask.test_lines_of_one_and_two_pixels_are_images_too((slice(25, 26), slice(None)))
test_compiled_mask.test_several_cameras_at_once_are_those_one_by_one()
test_flow.test_compiled_flow_is_that_in_numpy()
test_nodes.test_compiled_poses_are_those_in_torch()
test_sweep.test_compiled_comparisons_are_those_in_numpy()
for shape in ((12, 17, 33), (1, 6, 4)):
    test_semi_global.test_compiled_sums_are_those_in_numpy(shape)
for things in (0, 400):
    test_nodes.test_the_nearest_by_kernel_are_those_by_tree(6, 50, things)
for depth, side in ((False, 2), (True, 2), (False, 6)):
    test_births.test_compiled_births_are_those_found_in_numpy(depth, None, 0.05, side)
for depth in (False, True):
    test_steps.test_what_the_kernels_refute_is_what_is_refuted_in_numpy(depth)
    test_steps.test_what_is_seen_at_rest_is_by_kernel_what_it_is_in_numpy(depth)
    test_normal_equations.test_equations_are_those_of_numpy(depth)
test_normal_equations.test_spheres_reach_into_the_image_as_far_as_numpy_says.hypothesis.inner_test(0, 1.0)
test_steps.test_the_compiled_kernel_stores_newborns_as_torch_does(40, 4)
from twin_node.model.kernels import kernels
assert kernels() is not None
print("clean")
"""


def test_the_models_kernels_are_clean(tmp_path: Path) -> None:
    assert_clean(native_build.MODEL, PROGRAM, Path(__file__).parent, tmp_path)
