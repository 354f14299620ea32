"""Files of tensors (safetensors), and cameras in their headers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

from twin_node.model.parameters import ModelError
from twin_node.scene import Camera
from twin_node.unfinished import unwritable, whole_file

SUFFIX = ".safetensors"
"""What the names of checkpoints and baked models end in."""


def write_tensors(tensors: Mapping[str, Tensor], metadata: dict[str, str], path: Path) -> None:
    """A safetensors file, whole or not at all. Raises `ModelError` where it cannot be."""
    try:
        with whole_file(path, ModelError) as partial:
            mode = partial.stat().st_mode
            save_file(
                {name: value.detach().cpu().contiguous().clone() for name, value in tensors.items()}, partial, metadata
            )
            partial.chmod(mode)  # safetensors lets nobody else read what it writes
    except SafetensorError as error:
        raise ModelError(unwritable(path, error)) from None


@dataclass(frozen=True)
class TensorFile:
    """What a safetensors file holds."""

    metadata: Mapping[str, str]
    tensors: Mapping[str, Tensor]


def read_tensors(path: Path) -> TensorFile:
    """A whole safetensors file. Raises `ModelError` where it is none."""
    try:
        with safe_open(path, framework="pt") as file:
            return TensorFile(file.metadata() or {}, {name: file.get_tensor(name) for name in file.keys()})  # noqa: SIM118
    except (OSError, SafetensorError):
        found = "another kind of file, or a damaged one" if path.is_file() else "no file"
        raise ModelError(f"{path}: expected a safetensors file, found {found}") from None


def camera_record(camera: Camera) -> dict[str, Any]:
    """A camera as JSON."""
    return {**asdict(camera), "K": camera.K.tolist(), "T_base_cam": camera.T_base_cam.tolist()}


def camera_from_record(record: Mapping[str, Any]) -> Camera:
    """What `camera_record` was made of."""
    return Camera(**{**record, "K": np.array(record["K"]), "T_base_cam": np.array(record["T_base_cam"])})


def colour_from_record(record: Sequence[float]) -> tuple[float, float, float]:
    """Red, green and blue of a header."""
    red, green, blue = (float(value) for value in record)
    return red, green, blue
