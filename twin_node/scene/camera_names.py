"""Names of cameras: topics are named after them, and told by them."""

from __future__ import annotations

import re

_NAME = re.compile(r"[A-Za-z]\w*", re.ASCII)
_TAKEN = "depth"
"""Images on topics with this in their names are taken for depth."""
NAME_WANTED = f"a name of letters, digits and _ that starts with a letter and does not contain '{_TAKEN}'"
"""What `is_camera_name` asks for, in words."""


def is_camera_name(name: str) -> bool:
    """Whether `/NAME/image_raw` can be a topic, and is told to be of a camera `name` that sees colour."""
    return _NAME.fullmatch(name) is not None and _TAKEN not in name


def as_camera_name(text: str) -> str:
    """Any text as a camera's name, as like it as may be."""
    name = re.sub(r"\W+", "_", text, flags=re.ASCII).strip("_").replace(_TAKEN, "range")
    return name if name[:1].isalpha() else f"cam_{name}"
