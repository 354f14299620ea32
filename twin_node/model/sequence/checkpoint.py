"""Checkpoints in safetensors: all that a model needs to be drawn, and all that training needs to go on exactly."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor, nn

from twin_node.model.parameters import ModelError
from twin_node.model.ply import StoredGaussians
from twin_node.model.sequence.canonical import MOMENTS, CanonicalGaussians
from twin_node.model.sequence.densify import PositionGradients
from twin_node.model.sequence.field import Box
from twin_node.model.sequence.parameters import TrainParameters
from twin_node.model.sequence.recording import Recording
from twin_node.model.sequence.sequence_model import SequenceModel, Span
from twin_node.model.sequence.tensor_file import (
    camera_from_record,
    camera_record,
    colour_from_record,
    read_tensors,
    write_tensors,
)
from twin_node.model.sequence.trainer import Trainer, make_field
from twin_node.runtime.parameters import fill
from twin_node.scene import Camera

FORMAT = "twin_node sequence"
VERSION = 1
HOMES = "edit.homes"
"""`SequenceModel.homes`, the mark of a checkpoint that was edited."""


@dataclass(frozen=True)
class CheckpointHeader:
    """What a checkpoint says beside its tensors."""

    parameters: TrainParameters
    step: int
    """Steps taken."""
    span: Span
    stamps: tuple[int, ...]
    """Of the training images, distinct and rising, ns."""
    steps: int
    """Time steps that the field was made for."""
    background: tuple[float, float, float]
    cameras: tuple[Camera, ...]
    """Those of the training images, one per name."""
    images: int
    """Training images."""


@dataclass(frozen=True)
class Checkpoint:
    """A checkpoint as read."""

    path: Path
    header: CheckpointHeader
    tensors: Mapping[str, Tensor]

    @property
    def model(self) -> SequenceModel:
        """The model, ready to be drawn."""
        header = self.header
        field = make_field(self.box, header.steps, header.parameters)
        if isinstance(field, nn.Module):
            _load_field(field, self._part("field."))
        gaussians = CanonicalGaussians(self.stored, header.parameters.rates, 1.0, torch.device("cpu"))
        return SequenceModel(gaussians, field, header.span, header.background, self.tensors.get(HOMES))

    @property
    def is_whole(self) -> bool:
        """Whether all tensors are there, of the shapes that belong together, and numbers."""
        count, harmonics = len(self.tensors.get("gaussians.means", ())), (self.header.parameters.degree + 1) ** 2
        own = {"means": (count, 3), "quats": (count, 4), "log_scales": (count, 3), "logits": (count,)}
        learnt = own | {"colours": (count, 1, 3), "harmonics": (count, harmonics - 1, 3)}
        needed = {f"gaussians.{name}": shape for name, shape in (own | {"sh": (count, harmonics, 3)}).items()}
        needed |= {"gradients.sums": (count,), "gradients.counts": (count,), "box.lower": (3,), "box.upper": (3,)}
        needed |= {HOMES: (count, 3)} if HOMES in self.tensors else {}
        if any(name not in self.tensors or self.tensors[name].shape != shape for name, shape in needed.items()):
            return False
        if any(bool(value.isnan().any()) for value in self.tensors.values()):
            return False
        try:
            field = make_field(self.box, self.header.steps, self.header.parameters)
        except (ArithmeticError, RuntimeError, TypeError, ValueError):
            return False  # no field has such sizes, or there is no memory for them
        expected: Mapping[str, Tensor] = {}
        of_field: list[nn.Parameter] = []
        if isinstance(field, nn.Module):
            expected = field.state_dict()
            of_field = [*field.grids(), *field.decoder()]  # in the order of the trainer's optimizer
        return (
            _shapes(expected) == _shapes(self._part("field."))
            and _are_states(self._part("adam."), learnt)
            and _are_states(self._part("field_adam."), {str(at): tuple(one.shape) for at, one in enumerate(of_field)})
        )

    @property
    def stored(self) -> StoredGaussians:
        """The canonical Gaussians."""
        names = (field.name for field in dataclasses.fields(StoredGaussians))
        return StoredGaussians(*(self.tensors[f"gaussians.{name}"].numpy() for name in names))

    @property
    def box(self) -> Box:
        """What the field spans."""
        return Box(self.tensors["box.lower"], self.tensors["box.upper"])

    def continued(self, steps: int | None = None, device: str | None = None) -> TrainParameters:
        """What training goes on by: with `steps` and on the `device` in place of the checkpoint's own.

        Raises `ModelError` for fewer steps than were taken, and for a checkpoint that was edited: its images do not
        show what it does.
        """
        if HOMES in self.tensors:
            raise ModelError(f"{self.path}: was edited; go on from the checkpoint that it was made of, and edit again")
        parameters = self.header.parameters
        if steps is not None:
            share = parameters.coarse_steps / steps  # the static stage stays as long as it was
            parameters = dataclasses.replace(parameters, steps=steps, coarse_share=share)
        if parameters.all_steps < self.header.step:
            taken = self.header.step - parameters.coarse_steps
            raise ModelError(
                f"{self.path}: expected {taken} steps or more, for it has taken so many, found {steps}; give more, or "
                "begin anew for fewer"
            )
        return parameters if device is None else dataclasses.replace(parameters, device=device)

    def resume(self, recording: Recording, steps: int | None = None, device: str | None = None) -> Trainer:
        """The trainer as it was when it was saved; with `steps` and on the `device` in place of the checkpoint's own.

        Raises `ModelError` where the recording is not the one that was trained on, for a device that is not there, and
        as `continued` does.
        """
        header, parameters = self.header, self.continued(steps, device)
        found = tuple(sorted({view.stamp for view in recording.train}))
        if len(recording.train) != header.images or found != header.stamps:
            raise ModelError(
                f"{self.path}: expected the recording that it was trained on ({header.images} images at "
                f"{len(header.stamps)} stamps), found {len(recording.train)} at {len(found)} in {recording.name}; "
                "give the same data, --hold-out and --frames"
            )
        self._check_cameras(recording)
        trainer = Trainer(recording, parameters, self.stored, self.box)
        trainer.step = header.step
        trainer.model.gaussians.restore(self._part("adam."))
        there = trainer.model.gaussians.means.device
        trainer.gradients = PositionGradients(len(trainer.model.gaussians), there)
        trainer.gradients.sums += self.tensors["gradients.sums"].to(there)
        trainer.gradients.counts += self.tensors["gradients.counts"].to(there)
        if isinstance(trainer.model.field, nn.Module) and trainer.field_optimizer is not None:
            _load_field(trainer.model.field, self._part("field."))
            _restore_adam(trainer.field_optimizer, self._part("field_adam."))
        return trainer

    def _check_cameras(self, recording: Recording) -> None:
        """Raises `ModelError` where the recording's images are of other cameras than those that were trained on."""
        expected, found = ({camera.name: camera for camera in one.cameras} for one in (self.header, recording))
        for name in (*expected, *found):
            if name not in expected or name not in found:
                raise ModelError(
                    f"{self.path}: expected images of {_some(expected)}, as it was trained on, found {_some(found)} in "
                    f"{recording.name}; give the same data and --hold-out"
                )
            one, other = expected[name], found[name]
            if (one.width, one.height) != (other.width, other.height):
                raise ModelError(
                    f"{self.path}: expected images of {one.width}x{one.height} of {name}, as it was trained on, found "
                    f"{other.width}x{other.height}; give the same --width"
                )
            if camera_record(one) != camera_record(other):
                raise ModelError(
                    f"{self.path}: expected {name} calibrated as it was trained on, found another pose or lens in "
                    f"{recording.name}; give the same data and --rig"
                )

    def _part(self, prefix: str) -> dict[str, Tensor]:
        return {name.removeprefix(prefix): value for name, value in self.tensors.items() if name.startswith(prefix)}


def save_checkpoint(trainer: Trainer, path: Path) -> None:
    """Writes a trainer's state, whole or not at all. Raises `ModelError` where it cannot be written."""
    model, recording = trainer.model, trainer.recording
    tensors = {f"gaussians.{name}": torch.from_numpy(value) for name, value in vars(model.gaussians.stored()).items()}
    tensors |= {f"adam.{name}": value for name, value in model.gaussians.states()}
    tensors |= {"gradients.sums": trainer.gradients.sums, "gradients.counts": trainer.gradients.counts}
    tensors |= {"box.lower": trainer.box.lower, "box.upper": trainer.box.upper}
    if isinstance(model.field, nn.Module):
        tensors |= {f"field.{name}": value for name, value in model.field.state_dict().items()}
    if trainer.field_optimizer is not None:
        for index, state in trainer.field_optimizer.state_dict()["state"].items():
            tensors |= {f"field_adam.{index}.{name}": value for name, value in state.items()}
    stamps = tuple(sorted({view.stamp for view in recording.train}))
    header = CheckpointHeader(
        trainer.parameters,
        trainer.step,
        model.span,
        stamps,
        recording.steps,
        recording.background,
        recording.cameras,
        len(recording.train),
    )
    write_checkpoint(Checkpoint(path, header, tensors))


def write_checkpoint(checkpoint: Checkpoint) -> None:
    """Writes a checkpoint to its path, whole or not at all. Raises `ModelError` where it cannot be written."""
    header = checkpoint.header
    record = vars(header) | {
        "parameters": dataclasses.asdict(header.parameters),
        "span": [header.span.first, header.span.last],
        "cameras": [camera_record(camera) for camera in header.cameras],
    }
    metadata = {"format": FORMAT, "version": str(VERSION), "header": json.dumps(record)}
    write_tensors(checkpoint.tensors, metadata, checkpoint.path)


def load_checkpoint(path: Path) -> Checkpoint:
    """Reads a checkpoint. Raises `ModelError` for a file that is none, is damaged, or is of another version."""
    file = read_tensors(path)
    metadata = file.metadata
    if metadata.get("format") != FORMAT or metadata.get("version") != str(VERSION):
        found = f"{metadata.get('format', 'another kind of file')}, version {metadata.get('version', 'unknown')}"
        raise ModelError(
            f"{path}: expected a checkpoint of twin_node train, version {VERSION}, found {found}; give the checkpoint "
            "(of what 'twin_node bake' has made 'twin_node import model' makes a log, which exports), or train it anew"
        )
    try:
        header = json.loads(metadata["header"])
        if int(header["steps"]) < 1:
            raise ValueError(f"steps: {header['steps']}")
        parsed = CheckpointHeader(
            fill(TrainParameters, header["parameters"], str(path)),
            int(header["step"]),
            Span(*(int(stamp) for stamp in header["span"])),
            tuple(int(stamp) for stamp in header["stamps"]),
            int(header["steps"]),
            colour_from_record(header["background"]),
            tuple(camera_from_record(record) for record in header["cameras"]),
            int(header["images"]),
        )
    except (AttributeError, KeyError, OverflowError, TypeError, ValueError) as error:
        raise ModelError(f"{path}: the checkpoint's header is damaged ({error}); train again") from None
    checkpoint = Checkpoint(path, parsed, file.tensors)
    try:
        is_whole = checkpoint.is_whole
    except ModelError as error:
        raise ModelError(f"{path}: {error}") from None
    if not is_whole:
        raise ModelError(f"{path}: the checkpoint's tensors are not those of its header; train again")
    return checkpoint


def _some(names: Iterable[str]) -> str:
    """The first names of many."""
    first = sorted(names)
    return ", ".join(first[:4]) + (", ..." if len(first) > 4 else "")


def _shapes(tensors: Mapping[str, Tensor]) -> dict[str, torch.Size]:
    return {name: value.shape for name, value in tensors.items()}


def _are_states(tensors: Mapping[str, Tensor], of: Mapping[str, tuple[int, ...]]) -> bool:
    """Whether tensors are Adam's states of what has these shapes: all of a state, or none before its first step."""
    expected: dict[str, torch.Size] = {}
    for name, shape in of.items():
        if any(key.startswith(f"{name}.") for key in tensors):
            expected |= {f"{name}.step": torch.Size([])}
            expected |= {f"{name}.{moment}": torch.Size(shape) for moment in MOMENTS}
    return _shapes(tensors) == expected


def _load_field(field: nn.Module, tensors: Mapping[str, Tensor]) -> None:
    field.load_state_dict(dict(tensors))


def _restore_adam(optimizer: torch.optim.Adam, tensors: Mapping[str, Tensor]) -> None:
    parameters = [parameter for group in optimizer.param_groups for parameter in group["params"]]
    for name, value in tensors.items():
        index, key = name.split(".")
        parameter = parameters[int(index)]
        optimizer.state[parameter][key] = value.to(parameter.device)
