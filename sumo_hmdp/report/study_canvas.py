"""What the figures of a study's report share: their kind, colours, panels, and the names of cells on an axis."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from textwrap import fill

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sumo_hmdp.report.case_road import tidy
from sumo_hmdp.report.lane_panel import COLORS, MARKERS

# Width on the page, in inches of 96 pixels [in].
WIDTH = 7.0
INK, LINE, PAPER = "#16191d", "#d8dce0", "#ffffff"
# Letters in a line of a title, and of a cell's name.
TITLE, NAME = 92, 30


@dataclass(frozen=True)
class StudyFigure:
    """One figure.

    Attributes:
        name: of its file.
        title: the finding.
        key: how to read it.
        alt: what it shows, for those who do not see it.
        draw: makes it, within the style of the project.
    """

    name: str
    title: str
    key: str
    alt: str
    draw: Callable[[], Figure]


def look(index: int) -> tuple[str, str]:
    """Return the colour and the marker of one of several things."""
    return COLORS[index % len(COLORS)], ("o", *MARKERS)[index % (len(MARKERS) + 1)]


def panels(count: int, columns: int, height: float, title: str) -> tuple[Figure, list[Axes]]:
    """Return a figure with its title and panels row by row, each of a height in inches."""
    rows = -(-count // columns)
    lines = fill(title, TITLE)
    size = (WIDTH, rows * height + 0.2 + 0.17 * lines.count("\n"))
    figure = Figure(figsize=size, layout="constrained", facecolor=PAPER)
    axes_list = list(figure.subplots(rows, columns, squeeze=False).flat)
    for axes in axes_list[count:]:
        axes.remove()
    for axes in axes_list[:count]:
        tidy(axes)
        axes.set_facecolor("none")
        axes.grid(visible=True, axis="x", color=LINE, linewidth=0.5)
        axes.set_axisbelow(True)
    figure.suptitle(lines, fontsize=9, x=0.01, ha="left", weight="bold")
    return figure, axes_list[:count]


def cells(axes: Axes, names: Sequence[str], *, named: bool = True) -> None:
    """Put cells on the upright axis, the first on top."""
    axes.set_yticks(range(len(names)), [fill(name, NAME) for name in names] if named else [""] * len(names))
    axes.set_ylim(len(names) - 0.4, -0.6)
