"""The rasteriser's benchmark gives the figures that it promises; how large they are is no matter here."""

from __future__ import annotations

import json

import pytest
import torch

from twin_node.bench import raster, raster_scene
from twin_node.bench.raster_scene import Size

SMALL = Size(200, 32, 24)
BENCH = raster.RasterBench((SMALL, Size(100, 16, 16, 2)), (SMALL,), (SMALL,), (SMALL,), (0.5,), SMALL, SMALL, 2, 1)


def test_report_holds_every_figure():
    report = json.loads(json.dumps(raster.run(BENCH)))
    assert set(report) == {"cpu", "plain", "cuda", "steps", "training_iteration_ms", "masked_ratio"}
    assert [row["n"] for row in report["cpu"]] == [200, 100]
    names = {"n", "width", "height", "sh_degree", "forward_ms", "forward_backward_ms"}
    for row in (*report["cpu"], *report["plain"]):
        assert set(row) == names
        assert row["forward_ms"] > 0
    assert report["training_iteration_ms"] > 0
    assert report["masked_ratio"] > 0
    assert (report["cuda"] is None) == (report["steps"] is None) == (not torch.cuda.is_available())


def test_table_has_a_line_per_measurement():
    row = {"n": 5, "width": 8, "height": 6, "sh_degree": 1, "forward_ms": 0.5, "forward_backward_ms": 1.25}
    step = {"n": 90, "width": 8, "height": 6, "learning": 0.25, "recorded_ms": 1.5, "unrecorded_ms": 4.0}
    report = {"cpu": [row], "plain": [row], "cuda": None, "steps": [step], "training_iteration_ms": 5.0}
    lines = raster.table({**report, "masked_ratio": 0.2}).splitlines()
    assert len(lines) == 6
    assert lines[3] == "step with 4 cameras of 8x6, 25 % of 90 learning: 1.50 ms, unrecorded 4.00 ms"
    assert lines[1].split() == ["cpu", "5", "8x6", "1", "0.50", "1.25"]


@pytest.mark.parametrize("normal", [(0.0, 0, 1), (0.0, 0, -1), (1.0, 0, 0), (0.6, -0.8, 0.0)])
def test_gaussians_of_the_room_lie_flat_on_their_surface(normal: tuple[float, float, float]):
    from twin_node.geometry import rotation_from_quat

    quat = raster_scene._turn_z_to(torch.tensor([normal]))
    turned = rotation_from_quat(quat.numpy())[0] @ [0.0, 0.0, 1.0]
    assert turned == pytest.approx(normal, abs=1e-6)
