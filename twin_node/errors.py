"""The one base of every error that a user's input can cause, and the words of its messages."""

from __future__ import annotations

import datetime

_KINDS: dict[type, str] = {
    str: "text",
    bool: "true or false",
    int: "a whole number",
    float: "a number",
    list: "a list",
    tuple: "a list",
    dict: "a mapping",
    set: "a set",
    bytes: "bytes",
    datetime.date: "a date",
    datetime.datetime: "a date",
    type(None): "nothing",
}


MOST_SIGNS = 300
"""Of a value in a file: what is repeated to the user, enough for any 4x4 matrix of one's own."""


class TwinError(Exception):
    """Something given to the twin is wrong.

    The message is one line that names the thing, what was expected, what was found and what to do. Each room raises its
    own subclass; the command line prints the message and ends with status 2.
    """


class TwinWarning(UserWarning):
    """Something that a user must know, in one line, of work that goes on all the same; the command line prints it."""


def reason(error: Exception) -> str:
    """Why a file could not be read, in one line, without Python's numbers and names."""
    if isinstance(error, UnicodeDecodeError):
        return "what is no text"
    if isinstance(error, RecursionError):
        return "too many levels, one within the other"
    return getattr(error, "strerror", None) or " ".join(str(error).split())


def kind_in_words(kind: type) -> str:
    """What a type of YAML or JSON is to who writes such files."""
    return _KINDS.get(kind, "something else")


def kind_of(value: object) -> str:
    """What a value in a file is, in words: "expected a list, found text"."""
    return "an empty list" if value == [] else kind_in_words(type(value))


def told(value: object) -> str:
    """A value in a file: text and numbers themselves, of anything else what it is."""
    return repeated(value) if isinstance(value, str | int | float) else kind_of(value)


def repeated(value: object) -> str:
    """A value in a file itself, cut short where it is longer than anybody reads."""
    try:
        text = repr(value)
    except ValueError:  # in hexadecimal, numbers may be longer than Python says in decimal
        return "a number of thousands of digits"
    return text if len(text) <= MOST_SIGNS else f"{text[:MOST_SIGNS]} ..."


def several(count: int, what: str) -> str:
    """So many of something: 1 set, 2 sets."""
    return f"{count} {what}" if count == 1 else f"{count} {what}s"
