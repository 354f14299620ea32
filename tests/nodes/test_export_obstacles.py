"""Obstacles as other programs send them, in the files that exports make of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from twin_logs import PERIOD, START, obstacles_at

from twin_node.bag import LogWriter
from twin_node.cli import main
from twin_node.messages import convert
from twin_node.nodes.topics import OBSTACLES
from twin_node.scene import Obstacles


def exported(form: str, change: Callable[[Obstacles], Obstacles], output: Path) -> Path:
    """A log of two moments whose obstacles are changed, as a file of another program."""
    log_path = output.parent / "obstacles.mcap"
    with LogWriter(log_path) as log:
        for k in range(2):
            stamp = START + k * PERIOD
            log.write(OBSTACLES, convert.obstacles_to_message(change(obstacles_at(k, stamp))), stamp)
    given = ["export", log_path, "--to", form, "--rate", 10, "-o", output, "--arm", "ur5e"]
    assert main([str(word) for word in given]) == 0
    return output


@pytest.mark.parametrize(("row", "size"), [(0, (0.2, 0.0, 0.4)), (0, (0.0, 0.0, 0.0)), (1, (0.0, 0.0, 0.0))])
def test_a_flat_obstacle_is_one_that_mujoco_loads(row: int, size: tuple[float, ...], tmp_path: Path) -> None:
    """A wall without a thickness, or a point: it takes no geometry of no size, and refused the whole model."""

    def flattened(said: Obstacles) -> Obstacles:
        sizes = said.sizes.copy()
        sizes[row] = size
        return replace(said, sizes=sizes)

    model = mujoco.MjModel.from_xml_path(str(exported("mjcf", flattened, tmp_path / "a.xml")))
    shown = model.geom_size[model.geom(f"obstacle_{row}").id]
    assert np.allclose(shown[: 1 if row else 3], np.array(size[: 1 if row else 3]) / 2, atol=1e-5)


def test_obstacles_that_share_an_id_are_all_colliders_of_a_stage(tmp_path: Path) -> None:
    """As senders leave it that know no ids: each stood in the place of the one before, and was all that was there."""
    pytest.importorskip("pxr")
    from pxr import Usd, UsdGeom

    def nameless(said: Obstacles) -> Obstacles:
        alike = np.full_like(said.shapes, said.shapes[0])
        return replace(said, ids=np.zeros_like(said.ids), shapes=alike)

    stage = Usd.Stage.Open(str(exported("usd", nameless, tmp_path / "a.usda")))
    shown = stage.GetPrimAtPath("/World/Obstacles").GetChildren()
    for frame in range(2):
        stood = [UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(frame).ExtractTranslation() for prim in shown]
        assert np.allclose(sorted(map(tuple, stood)), sorted(map(tuple, obstacles_at(frame, START).positions[:3])))
        assert all(UsdGeom.Imageable(prim).ComputeVisibility(frame) == "inherited" for prim in shown)
