"""The errors a user can meet, each with what, where, and what to do about it."""

from collections.abc import Iterable
from dataclasses import dataclass

# A line that is longer helps nobody; what a user wrote may stand in it.
_LINE_MAX, _SOURCE_MAX = 1000, 300


def printable(text: str) -> str:
    """Return a text whose control and format characters, which a terminal would obey, are written as escapes.

    Line feeds and tabs stay. Nothing of a user's file or command line is printed without this.
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() or c in "\n\t" else ascii(c)[1:-1] for c in text)


class SumoHmdpError(Exception):
    """Base of every error that this package raises on purpose."""


@dataclass(frozen=True)
class Problem:
    """One mistake in a file.

    Attributes:
        path: where it stands, such as `vehicles[0].lane`.
        message: what must hold, what was found, and the remedy.
    """

    path: str
    message: str

    def __str__(self) -> str:
        return f"{self.path}: {self.message}" if self.path else self.message


class InputError(SumoHmdpError):
    """Something that the user gave cannot be used; holds every mistake that was found, not the first only."""

    def __init__(self, problems: Iterable[Problem | str], source: str = "") -> None:
        self.problems = tuple(p if isinstance(p, Problem) else Problem("", p) for p in problems)
        self.source = source
        super().__init__("\n".join(self.lines()))

    def lines(self) -> list[str]:
        """Return one line per mistake, each with the file it stands in; an option of the command line is in none."""
        # Of a path the end tells most.
        source = self.source if len(self.source) <= _SOURCE_MAX else f"...{self.source[-_SOURCE_MAX:]}"
        prefix = f"{source}: " if source else ""
        lines = [f"{'' if problem.path.startswith('--') else prefix}{problem}" for problem in self.problems]
        flat = [" ".join(line.splitlines()) for line in lines]
        return [line if len(line) <= _LINE_MAX else f"{line[:_LINE_MAX]}..." for line in flat]


class SimulationError(SumoHmdpError):
    """The traffic simulation did something that makes the run worthless, such as losing the ego."""
