"""Runs in random traffic as text, for comparing runs; as a script it prints those of its own process."""

import sys
from dataclasses import replace
from pathlib import Path

from sumo_hmdp.domain.road import Road
from sumo_hmdp.scenario.load import RunOptions, load_scenario
from sumo_hmdp.sim.background import BackgroundSettings
from sumo_hmdp.sim.warm_up import warm_up
from sumo_hmdp.sim.world_checks import WorldSettings
from sumo_hmdp.study.run import execute
from sumo_hmdp.traffic.demand import Demand, arrivals, initial_population, to_spawn
from sumo_hmdp.traffic.drivers import HIGHWAY_CLASSES
from sumo_hmdp.traffic.mobil import LaneChangeRule
from sumo_hmdp.traffic.spawn import DriverKind

ROOT = Path(__file__).parents[2]
NET = ROOT / "networks" / "highway_3x4m.net.xml"
ROAD = Road(lane_count=3, lane_width=4.0)


def settings(seed=1):
    return WorldSettings(NET, ROAD, dt=0.2, seed=seed, background=BackgroundSettings(LaneChangeRule()))


def crowd(density=20.0, seed=1, stretch=(0.0, 800.0), inflow=60.0):
    """Return drawn traffic [vehicles/km/lane], as yet unmoved, and who enters within `inflow` [s]."""
    demand = Demand(HIGHWAY_CLASSES, density=density / 1000.0)
    drawn = (
        *initial_population(demand, (1, 2, 3), *stretch, seed),
        *arrivals(demand, (1, 2, 3), stretch[0], inflow, seed),
    )
    return tuple(
        replace(to_spawn(vehicle), driver=DriverKind.BACKGROUND, politeness=vehicle.traits.politeness)
        for vehicle in drawn
    )


def warm(seed=1, duration=12.0):
    """Return the traffic as it is when it is warm, in full precision."""
    return "\n".join(map(repr, warm_up(settings(seed), crowd(seed=seed), duration)))


def write_scenario(folder, *changes, name="highway"):
    """Write a packaged scenario with changes of its text, short unless they say otherwise; return its file."""
    text = (ROOT / "scenarios" / f"{name}.yaml").read_text(encoding="utf-8")
    for old, new in (("duration_s: 60.0", "duration_s: 12.0"), ("warm_up_s: 20.0", "warm_up_s: 8.0"), *changes):
        assert old in text, old
        text = text.replace(old, new, 1)
    file = folder / f"{name}.yaml"
    file.write_text(text, encoding="utf-8")
    return file


def hashes(file, planners=("idm_mobil", "sumo"), seed=1):
    """Return what each planner's run did, in the exact bits."""
    return [execute(load_scenario(file, RunOptions(planner=name, seed=seed))).row["trace_hash"] for name in planners]


if __name__ == "__main__":
    print(warm())
    print(*hashes(Path(sys.argv[1])))
