"""Views that are decoded before their set is whole are kept no longer than that may come."""

from __future__ import annotations

from functools import partial

import numpy as np

from twin_node.nodes.depth_pairs import EncodedView
from twin_node.nodes.early import KEPT, EarlyViews
from twin_node.scene import Camera, View
from twin_node.side_thread import Task


def test_views_whose_sets_never_come_are_let_go() -> None:
    early = EarlyViews(["cam"])
    camera = Camera("cam", 16, 12, np.eye(3), np.eye(4))
    views = [View(camera, stamp, np.zeros((12, 16, 3), np.uint8), None) for stamp in range(2 * KEPT)]
    image = EncodedView(None, None)
    for view in views:
        early.keep("cam", view.stamp, image, Task(partial(lambda view: view, view)))
    kept = [early.get("cam", view.stamp, image) for view in views]
    assert [of is not None and of.result() is view for of, view in zip(kept, views, strict=True)] == [False] * KEPT + [
        True
    ] * KEPT
    early.pass_set(2 * KEPT - 1, [("cam", 2 * KEPT - 2)])
    assert early.get("cam", 2 * KEPT - 2, image) is None and early.get("cam", 2 * KEPT - 1, image) is kept[-1]
    assert early.set_of("cam", 2 * KEPT - 2) is None and early.set_of("cam", 100) == 101


def test_a_view_is_that_of_its_image_alone() -> None:
    """Two images of a camera may have one stamp; which of them is in the set the synchroniser decides."""
    early, image, other = EarlyViews(["cam"]), EncodedView("image", None), EncodedView("another", None)
    view = Task(lambda: View(Camera("cam", 16, 12, np.eye(3), np.eye(4)), 1, np.zeros((12, 16, 3), np.uint8), None))
    early.keep("cam", 1, image, view)
    assert (early.get("cam", 1, image), early.get("cam", 1, other)) == (view, None)
