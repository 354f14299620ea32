"""A camera that has moved is named within a second of log time; light, people and the arm name none."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from twin_node.cell import CellSource, load_scenario
from twin_node.rig.drift import DriftParameters, DriftWatch
from twin_node.rig.drift_report import Drift, DriftReport, Verdict
from twin_node.rig.errors import RigError
from twin_node.scene import FrameSet, View

BUMPED_AT_S = 0.6
"""When the edited recordings are bumped, s after their start."""
Axis = tuple[float, float, float]
AXES = [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)]

WRONG = [
    ("angle_deg", (0.0, -1.0, math.inf)),
    ("least_px", (0.0, -1.0, math.inf)),
    ("confirm", (0, -1, 10**9)),
    ("period_ms", (-1.0, math.inf)),
    ("least_features", (0, -1, 3, 10**9)),
    ("least_share", (0.0, -1.0, 1.5)),
    ("slow_deg", (0.0, -1.0, math.inf)),
    ("slow_px", (0.0, -1.0, math.inf)),
    ("average_s", (0.0, -1.0, math.inf)),
    ("drifting_s", (-1.0, math.inf)),
    ("lost_s", (-1.0, math.inf)),
]


@pytest.mark.parametrize(("name", "values"), WRONG)
def test_numbers_that_mean_nothing_are_refused_by_name(name: str, values: tuple[float, ...]) -> None:
    for value in values:
        with pytest.raises(RigError, match=f"drift: {name}: expected .*, found"):
            DriftParameters(**{name: value})


@pytest.fixture(scope="module")
def recording() -> tuple[FrameSet, ...]:
    """Two seconds of the demo's cell, in which a person, boxes and the arm move, 14 sets a second."""
    demo = load_scenario("demo")
    return tuple(CellSource(replace(demo, duration_s=2.0, sensing=replace(demo.sensing, rate_hz=14.0))))


def bumped(view: View, axis: Axis, degrees: float) -> View:
    """The view of a camera that was turned about its own centre."""
    K = view.camera.K.copy()
    K[:2, 2] -= 0.5
    R = Rotation.from_rotvec(np.radians(degrees) * np.array(axis)).as_matrix()
    size = (view.camera.width, view.camera.height)
    turned = cv2.warpPerspective(view.rgb, K @ R @ np.linalg.inv(K), size, borderMode=cv2.BORDER_REPLICATE)
    return replace(view, rgb=np.asarray(turned, np.uint8))


def edited(recording: tuple[FrameSet, ...], edit: Callable[[int, View, float], View]) -> Iterator[FrameSet]:
    """The recording with every view replaced by what `edit(camera, view, seconds)` makes of it."""
    for frames in recording:
        t = (frames.stamp - recording[0].stamp) / 1e9
        yield replace(frames, views=tuple(edit(i, view, t) for i, view in enumerate(frames.views)))


def turned(
    recording: tuple[FrameSet, ...], cameras: Iterable[int], axis: Axis, degrees: float, until_s: float = 9.0
) -> Iterator[FrameSet]:
    """The recording with some cameras turned from `BUMPED_AT_S` on."""
    return edited(
        recording,
        lambda i, view, t: bumped(view, axis, degrees) if i in cameras and BUMPED_AT_S < t < until_s else view,
    )


def slowly(view: View, step_s: float, turns_deg: Iterable[float]) -> Iterator[FrameSet]:
    """One view again and again with fresh noise, by a camera that turns about its vertical axis."""
    rng = np.random.default_rng(0)
    for i, degrees in enumerate(turns_deg):
        noise = 2 * rng.standard_normal(view.rgb.shape, np.float32)
        image = bumped(view, (0.0, 1.0, 0.0), degrees).rgb + noise
        stamp = view.stamp + round(i * step_s * 1e9)
        yield FrameSet(stamp, (replace(view, stamp=stamp, rgb=np.clip(image, 0, 255).astype(np.uint8)),))


def reports(sets: Iterable[FrameSet], parameters: DriftParameters | None = None) -> list[DriftReport]:
    """What a fresh watch says of sets."""
    watch = DriftWatch(parameters)
    return [watch.update(frames) for frames in sets]


def only(report: DriftReport) -> Drift:
    """The one camera's."""
    (drift,) = report.drifts
    return drift


@pytest.mark.parametrize("axis", AXES)
def test_a_camera_turned_by_a_degree_is_named_within_a_second(recording: tuple[FrameSet, ...], axis: Axis) -> None:
    said = reports(turned(recording, [1], axis, 1.0))
    name = recording[0].views[1].camera.name
    first = next(report for report in said if report.distrusted)
    assert (first.stamp - recording[0].stamp) / 1e9 - BUMPED_AT_S <= 1.0
    assert {report.distrusted for report in said} == {(), (name,)}
    assert first.warnings == (f"camera {name} has moved: its images are left out; put it back, or calibrate it anew",)
    assert first.drifts[1].angle_deg == pytest.approx(1.0, abs=0.15)
    assert abs(first.drifts[1].since / 1e9 - recording[0].stamp / 1e9 - BUMPED_AT_S) < 0.3
    assert not first.drifts[1].slow


def test_what_moves_before_still_cameras_bumps_none(recording: tuple[FrameSet, ...]) -> None:
    said = reports(recording)
    assert {verdict for report in said for verdict in report.verdicts} == {Verdict.STEADY}
    assert not any(report.warnings for report in said)
    assert all(drift.features >= DriftParameters().least_features for drift in said[-1].drifts)
    assert max(drift.angle_deg for drift in said[-1].drifts) < 0.1


def test_a_camera_put_back_is_cleared(recording: tuple[FrameSet, ...]) -> None:
    said = reports(turned(recording, [1], AXES[0], 1.0, until_s=1.3))
    assert any(report.distrusted for report in said)
    assert said[-1].distrusted == ()


def put_back(sets: Iterable[FrameSet], at_s: float, by_s: float) -> Iterator[FrameSet]:
    """The sets as they are stamped where the clock is put back some time after the first."""
    begun: int | None = None
    for frames in sets:
        begun = frames.stamp if begun is None else begun
        by = round(by_s * 1e9) if frames.stamp - begun > at_s * 1e9 else 0
        views = tuple(replace(view, stamp=view.stamp - by) for view in frames.views)
        yield replace(frames, stamp=frames.stamp - by, views=views)


@pytest.mark.parametrize("at_s", [0.4, 1.4])
def test_a_clock_that_is_put_back_hides_no_bump_and_clears_none(recording: tuple[FrameSet, ...], at_s: float) -> None:
    said = reports(put_back(turned(recording, [1], AXES[0], 1.0), at_s, 60.0))
    true_s = [(frames.stamp - recording[0].stamp) / 1e9 for frames in recording]
    named = [bool(report.distrusted) for report in said]
    assert true_s[named.index(True)] - BUMPED_AT_S <= 1.0
    assert all(named[named.index(True) :])
    assert 0 <= (said[-1].stamp - said[-1].drifts[1].since) / 1e9 <= 2.0


def test_a_camera_that_was_calibrated_anew_belongs_where_it_is(recording: tuple[FrameSet, ...]) -> None:
    watch, sets = DriftWatch(), list(turned(recording, [1], AXES[0], 1.0))
    for frames in sets:
        watch.update(frames)
    other = replace(sets[-1].views[1].camera, T_base_cam=2 * np.eye(4))
    views = tuple(replace(view, camera=other if i == 1 else view.camera) for i, view in enumerate(sets[-1].views))
    assert watch.update(replace(sets[-1], views=views)).distrusted == ()


LIGHTS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "dimmed": lambda image: 0.35 * image,
    "brightened": lambda image: 2.0 * image,
    "from one side": lambda image: image * np.linspace(0.2, 1.8, image.shape[1])[None, :, None],
    "a hard shadow": lambda image: image * np.where(np.arange(image.shape[1]) < 0.6 * image.shape[1], 0.35, 1)[:, None],
    "another colour": lambda image: image * [1.2, 0.8, 0.4],
}


@pytest.mark.parametrize("light", LIGHTS)
def test_lights_that_switch_move_no_camera(recording: tuple[FrameSet, ...], light: str) -> None:
    def switch(_: int, view: View, t: float) -> View:
        lit = np.clip(LIGHTS[light](view.rgb.astype(np.float64)), 0, 255).astype(np.uint8)
        return replace(view, rgb=lit if 0.7 < t < 1.4 else view.rgb)

    assert {verdict for report in reports(edited(recording, switch)) for verdict in report.verdicts} == {Verdict.STEADY}


@pytest.mark.parametrize("share", [0.3, 0.6, 0.8, 1.0])
def test_what_passes_close_before_the_lens_names_no_camera(recording: tuple[FrameSet, ...], share: float) -> None:
    rng = np.random.default_rng(3)
    cloth = cv2.resize(rng.integers(0, 255, (60, 60, 3), dtype=np.uint8), (900, 900), interpolation=cv2.INTER_CUBIC)

    def cover(_: int, view: View, t: float) -> View:
        if t < 0.4:
            return view
        height, width = view.rgb.shape[:2]
        rgb, shift = view.rgb.copy(), round(60 * t)
        rgb[:, : round(share * width)] = cloth[:height, shift : shift + round(share * width)]
        return replace(view, rgb=rgb)

    said = reports(edited(recording, cover))
    assert not any(report.distrusted for report in said)
    if share >= 0.8:
        assert Verdict.UNSURE in said[-1].verdicts


def test_a_dark_cell_gives_no_verdict_and_light_brings_it_back(recording: tuple[FrameSet, ...]) -> None:
    rng = np.random.default_rng(1)

    def night(_: int, view: View, t: float) -> View:
        if t > 0.9:
            return view
        return replace(view, rgb=np.clip(rng.normal(2, 2, view.rgb.shape), 0, 255).astype(np.uint8))

    said = reports(edited(recording, night), DriftParameters(period_ms=100))
    assert set(said[12].verdicts) == {Verdict.UNSURE}
    assert set(said[-1].verdicts) == {Verdict.STEADY}
    assert not any(report.distrusted for report in said)


def test_a_camera_turned_so_far_that_nothing_is_found_again_is_lost(recording: tuple[FrameSet, ...]) -> None:
    def turn_away(camera: int, view: View, t: float) -> View:
        return replace(view, rgb=np.ascontiguousarray(view.rgb[::-1, ::-1])) if camera == 1 and t > 0.6 else view

    said = reports(edited(recording, turn_away), DriftParameters(lost_s=0.4, period_ms=100))
    assert said[-1].drifts[1].verdict is Verdict.LOST
    assert said[-1].distrusted == (recording[0].views[1].camera.name,)


def test_cameras_that_change_places_are_told_at_once_by_what_the_other_saw(recording: tuple[FrameSet, ...]) -> None:
    """USB devices that are numbered anew: for 3.4 s their images were used in each other's place."""
    places = {1: 2, 2: 1}
    sets = []
    for frames in recording:
        late = frames.stamp - recording[0].stamp > BUMPED_AT_S * 1e9
        shown = [frames.views[places.get(i, i) if late else i] for i in range(len(frames.views))]
        views = zip(frames.views, shown, strict=True)
        sets.append(replace(frames, views=tuple(replace(v, rgb=s.rgb, depth=s.depth) for v, s in views)))
    said = reports(sets)
    first = next(report for report in said if report.distrusted)
    assert (first.stamp - recording[0].stamp) / 1e9 - BUMPED_AT_S <= 1.0
    assert said[-1].distrusted == tuple(view.camera.name for view in recording[0].views[1:])


def test_when_all_cameras_move_what_they_look_at_has(recording: tuple[FrameSet, ...]) -> None:
    last = reports(turned(recording, range(3), AXES[0], 1.0))[-1]
    assert len(last.distrusted) == 3
    assert len(last.warnings) == 1
    assert last.warnings[0].startswith("all cameras seem to have moved")


def test_when_all_cameras_see_nothing_that_stood_it_is_the_light() -> None:
    lost = tuple(Drift(name, Verdict.LOST, 0.0, 0.0, 0, 0) for name in ("left", "right"))
    (warning,) = DriftReport(0, lost).warnings
    assert "lit otherwise" in warning
    assert "start the twin anew" in warning


@pytest.mark.parametrize(
    ("depth_until_s", "consequence"),
    [
        (9.0, ": what it does not see is unknown"),
        (0.5, ": what it does not see is unknown"),  # a depth image that does not come makes it no camera without depth
        (-1.0, ", and measures no depth: all along its lines of sight to what moves is unknown"),
    ],
)
def test_the_last_camera_left_is_told_and_what_it_cannot_tell(
    recording: tuple[FrameSet, ...], depth_until_s: float, consequence: str
) -> None:
    def left(camera: int, view: View, t: float) -> View:
        moved = bumped(view, AXES[0], 1.0) if camera < 2 and t > BUMPED_AT_S else view
        return moved if t <= depth_until_s else replace(moved, depth=None)

    last = reports(edited(recording, left))[-1]
    assert len(last.warnings) == 3
    name = recording[0].views[2].camera.name
    assert last.warnings[-1] == f"camera {name} is the only one left{consequence}"


def test_a_tenth_of_a_degree_in_an_hour_is_told_apart_from_a_knock(recording: tuple[FrameSet, ...]) -> None:
    view = recording[0].views[0]
    hour = reports(slowly(view, 40.0, np.linspace(0, 0.1, 90)))
    creeping = only(hour[-1])
    assert creeping.verdict is Verdict.DRIFTING
    assert creeping.slow
    assert creeping.angle_deg == pytest.approx(0.1, abs=0.02)
    assert "calibrate refine" in hour[-1].warnings[0]
    assert creeping.trusted
    knocked = only(reports(slowly(view, 2.0, [0.0] * 10 + [0.12] * 40))[-1])
    assert knocked.verdict is Verdict.DRIFTING
    assert not knocked.slow
    assert knocked.since / 1e9 - view.stamp / 1e9 == pytest.approx(20, abs=35)


def test_noise_alone_does_not_creep(recording: tuple[FrameSet, ...]) -> None:
    said = reports(slowly(recording[0].views[0], 4.0, [0.0] * 100))
    assert {only(report).verdict for report in said} == {Verdict.STEADY}


def test_a_camera_that_crept_out_of_place_is_left_out_and_says_how(recording: tuple[FrameSet, ...]) -> None:
    last = reports(slowly(recording[0].views[0], 40.0, np.linspace(0, 0.5, 90)))[-1]
    assert only(last).verdict is Verdict.BUMPED
    assert only(last).slow
    assert "crept" in only(last).message


def hung(recording: tuple[FrameSet, ...], from_s: float, until_s: float, depth_alone: bool = False) -> list[FrameSet]:
    """The recording with the images of the second camera as they were at a time until another."""
    shown: list[View] = []

    def edit(i: int, view: View, t: float) -> View:
        if i != 1 or not from_s <= t < until_s:
            return view
        shown.append(view)
        return replace(view, rgb=view.rgb if depth_alone else shown[0].rgb.copy(), depth=shown[0].depth)

    return list(edited(recording, edit))


@pytest.mark.parametrize("depth_alone", [False, True])
def test_a_camera_that_hangs_is_left_out_from_the_second_repeat_until_it_goes_on(
    recording: tuple[FrameSet, ...], depth_alone: bool
) -> None:
    """A person who came meanwhile was in none of its images: the space was reported free."""
    sets = hung(recording, 1.0, 1.5, depth_alone)
    said = reports(sets)
    name = recording[0].views[1].camera.name
    stands = [1.0 <= (frames.stamp - recording[0].stamp) / 1e9 < 1.5 for frames in sets]
    first = stands.index(True)
    expected = [(name,) if stands[i] and i >= first + 2 else () for i in range(len(sets))]
    assert [report.distrusted for report in said] == expected
    assert "hangs, it sends the same image again and again" in said[first + 2].warnings[0]
    assert said[first + 2].drifts[1].since == sets[first].views[1].stamp


def test_a_camera_whose_depth_hung_and_then_ends_is_used_for_its_colour(recording: tuple[FrameSet, ...]) -> None:
    sets = hung(recording, 1.0, 1.5, depth_alone=True)
    ends = recording[0].stamp + 1_400_000_000
    sets = [replace(f, views=tuple(replace(v, depth=None) for v in f.views)) if f.stamp > ends else f for f in sets]
    said = reports(sets)
    assert any(report.distrusted for report in said)
    assert not said[-1].distrusted


def test_a_camera_that_hung_before_the_start_is_told_by_the_others_noise(recording: tuple[FrameSet, ...]) -> None:
    said = reports(hung(recording, 0.0, 9.0))
    assert said[-1].distrusted == (recording[0].views[1].camera.name,)


def without_noise(view: View) -> View:
    return replace(view, rgb=np.asarray(cv2.medianBlur(view.rgb, 5) // 32 * 32, np.uint8), depth=None)


def test_images_without_noise_may_be_alike(recording: tuple[FrameSet, ...]) -> None:
    """Simulated ones, and videos whose coder skips what stands: where nothing moves nothing changes."""
    still = replace(recording[0], views=tuple(map(without_noise, recording[0].views)))
    sets = [replace(still, stamp=still.stamp + i * 33_000_000) for i in range(60)]
    assert not any(report.warnings for report in reports(sets))


@pytest.mark.parametrize("every", [2, 3])
def test_images_that_are_sent_again_to_keep_a_rate_are_no_hang(recording: tuple[FrameSet, ...], every: int) -> None:
    sets = [replace(f, views=recording[i - i % every % 2].views) for i, f in enumerate(recording)]
    assert not any(report.distrusted for report in reports(sets))


def test_black_images_are_no_hang(recording: tuple[FrameSet, ...]) -> None:
    """What cannot be seen is not freed; a lens that is covered is told otherwise."""

    def black(_: int, view: View, t: float) -> View:
        return replace(view, rgb=np.zeros_like(view.rgb), depth=None) if t > 1 else view

    assert Verdict.FROZEN not in {v for report in reports(edited(recording, black)) for v in report.verdicts}
