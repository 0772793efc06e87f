"""The style of all figures of the docs: axes with a title and a grid, and where they are saved."""

from __future__ import annotations

from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from study import DOCS

FOLDER = DOCS / "figures"


def axes(
    title: str,
    rows: int = 1,
    columns: int = 1,
    x: str = "",
    y: str = "",
    size: tuple[float, float] | None = None,
) -> list[Axes]:
    """Return the axes of a new figure, row by row; `size` is width and height in inches."""
    figure = Figure(figsize=size or (8.0, 2.7 * rows + 1.0), dpi=80)
    grid = figure.subplots(rows, columns, squeeze=False)
    figure.suptitle(title, fontsize=10)
    for one in grid.flat:
        one.set(xlabel=x, ylabel=y)
        one.grid(alpha=0.3)
    return list(grid.flat)


def save(drawn: list[Axes], folder: str, name: str) -> Path:
    """Write a figure below docs/figures, each of its axes with a legend where something has a label."""
    for one in drawn:
        if one.get_legend_handles_labels()[0]:
            one.legend(fontsize=8)
    figure = drawn[0].figure
    assert isinstance(figure, Figure)
    figure.tight_layout()
    path = FOLDER / folder / f"{name}.png"
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, metadata={"Software": None})
    return path
