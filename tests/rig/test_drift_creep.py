"""What creeps is told by an average, through clocks that are put back, and is handed on to a watch made anew."""

from __future__ import annotations

import numpy as np
import pytest
from test_landmarks import FOCAL, HEIGHT, WIDTH, K, after, scene

from twin_node.rig.drift import DriftParameters, DriftWatch
from twin_node.rig.drift_report import Drift, Verdict
from twin_node.scene import Camera, FrameSet, UInt8, View

CAMERA = Camera("left", WIDTH, HEIGHT, K, np.eye(4))
STEP_S = 5.0
PARAMETERS = DriftParameters(slow_deg=0.05, slow_px=0.08, average_s=10.0, drifting_s=30.0, lost_s=3.0)


def turned_by(degrees: float) -> UInt8:
    return after(np.radians([0.0, degrees, 0.0]), scene())


def look(watch: DriftWatch, at_s: float, image: UInt8) -> Drift:
    """What is said of an image, to which a sensor's noise is added."""
    stamp = round(1e9 * at_s)
    noise = np.random.default_rng(round(at_s * 10) % 36000).normal(0, 1, image.shape)
    noisy = np.clip(image + noise, 0, 255).astype(np.uint8)
    return watch.update(FrameSet(stamp, (View(CAMERA, stamp, noisy),))).drifts[0]


def creeping(put_back_at: int | None = None, by_s: float = 0.0) -> list[Drift]:
    """A camera that stands for 40 s, and creeps by a tenth of a degree within 100; looked at every 5 s."""
    watch, said = DriftWatch(PARAMETERS), []
    for n in range(36):
        at_s = 1000 + STEP_S * n - (by_s if put_back_at is not None and n >= put_back_at else 0.0)
        said.append(look(watch, at_s, turned_by(0.1 * np.clip((n - 8) / 20, 0, 1))))
    return said


def test_what_creeps_is_told_with_its_size_and_since_when() -> None:
    said = creeping()
    first = next(n for n, drift in enumerate(said) if drift.verdict is Verdict.DRIFTING)
    # Beyond 0.05 degrees from about 100 s on, averaged over 10 s; 30 s later, and three looks, it is told.
    assert 26 <= first <= 33
    last = said[-1]
    assert last.verdict is Verdict.DRIFTING
    assert last.trusted
    assert last.angle_deg == pytest.approx(0.1, abs=0.015)
    assert last.residual_px == pytest.approx(FOCAL * np.radians(0.1), rel=0.2)
    assert 1040 < last.since / 1e9 < 1110  # when it was last at half the size that counts
    assert last.slow


@pytest.mark.parametrize("put_back_at", [4, 22, 26, 34])
def test_a_clock_that_is_put_back_leaves_it_at_that(put_back_at: int) -> None:
    plain, back = creeping(), creeping(put_back_at, by_s=3600.0)
    first, later = (next(n for n, d in enumerate(said) if d.verdict is Verdict.DRIFTING) for said in (plain, back))
    assert first <= later <= first + 2  # the look at which the clock is put back, and the time up to it, are lost
    assert back[-1].verdict is Verdict.DRIFTING
    assert back[-1].slow == plain[-1].slow
    assert back[-1].since / 1e9 + 3600 == pytest.approx(plain[-1].since / 1e9, abs=2 * STEP_S)


def test_a_knock_is_not_said_to_creep_and_one_that_is_undone_is_forgotten() -> None:
    watch = DriftWatch(PARAMETERS)
    knocked = [look(watch, 1000 + STEP_S * n, turned_by(0.1 if n >= 8 else 0.0)) for n in range(24)]
    assert knocked[-1].verdict is Verdict.DRIFTING
    assert not knocked[-1].slow
    assert 1030 <= knocked[-1].since / 1e9 <= 1050
    undone = [look(watch, 1000 + STEP_S * n, turned_by(0.0)) for n in range(24, 40)]
    assert undone[-1].verdict is Verdict.STEADY
    assert undone[-1].angle_deg < 0.02


def test_a_watch_made_anew_goes_on_where_the_one_before_was() -> None:
    plain, first = creeping(), DriftWatch(PARAMETERS)
    for n in range(28):
        look(first, 1000 + STEP_S * n, turned_by(0.1 * np.clip((n - 8) / 20, 0, 1)))
    second = DriftWatch(PARAMETERS)
    second.recall(first.memory())
    said = [look(second, 1000 + STEP_S * n, turned_by(0.1 * np.clip((n - 8) / 20, 0, 1))) for n in range(28, 36)]
    assert [drift.verdict for drift in said] == [drift.verdict for drift in plain[28:]]
    assert said[-1].since == plain[-1].since


@pytest.mark.parametrize("put_back", [False, True])
def test_a_camera_that_shows_something_else_is_lost_once_that_has_stood_for_long_enough(put_back: bool) -> None:
    watch, said = DriftWatch(DriftParameters(lost_s=3.0, confirm=1, least_features=40)), []
    for n in range(12):
        at_s = 1000 + 0.5 * n - (600 if put_back and n >= 7 else 0)
        said.append(look(watch, at_s, scene() if n < 3 else scene(1)).verdict)
    lost = said.index(Verdict.LOST)
    assert set(said[:3]) == {Verdict.STEADY}
    # Seen from 1.5 s on, it stands for 3 s with the image at 4.5 s; where the clock is put back one step is lost.
    assert lost == (10 if put_back else 9)
    assert set(said[3:lost]) == {Verdict.UNSURE}


def test_a_camera_before_which_all_moves_is_not_lost() -> None:
    watch = DriftWatch(DriftParameters(lost_s=1.0, confirm=1, least_features=40))
    said = [look(watch, 1000 + 0.5 * n, scene() if n < 3 else scene(n)).verdict for n in range(14)]
    assert set(said[3:]) == {Verdict.UNSURE}
