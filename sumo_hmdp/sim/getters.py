"""Position and speed of many vehicles at every step: the two calls that a run makes most often."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import chain, repeat
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Position = Callable[[Iterable[str]], Iterator[tuple[float, float]]]
Speed = Callable[[Iterable[str]], Iterator[float]]


class Getters:
    """Reads vehicles by their names."""

    def __init__(self, api: Any) -> None:  # noqa: ANN401 - libsumo, or TraCI, which has the same functions
        """Choose the functions.

        libsumo's are functions of Python that pass their arguments on to an extension module, which takes as long as
        the call itself. That module's own are taken where there is one and it has them, else those of the interface.

        Args:
            api: libsumo or a module with the same functions.
        """
        bare = getattr(getattr(api, "libsumo", None), "_libsumo", None)
        position = getattr(bare, "vehicle_getPosition", None)
        speed = getattr(bare, "vehicle_getSpeed", api.vehicle.getSpeed)
        self._position: Position = lambda names: map(api.vehicle.getPosition, names)
        if position is not None:
            without_height = repeat(False)  # noqa: FBT003 - the extension module knows no names of arguments
            self._position = lambda names: map(position, names, without_height)
        self._speed: Speed = lambda names: map(speed, names)

    def positions(self, names: Sequence[str]) -> FloatArray:
        """Return (x, y) of front bumpers [m], shape (n, 2)."""
        flat = np.fromiter(chain.from_iterable(self._position(names)), np.float64, 2 * len(names))
        return flat.reshape(-1, 2)

    def speeds(self, names: Sequence[str]) -> FloatArray:
        """Return speeds [m/s], shape (n,)."""
        return np.fromiter(self._speed(names), np.float64, len(names))
