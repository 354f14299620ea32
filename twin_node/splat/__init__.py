"""Draws 3D Gaussians and differentiates the images: gsplat's semantics on a CPU, gsplat itself on CUDA."""

from twin_node.splat.adam import AdamState, Bounds, Decays, adam_step
from twin_node.splat.arguments import RasterMeta
from twin_node.splat.dispatch import can_descend, descend, rasterize, rasterize_reference
from twin_node.splat.errors import SplatError
from twin_node.splat.first_calls import settle
from twin_node.splat.learning import Aims, Bystanders, Course, Descended, Learners
from twin_node.splat.library import has_kernels
from twin_node.splat.loss import image_loss, image_loss_reference
from twin_node.splat.missed import Missed, MissedReference, Pull, Sight, Tolerance
from twin_node.splat.placing import Placed, place
from twin_node.splat.still import Shot, draw_still, draw_still_reference, weigh, weigh_reference

__all__ = [
    "AdamState",
    "Aims",
    "Bounds",
    "Bystanders",
    "Course",
    "Decays",
    "Descended",
    "Learners",
    "Missed",
    "MissedReference",
    "Placed",
    "Pull",
    "RasterMeta",
    "Shot",
    "Sight",
    "SplatError",
    "Tolerance",
    "adam_step",
    "can_descend",
    "descend",
    "draw_still",
    "draw_still_reference",
    "has_kernels",
    "image_loss",
    "image_loss_reference",
    "place",
    "rasterize",
    "rasterize_reference",
    "weigh",
    "weigh_reference",
]

settle()
