"""Speed against accuracy: who dominates whom, what sizes change, and all of it on a scene as small as can be."""

from __future__ import annotations

import dataclasses
import itertools
import json
import os
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from pathlib import Path

import numpy as np
import pytest
import torch
from matplotlib.figure import Figure

from twin_node.bench.errors import BenchError
from twin_node.bench.methods.made_up import MadeUpParameters, make_up
from twin_node.bench.methods.protocol import QUICK as QUICK_BUDGET
from twin_node.bench.pareto import ablations, chart, costs, suite
from twin_node.bench.pareto.chart import draw
from twin_node.bench.pareto.front import dominated_sizes, on_front
from twin_node.bench.pareto.hexplane import HEXPLANE, against_hexplane, said
from twin_node.bench.pareto.measure import Job, Point, begun_mb, measure
from twin_node.bench.pareto.suite import Pareto, ParetoParameters, run
from twin_node.bench.pareto.tables import front_text, markdown, text
from twin_node.model import ModelParameters, SeedParameters
from twin_node.nodes.size_choice import Rated, read_front
from twin_node.nodes.sizes import SIZES
from twin_node.runtime.memory import peak_mb

TINY = MadeUpParameters(width=48, frames=4, rate_hz=3.0, cameras=3, held_out=1)
BUDGET = dataclasses.replace(
    QUICK_BUDGET, gaussians=300, offline_steps=6, online=ModelParameters(seed=SeedParameters(steps=10))
)


def point(name: str, ms: float, db: float | None, online: bool = True, **figures: float) -> Point:
    return Point(name, name, "scene", online, ms, psnr_left_out_db=db, **figures)


def test_the_front_is_who_nobody_beats_in_both() -> None:
    points = [
        point("frozen", 1, 12),
        point("ours_tiny", 10, 15),
        point("ours_large", 30, 18),
        point("streaming", 40, 17),
        point("previous", 0.1, None),
    ]
    assert [one.name for one in points if on_front(one, points)] == ["frozen", "ours_tiny", "ours_large"]
    assert not any(dominated_sizes(one, points) for one in points)


def test_a_rival_that_is_faster_and_better_dominates_and_one_that_knows_the_future_does_not() -> None:
    ours = point("ours_large", 30, 18)
    assert dominated_sizes(point("rival", 20, 18), [ours]) == ("ours_large",)
    assert dominated_sizes(point("rival", 30, 18), [ours]) == ()
    assert dominated_sizes(point("offline", 20, 30, online=False), [ours]) == ()
    assert on_front(ours, [ours, point("offline", 20, 30, online=False)])


def test_a_forecast_that_blocks_more_space_does_not_dominate() -> None:
    ours = point("ours_large", 30, 18, recall=0.98, volume_l=100.0, forecast_ms=10.0)
    worst = point("worst_case", 5, None, recall=0.99, volume_l=300.0, forecast_ms=5.0)
    better = dataclasses.replace(worst, volume_l=100.0)
    assert dominated_sizes(worst, [ours]) == ()
    assert dominated_sizes(better, [ours]) == ("ours_large",)


def test_a_suite_in_which_ours_is_dominated_does_not_pass() -> None:
    ours = point("ours_large", 30, 18)
    Pareto((ours, point("rival", 40, 18))).check()
    with pytest.raises(BenchError, match="found rival on scene: ours_large"):
        Pareto((ours, point("rival", 20, 18))).check()


def test_another_data_set_is_another_matter() -> None:
    other = dataclasses.replace(point("rival", 1, 40), data="elsewhere")
    assert dominated_sizes(other, [point("ours_tiny", 10, 15)]) == ()


def test_planes_are_compared_where_they_do_as_well() -> None:
    """Ours as shipped with the shortest training that reaches it, and the fastest size that reaches the plateau."""
    planes = [
        point(f"{HEXPLANE}:{steps}", 10.0 * steps, db, online=False, latency_ms=1000.0 * steps, parameters=600)
        for steps, db in ((1, 15), (2, 18), (3, 18.05))
    ]
    sizes = [
        point("ours_tiny", 5, 16.0, parameters=100),
        point("ours_large", 10, 17.5, parameters=200),
        point("ours_full", 20, 18.5, parameters=300),
    ]
    found = against_hexplane((*sizes, *reversed(planes)))
    pairs = [(one.at, one.ours, one.hexplane) for one in found]
    assert pairs == [("ours", "ours_large", f"{HEXPLANE}:2"), ("plateau", "ours_full", f"{HEXPLANE}:2")]
    assert found[0].times_faster_per_set == pytest.approx(200)
    assert found[0].times_faster_amortised == pytest.approx(2)
    assert found[0].times_fewer_parameters == pytest.approx(3)
    assert "reaches 18.5 dB, 4dgs_hexplane:2 18.0 dB (its plateau)" in said(found[1])


def test_where_one_never_reaches_the_other_there_is_no_pair() -> None:
    weak, strong = point("ours_large", 10, 15.0), point(f"{HEXPLANE}:9", 90, 16.0, online=False, latency_ms=9.0)
    assert [one.at for one in against_hexplane([weak, strong])] == ["ours"]
    assert [one.at for one in against_hexplane([replaced(weak, 17.0), strong])] == ["plateau"]


def replaced(one: Point, db: float) -> Point:
    return dataclasses.replace(one, psnr_left_out_db=db)


def test_sizes_rise_in_everything() -> None:
    sizes = list(SIZES.values())
    for smaller, larger in itertools.pairwise(sizes):
        *costs_less, share = dataclasses.astuple(smaller)
        *costs_more, of_more = dataclasses.astuple(larger)
        assert all(a <= b for a, b in zip(costs_less, costs_more, strict=True))
        assert costs_less != costs_more
        assert (
            share * smaller.gaussians_per_pixel * smaller.width**2
            < of_more * larger.gaussians_per_pixel * larger.width**2
        )


@pytest.fixture(scope="module")
def measured() -> Iterator[Pareto]:
    """Four methods, measured in this process, which is given back its threads."""
    threads = torch.get_num_threads()
    scene = make_up(TINY)
    names = ("frozen", "previous", f"{HEXPLANE}:5", "ours_tiny")
    yield Pareto(tuple(measure(Job(name, scene.recording, scene.truth, BUDGET, 2)) for name in names))
    torch.set_num_threads(threads)


def test_what_is_measured_is_told(measured: Pareto) -> None:
    frozen, previous, planes, ours = json.loads(json.dumps(measured.as_json()))["methods"]
    assert frozen["online"] and ours["online"] and not planes["online"]
    assert previous["psnr_left_out_db"] is None, "it has no image of a camera that it does not have"
    assert ours["ms_per_frame"] > frozen["ms_per_frame"] > 0
    assert ours["latency_ms"] >= ours["ms_per_frame"] - ours["draw_ms"]
    assert planes["title"].endswith("5 steps")
    assert 0 < ours["ssim"] < 1
    assert ours["track_mm"] > 0


def test_it_is_drawn_and_tabled(measured: Pareto, tmp_path: Path) -> None:
    assert "ours, tiny *" in text(measured)
    assert markdown(measured).startswith("### made-up")
    picture = draw(measured, tmp_path)
    assert picture.stat().st_size < 300_000
    assert picture.with_suffix(".svg").is_file()
    (tmp_path / "file").write_text("")
    with pytest.raises(BenchError, match="choose another folder"):
        draw(measured, tmp_path / "file")


@pytest.mark.parametrize("count", [1, 2, 3])
def test_the_legend_is_no_wider_than_the_chart(count: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of one data set both ends were cut, and with them what our own marks are."""
    drawn: list[Figure] = []
    monkeypatch.setattr(chart, "save_chart", lambda figure, folder, name: drawn.append(figure))
    points = [point("ours_tiny", 10, 15), point("frozen", 1, 12)]
    of_data = (dataclasses.replace(one, data=f"data {number}") for number in range(count) for one in points)
    draw(Pareto(tuple(of_data)), tmp_path)
    drawn[0].draw_without_rendering()
    legend = drawn[0].legends[0].get_window_extent()
    assert legend.x0 >= 0 and legend.x1 <= drawn[0].bbox.x1


def test_sizes_are_written_as_a_replay_reads_them(tmp_path: Path) -> None:
    points = [("ours_tiny", 10, 15.0), ("ours_tiny", 30, 17.0), ("ours_small", 20, None), ("frozen", 1, 12.0)]
    path = tmp_path / "sizes.yaml"
    path.write_text(front_text([Point(name, name, "scene", True, ms, psnr_left_out_db=db) for name, ms, db in points]))
    assert read_front(path) == (Rated("tiny", 20.0, 16.0),)


def test_a_method_that_is_none_is_named_before_anything_is_run() -> None:
    with pytest.raises(BenchError, match="expected some of frozen"):
        run(ParetoParameters(made_up=TINY, rivals=("magic",)))


@pytest.mark.parametrize("name", ["frozen:5", f"{HEXPLANE}:", f"{HEXPLANE}:0", f"{HEXPLANE}:²", "dynamic_nerf:40"])
def test_steps_are_given_to_what_takes_them(name: str) -> None:
    with pytest.raises(BenchError, match=f"with 4dgs_hexplane, 4dgs_hash, static_3dgs alone, found '{name}'"):
        run(ParetoParameters(made_up=TINY, rivals=(name,)))


def test_two_logs_of_one_name_are_refused(cell_log: Callable[..., Path], tmp_path: Path) -> None:
    log = cell_log(0.5)
    other = tmp_path / log.name
    other.write_bytes(log.read_bytes())
    with pytest.raises(BenchError, match=f"{log.stem}: expected logs with names of their own"):
        run(ParetoParameters((log, other), made_up=None, rivals=(), width=48, frames=2))
    with pytest.raises(BenchError, match=f"{log.stem}: expected logs with names of their own"):
        ablations.run(ablations.AblationParameters((log, other)))


def test_after_an_error_nothing_more_is_begun() -> None:
    wrong, waiting = Future[int](), Future[int]()
    wrong.set_exception(BenchError("too short"))
    with pytest.raises(BenchError, match="too short"):
        list(suite._as_done(["a", "b"], [wrong, waiting]))
    assert waiting.cancelled()


def test_memory_is_that_of_the_learning_alone() -> None:
    """The peak of what was done before is not that of what comes after."""
    if not os.access("/proc/self/clear_refs", os.W_OK):
        pytest.skip("this system does not let a process forget its peak")
    before = begun_mb()
    np.ones(8 << 20).sum()
    assert peak_mb() - before > 60
    before = begun_mb()
    assert peak_mb() - before < 20


def test_ablations_leave_out_one_part_each(tmp_path: Path) -> None:
    chain = ablations.load_parameters(None)
    changed = {name: change(chain) for name, change in ablations.ABLATIONS.items()}
    same = [name for name, one in changed.items() if one == chain]
    assert same == ["whole", ablations.ONE_RATE, ablations.SELF_FILTER]
    assert changed["no_gradient_steps"].model.track.steps == 0


def test_an_ablation_is_followed_and_told_of(cell_log: Callable[..., Path]) -> None:
    log = cell_log(1.2)
    parameters = ablations.AblationParameters((log,), 4, names=("no_mapper", ablations.ONE_RATE), width=64)
    rows = ablations.run(parameters)
    figures = json.loads(json.dumps(ablations.as_json(rows)))[log.stem]
    assert list(figures) == ["no_mapper", "one_rate"]
    assert figures["one_rate"]["mapper_ms"] == 0
    assert figures["no_mapper"]["parameters"] > 0
    assert ablations.text(rows).count("\n") == 2
    assert f"| {log.stem} | one rate |" in ablations.markdown(rows)


def test_one_set_is_no_run(cell_log: Callable[..., Path], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch, "set_num_threads", lambda count: None)
    with pytest.raises(BenchError, match="expected two sets of images or more, found 1"):
        ablations._follow(ablations._Job(cell_log(0.5), "whole", ablations.AblationParameters((), 1, width=48)))


def test_an_ablation_that_is_none_is_named(tmp_path: Path) -> None:
    with pytest.raises(BenchError, match=r"expected some of whole, no_nodes.*found 'no_magic'"):
        ablations.run(ablations.AblationParameters((tmp_path / "none.mcap",), names=("no_magic",)))


def test_more_of_the_image_moves_in_a_larger_crowd() -> None:
    shares = []
    for share in (0.02, 0.2):
        source = costs.CellSource(costs.crowd(share, 0.1))
        rig = source.simulated
        exact = [rig.see(index, rig.scenario.start_ns) for index in range(3)]
        shares.append(float(np.mean([one.shows(rig.world.moving_owners).mean() for one in exact])))
    assert 0.005 < shares[0] < 0.06
    assert 0.08 < shares[1] < 0.35
