"""How many files a process may have open: a recording of many hours has more than it may by default."""

from __future__ import annotations

import errno
import os
from pathlib import Path

SPARE = 512
"""Files, pipes and connections that a process may want later."""


def make_room(files: int) -> None:
    """Lets this process open so many files more, as far as the system allows it: by default it may a thousand."""
    if os.name != "posix":
        return
    import resource

    wanted = len(list(Path("/dev/fd").iterdir())) + files + SPARE
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft == resource.RLIM_INFINITY or wanted <= soft:
        return
    most = wanted if hard == resource.RLIM_INFINITY else min(wanted, hard)
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, hard))


def advice(error: OSError) -> str:
    """What to do where a log cannot be read."""
    if error.errno in (errno.EMFILE, errno.ENFILE):
        return "let a process have as many files open as the log has (ulimit -n), or give them one by one"
    return "check the path and its permissions"
