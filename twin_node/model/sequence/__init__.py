"""Whole sequences: readers, fields and training of 4DGS as published, checkpoints, and playback without the field."""

from twin_node.model.sequence.baking import Baked, bake_clouds, bake_model, check_size, is_baked, load_baked, save_baked
from twin_node.model.sequence.checkpoint import Checkpoint, load_checkpoint, save_checkpoint, write_checkpoint
from twin_node.model.sequence.editing import Edit, edited
from twin_node.model.sequence.field import Box, SequenceField, SequenceMotion
from twin_node.model.sequence.hash_mlp import HashParameters, SequenceHashMlp
from twin_node.model.sequence.hex_plane import HexPlaneParameters, SequenceHexPlane
from twin_node.model.sequence.parameters import METHODS, DensifyParameters, RateParameters, TrainParameters
from twin_node.model.sequence.readers import ReadOptions, read_folder
from twin_node.model.sequence.recording import ColouredPoints, Recording, recording_of, split
from twin_node.model.sequence.sequence_model import SequenceModel, Span
from twin_node.model.sequence.tensor_file import SUFFIX
from twin_node.model.sequence.trainer import Trainer

__all__ = [
    "METHODS",
    "SUFFIX",
    "Baked",
    "Box",
    "Checkpoint",
    "ColouredPoints",
    "DensifyParameters",
    "Edit",
    "HashParameters",
    "HexPlaneParameters",
    "RateParameters",
    "ReadOptions",
    "Recording",
    "SequenceField",
    "SequenceHashMlp",
    "SequenceHexPlane",
    "SequenceModel",
    "SequenceMotion",
    "Span",
    "TrainParameters",
    "Trainer",
    "bake_clouds",
    "bake_model",
    "check_size",
    "edited",
    "is_baked",
    "load_baked",
    "load_checkpoint",
    "read_folder",
    "recording_of",
    "save_baked",
    "save_checkpoint",
    "split",
    "write_checkpoint",
]
