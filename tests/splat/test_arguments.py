"""Whatever is wrong with a call is named before anything is rendered."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from splat_scenes import Case, make_case

from twin_node.splat import rasterize, rasterize_reference

CASE = make_case(count=9, cameras=2, channels=3)
TENSORS = ("means", "quats", "scales", "opacities", "colors", "viewmats", "Ks")
RENDERERS = pytest.mark.parametrize("renderer", [rasterize, rasterize_reference])


def assert_names(case: Case, name: str, renderer: Any = rasterize) -> None:
    with pytest.raises(ValueError, match=rf"^{name}\b") as raised:
        case.render(renderer)
    assert "\n" not in str(raised.value)


@RENDERERS
@pytest.mark.parametrize("name", TENSORS)
@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf")])
def test_values_that_are_not_finite(name: str, value: float, renderer: Any):
    tensor = getattr(CASE, name).clone()
    tensor.view(-1)[-1] = value
    assert_names(replace(CASE, **{name: tensor}), name, renderer)


@RENDERERS
def test_backgrounds_that_are_not_finite(renderer: Any):
    assert_names(CASE.with_options(backgrounds=torch.full((2, 3), float("nan"))), "backgrounds", renderer)


@pytest.mark.parametrize("name", TENSORS)
@given(data=st.data())
@settings(max_examples=15, deadline=None)
def test_wrong_shapes(name: str, data: st.DataObject):
    """Any axis longer or shorter than it should be, or gone."""
    tensor = getattr(CASE, name)
    axis = data.draw(st.integers(0, tensor.dim() - 1))
    change = data.draw(st.sampled_from(["longer", "shorter", "gone"]))
    if change == "gone":
        changed = tensor.select(axis, 0)
    else:
        size = tensor.shape[axis] + (1 if change == "longer" else -1)
        changed = torch.ones(*tensor.shape[:axis], size, *tensor.shape[axis + 1 :])
    # a change of N or C is first seen in another argument; any of them may be named
    free = name == "colors" and axis == tensor.dim() - 1 and change != "gone"
    if free:
        return
    with pytest.raises(ValueError, match=rf"^({'|'.join(TENSORS)})\b"):
        replace(CASE, **{name: changed}).render(rasterize)


@pytest.mark.parametrize("name", TENSORS)
@pytest.mark.parametrize("dtype", [torch.float64, torch.float16, torch.int32])
def test_wrong_dtypes(name: str, dtype: torch.dtype):
    case = replace(CASE, **{name: getattr(CASE, name).to(dtype)})
    with pytest.raises(ValueError, match=rf"^({name}|quats)\b"):
        case.render(rasterize)


def test_float64_is_for_the_plain_version():
    with pytest.raises(ValueError, match=r"^means: expected float32"):
        CASE.to(torch.float64).render(rasterize)
    assert CASE.to(torch.float64).render(rasterize_reference)[0].dtype == torch.float64


def test_something_else_than_a_tensor():
    assert_names(replace(CASE, means=[[0.0, 0, 1]]), "means")
    assert_names(replace(CASE, scales=None), "scales")


@RENDERERS
def test_colors_are_checked_where_only_depth_is_drawn(renderer: Any):
    case = replace(CASE, colors=torch.full_like(CASE.colors, float("nan"))).with_options(render_mode="D")
    assert_names(case, "colors", renderer)


@RENDERERS
def test_empty_sets(renderer: Any):
    none = {name: getattr(CASE, name)[:0] for name in ("means", "quats", "scales", "opacities", "colors")}
    assert_names(replace(CASE, **none), "means", renderer)
    assert_names(replace(CASE, viewmats=CASE.viewmats[:0], Ks=CASE.Ks[:0]), "viewmats", renderer)
    assert_names(replace(CASE, colors=CASE.colors[:, :0]), "colors", renderer)


@pytest.mark.parametrize(("width", "height"), [(0, 5), (5, 0), (-3, 4), (1 << 20, 1 << 20), (48.0, 32)])
def test_sizes_of_the_image(width: Any, height: int):
    assert_names(replace(CASE, width=width, height=height), "width, height")


@pytest.mark.parametrize(
    ("options", "name"),
    [
        ({"render_mode": "rgb"}, "render_mode"),
        ({"rasterize_mode": "fast"}, "rasterize_mode"),
        ({"near_plane": 0.0}, "near_plane"),
        ({"near_plane": 2.0, "far_plane": 1.0}, "near_plane"),
        ({"near_plane": float("nan")}, "near_plane"),
        ({"eps2d": -0.1}, "eps2d"),
        ({"eps2d": float("inf")}, "eps2d"),
        ({"radius_clip": float("nan")}, "radius_clip"),
        ({"sh_degree": 4}, "sh_degree"),
        ({"sh_degree": -1}, "sh_degree"),
        ({"sh_degree": 1}, "colors"),
        ({"backgrounds": torch.zeros(2, 4)}, "backgrounds"),
        ({"backgrounds": torch.zeros(2, 3, dtype=torch.float64)}, "backgrounds"),
        ({"pixel_mask": torch.ones(2, 32, 47, dtype=torch.bool)}, "pixel_mask"),
        ({"pixel_mask": torch.ones(2, 32, 48)}, "pixel_mask"),
        ({"pixel_mask": [[True]]}, "pixel_mask"),
    ],
)
def test_options(options: dict[str, Any], name: str):
    assert_names(CASE.with_options(**options), name)


def test_too_few_harmonics():
    assert_names(make_case(sh_degree=1).with_options(sh_degree=2), "colors")


@RENDERERS
def test_cameras_without_an_inverse(renderer: Any):
    viewmats = CASE.viewmats.clone()
    viewmats[1, 0, :3] = viewmats[1, 1, :3]
    assert_names(replace(CASE, viewmats=viewmats), "viewmats", renderer)


@RENDERERS
@pytest.mark.parametrize("focal", [0.0, -100.0])
def test_focal_lengths(focal: float, renderer: Any):
    Ks = CASE.Ks.clone()
    Ks[1, 1, 1] = focal
    assert_names(replace(CASE, Ks=Ks), "Ks", renderer)
