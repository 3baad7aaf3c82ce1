"""Contacts of random runs, found once more by a program of its own, which shares no code with that of the product.

50 runs in four worlds (highway, ramps, town, matched), by the packaged planners and one that drives at random, so that
there are contacts of every kind; densities and seeds vary. From
the recorded poses alone, every body is followed through every step in ten parts, evenly in x, y and heading, and two
bodies touch where the corners of their rectangles, clipped against each other, leave an area. The run must end with the
first such contact, and its fault must be that of the motion: the ego is at fault where it goes forward into a body that
is before it, or sideways into a body beside it. Prints one row a run and what disagrees, in Markdown.

    python analysis/12_contact_check.py
"""

import argparse
import math
import sys
from dataclasses import dataclass, replace
from itertools import cycle, islice, product

import numpy as np
import pandas as pd

from sumo_hmdp.domain.maneuver import Lateral
from sumo_hmdp.domain.plan import Command, Decision, Status
from sumo_hmdp.domain.scene import Scene
from sumo_hmdp.scenario.load import RunOptions, find_scenario, load_scenario
from sumo_hmdp.study.run import RunRecord, execute

PARTS = 10
# Overlaps of a smaller area are touches, or what lies between two looks [m2].
AREA = 1e-4
# A body that moves across the road more slowly keeps its lane [m/s].
STILL = 0.1

# Worlds with what is changed of them, and planners, as (scenario, overrides, planner).
WORLDS = (
    ("highway", "traffic.density_vpkm_per_lane", (10.0, 20.0, 30.0)),
    ("highway_ramps", "traffic.density_vpkm_per_lane", (10.0, 15.0, 20.0)),
    ("urban", "traffic.density_vpkm_per_lane", (10.0, 20.0)),
    ("matched_highway", "matched_traffic.density_vpkm_per_lane", (8.0, 11.0)),
)
# `at_random` is listed twice: of the others few touch anybody in so short a time.
AT_RANDOM = "at_random"
PLANNERS = ("constant", "idm_mobil", "hmdp_mpc", "sumo", AT_RANDOM, AT_RANDOM)


@dataclass(frozen=True)
class AtRandom:
    """Changes lanes, speeds up and brakes at random, whoever is there.

    Attributes:
        seed: of what it does.
        name: as in tables.
        period: between two decisions [s].
    """

    seed: int
    name: str = AT_RANDOM
    period: float = 0.8

    def initial_memory(self) -> None:
        """Return None: nothing is remembered."""

    def decide(self, scene: Scene, memory: None) -> tuple[Decision, None]:
        """Answer one scene."""
        rng = np.random.default_rng([self.seed, round(scene.time * 1000)])
        ways = [lateral for lateral in Lateral if scene.road.has_lane(scene.ego.lane + lateral)]
        lateral = ways[int(rng.integers(len(ways)))] if rng.random() < 0.4 else Lateral.KEEP
        command = Command(scene.ego.lane + lateral, float(rng.choice([-2.0, 0.0, 2.0, 2.0])))
        return Decision(scene.time, Status.RULE, command, lateral), memory


@dataclass(frozen=True)
class Found:
    """The first contact that this program finds in a run.

    Attributes:
        step: that begins before it.
        part: of the step, 1 to 10.
        other: whom the ego touches.
        at_fault: whether the ego moved into it.
    """

    step: int
    part: int
    other: str
    at_fault: bool


def corners(x: float, y: float, heading: float, length: float, width: float) -> np.ndarray:
    """Return the corners of a body counter-clockwise, shape (4, 2) [m]; (x, y) is the middle of its front."""
    forward = np.array([math.cos(heading), math.sin(heading)])
    left = np.array([-forward[1], forward[0]])
    front = np.array([x, y])
    back = front - length * forward
    half = 0.5 * width * left
    return np.array([front + half, back + half, back - half, front - half])


def common_area(one: np.ndarray, two: np.ndarray) -> float:
    """Return the area that two convex polygons have in common [m2], by clipping one against the other's edges."""
    polygon = [tuple(point) for point in one]
    for (ax, ay), (bx, by) in zip(two, np.roll(two, -1, axis=0), strict=True):
        side = [(bx - ax) * (y - ay) - (by - ay) * (x - ax) for x, y in polygon]
        clipped = []
        for i, (point, inside) in enumerate(zip(polygon, side, strict=True)):
            before, was = polygon[i - 1], side[i - 1]
            if (inside >= 0.0) != (was >= 0.0):
                share = was / (was - inside)
                clipped.append(tuple(p + share * (q - p) for p, q in zip(before, point, strict=True)))
            if inside >= 0.0:
                clipped.append(point)
        polygon = clipped
        if not polygon:
            return 0.0
    x, y = np.array(polygon).T
    return 0.5 * abs(float(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1))))


def first_contact(steps: pd.DataFrame) -> Found | None:
    """Return the first contact of the ego in a `steps` table, None where it has none."""
    names = ["x_m", "y_m", "heading_rad", "length_m", "width_m"]
    scenes = {
        int(step): dict(zip(group["vehicle_id"], group[names].to_numpy(float), strict=True))
        for step, group in steps.groupby("step")
    }
    times = steps.groupby("step")["time_s"].first()
    for step in sorted(scenes)[:-1]:
        before, after = scenes[step], scenes[step + 1]
        duration = float(times[step + 1] - times[step])
        for part in range(1, PARTS + 1):
            touched = [
                name
                for name in sorted(before.keys() & after.keys() - {"ego"})
                if _near(before, after, name) and _area(before, after, name, part / PARTS) > AREA
            ]
            if touched:
                return Found(step, part, touched[0], _ego_at_fault(before, after, touched[0], part, duration))
    return None


def _near(before: dict, after: dict, name: str) -> bool:
    """Tell whether a body can be within reach of the ego's in a step."""
    ways = np.array([scene[name][0] - scene["ego"][0] for scene in (before, after)])
    reach = before["ego"][3] + before[name][3] + 3.0
    return bool(ways.min() <= reach and ways.max() >= -reach)


def _pose(before: dict, after: dict, name: str, share: float) -> np.ndarray:
    pose = before[name].copy()
    change = after[name] - before[name]
    change[2] = (change[2] + math.pi) % (2 * math.pi) - math.pi
    return pose + share * change


def _area(before: dict, after: dict, name: str, share: float) -> float:
    return common_area(corners(*_pose(before, after, "ego", share)), corners(*_pose(before, after, name, share)))


def _ego_at_fault(before: dict, after: dict, name: str, part: int, duration: float) -> bool:
    """Tell whether the ego moved into a body: what lay between the two just before tells which way.

    In the ego's own frame the bodies are boxes along and across it. Just before the contact they were apart along or
    across; where along, the ego ran into what is before it, where across, the ego is at fault if it moves that way.
    """
    low, high = (part - 1) / PARTS, part / PARTS
    # The last look without a contact, as near to the contact as halving gets.
    for _ in range(30):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if _area(before, after, name, middle) > 0.0 else (middle, high)
    ego, other = _pose(before, after, "ego", low), corners(*_pose(before, after, name, low))
    cos, sin = math.cos(ego[2]), math.sin(ego[2])
    along = (other[:, 0] - ego[0]) * cos + (other[:, 1] - ego[1]) * sin
    across = (other[:, 1] - ego[1]) * cos - (other[:, 0] - ego[0]) * sin
    apart_along = max(along.min(), -ego[3] - along.max())
    apart_across = max(across.min() - 0.5 * ego[4], -0.5 * ego[4] - across.max())
    moved = (after["ego"] - before["ego"]) / duration
    if apart_along >= apart_across:
        return bool(along.min() >= -ego[3] - along.max() and math.hypot(moved[0], moved[1]) > STILL)
    toward = 1.0 if across.mean() > 0.0 else -1.0
    return bool(toward * moved[1] > STILL)


def runs(count: int) -> list[tuple[str, str, str, RunOptions]]:
    """List the runs: scenario, planner, what is changed in words, and the options."""
    settings = [
        (scenario, path, value, planner)
        for (scenario, path, values), planner in product(WORLDS, PLANNERS)
        for value in values
    ]
    order = np.random.default_rng(12).permutation(len(settings))
    chosen = islice(cycle([settings[i] for i in order]), count)
    return [
        (
            scenario,
            planner,
            f"{path.split('.')[-1]} {value:g}",
            RunOptions(
                planner="constant" if planner == AT_RANDOM else planner,
                solver="search",
                seed=number,
                overrides={"duration_s": 20.0, path: value},
            ),
        )
        for number, (scenario, path, value, planner) in enumerate(chosen)
    ]


def compare(record: RunRecord, found: Found | None) -> str:
    """Say what a run and this program see otherwise, nothing where they agree."""
    row = record.row
    if found is None:
        return "only `runs` has a contact" if row["contact_count"] else ""
    if not row["contact_count"]:
        return f"`runs` has no contact with {found.other}"
    if f"contact with {found.other} " not in record.reason:
        return f"another vehicle: {found.other}"
    last = int(record.steps["step"].max()) - 1
    if found.step != last:
        return f"step {found.step} and not {last}"
    if bool(row["contact_at_fault_count"]) != found.at_fault:
        return "another fault"
    return ""


def main() -> int:
    """Drive, compare and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=50, help="how many (default: %(default)s)")
    options = parser.parse_args()
    print("| world | changed | planner | seed | contact | at fault | here | disagrees |")
    print("|---|---|---|---|---|---|---|---|")
    contacts = at_fault = wrong = 0
    for scenario, planner, changed, given in runs(options.runs):
        ready = load_scenario(find_scenario(scenario), given)
        if planner == AT_RANDOM:
            ready = replace(ready, planner=AtRandom(given.seed))
        record = execute(ready, detailed=False)
        found = first_contact(record.steps)
        said = compare(record, found)
        row = record.row
        contacts += bool(row["contact_count"])
        at_fault += bool(row["contact_at_fault_count"])
        wrong += bool(said)
        time = "" if row["contact_first_s"] is None else f"{row['contact_first_s']:.2f} s"
        fault = {0: "", 1: "yes"}[min(1, row["contact_at_fault_count"])]
        blamed = ", at fault" if found is not None and found.at_fault else ""
        here = "" if found is None else f"step {found.step}, part {found.part}{blamed}"
        print(
            f"| {scenario} | {changed} | `{planner}` | {given.seed} | {time} | {fault} | {here} | {said} |",
            flush=True,
        )
    print(f"\n{options.runs} runs, {contacts} with a contact, {at_fault} of them at the ego's fault; {wrong} disagree.")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
