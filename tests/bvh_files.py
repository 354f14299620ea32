"""A small motion capture file that tests of several rooms read."""

from __future__ import annotations

from pathlib import Path

ONE_ARM = """HIERARCHY
ROOT Hips
{
  OFFSET 9 9 9
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  JOINT RightArm
  {
    OFFSET 0 10 0
    CHANNELS 3 Zrotation Xrotation Yrotation
    End Site
    {
      OFFSET 5 0 0
    }
  }
}
MOTION
Frames: 2
Frame Time: 0.05
0 80 0 0 0 0 0 0 0
1 80 0 90 0 0 0 0 90
"""


def written(folder: Path, text: str) -> Path:
    """Path of `text` as a file in `folder`."""
    path = folder / "motion.bvh"
    path.write_text(text)
    return path
