"""Pictures of a report."""

from __future__ import annotations

import numpy as np

from twin_node.nodes.export.usd import linear
from twin_node.nodes.report.pictures import FORESEEN, MASK, TRUE, _broken, camera_column, outline, table
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


def test_curves_break_where_there_were_no_sets() -> None:
    """Over a pause of minutes they ran on, as if all that time had been measured."""
    seconds = np.array([0.0, 0.1, 0.2, 600.0, 600.1])
    times, values = _broken(seconds, np.array([1, 2, 3, 4, 5]))
    np.testing.assert_allclose(times, [0.0, 0.1, 0.2, 0.3, 600.0, 600.1])
    np.testing.assert_array_equal(values, [1, 2, 3, np.nan, 4, 5])


def test_curves_of_few_sets_a_second_do_not_break() -> None:
    for seconds in (np.arange(5) * 2.0, np.zeros(1), np.zeros(0)):
        assert not np.isnan(_broken(seconds, seconds)[1]).any()


def test_what_a_mask_leaves_out_in_its_midst_is_outlined() -> None:
    """Between a body and its bent arm nothing moves: there the picture looked as if all did."""
    mask = np.zeros((60, 60), np.bool_)
    mask[10:50, 10:50] = True
    mask[25:35, 25:35] = False
    drawn = (outline(np.zeros((60, 60, 3), np.uint8), mask, TRUE) == TRUE).all(2)
    assert drawn[24, 25:35].all() and drawn[10, 10:50].all()
    assert not drawn[13:22, 13:47].any() and not drawn[28:32, 28:32].any()


def test_outlines_are_told_from_grey_by_who_sees_no_green() -> None:
    """Machado, Oliveira & Fernandes 2009, deuteranopia: the moving masks' outline was the grey of the cell's floor."""
    seen = np.array([[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.01182, 0.04294, 0.968881]])
    for colour in (FORESEEN, TRUE, MASK):
        red, green, blue = (255 * np.clip(seen @ linear(np.array(colour) / 255), 0, 1)).tolist()
        assert abs(blue - (red + green) / 2) > 30, colour
