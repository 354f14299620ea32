"""The table of methods: the made-up scene is what it says, scores are right, and all methods run on one protocol."""

from __future__ import annotations

import dataclasses
import itertools
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from matplotlib.figure import Figure

from twin_node.bench.errors import BenchError
from twin_node.bench.methods import chart, whole_sequence
from twin_node.bench.methods.chart import draw_chart, text
from twin_node.bench.methods.following import Population, follow_populations, no_motion, stand_still
from twin_node.bench.methods.made_up import MadeUp, MadeUpParameters, make_up
from twin_node.bench.methods.plane_nerf import MOVING, CameraPixels
from twin_node.bench.methods.protocol import QUICK, Budget, Fitted
from twin_node.bench.methods.scores import score_images, structural_similarity
from twin_node.bench.methods.table import METHODS, MethodsBench, run
from twin_node.bench.methods.truth import MotionTruth, track_errors_mm
from twin_node.geometry import project
from twin_node.model import ModelParameters, SeedParameters
from twin_node.model.sequence import SequenceModel, Span, split
from twin_node.model.sequence.scoring import evenly
from twin_node.nodes.report.quality import unit

TINY = MadeUpParameters(width=48, frames=4, rate_hz=3.0, cameras=3, held_out=1)
BUDGET = dataclasses.replace(
    QUICK,
    gaussians=500,
    offline_steps=6,
    per_frame_steps=3,
    stream_steps=2,
    nerf=dataclasses.replace(QUICK.nerf, steps=4, rays=64, samples=8, resolution=8),
    online=ModelParameters(seed=SeedParameters(steps=10)),
)


@pytest.fixture(scope="module")
def scene() -> MadeUp:
    return make_up(TINY)


@pytest.fixture(scope="module")
def bench(scene: MadeUp) -> MethodsBench:
    return run(scene.recording, scene.truth, BUDGET, tuple(METHODS), lambda name, share: None)


def test_the_scene_is_the_same_every_time(scene: MadeUp) -> None:
    again = make_up(TINY)
    for a, b in zip(scene.recording.train, again.recording.train, strict=True):
        np.testing.assert_array_equal(a.rgb, b.rgb)
    np.testing.assert_array_equal(scene.truth.positions, again.truth.positions)


def test_points_are_where_the_images_show_their_movers(scene: MadeUp) -> None:
    """Around the projected points of a mover, images with it differ from images of an empty scene."""
    truth = scene.truth
    empty = make_up(dataclasses.replace(TINY, movers=())).recording
    for name in ("bending", "rigid"):
        chosen = [index for index, mover in enumerate(truth.movers) if mover == name]
        for with_it, without in zip(scene.recording.train, empty.train, strict=True):
            step = truth.stamps.index(with_it.stamp)
            uvz = project(with_it.camera.K, with_it.camera.viewmat, truth.positions[step, chosen])
            column, row = np.floor(uvz[:, :2]).astype(int).T
            inside = (column >= 0) & (column < with_it.camera.width) & (row >= 0) & (row < with_it.camera.height)
            changed = np.abs(with_it.rgb.astype(int) - without.rgb).max(-1) > 4
            assert inside.any() and changed[row[inside], column[inside]].mean() > 0.75  # the rest is outline


def test_points_of_the_rod_lie_on_its_surface() -> None:
    """They lay within it, by up to 24 mm."""
    truth = make_up(dataclasses.replace(TINY, movers=("bending",))).truth
    links, length, radius = 9, 0.05, 0.035
    foot = np.array([-0.05, 0.35, 0.0])  # where it stands upright at first
    points = truth.positions[0, truth.births == 0]
    from_axis = np.linalg.norm(points[:, :2] - foot[:2], axis=1)
    ends = foot[2] + length * np.arange(links + 1)
    past = np.maximum(ends[:-1] - points[:, 2:], points[:, 2:] - ends[1:]).clip(0)  # of every link
    to_surface = np.abs(np.hypot(from_axis[:, None], past) - radius).min(1)
    assert len(points) > 50
    np.testing.assert_allclose(to_surface, 0, atol=1e-9)


def test_movers_move_as_their_names_say(scene: MadeUp) -> None:
    positions, movers = scene.truth.positions, np.array(scene.truth.movers)
    rigid = positions[:, movers == "rigid"]
    spread = [np.linalg.norm(at[:, None] - at[None], axis=-1) for at in rigid]
    np.testing.assert_allclose(spread[0], spread[-1], atol=1e-9)
    bending = positions[:, movers == "bending"]
    assert (
        np.abs(np.linalg.norm(bending[1, 0] - bending[1, -1]) - np.linalg.norm(bending[0, 0] - bending[0, -1])) > 0.01
    )
    assert scene.truth.births[movers == "appearing"].min() > 0
    assert (scene.truth.births[movers == "rigid"] == 0).any()


def test_held_out_cameras_stand_elsewhere(scene: MadeUp) -> None:
    hidden = {tuple(view.camera.T_base_cam[:3, 3]) for view in scene.recording.held_out}
    assert not hidden & {tuple(view.camera.T_base_cam[:3, 3]) for view in scene.recording.train}
    assert len(hidden) == 1


@pytest.mark.parametrize("name", METHODS)
def test_every_method_renders_the_scene(bench: MethodsBench, name: str) -> None:
    row = bench.rows[name]
    assert row.scores.psnr_db is not None and row.scores.psnr_db > 8
    assert row.scores.ssim is not None and 0 < row.scores.ssim <= 1
    assert row.learn_ms_per_frame > 0 and row.scores.draw_ms > 0
    assert name == "previous" or (row.bytes or 0) > 0 < (row.parameters or 0)


def test_tracks_are_told_of_those_that_have_motion(bench: MethodsBench) -> None:
    told = {name for name, row in bench.rows.items() if row.track_mm}
    assert told == set(METHODS) - {"previous", "per_frame_3dgs", "dynamic_nerf"}
    assert bench.rows["frozen"].track_mm["rigid"] > 100


def test_figures_are_json_with_stable_names(bench: MethodsBench) -> None:
    figures = json.loads(json.dumps(bench.as_json(), allow_nan=False))
    assert set(figures["methods"]) == set(METHODS)
    assert {
        "psnr_db",
        "psnr_moving_db",
        "ssim",
        "draw_ms",
        "learn_ms_per_frame",
        "bytes",
        "parameters",
        "track_mm",
    } <= set(figures["methods"]["ours"])
    best = max(figures["methods"][name]["psnr_moving_db"] for name in ("4dgs_hexplane", "4dgs_hash"))
    assert figures["ours_less_offline_moving_db"] == figures["methods"]["ours"]["psnr_moving_db"] - best


def test_table_and_chart_name_every_method(bench: MethodsBench, tmp_path: Path) -> None:
    lines = text(bench)
    assert all(method.title in lines for method in METHODS.values())
    assert draw_chart(bench, tmp_path / "new").stat().st_size > 5000
    (tmp_path / "file").write_text("")
    with pytest.raises(BenchError, match="--out"):
        draw_chart(bench, tmp_path / "file")


@pytest.mark.parametrize(
    ("spoil", "names", "says"),
    [
        (lambda r: dataclasses.replace(r, held_out=()), ("frozen",), "--hold-out"),
        (lambda r: r, ("frozen", "magic"), "magic"),
        (lambda r: dataclasses.replace(r, camera_moves=True), ("frozen",), "stand still"),
        (lambda r: split(r, ("train_0", "train_1")), ("frozen",), "found train_2 alone; hold out fewer"),
    ],
)
def test_unfit_data_is_refused(scene: MadeUp, spoil: Callable, names: tuple[str, ...], says: str) -> None:
    with pytest.raises(BenchError, match=says):
        run(spoil(scene.recording), None, BUDGET, names, lambda name, share: None)


def test_scores_are_those_of_the_pixels(scene: MadeUp) -> None:
    views = scene.recording.held_out
    first = {views[0].camera.name: unit(views[0])}
    off = Fitted(lambda camera, stamp: _image_of(scene, stamp) + np.float32(0.1), no_motion, None, None)
    scores = score_images(off, views[1:], first)
    assert scores.psnr_db == pytest.approx(20, abs=0.01)
    assert scores.psnr_moving_db == pytest.approx(20, abs=0.01)
    assert scores.psnr_unchanged_db == pytest.approx(20, abs=0.01)


@pytest.mark.parametrize("name", ["per_frame_3dgs", "streaming", "ours"])
def test_a_method_that_learns_set_by_set_tells_of_every_set(scene: MadeUp, name: str) -> None:
    """By that its costs are told apart: the second set's were taken for those of the first, which starts it."""
    shares: list[float] = []
    METHODS[name].fit(scene.recording, BUDGET, shares.append)
    sets = len(scene.recording.sets())
    assert shares == pytest.approx([number / sets for number in range(1, sets + 1)])


def test_the_previous_image_is_no_rival_where_there_is_none(scene: MadeUp) -> None:
    """A camera's first image in its own place would be 100 dB."""
    recording = scene.recording
    fitted = METHODS["previous"].fit(recording, BUDGET, lambda share: None)
    views = [view for view in recording.train if view.camera.name == "train_1"]
    assert fitted.render(views[0].camera, views[0].stamp) is None
    first = {"train_1": unit(views[0])}
    scores = score_images(fitted, tuple(views), first)
    errors = [float(np.mean((unit(a) - unit(b)) ** 2)) for a, b in itertools.pairwise(views)]
    assert scores.psnr_db == pytest.approx(np.mean(-10 * np.log10(errors)), abs=1e-3)
    assert scores.ssim == pytest.approx(
        np.mean([structural_similarity(unit(a), unit(b)) for a, b in itertools.pairwise(views)]), abs=1e-6
    )
    alone = score_images(fitted, tuple(views[:1]), first)
    assert alone.psnr_db is None and alone.ssim is None and alone.draw_ms is None


def test_pixels_that_are_not_valid_are_not_scored(scene: MadeUp) -> None:
    view = scene.recording.held_out[1]
    valid = np.ones(view.rgb.shape[:2], bool)
    valid[:, :12] = False
    other = unit(view).copy()
    other[~valid] = 1
    fitted = Fitted(lambda camera, stamp: other, no_motion, None, None)
    scores = score_images(fitted, (dataclasses.replace(view, valid=valid),), {view.camera.name: other})
    assert scores.psnr_db == 100 and scores.ssim == pytest.approx(1, abs=1e-6)


def test_the_chart_has_no_bar_for_what_no_image_gave(
    bench: MethodsBench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = {name: bench.rows[name] for name in ("frozen", "ours")}
    nothing = dataclasses.replace(rows["ours"].scores, psnr_moving_db=None)
    rows["ours"] = dataclasses.replace(rows["ours"], scores=nothing)
    drawn: list[Figure] = []
    monkeypatch.setattr(chart, "save_chart", lambda figure, folder, name: drawn.append(figure))
    draw_chart(dataclasses.replace(bench, rows=rows), tmp_path)
    labels = [text.get_text() for text in drawn[0].axes[0].texts]
    assert len(labels) == 4 and labels[-1] == "" and "0.0" not in labels


def test_the_chart_s_legend_lies_on_no_bar(
    bench: MethodsBench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It lay on the last row, ours, and on its figures."""
    drawn: list[Figure] = []
    monkeypatch.setattr(chart, "save_chart", lambda figure, folder, name: drawn.append(figure))
    draw_chart(bench, tmp_path)
    drawn[0].draw_without_rendering()
    (legend,) = (own for own in (*drawn[0].legends, drawn[0].axes[0].get_legend()) if own is not None)
    assert not legend.get_window_extent().overlaps(drawn[0].axes[0].get_window_extent())


def _image_of(scene: MadeUp, stamp: int) -> np.ndarray:
    return next(unit(view) for view in scene.recording.held_out if view.stamp == stamp)


def test_structural_similarity_is_1_for_equal_images_alone() -> None:
    image = np.random.default_rng(0).random((20, 30, 3)).astype(np.float32)
    assert structural_similarity(image, image) == pytest.approx(1, abs=1e-6)
    assert structural_similarity(image, image[::-1].copy()) < 0.5


def moving(steps: int = 5) -> MotionTruth:
    rng = np.random.default_rng(0)
    start = rng.uniform(-1, 1, (6, 3))
    positions = start + np.arange(steps)[:, None, None] * np.array([0.1, 0.0, 0.0])
    return MotionTruth(tuple(range(steps)), positions, np.array([0, 0, 0, 2, 2, 4]), ("a", "a", "b", "b", "b", "b"))


def test_perfect_motion_has_no_error_and_none_has_that_of_standing_still() -> None:
    truth = moving()

    def population(step: int) -> Population:
        return Population(np.arange(6), truth.positions[step], np.ones(6))

    assert track_errors_mm(truth, follow_populations(5, population))["all"] == pytest.approx(0, abs=1e-9)
    still = track_errors_mm(truth, stand_still(5))
    assert still == pytest.approx({"a": 250.0, "b": (250 + 150 + 150) / 3, "all": (3 * 250 + 2 * 150) / 5})
    assert track_errors_mm(truth, no_motion) == {}


def test_points_go_over_to_others_when_their_carriers_die() -> None:
    truth = moving()

    def population(step: int) -> Population:
        return Population(np.arange(6) + (100 if step >= 2 else 0), truth.positions[step], np.ones(6))

    errors = track_errors_mm(truth, follow_populations(5, population))
    assert errors["all"] < 101  # what the step is long in which nobody carried them
    assert errors["all"] > 10


def test_faint_gaussians_carry_nothing() -> None:
    truth = moving()
    decoys = truth.positions[0] + 1e-4

    def population(step: int) -> Population:
        means = np.concatenate([truth.positions[step], decoys])
        return Population(np.arange(12), means, np.array([1.0] * 6 + [0.05] * 6))

    assert track_errors_mm(truth, follow_populations(5, population))["all"] == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize("cameras", [1, 2, 3, 4, 6])
@pytest.mark.parametrize("steps", [1, 7, 24, 50, 75])
def test_every_held_out_camera_is_scored(scene: MadeUp, cameras: int, steps: int) -> None:
    view = scene.recording.held_out[0]
    views = tuple(
        dataclasses.replace(view, stamp=step, camera=dataclasses.replace(view.camera, name=f"c{camera}"))
        for step in range(steps)
        for camera in range(cameras)
    )
    chosen = evenly(views, 24)
    assert len(chosen) <= 24 and len({one.camera.name for one in chosen}) == cameras
    assert chosen[-1].stamp >= 0.8 * (steps - 1)


def test_budgets_are_one_for_all() -> None:
    assert QUICK.offline_steps < Budget().offline_steps


def test_half_of_the_rays_look_at_what_moves(scene: MadeUp) -> None:
    recording = scene.recording
    name = recording.cameras[0].name
    views = [view for view in recording.train if view.camera.name == name]
    pixels = CameraPixels(views, Span(recording.first, recording.last))
    sample = pixels.draw(400, torch.Generator().manual_seed(0))
    uv = project(views[0].camera.K, views[0].camera.viewmat, (sample.rays.origins + sample.rays.directions).numpy())
    median = np.median([view.rgb for view in views], axis=0)
    moving = 0
    for (u, v, _), time, rgb in zip(uv, sample.rays.times, sample.rgb.numpy(), strict=True):
        view = views[round(float(time + 1) / 2 * (len(views) - 1))]
        at = view.rgb[int(v), int(u)]
        np.testing.assert_allclose(rgb, at / 255, atol=1e-6)
        moving += np.abs(at - median[int(v), int(u)]).max() > 255 * MOVING
    assert 200 <= moving < 300


def test_rays_are_learnt_of_valid_pixels_alone(scene: MadeUp) -> None:
    """What undistortion leaves black is no part of the scene, and not scored either."""
    recording = scene.recording
    name = recording.cameras[0].name
    views = [view for view in recording.train if view.camera.name == name]
    valid = np.ones(views[0].rgb.shape[:2], bool)
    valid[:, :40] = False
    marked = [dataclasses.replace(one, valid=valid, rgb=np.where(valid[..., None], one.rgb, 0)) for one in views]
    marked[1].rgb[~valid] = 255  # it changes, as what moves does
    pixels = CameraPixels(marked, Span(recording.first, recording.last))
    sample = pixels.draw(400, torch.Generator().manual_seed(0))
    uv = project(views[0].camera.K, views[0].camera.viewmat, (sample.rays.origins + sample.rays.directions).numpy())
    assert uv[:, 0].min() > 40


def test_what_shows_the_plateau_is_scored_when_all_is_learnt(scene: MadeUp, monkeypatch: pytest.MonkeyPatch) -> None:
    """Else a rival's training would take as long as it takes to draw the probes."""
    told: list[float] = []
    scored: list[SequenceModel] = []

    def score(model: SequenceModel, _views: object) -> float:
        assert told[-1] == 1
        scored.append(model)
        return 0.0

    monkeypatch.setattr(whole_sequence, "mean_psnr", score)
    whole_sequence.fit_plain(scene.recording, BUDGET, told.append)
    after, before = (model.gaussians.means for model in scored)
    assert not torch.equal(after, before)
