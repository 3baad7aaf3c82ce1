"""Figures as SVG: for files as they are, for a page with the page's colours and with names of their own."""

import io
import re
from typing import Any

import matplotlib as mpl
from markupsafe import Markup

from sumo_hmdp.report.case_road import GREY, style
from sumo_hmdp.report.figures import METADATA
from sumo_hmdp.report.lane_panel import COLORS
from sumo_hmdp.report.study_canvas import INK, LINE, PAPER, StudyFigure

# Which variable of the page's style stands for which colour of the figures.
VARIABLES = {INK: "ink", LINE: "line", PAPER: "surface", GREY: "muted"} | {
    color: f"hue{place}" for place, color in enumerate(COLORS)
}
SETTINGS: dict[Any, Any] = {"font.size": 8, "axes.titlesize": 8, "legend.fontsize": 7.5} | dict.fromkeys(
    ("text.color", "axes.edgecolor", "axes.labelcolor", "axes.titlecolor", "xtick.color", "ytick.color"), INK
)


def svg_of(figure: StudyFigure) -> str:
    """Draw a figure as an SVG file; the same figure gives the same text."""
    target = io.StringIO()
    with style(), mpl.rc_context(SETTINGS):
        figure.draw().savefig(target, format="svg", metadata=METADATA[".svg"])
    return target.getvalue()


def inline(svg: str, name: str) -> Markup:
    """Return an SVG file as an element of a page: its colours follow the page's, its ids are its own.

    Args:
        svg: the file.
        name: unique in the page.
    """
    text = svg[svg.index("<svg") :]
    text = re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL)
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r'(\bid="|href="#|url\(#)', rf"\g<1>{name}-", text)
    for color, variable in VARIABLES.items():
        text = re.sub(re.escape(color), f"var(--{variable})", text, flags=re.IGNORECASE)
    # The name and the description are given to screen readers around it.
    text = text.replace("<svg", '<svg aria-hidden="true" focusable="false"', 1)
    # Our own drawing: matplotlib escapes the texts in it.
    return Markup(text)  # noqa: S704
