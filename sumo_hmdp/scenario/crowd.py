"""The background of a run: drawn, sent on its routes, warmed up, and the place in it that the ego takes."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

from sumo_hmdp.errors import InputError, Problem
from sumo_hmdp.scenario.schema import EgoFile
from sumo_hmdp.scenario.traffic import TrafficFile
from sumo_hmdp.sim.network import Network, Ramp, SideEntry, read_network
from sumo_hmdp.sim.routes import Routes
from sumo_hmdp.sim.warm_up import warm_up
from sumo_hmdp.sim.world_checks import WorldSettings
from sumo_hmdp.traffic.demand import CROWD_PREFIX, Demand, arrivals, initial_population, to_spawn
from sumo_hmdp.traffic.spawn import DriverKind, Spawn
from sumo_hmdp.traffic.streams import stream

# Vehicles come onto a ramp or side street no faster than this [m/s].
_ENTRY_SPEED = 12.0
# An exit nearer ahead than this is not drawn: nobody could change lanes for it in time [m].
_EXIT_SIGHT = 200.0
# An ego that takes a vehicle's place farther from where it was put is somewhere else [m].
_EGO_REACH = 500.0
# Entries have numbers of their own among the streams of the lanes.
_ENTRY_STREAM = 100


@dataclass(frozen=True)
class Flows:
    """Who comes and goes besides the ends of the road.

    Attributes:
        ramp: demand of each on-ramp, None for none.
        side: demand of each side street, None for none.
        exit_share: of all vehicles.
    """

    ramp: Demand | None
    side: Demand | None
    exit_share: float


def background(traffic: TrafficFile, world: WorldSettings, duration: float) -> tuple[Spawn, ...]:
    """Return the background as it is when the run begins, and who enters later.

    It hangs on the `traffic` section, the network, the step and the seed alone, so that all planners meet the same.

    Args:
        traffic: the section.
        world: with the background's settings; who drives the ego plays no part.
        duration: of the run [s].

    Raises:
        InputError: ramps, side streets or exits that the network does not have.
    """
    network = read_network(world.net_file, world.road)
    low, high = traffic.stretch_m
    lanes = traffic.lanes or [n for n in range(1, world.road.lane_count + 1) if not _is_closed(network, n, low, high)]
    limit = max((zone.speed for zone in network.rules.speed_zones), default=None)
    try:
        demand = traffic.demand(limit)
        flows = Flows(
            traffic.flow(traffic.ramp_flow_vph, limit), traffic.flow(traffic.side_flow_vph, limit), traffic.exit_share
        )
    except InputError as error:
        where = {"density": "traffic.density_vpkm_per_lane", "flow": "traffic"}
        raise InputError([Problem(where.get(p.path, p.path), p.message) for p in error.problems]) from error
    return _warm(
        replace(world, ego_driver=None),
        demand,
        flows,
        tuple(lanes),
        (traffic.stretch_m[0], traffic.stretch_m[1]),
        traffic.warm_up_s,
        traffic.warm_up_s + duration if traffic.inflow else 0.0,
    )


# Runs of one seed follow each other in a study, and only differ in who drives the ego.
@lru_cache(maxsize=4)
def _warm(
    world: WorldSettings,
    demand: Demand,
    flows: Flows,
    lanes: tuple[int, ...],
    stretch: tuple[float, float],
    warm_up_time: float,
    inflow_time: float,
) -> tuple[Spawn, ...]:
    routes = Routes(read_network(world.net_file, world.road))
    problems = [
        *_missing_ways(routes, flows),
        *_misplaced(routes.network, lanes, stretch, max(kind.length for kind in demand.classes)),
    ]
    if problems:
        raise InputError(problems)
    present = initial_population(demand, lanes, *stretch, world.seed)
    later = arrivals(demand, lanes, stretch[0], inflow_time, world.seed)
    spawns = [
        replace(to_spawn(vehicle), driver=DriverKind.BACKGROUND, politeness=vehicle.traits.politeness)
        for vehicle in (*present, *later)
    ]
    spawns += _entering(routes, flows, inflow_time, world.seed)
    assert world.background is not None  # noqa: S101 - the caller's own mistake
    spawns = [_under_limits(spawn, routes, world.speed_limit) for spawn in spawns]
    spawns = list(_with_courtesy(world.background.courtesy.share, spawns, world.seed))
    return warm_up(world, tuple(_with_exits(routes, flows.exit_share, spawns, world.seed)), warm_up_time)


def _is_closed(network: Network, lane: int, low: float, high: float) -> bool:
    """Tell whether a lane is closed to passenger cars anywhere between two x [m]."""
    parts = (s.lane_parts[lane - 1] for s in network.stretches if s.x_begin < high and s.x_end > low)
    return any(part is not None and not part.is_open for part in parts)


def _under_limits(spawn: Spawn, routes: Routes, limit: float | None) -> Spawn:
    """Return a vehicle that enters no faster than it may be there; with a limit for the whole road, as it is."""
    if limit is not None or spawn.speed_factor is None:
        return replace(spawn, speed_factor=None)
    if spawn.entry is None:
        allowed = routes.network.rules.speed_limit(spawn.lane, spawn.x)
    else:
        edge = routes.entries[spawn.entry].route[0]
        allowed = min(v for name, v in routes.network.side_limits.items() if name.rpartition("_")[0] == edge)
    return replace(spawn, speed=min(spawn.speed, spawn.speed_factor * allowed))


def _missing_ways(routes: Routes, flows: Flows) -> Iterator[Problem]:
    """Yield flows for which the network has no way."""
    network = routes.network
    wanted = (
        ("ramp_flow_vph", flows.ramp is not None, network.on_ramps, "an on-ramp"),
        ("side_flow_vph", flows.side is not None, network.side_entries, "a side street"),
        ("exit_share", flows.exit_share > 0.0, routes.exits, "an off-ramp or a turn"),
    )
    for key, asked, ways, what in wanted:
        if asked and not ways:
            message = f"must go with a network that has {what}; leave it out or change the network"
            yield Problem(f"traffic.{key}", message)


def _misplaced(
    network: Network, lanes: Sequence[int], stretch: tuple[float, float], longest: float
) -> Iterator[Problem]:
    """Yield traffic where there is no road, or no lane."""
    low, high = network.x_begin + longest, network.x_end
    if not (low <= stretch[0] and stretch[1] <= high):
        message = f"must be within {low:g}..{high:g} m, where whole vehicles are on the road, got {list(stretch)}"
        yield Problem("traffic.stretch_m", message)
        return
    for lane in lanes:
        if _is_closed(network, lane, *stretch):
            message = f"must be open to passenger cars all along stretch_m, got {lane}, which is not; list the others"
            yield Problem("traffic.lanes", message)
            continue
        edges = (part for part in network.stretches if part.edge is not None)
        inside = (part for part in edges if part.x_begin < stretch[1] and part.x_end > stretch[0])
        gap = next((part for part in inside if not part.lanes[lane - 1]), None)
        if gap is not None:
            message = f"must be lanes that exist all along stretch_m, got {lane}, which does not at {gap.x_begin:g} m"
            yield Problem("traffic.lanes", f"{message}; list the others")


def _entering(routes: Routes, flows: Flows, duration: float, seed: int) -> Iterator[Spawn]:
    """Yield who comes by ramps and side streets."""
    for number, entry in enumerate(routes.entries.values()):
        demand = flows.ramp if isinstance(entry, Ramp) else flows.side
        if demand is None:
            continue
        key = _ENTRY_STREAM + number
        for vehicle in arrivals(demand, [key], 0.0, duration, seed):
            yield replace(
                to_spawn(vehicle),
                id=vehicle.id.replace(f"{CROWD_PREFIX}{key}-in", CROWD_PREFIX + entry.name),
                lane=entry.lanes[0] if isinstance(entry, SideEntry) else entry.lane,
                speed=min(vehicle.speed, _ENTRY_SPEED),
                driver=DriverKind.BACKGROUND,
                politeness=vehicle.traits.politeness,
                entry=entry.name,
            )


def _with_exits(routes: Routes, share: float, spawns: Iterable[Spawn], seed: int) -> Iterator[Spawn]:
    """Draw who leaves the road before its end and where; each vehicle has a stream of its own for it."""
    for spawn in spawns:
        entry = None if spawn.entry is None else routes.entries[spawn.entry]
        x = spawn.x if entry is None else entry.x_begin if isinstance(entry, Ramp) else entry.x
        ahead = [way.name for way in routes.exits.values() if way.x > x + _EXIT_SIGHT]
        leaves, which = stream(seed, "exit", spawn.id).random(2).tolist()
        yield replace(spawn, exit=ahead[int(which * len(ahead))]) if ahead and leaves < share else spawn


def _with_courtesy(share: float, spawns: Iterable[Spawn], seed: int) -> Iterator[Spawn]:
    """Draw who lets others in; each vehicle has a stream of its own for it, which all or none need not ask."""
    for spawn in spawns:
        courteous = share >= 1.0 or (share > 0.0 and stream(seed, "courtesy", spawn.id).random() < share)
        yield replace(spawn, courteous=bool(courteous))


def ego_start(ego: EgoFile, crowd: Sequence[Spawn]) -> tuple[Spawn, tuple[Spawn, ...]]:
    """Return where the ego starts, as a spawn, and the background without the vehicle whose place it takes.

    Args:
        ego: the section.
        crowd: the background.

    Raises:
        InputError: the place hangs on traffic that is not there, or the speed is missing.
    """
    if not ego.in_traffic:
        if ego.speed_mps is None:
            raise InputError([Problem("ego.speed_mps", "is missing; add it, or set ego.in_traffic")])
        return Spawn("ego-start", ego.lane, ego.x_m, ego.speed_mps), tuple(crowd)
    if ego.speed_mps is not None:
        message = f"must be left out with ego.in_traffic, got {ego.speed_mps:g} m/s; the ego takes a vehicle's speed"
        raise InputError([Problem("ego.speed_mps", message)])
    there = [spawn for spawn in crowd if spawn.lane == ego.lane and spawn.time == 0.0]
    if not there:
        message = f"must be in a lane with background traffic, got lane {ego.lane}; change ego.lane or the traffic"
        raise InputError([Problem("ego.in_traffic", message)])
    replaced = min(there, key=lambda spawn: (abs(spawn.x - ego.x_m), spawn.id))
    if abs(replaced.x - ego.x_m) > _EGO_REACH:
        message = f"must be within {_EGO_REACH:g} m of a vehicle in lane {ego.lane}, got {ego.x_m:g} m; the nearest is"
        raise InputError([Problem("ego.x_m", f"{message} at {replaced.x:.0f} m. Move it or the traffic")])
    return replaced, tuple(spawn for spawn in crowd if spawn is not replaced)
