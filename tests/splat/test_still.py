"""One image, or what shows in it, in one call: the same as the rasteriser draws."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from splat_scenes import Case, make_case

from twin_node.splat import Shot, draw_still, draw_still_reference, weigh, weigh_reference
from twin_node.splat.library import SplatLibrary


def shot(case: Case, camera: int) -> Shot:
    gaussians = (case.means, case.quats, case.scales, case.opacities, case.colors)
    return Shot(*gaussians, case.viewmats[camera], case.Ks[camera], case.width, case.height)


def nobody(case: Case) -> Case:
    return replace(
        case, **{name: getattr(case, name)[:0] for name in ("means", "quats", "scales", "opacities", "colors")}
    )


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
    rgbd, alpha = draw(shot(nobody(case), 0))
    assert rgbd.shape == (case.height, case.width, 4) and not rgbd.any() and not alpha.any()


def test_gaussians_that_are_not_finite_are_named(library: SplatLibrary) -> None:
    case = make_case(channels=3)
    case.colors[7, 1] = torch.nan
    with pytest.raises(ValueError, match="rgb: expected finite values, found nan"):
        draw_still(shot(case, 0))


@pytest.mark.parametrize("camera", [0, 1])
def test_weights_agree_with_the_plain_ones(camera: int, library: SplatLibrary) -> None:
    fast, plain = (of(shot(make_case(channels=3), camera)) for of in (weigh, weigh_reference))
    assert plain.max() > 1 and (plain == 0).any()
    torch.testing.assert_close(fast, plain, rtol=1e-5, atol=1e-6)


def test_no_gaussians_have_no_weights(library: SplatLibrary) -> None:
    for weights in (weigh, weigh_reference):
        assert weights(shot(nobody(make_case(channels=3)), 0)).shape == (0,)


def test_weights_add_up_to_what_is_opaque(library: SplatLibrary) -> None:
    seen = shot(make_case(channels=3), 0)
    assert float(weigh(seen).sum()) == pytest.approx(float(draw_still(seen)[1].sum()), rel=1e-5)


def test_what_is_not_finite_is_named_to_who_weighs(library: SplatLibrary) -> None:
    seen = shot(make_case(channels=3), 0)
    with pytest.raises(ValueError, match="K: expected finite values, found nan"):
        weigh(replace(seen, K=torch.full_like(seen.K, torch.nan)))
    seen.opacities[3] = torch.inf
    with pytest.raises(ValueError, match="opacities: expected finite values, found inf"):
        weigh(seen)
