"""What is known of a path before anything is read from it or written to it."""

from __future__ import annotations

import errno
from pathlib import Path

_NOTHING = (errno.ENOENT, errno.ENOTDIR, errno.EBADF, errno.ELOOP)


def is_there(path: Path) -> bool:
    """Whether something is there. Raises `OSError` where nobody may look, or no file can have such a name.

    `Path.exists` does the same before Python 3.14, and calls that nothing from then on.
    """
    try:
        path.stat()
    except OSError as error:
        if error.errno in _NOTHING:
            return False
        raise
    except ValueError:  # a null byte in its name
        return False
    return True
