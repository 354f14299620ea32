"""One image in one call: the same as the rasteriser draws."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from splat_scenes import Case, make_case

from twin_node.splat import Shot, draw_still, draw_still_reference
from twin_node.splat.library import SplatLibrary


def shot(case: Case, camera: int) -> Shot:
    gaussians = (case.means, case.quats, case.scales, case.opacities, case.colors)
    return Shot(*gaussians, case.viewmats[camera], case.Ks[camera], case.width, case.height)


@pytest.mark.parametrize("camera", [0, 1])
def test_agrees_with_the_plain_one(camera: int, library: SplatLibrary) -> None:
    case = make_case(channels=3)
    (fast, alpha), (plain, other) = (of(shot(case, camera)) for of in (draw_still, draw_still_reference))
    assert other.max() > 0.5 and plain.shape == (case.height, case.width, 4)
    assert torch.equal(fast, plain) and torch.equal(alpha, other)


@pytest.mark.parametrize("draw", [draw_still, draw_still_reference])
def test_nobody_is_seen_as_nothing(draw: object, library: SplatLibrary) -> None:
    assert callable(draw)
    case = make_case(channels=3)
    nobody = {name: getattr(case, name)[:0] for name in ("means", "quats", "scales", "opacities", "colors")}
    rgbd, alpha = draw(shot(replace(case, **nobody), 0))
    assert rgbd.shape == (case.height, case.width, 4) and not rgbd.any() and not alpha.any()


def test_gaussians_that_are_not_finite_are_named(library: SplatLibrary) -> None:
    case = make_case(channels=3)
    case.colors[7, 1] = torch.nan
    with pytest.raises(ValueError, match="rgb: expected finite values, found nan"):
        draw_still(shot(case, 0))
