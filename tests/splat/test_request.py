"""Structs of the compiled library: fields by name, zeros for the others, and no field that there is not."""

from __future__ import annotations

import pytest
import torch

from twin_node.splat import library as native
from twin_node.splat.arguments import Options
from twin_node.splat.request import fill, new_request
from twin_node.splat.semantics import Semantics


def test_a_request_holds_its_options_and_what_is_named_and_zeros_else() -> None:
    options = Options(0.5, 8.0, 2.0, 0.25, sh_degree=2, render_mode="RGB+ED", rasterize_mode="antialiased")
    means = torch.zeros(3, 3)
    request = new_request(options, Semantics(0.75, 0.125), gaussians=3, means=means, colors=torch.zeros(0, 3))
    found = {name: getattr(request, name) for name, _ in native.Request._fields_ if getattr(request, name)}
    named = {"gaussians": 3, "means": means.data_ptr(), "sh_degree": 2, "depth_mode": 2, "antialiased": 1}
    limits = {"near_plane": 0.5, "far_plane": 8.0, "radius_clip": 2.0, "eps2d": 0.25}
    assert found == {**named, **limits, "max_alpha": 0.75, "min_compensation": 0.125}


def test_a_name_that_is_no_field_is_refused() -> None:
    with pytest.raises(AttributeError, match="v_color"):
        fill(native.Gradients, v_color=torch.zeros(3))
