"""What can go wrong with images, stamps and calibration: each a pure function of a shot, a level and a generator.

A function gives the set that the twin gets in place of the shot's, or None where the set is lost. The generator comes
from the run's seed and the set's number alone.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np

from twin_node.bench.stability.scenes import ONSET_S, RATE_HZ
from twin_node.bench.stability.shots import Shot
from twin_node.geometry import transform
from twin_node.model.rays import back_project
from twin_node.scene import Bool, Float32, FrameSet, UInt8, View

Perturbation = Callable[[Shot, float, np.random.Generator], "FrameSet | None"]

BANDS = 8
"""Strips of an image that a rolling shutter is made of."""
HOLE_SHARE = 1 / 16
"""Size of a depth hole as a share of the image's width: stereo loses patches, not pixels."""
MIRRORED_M = 0.4
"""How far behind a mirror stereo sees what it reflects, m."""
SHADOW_M = 0.35
"""Radius of the shadow's core, m; it fades out over half as much again."""


def untouched(shot: Shot, level: float, rng: np.random.Generator) -> FrameSet | None:
    """The set as it is: what goes wrong is in the scene."""
    return shot.frames


def each(shot: Shot, change: Callable[[View], View]) -> FrameSet:
    """The set with every view changed."""
    return with_views(shot.frames, tuple(change(view) for view in shot.frames.views))


def with_views(frames: FrameSet, views: tuple[View, ...]) -> FrameSet:
    """The set with other views: its stamp is that of the newest."""
    return replace(frames, views=views, stamp=max(view.stamp for view in views))


def lit(rgb: UInt8, gain: float | Float32) -> UInt8:
    """An image [H, W, 3] times a gain, a number or [H, W, 1]."""
    brighter: UInt8 = np.clip(rgb * np.float32(gain) + 0.5, 0, 255).astype(np.uint8)
    return brighter


def lights_switched(shot: Shot, level: float, rng: np.random.Generator) -> FrameSet | None:
    """The share `level` of the light goes out at the onset, and comes back a second later."""
    dark = ONSET_S <= shot.seconds < ONSET_S + 1
    return each(shot, lambda view: replace(view, rgb=lit(view.rgb, 1 - level if dark else 1.0)))


def flicker(shot: Shot, level: float, rng: np.random.Generator) -> FrameSet | None:
    """Lamps at the mains' frequency, and a shutter that catches any part of the wave: brightness within +- `level`."""
    gain = 1 + level * float(np.sin(rng.uniform(0, 2 * np.pi)))
    return each(shot, lambda view: replace(view, rgb=lit(view.rgb, gain)))


def exposure_hunting(shot: Shot, level: float, rng: np.random.Generator) -> FrameSet | None:
    """Every camera's exposure swings by +- `level` stops, 1.5 times a second, each by itself."""
    phases = {view.camera.name: index for index, view in enumerate(shot.frames.views)}

    def change(view: View) -> View:
        swing = np.sin(2 * np.pi * 1.5 * max(shot.seconds - RATE_HZ**-1, 0) + 2.1 * phases[view.camera.name])
        return replace(view, rgb=lit(view.rgb, float(2 ** (level * swing))))

    return each(shot, change)


def moving_shadow(shot: Shot, level: float, rng: np.random.Generator) -> FrameSet | None:
    """A soft round shadow wanders over the table at 0.6 m/s and takes the share `level` of the light."""
    if shot.seconds < ONSET_S / 2:
        return shot.frames
    y = -1.0 + 0.6 * (shot.seconds - ONSET_S / 2) % 2.0
    centre = np.array([0.55, y])

    def change(view: View) -> View:
        points = back_project(view.camera, shot.exact[view.camera.name].depth)
        off = np.linalg.norm(points[..., :2] - centre, axis=-1)
        share = np.clip((1.5 * SHADOW_M - off) / (0.5 * SHADOW_M), 0, 1) * (points[..., 2] < 0.6)
        return replace(view, rgb=lit(view.rgb, (1 - level * share[..., None]).astype(np.float32)))

    return each(shot, change)


def image_noise(shot: Shot, level: float, rng: np.random.Generator) -> FrameSet | None:
    """Colour noise of 1 sigma `level`, of 255 levels."""

    def change(view: View) -> View:
        noisy = view.rgb + level * rng.standard_normal(view.rgb.shape, dtype=np.float32)
        return replace(view, rgb=np.clip(noisy, 0, 255).astype(np.uint8))

    return each(shot, change)


def noise_rises(shot: Shot, level: float, rng: np.random.Generator) -> FrameSet | None:
    """From the onset on colour noise of 1 sigma `level`, of 255 levels: the light goes out, and the gain goes up."""
    return image_noise(shot, level, rng) if shot.seconds >= ONSET_S else shot.frames


def noise_only(shot: Shot, level: float, rng: np.random.Generator) -> FrameSet | None:
    """From the onset on the share `level` of every image is noise; at 1 nothing else is left, of the depth neither."""
    if shot.seconds < ONSET_S:
        return shot.frames

    def change(view: View) -> View:
        noise = rng.integers(0, 256, view.rgb.shape).astype(np.float32)
        depth = None if view.depth is None else np.where(rng.random(view.depth.shape) < level, 0, view.depth)
        rgb = ((1 - level) * view.rgb + level * noise).astype(np.uint8)
        return replace(view, rgb=rgb, depth=None if depth is None else depth.astype(np.float32))

    return each(shot, change)


def black_frames(shot: Shot, level: float, rng: np.random.Generator) -> FrameSet | None:
    """`level` of the rig's sets in a row are black in all cameras, depth and all, from the onset on."""
    first = round(ONSET_S * RATE_HZ)  # by their number: a set's stamp is that of its last camera, up to a period later
    if not first <= shot.frames.sequence < first + level:
        return shot.frames

    def change(view: View) -> View:
        depth = None if view.depth is None else np.zeros_like(view.depth)
        return replace(view, rgb=np.zeros_like(view.rgb), depth=depth)

    return each(shot, change)


def depth_holes(shot: Shot, level: float, rng: np.random.Generator) -> FrameSet | None:
    """Patches of the depth are missing, the share `level` of the image in all."""

    def change(view: View) -> View:
        if view.depth is None:
            return view
        return replace(view, depth=np.where(_patches(view, level, rng), 0, view.depth).astype(np.float32))

    return each(shot, change)


def _patches(view: View, share: float, rng: np.random.Generator) -> Bool:
    """[H, W] the given share of the pixels, in patches."""
    height, width = view.rgb.shape[:2]
    patch = max(1, round(width * HOLE_SHARE))
    coarse = rng.random((-(-height // patch), -(-width // patch)), dtype=np.float32)
    fine = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_NEAREST)
    return np.asarray(fine < share)


def reflective(shot: Shot, level: float, rng: np.random.Generator) -> FrameSet | None:
    """What moves is a mirror by the share `level`: it shows the image turned about, at the depth of its reflection."""
    owners = shot.rig.world.moving_owners

    def change(view: View) -> View:
        mirror = shot.exact[view.camera.name].shows(owners)
        blend = np.where(mirror, np.float32(level), np.float32(0))[..., None]
        rgb = (1 - blend) * view.rgb + blend * view.rgb[:, ::-1]
        if view.depth is None:
            return replace(view, rgb=rgb.astype(np.uint8))
        wrong = mirror & (rng.random(mirror.shape) < level)
        depth = np.where(wrong & (view.depth > 0), view.depth + MIRRORED_M, view.depth).astype(np.float32)
        return replace(view, rgb=rgb.astype(np.uint8), depth=depth)

    return each(shot, change)


def rolling_shutter(shot: Shot, level: float, rng: np.random.Generator) -> FrameSet | None:
    """The last row is read out `level` ms after the first; the stamp tells the middle."""

    def change(view: View) -> View:
        rgb = view.rgb.copy()
        edges = np.linspace(0, len(rgb), BANDS + 1).astype(int)
        for index, (top, bottom) in enumerate(itertools.pairwise(edges)):
            late_ms = level * ((index + 0.5) / BANDS - 0.5)
            rgb[top:bottom] = shot.seen_at(view.camera.name, view.stamp + round(late_ms * 1e6))[top:bottom]
        return replace(view, rgb=rgb)

    return each(shot, change)


def stamp_jitter(shot: Shot, level: float, rng: np.random.Generator) -> FrameSet | None:
    """Every stamp is off by up to +- `level` ms, evenly."""
    return each(shot, lambda view: replace(view, stamp=view.stamp + round(1e6 * rng.uniform(-level, level))))


def wrong_clock(shot: Shot, level: float, rng: np.random.Generator) -> FrameSet | None:
    """The scene's last camera looks `level` ms late (the scene sees to that) and says nothing of it."""
    *others, last = shot.frames.views
    return with_views(shot.frames, (*others, replace(last, stamp=last.stamp - round(level * 1e6))))


def dropped_frames(shot: Shot, level: float, rng: np.random.Generator) -> FrameSet | None:
    """Every camera loses the share `level` of its images; the first set comes whole."""
    kept = tuple(view for view in shot.frames.views if shot.frames.sequence == 0 or rng.random() >= level)
    return with_views(shot.frames, kept) if kept else None


def dead_cameras(shot: Shot, level: float, rng: np.random.Generator) -> FrameSet | None:
    """From the onset on `level` cameras send nothing."""
    dead = 0 if shot.seconds < ONSET_S else int(level)
    kept = shot.frames.views[dead:]
    return with_views(shot.frames, kept) if kept else None


def calibration_error(shot: Shot, level: float, rng: np.random.Generator) -> FrameSet | None:
    """The first camera stands `level` mm beside where it is said to stand."""
    first, *others = shot.frames.views
    T = first.camera.T_base_cam.copy()
    T[:3, 3] = transform(T, np.array([[1e-3 * level, 0.0, 0.0]]))[0]
    return with_views(shot.frames, (replace(first, camera=replace(first.camera, T_base_cam=T)), *others))
