"""What drivers are like, as columns of numbers: one column a vehicle, one row a trait."""

from collections.abc import Sequence
from dataclasses import fields

import numpy as np
from numpy.typing import NDArray

from sumo_hmdp.domain.scene import VehicleState
from sumo_hmdp.traffic.car_following import Drivers
from sumo_hmdp.traffic.spawn import IdmParameters, Spawn

FloatArray = NDArray[np.float64]

_ORDINARY = IdmParameters()
# Length, politeness, and what the IDM takes.
_COUNT = 2 + len(fields(Drivers))


def traits_of(spawns: Sequence[Spawn]) -> FloatArray:
    """Return length, politeness and the IDM's parameters in the order of `Drivers`, shape (8, n)."""
    return _columns(
        [
            _traits(
                spawn.length,
                spawn.politeness,
                spawn.speed if spawn.desired_speed is None else spawn.desired_speed,
                spawn.idm,
            )
            for spawn in spawns
        ]
    )


def stranger_traits(vehicles: Sequence[VehicleState]) -> FloatArray:
    """Return what background drivers take others to be: drivers like themselves who keep their speed, shape (8, n)."""
    return _columns(
        [_traits(vehicle.length, Spawn.politeness, max(vehicle.speed, 1.0), _ORDINARY) for vehicle in vehicles]
    )


def _traits(length: float, politeness: float, desired_speed: float, idm: IdmParameters) -> tuple[float, ...]:
    return length, politeness, desired_speed, idm.min_gap, idm.time_gap, idm.accel, idm.decel, idm.exponent


def _columns(rows: list[tuple[float, ...]]) -> FloatArray:
    """Return one column a vehicle, also of none."""
    return np.array(rows, dtype=np.float64).reshape(-1, _COUNT).T
