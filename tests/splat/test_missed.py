"""What views miss, in one call per view: the same as the rasteriser and its gradient say."""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

import pytest
import torch
from splat_scenes import INPUTS, Case, make_case

from twin_node.splat import Missed, MissedReference, Sight, Tolerance
from twin_node.splat.library import SplatLibrary

TOLERANCE = Tolerance(outlier=0.1, depth_gain=2.0, nearest=1e-3)
Kind = TypeVar("Kind", Missed, MissedReference)


def missed_of(kind: type[Kind], case: Case, with_depth: bool) -> Kind:
    """What two of the case's cameras miss of noise."""
    learners = torch.arange(len(case.means)) % 3 > 0
    missed = kind(case.means, case.quats, case.scales, case.opacities, case.colors, learners)
    generator = torch.Generator().manual_seed(3)
    shape = (case.height, case.width)
    for viewmat, K in zip(case.viewmats, case.Ks, strict=True):
        rgb, counted = torch.rand(*shape, 3, generator=generator), torch.rand(shape, generator=generator) > 0.3
        depth = 3 * torch.rand(shape, generator=generator) * (torch.rand(shape, generator=generator) > 0.5)
        surface = torch.full(shape, 3.0)
        missed.add(
            Sight(viewmat, K, rgb, counted, depth if with_depth else None, surface if with_depth else None), TOLERANCE
        )
    return missed


@pytest.mark.parametrize("with_depth", [False, True])
def test_agrees_with_the_plain_one(with_depth: bool, library: SplatLibrary) -> None:
    case = make_case(channels=3)
    fast, plain = (missed_of(kind, case, with_depth) for kind in (Missed, MissedReference))
    for name in ("means", "quats", "scales", "opacities", "rgb", "weights"):
        ours, theirs = getattr(fast.pull, name), getattr(plain.pull, name)
        assert theirs.abs().max() > 0
        torch.testing.assert_close(ours, theirs, rtol=1e-4, atol=1e-4 * float(theirs.abs().max()))


@pytest.mark.parametrize("kind", [Missed, MissedReference])
def test_no_gaussians_miss_nothing(kind: type[Missed | MissedReference], library: SplatLibrary) -> None:
    case = make_case(channels=3)
    none = replace(case, **{name: getattr(case, name)[:0] for name in INPUTS if name != "viewmats"})
    missed = missed_of(kind, none, with_depth=True)
    assert missed.pull.means.shape == (0, 3) and missed.pull.weights.shape == (0,)


def test_gaussians_that_are_not_finite_are_named(library: SplatLibrary) -> None:
    case = make_case(channels=3)
    case.scales[7, 1] = torch.nan
    with pytest.raises(ValueError, match="scales: expected finite values, found nan"):
        missed_of(Missed, case, with_depth=False)
