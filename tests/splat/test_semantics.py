"""Constants that differ between versions of gsplat."""

from __future__ import annotations

import pytest
import torch
from splat_scenes import Case, Result, assert_close, make_case

from twin_node.splat import semantics
from twin_node.splat.arguments import Gaussians, Options, Rendered, Views, check_shapes
from twin_node.splat.cpu import render_native
from twin_node.splat.library import SplatLibrary
from twin_node.splat.reference import render_reference


@pytest.mark.parametrize("version", ["1.5.3", "1.5", "1.4.0", "1", "1.5.3+pt24cu124", "1.5rc2"])
def test_constants_of_today(version: str):
    assert semantics.semantics_of(version).max_alpha == 0.999


@pytest.mark.parametrize("version", ["1.6.0", "1.6.0rc1", "1.6rc1", "1.10.2", "2.0", "2"])
def test_constants_of_the_next_version(version: str):
    assert semantics.semantics_of(version).max_alpha == 0.99


def opaque_case() -> Case:
    case = make_case(count=200, channels=3, scale=0.3)
    return Case(**{**vars(case), "opacities": torch.full((200,), 1.0)})


def test_backends_follow_the_same_constants(library: SplatLibrary):
    def images(case: Case, constants: semantics.Semantics) -> Rendered:
        gaussians = Gaussians(case.means, case.quats, case.scales, case.opacities, case.colors)
        views = Views(case.viewmats, case.Ks, case.width, case.height, None, None)
        scene = check_shapes(gaussians, views, Options())
        if case.means.dtype == torch.float64:
            return render_reference(scene, constants)
        return render_native(scene, library, constants)

    today, coming = (images(opaque_case(), c) for c in (semantics.GSPLAT_1_5, semantics.GSPLAT_1_6))
    assert not torch.equal(today.alphas, coming.alphas)
    expected = images(opaque_case().to(torch.float64), semantics.GSPLAT_1_6)
    found = Result(coming.renders, coming.alphas, coming.meta, {})
    assert_close(found, Result(expected.renders, expected.alphas, expected.meta, {}))
