"""One image in one call: the same as the rasteriser draws."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from splat_scenes import Case, make_case

from twin_node.splat import Still, StillPlainly
from twin_node.splat.library import SplatLibrary


def still_of(kind: type[Still] | type[StillPlainly], case: Case, camera: int) -> Still | StillPlainly:
    """What one of the case's cameras sees."""
    gaussians = (case.means, case.quats, case.scales, case.opacities, case.colors)
    still = kind(*gaussians, case.viewmats[camera], case.Ks[camera], case.width, case.height)
    still.draw()
    return still


@pytest.mark.parametrize("camera", [0, 1])
def test_agrees_with_the_plain_one(camera: int, library: SplatLibrary) -> None:
    case = make_case(channels=3)
    fast, plain = (still_of(kind, case, camera) for kind in (Still, StillPlainly))
    assert plain.alpha.max() > 0.5
    assert torch.equal(fast.rgbd, plain.rgbd) and torch.equal(fast.alpha, plain.alpha)


@pytest.mark.parametrize("kind", [Still, StillPlainly])
def test_nobody_is_seen_as_nothing(kind: type[Still] | type[StillPlainly], library: SplatLibrary) -> None:
    case = make_case(channels=3)
    nobody = {name: getattr(case, name)[:0] for name in ("means", "quats", "scales", "opacities", "colors")}
    still = still_of(kind, replace(case, **nobody), 0)
    assert still.rgbd.shape == (case.height, case.width, 4) and not still.rgbd.any() and not still.alpha.any()


def test_gaussians_that_are_not_finite_are_named(library: SplatLibrary) -> None:
    case = make_case(channels=3)
    case.colors[7, 1] = torch.nan
    with pytest.raises(ValueError, match="rgb: expected finite values, found nan"):
        still_of(Still, case, 0)
