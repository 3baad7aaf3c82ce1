"""What a planner gets to see of a scene: everybody in their true place, or measured with noise."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from sumo_hmdp.domain.scene import Scene, VehicleState
from sumo_hmdp.traffic.streams import stream


@dataclass(frozen=True)
class MeasurementNoise:
    """Standard deviations of one vehicle's measurement.

    Attributes:
        position_std: along the road, and across it but for `lateral_std` [m].
        speed_std: [m/s].
        lateral_std: across the road [m]; None takes `position_std`.
    """

    position_std: float = 0.0
    speed_std: float = 0.0
    lateral_std: float | None = None

    @property
    def across(self) -> float:
        """Across the road [m]."""
        return self.position_std if self.lateral_std is None else self.lateral_std

    @property
    def exact(self) -> bool:
        """Tell whether there is none."""
        return self.position_std == self.speed_std == self.across == 0.0


@dataclass(frozen=True)
class Measurement:
    """How the surrounding vehicles are measured; the ego knows its own state.

    Attributes:
        seed: of the run.
        by_vehicle: the noise of vehicles by id.
        otherwise: that of everybody else.
    """

    seed: int = 0
    by_vehicle: Mapping[str, MeasurementNoise] = field(default_factory=dict)
    otherwise: MeasurementNoise = MeasurementNoise()

    def perceive(self, scene: Scene, step: int) -> Scene:
        """Return the scene as measured at a step.

        Each vehicle and step has a stream of its own: what is measured of one does not hang on who else is in sight.
        """
        if self.otherwise.exact and all(noise.exact for noise in self.by_vehicle.values()):
            return scene
        return replace(scene, others=tuple(self._measured(other, step) for other in scene.others))

    def _measured(self, vehicle: VehicleState, step: int) -> VehicleState:
        noise = self.by_vehicle.get(vehicle.id, self.otherwise)
        if noise.exact:
            return vehicle
        x, y, speed = stream(self.seed, "measurement", vehicle.id, step).standard_normal(3).tolist()
        return replace(
            vehicle,
            x=vehicle.x + noise.position_std * x,
            y=vehicle.y + noise.across * y,
            speed=max(0.0, vehicle.speed + noise.speed_std * speed),
        )


def measurement_noise(position_var: float, speed_var: float, lateral_var: float) -> MeasurementNoise:
    """Return the noise of given variances [m2], [m2/s2] and [m2]."""
    return MeasurementNoise(math.sqrt(position_var), math.sqrt(speed_var), math.sqrt(lateral_var))
