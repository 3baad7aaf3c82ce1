"""How far a long piece of work has come, told to whoever watches it."""

from collections.abc import Callable
from dataclasses import dataclass

OnProgress = Callable[[float, float], None]


@dataclass
class Work:
    """Counts units of work against how many there will be.

    Attributes:
        on_progress: called with what is done and what there is in all, None where nobody watches.
        total: how much there is in all, as far as is known.
        done: of it.
    """

    on_progress: OnProgress | None = None
    total: float = 0.0
    done: float = 0.0

    def expect(self, total: float) -> None:
        """Say how much there is in all; it may turn out otherwise later."""
        self.total = total
        self.tick(0.0)

    def tick(self, units: float = 1.0) -> None:
        """Say that some of it is done."""
        self.done += units
        if self.on_progress is not None:
            self.on_progress(self.done, self.total)
