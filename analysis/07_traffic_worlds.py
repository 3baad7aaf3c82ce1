"""How the highway's random traffic flows: contacts, density, flow and speed against theory, and lane changes.

Per density and seed the traffic of scenarios/highway.yaml is warmed up and then drives for some time. The ego stands
for nobody: it keeps 5 m/s behind all of it, where no driver sees it. The traffic is measured in a window that travels
with it, from the vehicle at the first fifth of the places to the one at the fourth, so that neither end of the traffic
counts. By Edie's definitions, with d the sum of the distances that all vehicles drive in the window, t the sum of the
times that they spend there and A its area (length times time times lanes): density t / A, flow d / A, mean speed d / t.

Theory is that of one lane without lane changes, all at one speed in their equilibrium gaps
(sumo_hmdp/traffic/theory.py): for the mean driver, and for a mix of drivers, none of whom is faster than the slowest.

Then lane changes alone, on the same road and on the one with ramps, in the scenarios as they are, the ego driven by
SUMO among the others.

    python analysis/07_traffic_worlds.py --figure docs/figures
"""

import argparse
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from sumo_hmdp.domain.road import Road
from sumo_hmdp.domain.scene import VehicleState
from sumo_hmdp.report.case_road import BLUE, ORANGE, panels, style, tidy, write_figure
from sumo_hmdp.scenario.load import RunOptions, find_scenario, load_scenario
from sumo_hmdp.sim.background import BackgroundSettings
from sumo_hmdp.sim.libsumo_world import LibsumoWorld
from sumo_hmdp.sim.warm_up import warm_up
from sumo_hmdp.sim.world_checks import WorldSettings
from sumo_hmdp.traffic.demand import Demand, arrivals, initial_population, to_spawn
from sumo_hmdp.traffic.drivers import HIGHWAY_CLASSES, draw_traits, mean_traits
from sumo_hmdp.traffic.mobil import LaneChangeRule
from sumo_hmdp.traffic.spawn import DriverKind, Spawn
from sumo_hmdp.traffic.theory import FundamentalDiagram, fundamental_diagram

NET = Path(__file__).resolve().parents[1] / "networks" / "highway_3x4m.net.xml"
ROAD = Road(lane_count=3, lane_width=4.0)
LANES = (1, 2, 3)
# As in scenarios/highway.yaml; the road is long enough for 140 s of driving from there.
STRETCH, DT, WARM_UP = (0.0, 2000.0), 0.2, 20.0
EGO = VehicleState("ego", x=-900.0, y=ROAD.center_y(2), speed=5.0, lane=2)
# Drivers that stand for the mix, so many that a share of one class is met to a thousandth.
MIX = 2000
# Of places of the vehicles: the window is from the first to the second.
WINDOW = (0.2, 0.8)


@dataclass(frozen=True)
class Measured:
    """One run.

    Attributes:
        density: in the window [1/m and lane].
        flow: in the window [1/s and lane].
        speed: mean in space [m/s].
        changes: lane changes begun, of all vehicles.
        distance: driven by all vehicles [m].
        contacts: pairs of vehicles that overlapped.
        hardest: largest deceleration of anybody [m/s2].
    """

    density: float
    flow: float
    speed: float
    changes: int
    distance: float
    contacts: int
    hardest: float


def traffic(density: float, seed: int, duration: float) -> tuple[Spawn, ...]:
    """Return the warm traffic of a density [1/m], as `sumo-hmdp run highway` has it."""
    demand = Demand(HIGHWAY_CLASSES, density=density)
    drawn = (
        *initial_population(demand, LANES, *STRETCH, seed),
        *arrivals(demand, LANES, STRETCH[0], WARM_UP + duration, seed),
    )
    spawns = [replace(to_spawn(one), driver=DriverKind.BACKGROUND, politeness=one.traits.politeness) for one in drawn]
    return warm_up(settings(seed), spawns, WARM_UP)


def settings(seed: int) -> WorldSettings:
    """Return the world's settings; everybody is in sight."""
    return WorldSettings(NET, ROAD, DT, seed, background=BackgroundSettings(LaneChangeRule()), sight=math.inf)


def drive(spawns: Sequence[Spawn], seed: int, steps: int) -> Iterator[tuple[tuple[VehicleState, ...], int]]:
    """Yield everybody, and the contacts so far, at every instant."""
    ego = EGO
    with LibsumoWorld(settings(seed), ego, tuple(spawns)) as world:
        yield world.observe(), 0
        for _ in range(steps):
            ego = replace(ego, x=ego.x + ego.speed * DT)
            world.advance(ego, {})
            yield world.observe(), len(world.background_contacts())


def measure(density: float, seed: int, duration: float) -> Measured:
    """Drive the traffic of a density [1/m] and a seed for a time [s], and measure it."""
    spawns = traffic(density, seed, duration)
    edges = window_edges(spawns)
    area = time = distance = total = hardest = 0.0
    changes = contacts = 0
    last: dict[str, VehicleState] = {}
    for states, touching in drive(spawns, seed, round(duration / DT)):
        now = {state.id: state for state in states}
        if last:
            x, speed = (np.array([getattr(state, name) for state in states]) for name in ("x", "speed"))
            low, high = (now[name].x for name in edges)
            inside = (x >= low) & (x < high)
            area += len(LANES) * (high - low) * DT
            time += DT * int(inside.sum())
            distance += DT * float(speed[inside].sum())
            total += DT * float(speed.sum())
            hardest = max(hardest, *(-state.accel for state in states))
            changes += begun(last, now)
        last, contacts = now, touching
    return Measured(time / area, distance / area, distance / time, changes, total, contacts, hardest)


@dataclass(frozen=True)
class Changes:
    """Lane changes of one run of a scenario.

    Attributes:
        rate: changes begun by the background, per vehicle and metre that it drives along the road.
        contacts: pairs of background vehicles that overlapped.
    """

    rate: float
    contacts: int


def count_changes(scenario: str, density: float, seed: int, duration: float) -> Changes:
    """Drive a scenario at a density [1/m] for a time [s], with everybody in sight, and count lane changes."""
    overrides = {"traffic.density_vpkm_per_lane": 1000.0 * density, "duration_s": duration}
    run = load_scenario(find_scenario(scenario), RunOptions(planner="sumo", seed=seed, overrides=overrides))
    changes, distance = 0, 0.0
    last: dict[str, VehicleState] = {}
    with LibsumoWorld(replace(run.world, sight=math.inf), run.episode.ego, run.spawns) as world:
        for _ in range(run.episode.steps):
            world.advance(None, {})
            now = {state.id: state for state in world.observe()}
            distance += run.episode.dt * sum(state.speed for state in now.values())
            changes += begun(last, now, run.episode.road)
            last = now
        return Changes(changes / distance, len(world.background_contacts()))


def change_table(scenarios: Sequence[str], densities: Sequence[float], seeds: int, duration: float) -> str:
    """Return lane changes per vehicle and km of scenarios at densities [1/m] as Markdown."""
    lines = ["| scenario | asked [veh/km/lane] | lane changes [1/(veh km)] | contacts |", "|---|---|---|---|"]
    for scenario in scenarios:
        for density in densities:
            runs = [count_changes(scenario, density, seed, duration) for seed in range(seeds)]
            rates = np.array([1000.0 * run.rate for run in runs])
            lines.append(
                f"| `{scenario}` | {1000.0 * density:.0f} | {rates.mean():.2f} ± {rates.std(ddof=1):.2f} | "
                f"{sum(run.contacts for run in runs)} |"
            )
    return "\n".join(lines)


def window_edges(spawns: Sequence[Spawn]) -> tuple[str, str]:
    """Return the vehicles between which the traffic is measured."""
    places = sorted((spawn.x, spawn.id) for spawn in spawns if spawn.time == 0.0)
    low, high = (places[round(share * (len(places) - 1))][1] for share in WINDOW)
    return low, high


def begun(last: dict[str, VehicleState], now: dict[str, VehicleState], road: Road = ROAD) -> int:
    """Return how many vehicles have left the centre of a lane within a step."""
    return sum(
        centred(last[name].y, road) and not centred(state.y, road) for name, state in now.items() if name in last
    )


def centred(y: float, road: Road) -> bool:
    """Tell whether y [m] is the centre of a lane."""
    return min(abs(y - road.center_y(lane)) for lane in range(1, road.lane_count + 1)) < 1e-6


def table(results: dict[float, list[Measured]]) -> str:
    """Return the results and the theory as Markdown, with the standard deviations over the seeds."""
    head = (
        "asked [veh/km/lane]", "measured", "flow [veh/h/lane]", "mean driver's", "mix's",
        "mean speed [m/s]", "mean driver's", "mix's", "lane changes [1/(veh km)]", "hardest braking [m/s2]", "contacts",
    )  # fmt: skip
    lines = [f"| {' | '.join(head)} |", f"|{'---|' * len(head)}"]
    for asked, runs in results.items():
        density, flow, speed = (np.array([getattr(run, name) for run in runs]) for name in ("density", "flow", "speed"))
        rates = np.array([1000.0 * run.changes / run.distance for run in runs])
        mean, mixed = theory(np.array([density.mean()]))
        cells = [
            f"{1000.0 * asked:.0f}",
            f"{1000.0 * density.mean():.1f} ± {1000.0 * density.std(ddof=1):.1f}",
            f"{3600.0 * flow.mean():.0f} ± {3600.0 * flow.std(ddof=1):.0f}",
            f"{3600.0 * float(mean.flow[0]):.0f}",
            f"{3600.0 * float(mixed.flow[0]):.0f}",
            f"{speed.mean():.1f} ± {speed.std(ddof=1):.1f}",
            f"{float(mean.speed[0]):.1f}",
            f"{float(mixed.speed[0]):.1f}",
            f"{rates.mean():.2f} ± {rates.std(ddof=1):.2f}",
            f"{max(run.hardest for run in runs):.1f}",
            f"{sum(run.contacts for run in runs)}",
        ]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def theory(density: NDArray[np.float64]) -> tuple[FundamentalDiagram, FundamentalDiagram]:
    """Return the diagrams of the mean driver and of the mix at densities [1/m]."""
    uniforms = np.random.default_rng(0).random((MIX, 4))
    mix = [draw_traits(HIGHWAY_CLASSES, row) for row in uniforms.tolist()]
    return fundamental_diagram(density, [mean_traits(HIGHWAY_CLASSES)]), fundamental_diagram(density, mix)


def figure(results: dict[float, list[Measured]]) -> Figure:
    """Draw flow and speed over density."""
    density = np.linspace(0.0, 0.06, 121)
    curves = zip(("mean driver", "mix of drivers"), theory(density), ("-", "--"), (BLUE, ORANGE), strict=True)
    with style():
        drawn, (flows, speeds) = panels(2, 4.2, sharex=True)
        for label, curve, line, color in curves:
            flows.plot(1000.0 * density, 3600.0 * curve.flow, line, color=color, linewidth=1.2, label=label)
            speeds.plot(1000.0 * density, curve.speed, line, color=color, linewidth=1.2)
        for (asked, runs), marker in zip(results.items(), "os^Dv", strict=False):
            look = {"marker": marker, "linestyle": "", "markersize": 3.4, "color": "black", "markerfacecolor": "none"}
            x = [1000.0 * run.density for run in runs]
            flows.plot(x, [3600.0 * run.flow for run in runs], label=f"{1000.0 * asked:.0f} asked for", **look)
            speeds.plot(x, [run.speed for run in runs], **look)
        flows.set_ylabel("flow [vehicles/h/lane]")
        speeds.set_ylabel("mean speed [m/s]")
        speeds.set_xlabel("density [vehicles/km/lane]")
        speeds.set_xlim(0.0, 60.0)
        flows.set_ylim(bottom=0.0)
        speeds.set_ylim(bottom=0.0)
        for axes in (flows, speeds):
            tidy(axes)
        flows.legend(loc="lower right")
    return drawn


def main() -> None:
    """Measure, draw and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--density", type=float, nargs="+", default=[15.0, 25.0, 35.0], help="vehicles/km and lane")
    parser.add_argument("--seeds", type=int, default=10, help="runs a density")
    parser.add_argument("--duration", type=float, default=120.0, help="of a run, in s")
    parser.add_argument("--figure", type=Path, help="folder for fundamental_diagram.svg and .png")
    arguments = parser.parse_args()
    results = {
        0.001 * density: [measure(0.001 * density, seed, arguments.duration) for seed in range(arguments.seeds)]
        for density in arguments.density
    }
    print(table(results), end="\n\n")
    print(change_table(("highway", "highway_ramps"), list(results), arguments.seeds, arguments.duration))
    if arguments.figure is not None:
        write_figure(figure(results), arguments.figure, "fundamental_diagram")


if __name__ == "__main__":
    main()
