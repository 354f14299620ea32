"""`bench track`: what is followed is scored against what came, and wrong requests are named."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

from twin_node.bench.errors import BenchError
from twin_node.bench.track import TrackBenchParameters, last_less_second, run
from twin_node.bench.track_runs import to_and_fro
from twin_node.bench.track_scores import MethodScore, TrackScores, score_foresight, score_renderings
from twin_node.model import ModelParameters, SeedParameters
from twin_node.nodes import spool
from twin_node.nodes.chain_parameters import ChainParameters
from twin_node.nodes.report.quality import Renderings, score
from twin_node.nodes.spool import Tick
from twin_node.nodes.synchronizer import SynchronizerParameters
from twin_node.scene import (
    HORIZONS_NS,
    Camera,
    Exposure,
    FrameSet,
    GaussianCloud,
    JointSample,
    NodeStates,
    TwinState,
    View,
)

SMALL = ChainParameters(
    synchronizer=SynchronizerParameters(width=64, max_rate_hz=20), model=ModelParameters(seed=SeedParameters(steps=10))
)
CAMERA = Camera("one", 16, 12, np.eye(3), np.eye(4))


def stamped(*stamps: int) -> FrameSet:
    """A set whose views have these stamps."""
    views = tuple(View(CAMERA, stamp, np.zeros((12, 16, 3), np.uint8)) for stamp in stamps)
    return FrameSet(max(stamps), views)


def test_passes_to_and_fro_have_rising_stamps_and_the_same_images() -> None:
    sets = [stamped(100, 110), stamped(200, 190), stamped(300, 310)]
    passes = [list(one) for one in to_and_fro(sets, 4)]
    stamps = [frames.stamp for one in passes for frames in one]
    assert stamps == sorted(set(stamps))
    assert [frames.views[0].rgb is sets[2].views[0].rgb for frames in passes[1]] == [True, False, False]
    apart = {a.views[0].stamp - a.views[1].stamp for a in passes[1]}
    assert apart == {-10, 10}


def test_passes_to_and_fro_have_the_arm_where_the_images_show_it() -> None:
    """Its joints kept their first stamps, so that the mask of an arm that moves ran away from it, pass by pass."""
    speed = np.array([0.5, -2.0])

    def sample(stamp: int) -> JointSample:
        return JointSample(stamp, ("a", "b"), 1e-9 * stamp * speed, speed)

    sets = [replace(stamped(stamp - 7, stamp), joints=sample(stamp + 5)) for stamp in (100, 200, 300)]
    for index, one in enumerate(to_and_fro(sets, 4)):
        passed = list(one)
        for frames, before in zip(passed if index % 2 == 0 else passed[::-1], sets, strict=True):
            assert frames.joints is not None
            for view, own in zip(frames.views, before.views, strict=True):
                there = frames.joints.at(view.stamp).positions
                assert np.allclose(there, 1e-9 * own.stamp * speed, rtol=0, atol=1e-12)


def shown(ours: float, image: float, first: float, stamp: int) -> Renderings:
    """Even images of one camera."""
    planes = [np.full((12, 16, 3), value, np.float32) for value in (image, first, ours)]
    view = View(CAMERA, stamp, (planes[0] * 255).astype(np.uint8))
    return Renderings(stamp, view, None, None, *planes, planes[1], planes[0] if stamp else None)


def test_kinds_of_pixels_and_flicker_are_told_apart() -> None:
    scores = score_renderings([shown(0.5, 0.5, 0.1, 0), shown(0.5, 0.6, 0.1, 1)])
    assert scores.methods["ours"].unchanged is None and scores.flicker is None
    assert scores.methods["ours"].moving == pytest.approx((100 + 20) / 2, abs=0.01)
    assert scores.methods["frozen"].moving == pytest.approx(
        -10 * np.log10(0.4**2) / 2 - 10 * np.log10(0.5**2) / 2, 1e-4
    )
    still = score_renderings([shown(0.5, 0.5, 0.5, 0), shown(0.52, 0.5, 0.5, 1)])
    assert still.flicker == pytest.approx(2.0, rel=1e-4)
    assert still.images_flicker == 0


def test_what_was_out_by_then_is_scored_beside_ours() -> None:
    late = [
        replace(one, published=one.ours + np.float32(0.1), moved_on=one.ours + np.float32(0.01))
        for one in (shown(0.5, 0.5, 0.1, 1), shown(0.5, 0.5, 0.5, 2))
    ]
    scores = score_renderings([shown(0.5, 0.5, 0.1, 0), *late])
    assert asdict(scores.methods["published"]) == pytest.approx({"all": 20, "moving": 20, "unchanged": 20}, abs=1e-3)
    assert asdict(scores.methods["moved_on"]) == pytest.approx({"all": 40, "moving": 40, "unchanged": 40}, abs=1e-2)
    lockstep = score_renderings([shown(0.5, 0.5, 0.1, 0)])
    assert set(asdict(lockstep.methods["published"]).values()) == {None}


def test_flicker_is_not_told_across_a_gap() -> None:
    after = replace(shown(0.9, 0.5, 0.5, 9), previous=None)
    scores = score_renderings([shown(0.5, 0.5, 0.5, 0), shown(0.52, 0.5, 0.5, 1), after, shown(0.92, 0.5, 0.5, 10)])
    assert scores.flicker == pytest.approx(2.0, rel=1e-4)


def seen(stamp: int, level: float, is_followed: bool = True) -> Tick:
    """An even image of a camera that shows colours 0.25 brighter than the model, which is black."""
    images = [np.full((12, 16, 3), round(255 * value), np.uint8) for value in (level, level - 0.25)]
    frames, levelled = (FrameSet(stamp, (View(CAMERA, stamp, image),)) for image in images)
    if not is_followed:
        return Tick(frames)
    light = Exposure(np.ones(3, np.float32), np.full(3, 0.25, np.float32))
    mask = np.zeros((12, 16), np.bool_)
    return Tick(
        frames,
        TwinState(stamp, levelled, GaussianCloud.none(), NodeStates.none(), (mask,), (None,), exposures=(light,)),
    )


@pytest.mark.parametrize("is_followed", [True, False])
def test_foresight_is_scored_in_the_light_of_each_camera(is_followed: bool) -> None:
    horizon = HORIZONS_NS[-1]
    stands = score_foresight([seen(0, 0.5), seen(horizon, 0.5, is_followed)])
    assert (stands.forecast, stands.present) == (None, None)
    changed = score_foresight([seen(0, 0.5), seen(horizon, 0.35, is_followed)])
    assert (changed.forecast, changed.present) == pytest.approx((20, 20), abs=0.2)


def test_foresight_is_not_scored_across_a_pause_nor_where_a_lens_left_the_first_image_empty() -> None:
    horizon = HORIZONS_NS[-1]
    paused = score_foresight([seen(0, 0.5), seen(2 * horizon, 0.35)])
    assert (paused.forecast, paused.present) == (None, None)
    then = seen(0, 0.5)
    empty = replace(then.frames.views[0], valid=np.zeros((12, 16), np.bool_))
    then = replace(then, frames=replace(then.frames, views=(empty,)))
    assert score_foresight([then, seen(horizon, 0.35)]).forecast is None


def of_passes(*levels: float) -> list[TrackScores]:
    """So many passes of this PSNR."""
    return [TrackScores({"ours": MethodScore(level, level, None)}, None, None) for level in levels]


def test_the_last_pass_is_held_against_the_first_of_its_direction() -> None:
    assert last_less_second(of_passes(20, 30, 31)) is None
    assert last_less_second(of_passes(20, 30, 31, 30.5)) == {"all": 0.5, "moving": 0.5, "unchanged": None}
    assert last_less_second(of_passes(20, 30, 31, 30.5, 31.25)) == {"all": 0.25, "moving": 0.25, "unchanged": None}


def spoilt(one: Renderings) -> Renderings:
    """Where undistortion found nothing, images are black, whatever the model shows there."""
    valid = np.ones((12, 16), np.bool_)
    valid[:, :4] = False

    def black(plane: np.ndarray, level: float = 0.0) -> np.ndarray:
        return np.where(valid[..., None], plane, np.float32(level))

    view, ours = replace(one.view, valid=valid), black(one.ours, 1.0)
    return replace(one, view=view, image=black(one.image), first=black(one.first), frozen=black(one.frozen), ours=ours)


@pytest.mark.parametrize("first", [0.1, 0.5])
def test_pixels_without_an_image_are_not_scored(first: float) -> None:
    renderings = [shown(0.5, 0.5, first, 0), shown(0.52, 0.55, first, 1)]
    mine, whole = score_renderings(map(spoilt, renderings)), score_renderings(renderings)
    for name, method in whole.methods.items():
        assert asdict(mine.methods[name]) == pytest.approx(asdict(method))
    assert (mine.flicker, mine.images_flicker) == pytest.approx((whole.flicker, whole.images_flicker))
    assert asdict(score(map(spoilt, renderings))) == pytest.approx(asdict(score(renderings)))


def test_a_log_is_followed_live_and_a_camera_left_out(cell_log: Callable[..., Path]) -> None:
    log = cell_log(1.2)
    names = ("all", "moving", "unchanged")
    bench = run(log, TrackBenchParameters(rate=1.0, chain=SMALL))
    live, followed = bench.as_json(), bench.followed
    assert len(followed.updates_ms) == followed.sets == len(followed.tiers)
    assert json.loads(json.dumps(live))["mode"] == "real time"
    psnr_db = live["psnr_db"]
    assert psnr_db["published"]["all"] is not None and psnr_db["moved_on"]["all"] is not None
    latency = live["latency_ms"]
    assert 0 < latency["p50"] <= latency["p95"] <= latency["p99"]
    camera = run(log, TrackBenchParameters(duration_s=0.1, chain=SMALL)).followed.model
    assert camera.capacity > 0
    bounced = run(log, TrackBenchParameters(bounce=4, duration_s=0.3, leave_out="all", chain=SMALL)).as_json()
    assert set(bounced["last_less_second_db"]) == set(names)
    assert len(bounced["left_out"]) == 3
    assert bounced["growth_mb"] is not None


def test_sets_per_second_are_those_of_the_time_that_they_took(cell_log: Callable[..., Path]) -> None:
    """Nobody follows a log a thousand times as fast: thousands of sets per second were told."""
    bench = run(cell_log(0.6), TrackBenchParameters(rate=1000.0, chain=SMALL))
    followed = bench.followed
    assert followed.sets > 1
    assert followed.seconds >= sum(followed.updates_ms[1:]) / 1e3  # the first set is followed before the clock runs
    assert bench.as_json()["rate_hz"] == followed.sets / followed.seconds


@pytest.mark.parametrize("asked", [{"bounce": 2, "duration_s": 0.05}, {"duration_s": 0.1}])
def test_a_short_run_does_not_say_that_memory_does_not_grow(
    cell_log: Callable[..., Path], asked: dict[str, float]
) -> None:
    assert run(cell_log(0.5), TrackBenchParameters(chain=SMALL, **asked)).as_json()["growth_mb"] is None


def test_a_run_too_long_to_be_scored_whole_says_on_how_many_sets_it_is(
    cell_log: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(spool, "MAX_SETS", 4)
    monkeypatch.setattr(spool, "BLOCK_NS", 100_000_000)
    found = run(cell_log(0.5), TrackBenchParameters(chain=SMALL)).as_json()
    assert 0 < found["scored"] < found["sets"]


def test_wrong_requests_are_named(cell_log: Callable[..., Path]) -> None:
    with pytest.raises(BenchError, match="leave one of the two out"):
        run(cell_log(1.2), TrackBenchParameters(bounce=2, rate=1.0, chain=SMALL))
    with pytest.raises(BenchError, match="no such camera; expected all or"):
        run(cell_log(1.2), TrackBenchParameters(leave_out="nobody", chain=SMALL))
    with pytest.raises(BenchError, match="longer --duration"):
        run(cell_log(1.2), TrackBenchParameters(duration_s=1e-6, chain=replace(SMALL)))
