"""Surrounding vehicles as they enter the simulation: what, where, when, and driven by whom."""

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from enum import StrEnum

from sumo_hmdp.domain.road import Road
from sumo_hmdp.domain.scene import EGO_ID
from sumo_hmdp.errors import Problem

GHOST_PREFIX = "ghost-of-"
_ID_PATTERN = re.compile(r"[A-Za-z0-9_.-]+")


class DriverKind(StrEnum):
    """Who moves a vehicle.

    SCRIPTED: its speed is given for every step; it keeps its lane.
    POSED: its whole pose is given for every step, as the ego's is.
    IDM: SUMO's Intelligent Driver Model; it keeps its lane.
    BACKGROUND: SUMO's Intelligent Driver Model along the road, MOBIL across it.
    """

    SCRIPTED = "scripted"
    POSED = "posed"
    IDM = "idm"
    BACKGROUND = "background"


# Whose speed is SUMO's IDM's.
IDM_KINDS = frozenset({DriverKind.IDM, DriverKind.BACKGROUND})


@dataclass(frozen=True)
class IdmParameters:
    """Parameters of the Intelligent Driver Model.

    Attributes:
        min_gap: gap at standstill [m].
        time_gap: desired time gap [s].
        accel: largest acceleration [m/s2].
        decel: comfortable deceleration, positive [m/s2]; SUMO lets an emergency reach 9.
        exponent: of the free-road term.
    """

    min_gap: float = 2.0
    time_gap: float = 1.5
    accel: float = 1.5
    decel: float = 2.0
    exponent: float = 4.0


@dataclass(frozen=True)
class Spawn:
    """One surrounding vehicle at the moment it enters.

    Attributes:
        id: its name.
        lane: 1 is leftmost; it starts on the lane's centre.
        x: front bumper [m].
        speed: [m/s].
        driver: who moves it.
        desired_speed: free-road speed of the IDM [m/s], at least `speed`; None takes `speed`.
        length: [m].
        width: [m].
        time: when it enters [s]; rounded to the simulation step.
        idm: parameters of an `idm` or `background` driver.
        politeness: of a `background` driver, the weight of what its lane change does to others.
        entry: the way onto the road that a `background` vehicle takes; None starts on the road, else `x` has no
            meaning until it gets there.
        exit: the way off the road that a `background` vehicle wants, None for the road's end.
        courteous: whether a `background` driver lets others in.
        speed_factor: how many times the speed limit of a lane it wants to drive at most; None is above any limit.
    """

    id: str
    lane: int
    x: float
    speed: float
    driver: DriverKind = DriverKind.SCRIPTED
    desired_speed: float | None = None
    length: float = 4.5
    width: float = 1.8
    time: float = 0.0
    idm: IdmParameters = field(default_factory=IdmParameters)
    politeness: float = 0.0
    entry: str | None = None
    exit: str | None = None
    courteous: bool = False
    speed_factor: float | None = None


def spawn_problems(spawns: Sequence[Spawn], road: Road, where: str = "spawns") -> list[Problem]:
    """List everything that keeps these vehicles from entering, empty when nothing does.

    Args:
        spawns: the vehicles.
        road: the road they enter.
        where: the name of the list, for the paths of the problems.
    """
    problems = []
    seen: set[str] = set()
    for i, spawn in enumerate(spawns):
        path = f"{where}[{i}]"
        problems += [Problem(f"{path}.{name}", message) for name, message in _mistakes(spawn, road)]
        if spawn.id in seen:
            problems.append(Problem(f"{path}.id", f"id must be unique, got {spawn.id!r} twice. Rename one."))
        seen.add(spawn.id)
    return problems


def _mistakes(spawn: Spawn, road: Road) -> Iterator[tuple[str, str]]:
    if not _ID_PATTERN.fullmatch(spawn.id) or spawn.id == EGO_ID or spawn.id.startswith(GHOST_PREFIX):
        message = (
            f"id must be made of letters, digits, '_', '.' and '-', and be neither {EGO_ID!r} nor start with "
            f"{GHOST_PREFIX!r}, got {spawn.id!r}. Rename it."
        )
        yield "id", message
    if not road.has_lane(spawn.lane):
        yield "lane", f"lane must be in 1..{road.lane_count}, got {spawn.lane}. Lane 1 is leftmost."
    if spawn.driver not in tuple(DriverKind):
        kinds = ", ".join(DriverKind)
        yield "driver", f"driver must be one of {kinds}, got {spawn.driver!r}."
    yield from _unusable_numbers(spawn)
    if spawn.driver in IDM_KINDS and spawn.desired_speed is not None and spawn.desired_speed < spawn.speed:
        message = (
            f"desired_speed must be at least the speed {spawn.speed} m/s at which the vehicle enters, got "
            f"{spawn.desired_speed} m/s. Lower the one or raise the other."
        )
        yield "desired_speed", message


def _unusable_numbers(spawn: Spawn) -> Iterator[tuple[str, str]]:
    if not math.isfinite(spawn.x):
        yield "x", f"x must be finite, got {spawn.x} m."
    for name, value, unit in (("speed", spawn.speed, "m/s"), ("time", spawn.time, "s")):
        if not (math.isfinite(value) and value >= 0.0):
            yield name, f"{name} must be finite and at least 0, got {value} {unit}."
    positive = {"length": spawn.length, "width": spawn.width}
    if spawn.desired_speed is not None:
        positive["desired_speed"] = spawn.desired_speed
    if spawn.driver in IDM_KINDS:
        positive |= {f"idm.{name}": getattr(spawn.idm, name) for name in IdmParameters.__dataclass_fields__}
    for name, value in positive.items():
        if not (math.isfinite(value) and value > 0.0):
            yield name, f"{name} must be finite and above 0, got {value}."
