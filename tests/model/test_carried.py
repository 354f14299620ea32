"""Gaussians that nodes carry: rows, cells, creep, and how all are published; what is compiled is what is plain."""

from __future__ import annotations

from dataclasses import fields, is_dataclass

import numpy as np
import torch

from twin_node.model import cells, creep, publishing
from twin_node.model.field import HexPlane
from twin_node.model.gaussians import MEAN, QUAT, Gaussians
from twin_node.model.motion import Motion
from twin_node.model.nodes import Nodes
from twin_node.scene import Tier

CAPACITY = 300


def store(seed: int = 0) -> tuple[Gaussians, Motion]:
    """Gaussians of all tiers but DEFORMABLE, some dead, with three nodes, one of them the arm's."""
    rng = np.random.default_rng(seed)
    nodes, gaussians = Nodes(5, 4), Gaussians(CAPACITY, torch.device("cpu"))
    for tier in (Tier.RIGID, Tier.ROBOT, Tier.RIGID):
        row = nodes.give_birth(torch.from_numpy(rng.normal(size=3)), torch.from_numpy(rng.normal(size=3)), tier)
        quat = torch.from_numpy(rng.normal(size=4))
        nodes.quats[row] = quat / quat.norm()
        nodes.angular_velocities[row] = torch.from_numpy(rng.normal(size=3))
    gaussians.values[:] = torch.from_numpy(rng.normal(0, 0.3, (CAPACITY, 14)))
    gaussians.values[:, QUAT] /= gaussians.values[:, QUAT].norm(dim=1, keepdim=True)
    carriers = torch.from_numpy(rng.integers(-1, 3, CAPACITY))
    gaussians.nodes[:] = carriers
    gaussians.alive[:] = torch.from_numpy(rng.random(CAPACITY) > 0.2)
    loose = torch.from_numpy(np.where(rng.random(CAPACITY) > 0.5, int(Tier.STATIC), int(Tier.TRANSIENT)))
    gaussians.tiers[:] = torch.where(carriers >= 0, nodes.tiers[carriers.clamp_min(0)], loose.to(torch.uint8))
    gaussians.ids[:] = torch.from_numpy(rng.permutation(CAPACITY))
    gaussians.founders[:] = torch.from_numpy(rng.integers(-1, 3, CAPACITY))
    box = torch.ones(3)
    return gaussians, Motion(nodes, HexPlane(-box, box, 4))


def same(one: object, other: object, tolerance: float = 0.0) -> bool:
    """Whether two records of arrays hold the same."""
    assert is_dataclass(one)
    pairs = ((np.asarray(getattr(one, field.name)), np.asarray(getattr(other, field.name))) for field in fields(one))
    return all(a.shape == b.shape and a.dtype == b.dtype and np.allclose(a, b, 0, tolerance) for a, b in pairs)


def test_the_compiled_cloud_is_the_plain_one() -> None:
    """Its quaternions are of length 1, as ROS has them; those that are fitted are of any."""
    gaussians, motion = store()
    gaussians.values[:, QUAT] *= torch.linspace(0.5, 2, CAPACITY)[:, None]
    rows = torch.cat([gaussians.static_rows, gaussians.other_rows])
    assert len(rows) == len(gaussians)
    cloud = publishing.cloud_of(gaussians, motion)
    assert np.allclose(np.linalg.norm(cloud.quats, axis=1), 1, atol=1e-6)
    assert same(cloud, publishing.cloud_reference(gaussians, motion, rows), 1e-6)
    found, expected = (f(gaussians, motion.nodes) for f in (publishing.extents_of, publishing.extents_reference))
    assert same(found, expected, 1e-12)


def test_compiled_cells_are_the_plain_ones() -> None:
    gaussians, _ = store(1)
    rows = gaussians.moving_rows[gaussians.nodes[gaussians.moving_rows] >= 0]
    means = torch.from_numpy(np.random.default_rng(2).normal(size=(len(rows), 3))).float()
    gaussians.values[rows[0], MEAN] = 1e6  # beyond the last cell
    found, expected = cells.cells_of(gaussians, rows, means), cells.cells_reference(gaussians, rows, means)
    assert len(found) > 20
    assert same(found, expected)
    nobody = cells.cells_of(gaussians, rows[:0], means[:0])
    assert same(nobody, cells.cells_reference(gaussians, rows[:0], means[:0]))
    assert len(nobody) == 0
    assert nobody.centres.shape == (0, 3)


class PlainCreep(creep.Creep):
    """Tells what creeps by the plain code."""

    _crept = creep.Creep._crept_reference


def test_cells_are_known_by_their_keys() -> None:
    nobody = np.zeros(5, np.int64)
    some = cells.Cells(np.array([2, 3, 5, 8, 13]), nobody, nobody, nobody, np.zeros((5, 3)), np.zeros((5, 3)))
    for keys in ([], [1], [3, 13], [2, 4, 8, 20]):
        known = np.array(keys, np.int64)
        assert np.array_equal(some.are_among(known), np.isin(some.keys, known))
    assert not len(cells.Cells.none().are_among(np.array([1])))


def test_what_creeps_is_told_by_the_compiled_kernel_as_by_the_plain_one() -> None:
    gaussians, motion = store(3)
    rows = gaussians.moving_rows[gaussians.nodes[gaussians.moving_rows] >= 0]
    compiled, plain = creep.Creep(CAPACITY), PlainCreep(CAPACITY)
    for step in range(3):
        own = cells.cells_of(gaussians, rows, gaussians.means[rows])
        found, expected = (one.of(gaussians, rows, own, motion.nodes) for one in (compiled, plain))
        assert np.array_equal(found, expected)
        assert bool(found.any()) == (step > 0)
        gaussians.values[rows, MEAN] += 0.01 * torch.randn(len(rows), 3, generator=torch.Generator().manual_seed(step))
        gaussians.ids[rows[: 10 * step]] += CAPACITY  # others live there now
        rows = rows[step:]


def test_rows_are_those_of_the_living_whatever_has_been_written_since() -> None:
    gaussians, motion = store(4)
    before = gaussians.moving_rows
    assert gaussians.moving_rows is before
    gaussians.retire(before[:5])
    assert torch.equal(gaussians.moving_rows, before[5:])
    gaussians.settle(before[5:7], 0, motion.nodes)
    assert torch.equal(gaussians.moving_rows, before[7:])
    assert bool(torch.isin(before[5:7], gaussians.static_rows).all())
    gaussians.tiers[before[7]] = int(Tier.ROBOT)
    assert int(before[7]) in gaussians.robot_rows.tolist()
