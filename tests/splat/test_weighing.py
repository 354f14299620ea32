"""How much Gaussians show, in one call: the same as the gradient of a feature says."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from splat_scenes import Case, make_case

from twin_node.splat import rasterize, weigh, weigh_reference
from twin_node.splat.library import SplatLibrary


def given(case: Case, camera: int) -> tuple[torch.Tensor, ...]:
    return (case.means, case.quats, case.scales, case.opacities, case.viewmats[camera], case.Ks[camera])


@pytest.mark.parametrize("camera", [0, 1])
def test_agrees_with_the_plain_one(camera: int, library: SplatLibrary) -> None:
    case = make_case(channels=3)
    seen = given(case, camera)
    fast, plain = (of(*seen, case.width, case.height) for of in (weigh, weigh_reference))
    assert plain.max() > 1 and (plain == 0).any()
    torch.testing.assert_close(fast, plain, rtol=1e-5, atol=1e-6)


def test_no_gaussians_have_no_weights(library: SplatLibrary) -> None:
    case = make_case(channels=3)
    *gaussians, viewmat, K = given(case, 0)
    none = [of[:0] for of in gaussians]
    for weights in (weigh, weigh_reference):
        assert weights(*none, viewmat, K, case.width, case.height).shape == (0,)


def test_weights_add_up_to_what_is_opaque(library: SplatLibrary) -> None:
    case = make_case(channels=3)
    *gaussians, viewmat, K = given(case, 0)
    _, alphas, _ = rasterize(*gaussians, case.colors, viewmat[None], K[None], case.width, case.height)
    weights = weigh(*gaussians, viewmat, K, case.width, case.height)
    assert float(weights.sum()) == pytest.approx(float(alphas.sum()), rel=1e-5)


def test_what_is_not_finite_is_named(library: SplatLibrary) -> None:
    case = make_case(channels=3)
    broken = replace(case, opacities=case.opacities.clone())
    broken.opacities[3] = torch.inf
    with pytest.raises(ValueError, match="opacities: expected finite values, found inf"):
        weigh(*given(broken, 0), case.width, case.height)
    *gaussians, viewmat, K = given(case, 0)
    with pytest.raises(ValueError, match="K: expected finite values, found nan"):
        weigh(*gaussians, viewmat, torch.full_like(K, torch.nan), case.width, case.height)
