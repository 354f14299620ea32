"""The one base of every error that a user's input can cause."""


class TwinError(Exception):
    """Something given to the twin is wrong.

    The message is one line that names the thing, what was expected, what was found and what to do. Each room raises its
    own subclass; the command line prints the message and ends with status 2.
    """


def reason(error: Exception) -> str:
    """Why a file could not be read, in one line, without Python's numbers and names."""
    if isinstance(error, UnicodeDecodeError):
        return "what is no text"
    return getattr(error, "strerror", None) or " ".join(str(error).split())
