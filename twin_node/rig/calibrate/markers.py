"""Markers of calibration targets, by OpenCV's dictionaries."""

from __future__ import annotations

from typing import Protocol

import cv2

from twin_node.rig.errors import RigError


class Marked(Protocol):
    """A target with markers."""

    @property
    def dictionary(self) -> str:
        """OpenCV's name of the dictionary that they are of."""

    @property
    def markers(self) -> int:
        """How many it has."""


def marker_dictionary(name: str) -> cv2.aruco.Dictionary:
    """OpenCV's predefined dictionary of that name. Raises `RigError` for an unknown one."""
    number = getattr(cv2.aruco, name, None)
    if not name.startswith("DICT_") or not isinstance(number, int):
        raise RigError(f"marker dictionary: expected one of OpenCV's names (DICT_4X4_50, ...), found {name!r}")
    return cv2.aruco.getPredefinedDictionary(number)


def dictionary_of(board: Marked) -> cv2.aruco.Dictionary:
    """The dictionary of a board's markers. Raises `RigError` for an unknown one, and for one that has too few."""
    dictionary = marker_dictionary(board.dictionary)
    most = len(dictionary.bytesList)
    if board.markers > most:
        raise RigError(
            f"board: expected at most {most} markers, as many as {board.dictionary} has, found {board.markers}; use a "
            "larger dictionary, for example DICT_4X4_250"
        )
    return dictionary
