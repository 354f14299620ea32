"""Pictures of a report."""

from __future__ import annotations

import numpy as np

from twin_node.nodes.report.pictures import camera_column, table
from twin_node.scene import Float32


def grey(rows: int, level: float) -> Float32:
    return np.full((rows, 16, 3), level, np.float32)


def test_rows_are_in_line_where_cameras_are_not_of_one_size() -> None:
    columns = [camera_column(grey(rows, 0.2), grey(rows, 0.4), None) for rows in (12, 9)]
    picture = table(columns)
    (tall, wide, _), (short, *_) = (column[0].shape for column in columns)
    assert picture.shape[:2] == (3 * tall, 2 * wide + 6)
    for index, level in enumerate((0.2, 0.4, 0.2)):
        row = picture[index * tall : (index + 1) * tall]
        for drawn in (row[:, :wide], row[:short, wide + 6 :]):
            assert (drawn == round(255 * level)).all()
        assert (row[short:, wide + 6 :] == 255).all() and (row[:, wide : wide + 6] == 255).all()
