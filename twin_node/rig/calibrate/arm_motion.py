"""A camera's clock against the arm's: the arm's surface moves in the image as its joints say, at the right shift only.

Optical flow on the arm is compared with the flow that the joint angles predict. Unlike outlines, flow is a velocity: a
wrong shape or contrast changes its size, which no shift in time can mend, and so leaves the offset unbiased.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from twin_node.geometry import inverse_pose
from twin_node.rig.calibrate.arm_surface import arm_surface
from twin_node.rig.calibrate.shifts import Costs
from twin_node.robot import ArmModel, forward_kinematics
from twin_node.scene import Camera, Float32, Float64, JointSample, UInt8

STEP_S = 0.004
"""Time between the arm's positions that are worked out, and between shifts tried; the best is found between them, s."""
ALONG, AROUND = 4, 7
"""Points on each capsule of the arm."""
FACING = -0.2
"""Cosine between a surface's normal and the ray that sees it above which it is too slanted to show motion."""
FLOW_SIGMA = 15.0 / 320
"""Error of optical flow at which it loses its say, image widths per second: half a pixel per frame at 320 px, 30 Hz."""
TEXTURE = 4.0
"""Grey levels per pixel at which a point counts half: flow in smooth places is guessed by its surroundings."""


@dataclass(frozen=True)
class Film:
    """One camera's images over time."""

    camera: Camera
    stamps: NDArray[np.int64]
    """[T] ns, rising."""
    grey: UInt8
    """[T, H, W]."""


@dataclass(frozen=True)
class _Course:
    """Where points of the arm's surface are over time."""

    start: int
    """ns."""
    points: Float32
    """[G, N, 3] m, every `STEP_S`."""
    normals: Float32
    """[G, N, 3]."""


class JointCourse:
    """The arm's joints over a recording."""

    def __init__(self, arm: ArmModel, joints: Sequence[JointSample]) -> None:
        """`joints` in rising order of stamps, two at least."""
        self.arm = arm
        self.start = joints[0].stamp
        times = np.array([(sample.stamp - self.start) / 1e9 for sample in joints])
        self.end_s = float(times[-1])
        self._angles = CubicSpline(times, np.stack([arm.ordered_positions(sample) for sample in joints]))

    def links(self, times: Float64) -> Float64:
        """[..., J + 1, 4, 4] link poses at times [...] s; held still beyond the recording."""
        return forward_kinematics(self.arm, self._angles(np.clip(times, 0.0, self.end_s)))


class ArmCourse:
    """The arm's surface over a recording."""

    def __init__(self, joints: JointCourse) -> None:
        self._course = _course(joints)

    def costs(self, film: Film, max_offset_s: float) -> Costs | None:
        """How badly a film fits the arm's motion at every shift of its stamps; None where the arm does not move."""
        projected = _Projected(self._course, film.camera)
        if not projected.moves:
            return None
        count = int(np.ceil(max_offset_s / STEP_S))
        shifts = np.arange(-count, count + 1)
        flow = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
        flow.setFinestScale(0)
        stamps, rows = [], []
        for i in range(len(film.stamps) - 1):
            first, second = ((film.stamps[k] - self._course.start) / 1e9 / STEP_S for k in (i, i + 1))
            if first - count < 0 or second + count >= len(self._course.points) - 1 or second <= first:
                continue
            measured = np.asarray(flow.calc(film.grey[i], film.grey[i + 1], None), np.float32)  # type: ignore[call-overload]
            rows.append(projected.misfits(measured, film.grey[i], first + shifts, second + shifts))
            stamps.append((film.stamps[i] + film.stamps[i + 1]) // 2)
        return Costs(np.array(stamps), (shifts * STEP_S).astype(np.float64), np.array(rows)) if rows else None


class _Projected:
    """The arm's course as one camera sees it."""

    def __init__(self, course: _Course, camera: Camera) -> None:
        view = inverse_pose(camera.T_base_cam).astype(np.float32)
        local = course.points @ view[:3, :3].T + view[:3, 3]
        rays = course.points - camera.T_base_cam[:3, 3].astype(np.float32)
        slant = (rays * course.normals).sum(-1) / np.linalg.norm(rays, axis=-1)
        with np.errstate(divide="ignore", invalid="ignore"):
            pixels = local[..., :2] / local[..., 2:] * camera.K[[0, 1], [0, 1]] + camera.K[:2, 2]
        limit = np.array([camera.width, camera.height]) - 1.0
        inside = np.asarray(((pixels >= 1) & (pixels <= limit)).all(axis=-1))
        self._pixels = np.where(inside[..., None], pixels, 1.0)
        self._seen = inside & (local[..., 2] > 0) & (slant < FACING)
        self._sigma = FLOW_SIGMA * camera.width
        self.moves = bool(self._seen.any() and np.ptp(np.where(self._seen[..., None], pixels, 0.0), axis=0).max() > 1)

    def misfits(self, measured: Float32, image: UInt8, first: Float64, second: Float64) -> Float64:
        """[D] robust misfit of the flow [H, W, 2] from an image to the next; both at grid places [D] of the course."""
        before, after = self._at(first), self._at(second)
        seen = self._seen[np.rint(first).astype(np.int64)]
        u, v = np.moveaxis(np.rint(before - 0.5).astype(np.int64), -1, 0)
        duration = (second - first)[:, None] * STEP_S
        off = ((measured[v, u] - (after - before)) ** 2).sum(-1) / (self._sigma * duration) ** 2
        weights = np.where(seen, _texture(image)[v, u], 0.0)
        out: Float64 = (np.log1p(off) * weights).sum(1) / np.maximum(weights.sum(1), 1e-6)
        return out

    def _at(self, places: Float64) -> Float64:
        """[D, N, 2] pixels between the course's grid places."""
        low = np.floor(places).astype(np.int64)
        share = (places - low)[:, None, None]
        out: Float64 = (1 - share) * self._pixels[low] + share * self._pixels[low + 1]
        return out


def _texture(image: UInt8) -> Float32:
    """[H, W] 0 to 1: how well flow can be measured."""
    across, along = (cv2.Sobel(image, cv2.CV_32F, dx, 1 - dx, scale=1 / 8) for dx in (1, 0))
    slope = cv2.GaussianBlur(np.hypot(across, along), (0, 0), 1.5)
    out: Float32 = (slope**2 / (slope**2 + TEXTURE**2)).astype(np.float32)
    return out


def _course(joints: JointCourse) -> _Course:
    surface = arm_surface(joints.arm.capsules, ALONG, AROUND)
    poses = joints.links(np.arange(0.0, joints.end_s, STEP_S))[:, surface.links]
    turned = np.einsum("gnij,nj->gni", poses[..., :3, :3], surface.normals)
    placed = np.einsum("gnij,nj->gni", poses[..., :3, :3], surface.points) + poses[..., :3, 3]
    return _Course(joints.start, placed.astype(np.float32), turned.astype(np.float32))
