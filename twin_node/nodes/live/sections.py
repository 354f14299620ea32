"""Parameters as launch files hold them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

Sections = Mapping[str, Mapping[str, Any]]
"""Node name -> its `ros__parameters`; `/**` holds those of every node that knows them."""
