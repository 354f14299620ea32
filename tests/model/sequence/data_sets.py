"""The same tiny scene in every published layout, written by its rules."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
from model_scenes import rig, sliding

from twin_node.geometry import quat_from_rotation
from twin_node.scene import FrameSet

WIDTH, HEIGHT, FRAMES = 48, 36, 4
CAMERAS = rig(WIDTH, HEIGHT)


def scene() -> list[FrameSet]:
    return sliding(FRAMES, CAMERAS, still=0)


def write_image(path: Path, rgb: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR))


def neural_video(folder: Path) -> Path:
    """poses_bounds.npy in LLFF's axes (down, right, back) and one video per camera."""
    rows = []
    for index, camera in enumerate(CAMERAS):
        right, down, forward, position = camera.T_base_cam[:3].T
        hwf = np.array([HEIGHT, WIDTH, camera.K[0, 0]])
        rows.append([*np.stack([down, right, -forward, position, hwf], 1).ravel(), 0.1, 10.0])
        writer = cv2.VideoWriter(
            str(folder / f"cam{index:02d}.mp4"), cv2.VideoWriter.fourcc(*"mp4v"), 25.0, (WIDTH, HEIGHT)
        )
        assert writer.isOpened()
        for one in scene():
            writer.write(cv2.cvtColor(one.views[index].rgb, cv2.COLOR_RGB2BGR))
        writer.release()
    np.save(folder / "poses_bounds.npy", np.array(rows))
    return folder


def dnerf(folder: Path) -> Path:
    """Each image with a camera and a time of its own, OpenGL axes, transparent where the pixel is nearly black."""
    angle = 2 * np.arctan(WIDTH / 2 / CAMERAS[0].K[0, 0])
    for name, camera_of in (("train", lambda i: i % 3), ("test", lambda i: (i + 1) % 3)):
        frames = []
        for index, one in enumerate(scene()):
            view = one.views[camera_of(index)]
            pose = view.camera.T_base_cam.copy()
            pose[:, 1:3] *= -1
            file = f"./{name}/r_{index:03d}"
            frames.append({"file_path": file, "time": index / (FRAMES - 1), "transform_matrix": pose.tolist()})
            rgba = np.dstack([view.rgb, np.full(view.rgb.shape[:2], 255, np.uint8)])
            rgba[0, 0, 3] = 0
            (folder / name).mkdir(exist_ok=True)
            assert cv2.imwrite(str(folder / f"{file}.png"), cv2.cvtColor(rgba, cv2.COLOR_RGBA2BGRA))
        content = {"camera_angle_x": float(angle), "frames": frames}
        (folder / f"transforms_{name}.json").write_text(json.dumps(content))
    return folder


def colmap(folder: Path) -> Path:
    """A model in text with one image per camera, and a folder of images per camera."""
    model = folder / "sparse" / "0"
    model.mkdir(parents=True)
    K = CAMERAS[0].K
    cameras = [f"{i + 1} PINHOLE {WIDTH} {HEIGHT} {K[0, 0]} {K[1, 1]} {K[0, 2]} {K[1, 2]}" for i in range(len(CAMERAS))]
    (model / "cameras.txt").write_text("\n".join(cameras) + "\n")
    images = []
    for index, camera in enumerate(CAMERAS):
        q, t = quat_from_rotation(camera.viewmat[:3, :3]), camera.viewmat[:3, 3]
        images.append(f"{index + 1} {' '.join(map(repr, map(float, [*q, *t])))} {index + 1} {camera.name}.png\n\n")
        for step, one in enumerate(scene()):
            write_image(folder / "images" / camera.name / f"{step:04d}.png", one.views[index].rgb)
    (model / "images.txt").write_text("".join(images))
    (model / "points3D.txt").write_text("1 0.1 0.2 0.3 255 0 51 0.5\n2 -0.1 0.2 0.0 0 255 0 0.5\n")
    return folder


LAYOUTS = {"neural_video": neural_video, "dnerf": dnerf, "colmap": colmap}
