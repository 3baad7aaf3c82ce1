"""What the closed loop needs of a world, whoever moves the other vehicles in it."""

from collections.abc import Iterable, Mapping, Sequence
from types import TracebackType
from typing import Protocol, Self

from sumo_hmdp.domain.road_rules import RoadRules
from sumo_hmdp.domain.scene import StopLine, VehicleState
from sumo_hmdp.sim.signals import Breaches


class World(Protocol):
    """A road with the ego and everybody else on it, open between `__enter__` and `__exit__`.

    An open world is at time 0. All methods speak of the instant that the last `advance` has led to; positions are
    those of the centre of the front bumper [m].
    """

    @property
    def rules(self) -> RoadRules:
        """What the road forbids to everybody."""
        ...

    @property
    def x_end(self) -> float:
        """Where the road ends [m]."""
        ...

    def __enter__(self) -> Self:
        """Open the world at time 0.

        Raises:
            SimulationError: it cannot be opened, for example as SUMO has one open in this process already.
        """
        ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the world, also after an error."""
        ...

    def observe(self) -> tuple[VehicleState, ...]:
        """Return the surrounding vehicles on the road, ordered by id."""
        ...

    def ego(self) -> VehicleState:
        """Return the ego, as it was last commanded or as the world has driven it."""
        ...

    def advance(
        self, ego: VehicleState | None, speeds: Mapping[str, float], poses: Iterable[VehicleState] = ()
    ) -> None:
        """Carry the world on by one step.

        Args:
            ego: where the ego is at the end of the step; None where the world drives it.
            speeds: [m/s] of the scripted vehicles at the end of the step, by id.
            poses: where the vehicles drawn from the model are at the end of the step.
        """
        ...

    def crossing(self) -> tuple[VehicleState, ...]:
        """Return vehicles near the ego that `observe` leaves out, as they do not drive along the road."""
        ...

    def stop_lines(self, others: Iterable[VehicleState], told: Sequence[StopLine] = ()) -> tuple[StopLine, ...]:
        """Return the stop lines that are closed to the ego.

        Args:
            others: as from `observe`.
            told: the lines that were closed when the ego last decided.
        """
        ...

    def breaches(self) -> Breaches:
        """Return the rules that the ego broke in the last step."""
        ...

    def background_contacts(self) -> tuple[tuple[str, str], ...]:
        """Return the pairs of other vehicles that have overlapped so far, sorted."""
        ...

    def sumo_contacts(self) -> tuple[tuple[str, str], ...]:
        """Return the simulator's own (collider, victim) pairs with the ego since the last call; () if it has none."""
        ...
