"""Figures are written as Matplotlib would write them, and a file that cannot be written is an error."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from facadelake.reporting.drawing.png_writer import PngWriter


def draw_line(number: int) -> Figure:
    figure = Figure(figsize=(3.0, 2.0), dpi=100, facecolor="white")
    FigureCanvasAgg(figure)
    figure.add_axes((0.1, 0.1, 0.8, 0.8)).plot([0, number], [0, 1], color="tab:red")
    return figure


def test_pictures_are_those_that_matplotlib_writes(tmp_path: Path) -> None:
    with PngWriter() as writer:
        for number in range(5):
            writer.write(draw_line(number), tmp_path / f"{number}.png")
    for number in range(5):
        draw_line(number).savefig(tmp_path / "expected.png")
        expected, found = (cv2.imread(str(tmp_path / f"{name}.png")) for name in ("expected", number))
        assert expected is not None and np.array_equal(found, expected)


def test_a_picture_that_cannot_be_written_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(OSError, match="missing"), PngWriter() as writer:
        writer.write(draw_line(1), tmp_path / "missing" / "1.png")


def test_an_error_in_drawing_is_not_hidden(tmp_path: Path) -> None:
    def fail() -> None:
        with PngWriter() as writer:
            writer.write(draw_line(1), tmp_path / "missing" / "1.png")
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail()
