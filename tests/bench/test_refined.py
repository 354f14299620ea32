"""The worth of a better rig: a model of two cameras shows what the third sees the better, the righter the poses are."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from twin_node.bench.errors import BenchError
from twin_node.bench.refined import RefinedParameters, run
from twin_node.cell import CellSource, load_scenario
from twin_node.scene import Rig, RigCamera

FAST = RefinedParameters(width=96, steps=30)


def turned(camera: RigCamera, axis: int, degrees: float) -> RigCamera:
    T = camera.T_base_cam.copy()
    T[:3, :3] @= Rotation.from_rotvec(np.radians(degrees) * np.eye(3)[axis]).as_matrix()
    return replace(camera, T_base_cam=T)


@pytest.fixture
def rig() -> Rig:
    return CellSource(load_scenario("demo")).rig


def test_turned_cameras_cost_what_right_ones_give_back(rig: Rig, cell_log: Callable[..., Path]) -> None:
    wrong = replace(rig, cameras=tuple(turned(camera, i, 2.0) for i, camera in enumerate(rig.cameras)))
    bench = run(cell_log(1.2), wrong, rig, FAST)
    assert bench.gain_db(lambda score: score.shading_psnr_db) > 0.1
    for score in (*bench.before.values(), *bench.after.values()):
        assert score.psnr_db <= score.one_gain_psnr_db <= score.shading_psnr_db
    figures = bench.as_json()
    assert set(figures["before"]) == set(figures["after"]) == {camera.name for camera in rig.cameras}


def test_rigs_of_other_cameras_or_of_two_are_refused(rig: Rig, cell_log: Callable[..., Path]) -> None:
    renamed = replace(rig, cameras=tuple(replace(camera, name=f"{camera.name}_x") for camera in rig.cameras))
    with pytest.raises(BenchError, match="two rigs of the cameras"):
        run(cell_log(1.2), rig, renamed, FAST)
    two = replace(rig, cameras=rig.cameras[:2])
    with pytest.raises(BenchError, match="three cameras or more"):
        run(cell_log(1.2), two, two, FAST)
