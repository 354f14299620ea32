"""What of a solved bundle is taken for a contradiction, from which size on, and who is named."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from test_bundle_adjustment import BOARD, a_moving_state, a_still_state, sightings_of

from twin_node.rig import RigError
from twin_node.rig.calibrate import contradictions
from twin_node.rig.calibrate.bundle import BundleOptions, BundleResult, Sighting
from twin_node.rig.calibrate.bundle_solver import solve_bundle
from twin_node.rig.calibrate.contradictions import MOST_WORSE, check_board, check_fit, check_lenses
from twin_node.rig.calibrate.stamp_jitter import MOST_JITTER_S
from twin_node.rig.calibrate.witnesses import LIKE_PX, MOST_GAIN, MOVED_M, MOVED_RAD, OtherLens, Witnesses

NAMES = ("left", "right")
NOISE_PX = 0.1


@pytest.fixture(scope="module")
def solved() -> tuple[list[Sighting], BundleResult]:
    state = a_still_state("plumb_bob", sets=8)
    seen = sightings_of(state, np.random.default_rng(0), noise=NOISE_PX)
    return seen, solve_bundle(state, seen, BundleOptions(lenses=False))


def check(given: list[Sighting], bundle: BundleResult, moving: bool = False) -> None:
    check_fit(NAMES, bundle.state.lenses, given, bundle, moving)


def with_residuals(bundle: BundleResult, camera: int, factor: float) -> BundleResult:
    residuals = [
        factor * r if s.camera == camera else r for s, r in zip(bundle.sightings, bundle.residuals, strict=True)
    ]
    return replace(bundle, residuals=tuple(residuals))


def test_a_good_bundle_is_passed(solved: tuple[list[Sighting], BundleResult]) -> None:
    given, bundle = solved
    assert not bundle.left_out
    for moving in (False, True):
        check(given, bundle, moving)


def test_images_that_fit_a_place_of_their_own_far_better_are_refused(
    solved: tuple[list[Sighting], BundleResult],
) -> None:
    given, bundle = solved
    # Each image by itself is about as far off as all together: eight times that is the limit.
    check(given, with_residuals(bundle, 1, 0.8 * MOST_WORSE))
    with pytest.raises(RigError, match=r"camera right: .* found them 1\.\d\d px off where each by itself is 0\.1\d px"):
        check(given, with_residuals(bundle, 1, 1.4 * MOST_WORSE))
    with pytest.raises(RigError, match="camera left: expected images that fit the other cameras'"):
        check(given, with_residuals(bundle, 0, 1.4 * MOST_WORSE))


def test_less_than_half_a_pixel_is_no_matter(solved: tuple[list[Sighting], BundleResult]) -> None:
    state = solved[1].state
    given = sightings_of(state, np.random.default_rng(0), noise=0.01)
    bundle = replace(solve_bundle(state, given, BundleOptions(lenses=False)))
    check(given, with_residuals(bundle, 1, 30.0))
    with pytest.raises(RigError, match="camera right"):
        check(given, with_residuals(bundle, 1, 60.0))


def test_stamps_that_jitter_as_much_as_is_sought_are_refused(solved: tuple[list[Sighting], BundleResult]) -> None:
    given, bundle = solved
    check(given, replace(bundle, jitter_s=np.array([0.0, 0.9 * MOST_JITTER_S])))
    with pytest.raises(RigError, match=r"camera right: expected stamps that are right to 40 ms"):
        check(given, replace(bundle, jitter_s=np.array([0.0, MOST_JITTER_S])))


def test_a_camera_without_an_image_that_fits_is_named(solved: tuple[list[Sighting], BundleResult]) -> None:
    given, bundle = solved
    own = [n for n, s in enumerate(bundle.sightings) if s.camera == 0]
    left = replace(
        bundle,
        sightings=tuple(bundle.sightings[n] for n in own),
        residuals=tuple(bundle.residuals[n] for n in own),
    )
    with pytest.raises(RigError, match=r"camera right: .* found none that do"):
        check(given, left)


def test_a_moved_board_of_which_many_images_were_left_out_is_refused(
    solved: tuple[list[Sighting], BundleResult],
) -> None:
    given, bundle = solved
    check(given, replace(bundle, left_out=tuple(given[-2:])), moving=True)
    many = replace(bundle, left_out=(given[0], *given[-2:]))
    check(given, many, moving=False)
    with pytest.raises(RigError, match=r"cameras left, right: .* \(1 of 8 of left, 2 of 8 of right\)"):
        check(given, many, moving=True)


def test_a_board_whose_corners_are_elsewhere_in_its_plane_is_another_one(
    solved: tuple[list[Sighting], BundleResult],
) -> None:
    _, bundle = solved
    check_board(BOARD, bundle)
    waves = np.zeros_like(BOARD.points)
    waves[:, 0] = np.where(np.arange(len(waves)) % 2, 1, -1)
    for off_m, passed in ((0.0008, True), (0.002, False)):
        points = BOARD.points + off_m * waves
        bent = replace(bundle, state=replace(bundle.state, points=points))
        if passed:
            check_board(BOARD, bent)
        else:
            with pytest.raises(RigError, match=r"board: expected .*, found its corners [12]\.\d mm off that"):
                check_board(BOARD, bent)


def test_a_board_at_rest_is_one_witness_per_camera_whatever_order_its_images_come_in() -> None:
    state = a_still_state("plumb_bob", sets=3)
    seen = sightings_of(state, np.random.default_rng(0), noise=0.0)
    per_camera = [[s for s in seen if s.camera == camera] for camera in (0, 1)]
    timed: list[Sighting] = []
    for own in per_camera:  # three looks at each place, one after the other
        for n, sighting in enumerate(own):
            for again in range(3):
                shifted = sighting.corners.pixels + 0.3 * LIKE_PX * again
                timed.append(
                    replace(sighting, corners=replace(sighting.corners, pixels=shifted), time_s=3.0 * n + again)
                )
    order = np.random.default_rng(1).permutation(len(timed))
    mixed = tuple(timed[n] for n in order)
    residuals = tuple(np.full((len(s.corners), 2), 0.1 * (1 + s.camera)) for s in mixed)
    bundle = replace(
        solve_bundle(state, seen, BundleOptions(lenses=False)),
        sightings=mixed,
        residuals=residuals,
        left_out=(),
        noise_px=np.array([0.1, 0.4]),
        state=replace(state, delays=np.array([s.time_s for s in mixed])),
    )
    witnesses = Witnesses.of(mixed, bundle)
    assert sorted((s.camera, s.time_s) for s in witnesses.sightings) == [(c, t) for c in (0, 1) for t in (0, 3.0, 6.0)]
    np.testing.assert_array_equal(witnesses.delays, [s.time_s for s in witnesses.sightings])
    np.testing.assert_allclose(witnesses.misfits, [(1.0, 0.5)[s.camera] for s in witnesses.sightings])
    fewer = witnesses.without(2)
    assert fewer.sightings == witnesses.sightings[:2] + witnesses.sightings[3:]
    np.testing.assert_array_equal(fewer.delays, [s.time_s for s in fewer.sightings])
    assert len(fewer.misfits) == 5


def test_witnesses_have_the_delays_of_their_own_images_where_some_were_left_out() -> None:
    state = a_moving_state("plumb_bob")
    seen = sightings_of(state, np.random.default_rng(0))
    bundle = solve_bundle(state, seen, BundleOptions(lenses=False))
    told = replace(bundle.state, delays=np.arange(float(len(seen))))
    lost = [0, 5, 30]
    kept = [n for n in range(len(seen)) if n not in lost]
    left = replace(
        bundle,
        state=told,
        sightings=tuple(seen[n] for n in kept),
        residuals=tuple(np.ones((len(seen[n].corners), 2)) for n in kept),
        left_out=tuple(seen[n] for n in lost),
    )
    witnesses = Witnesses.of(seen, left)
    np.testing.assert_array_equal(witnesses.delays, kept)  # the board moves: every image is a witness


@pytest.mark.parametrize("given_share", [0.97, 1.03])
def test_images_tell_which_lens_they_were_taken_through(given_share: float) -> None:
    state = a_still_state("plumb_bob", sets=10)
    seen = sightings_of(state, np.random.default_rng(0), noise=0.2)
    true = state.lenses[1]
    wrong = replace(true, K=true.K * np.array([[given_share, 1, 1], [1, given_share, 1], [1, 1, 1]]))
    bundle = solve_bundle(replace(state, lenses=(state.lenses[0], wrong)), seen, BundleOptions(lenses=False))
    first, second = Witnesses.of(seen, bundle).other_lenses()
    assert second.gain > max(MOST_GAIN, 3 * first.gain)
    assert second.focal_px == pytest.approx(true.K[0, 0], rel=0.008)
    assert second.matters
    # The distance to the board has taken up the focal length: 3 % of about a metre.
    assert second.shift_m == pytest.approx(0.03, rel=0.7)
    right = Witnesses.of(seen, solve_bundle(state, seen, BundleOptions(lenses=False))).other_lenses()
    assert max(lens.gain for lens in right) < MOST_GAIN


def with_lenses(solved: tuple[list[Sighting], BundleResult], *told: OtherLens) -> Witnesses:
    """Witnesses that would have lenses like these."""
    return cast(Witnesses, SimpleNamespace(bundle=solved[1], other_lenses=lambda: list(told)))


def test_the_lens_that_is_furthest_off_is_named_where_that_matters(
    solved: tuple[list[Sighting], BundleResult], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(contradictions, "most_gained", lambda _: 0.0)
    likely, far = OtherLens(0.9 * MOST_GAIN, 500.0, 0.1, 0.1), OtherLens(1.1 * MOST_GAIN, 533.25, 0.012, 0.0052)
    check_lenses(NAMES, with_lenses(solved, likely, likely))
    check_lenses(NAMES, with_lenses(solved, likely, replace(far, shift_m=0.9 * MOVED_M, turn_rad=0.9 * MOVED_RAD)))
    told = r"of focal length 520\.0 px, found some that fit 533\.2 px and cameras up to 12 mm and 0\.3 degrees"
    with pytest.raises(RigError, match=f"camera right: .* {told}"):
        check_lenses(NAMES, with_lenses(solved, likely, far))
    for less in (replace(far, shift_m=0.0), replace(far, turn_rad=0.0)):
        with pytest.raises(RigError, match="camera left"):
            check_lenses(NAMES, with_lenses(solved, less, likely))


def test_a_move_that_explains_far_more_is_told_in_its_place(
    solved: tuple[list[Sighting], BundleResult], monkeypatch: pytest.MonkeyPatch
) -> None:
    def moved(*_: object) -> None:
        raise RigError("moved")

    far = OtherLens(2 * MOST_GAIN, 533.25, 0.012, 0.0052)
    for share, told in ((2.9, "camera left"), (3.1, "moved")):
        monkeypatch.setattr(contradictions, "most_gained", lambda _, share=share: share * 2 * MOST_GAIN)
        monkeypatch.setattr(contradictions, "check_steady", moved)
        with pytest.raises(RigError, match=told):
            check_lenses(NAMES, with_lenses(solved, far, replace(far, gain=1.0)))
    monkeypatch.setattr(contradictions, "check_steady", lambda *_: None)  # two images that were misread alike
    with pytest.raises(RigError, match="camera left"):
        check_lenses(NAMES, with_lenses(solved, far, replace(far, gain=1.0)))
