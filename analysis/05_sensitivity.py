"""What of the paper's three cases hangs on the choices that the paper leaves open?

Each open choice is varied by itself around the scenario's value, and the case's conclusion is looked for in what comes
out. Everything is solved by the exact search. Some minutes on two cores.

    python analysis/05_sensitivity.py > docs/sensitivity.md
"""

import argparse
import copy
import json
import multiprocessing
import tempfile
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml

from sumo_hmdp.decision.decide import answer
from sumo_hmdp.decision.first_actions import first_actions
from sumo_hmdp.decision.problem_file import read_problem
from sumo_hmdp.scenario.load import RunOptions, find_scenario, load_scenario
from sumo_hmdp.study.run import RunRecord, execute

PLANNER = "hmdp_mpc"
PREFERENCES = ("speed_weight", "desired_speed_mps", "speed_deadband_mps", "lane_weight", "goal_lane", "terminal_weight")
# The paper compares five risk levels and does not name them.
RISK_LEVELS = (0.001, 0.01, 0.05, 0.1, 0.3)
SAME_COST = 1e-6

Document = dict[str, Any]
Change = Callable[[Document], None]


@dataclass(frozen=True)
class Variant:
    """One row of a table.

    Attributes:
        case: 1, 2 or 3.
        choice: what is varied.
        value: its value, as shown; the scenario's own is in bold.
        document: the scenario.
    """

    case: int
    choice: str
    value: str
    document: Document


@dataclass(frozen=True)
class Outcome:
    """What came out of a variant: the cells of its row, and what becomes of the case's conclusion."""

    cells: tuple[str, ...]
    verdict: str


STANDS, SHORT, FALLS = "yes", "short", "**no**"


def verdict(*, concluded: bool, kept: bool) -> str:
    """Tell whether a conclusion stands, stands at the price of distances that are not kept, or does not."""
    if not concluded:
        return FALLS
    return STANDS if kept else SHORT


# ---- the open choices -------------------------------------------------------------------------------------------


def planner_value(key: str, value: float) -> Change:
    """Set a key of the planner."""

    def change(document: Document) -> None:
        document["planners"][PLANNER][key] = value

    return change


def noise(value: float) -> Change:
    """Set both variances of the position that the scenario has above 0 [m2]."""

    def change(document: Document) -> None:
        for vehicle in document["vehicles"]:
            for key in ("position_var_m2", "process_position_var_m2"):
                if vehicle[key] > 0:
                    vehicle[key] = value

    return change


def process_noise(value: float) -> Change:
    """Set the variance that each step adds to the position [m2]."""

    def change(document: Document) -> None:
        for vehicle in document["vehicles"]:
            vehicle["process_position_var_m2"] = value

    return change


def change_probability(value: float) -> Change:
    """Set the probability of each lane change that may happen, per step; where none may, of one into lane 1 or 2."""

    def change(document: Document) -> None:
        for vehicle in document["vehicles"]:
            for policy in vehicle["policy"]:
                table = policy["lateral_probs"]
                rows = list(table.values()) if "keep" not in table else [table]
                if all(row["keep"] == 1.0 for row in rows) and vehicle["id"].startswith("sv"):
                    rows[0]["left" if vehicle["lane"] > 1 else "right"] = 1.0
                for row in rows:
                    for side in ("left", "right"):
                        row[side] = value if row[side] > 0 else 0.0
                    row["keep"] = 1.0 - row["left"] - row["right"]

    return change


def lane_change_time(value: float) -> Change:
    """Set how long the ego's lane change takes [s]."""

    def change(document: Document) -> None:
        document["ego"]["lane_change_time_s"] = value

    return change


def sv1_top_speed(value: float) -> Change:
    """Set the speed up to which SV1 accelerates [m/s]."""

    def change(document: Document) -> None:
        document["vehicles"][0]["driver"]["speed_max_mps"] = value

    return change


def duration(value: float) -> Change:
    """Set how long the run takes [s]."""

    def change(document: Document) -> None:
        document["duration_s"] = value

    return change


def literal(_: float) -> Change:
    """Leave the paper's cost alone: no preferences."""

    def change(document: Document) -> None:
        for key in PREFERENCES:
            document["planners"][PLANNER].pop(key, None)

    return change


GRIDS: dict[int, tuple[tuple[str, Callable[[float], Change], tuple[float, ...], float | None], ...]] = {
    1: (
        ("desired speed [m/s]", lambda v: planner_value("desired_speed_mps", v), (18, 19, 20, 21, 22), 20),
        ("speed weight [s/m]", lambda v: planner_value("speed_weight", v), (1, 2, 2.5, 3, 4, 6), 3),
        ("speed dead band [m/s]", lambda v: planner_value("speed_deadband_mps", v), (0.8, 1, 1.6), 0.8),
        ("noise [m2]", noise, (0.005, 0.02, 0.1, 0.5, 0.9), 0.02),
        ("lane-change probability", change_probability, (1e-4, 0.01, 0.1, 0.3), 0.1),
        ("horizon [steps]", lambda v: planner_value("horizon_steps", int(v)), (2, 3, 4, 5), 3),
        ("risk level", lambda v: planner_value("risk_level", v), (0.001, 0.01, 0.05, 0.2), 0.05),
        ("lane-change time [s]", lane_change_time, (3, 4, 6), 4),
        ("duration [s]", duration, (50, 80), 50),
    ),
    2: (
        ("desired speed [m/s]", lambda v: planner_value("desired_speed_mps", v), (30, 31, 32, 33, 34), 32),
        ("speed weight [s/m]", lambda v: planner_value("speed_weight", v), (1, 2, 2.8, 3.1, 4, 6), 3.1),
        ("noise [m2]", noise, (0.005, 0.02, 0.05, 0.1, 0.5, 0.9), 0.02),
        ("lane-change probability", change_probability, (0, 0.001, 0.05), 0),
        ("horizon [steps]", lambda v: planner_value("horizon_steps", int(v)), (2, 3, 4, 5), 3),
        ("risk level", lambda v: planner_value("risk_level", v), (0.001, 0.01, 0.05, 0.2), 0.05),
        ("lane-change time [s]", lane_change_time, (4, 6, 8), 8),
        ("SV1's top speed [m/s]", sv1_top_speed, (28, 30, 32, 34, 36, 38), 38),
    ),
    3: (
        ("desired speed [m/s]", lambda v: planner_value("desired_speed_mps", v), (9, 10, 11, 12), 10),
        ("speed weight [s/m]", lambda v: planner_value("speed_weight", v), (1, 3, 6), 3),
        ("noise [m2]", noise, (0.3, 0.9, 2), 0.9),
        ("noise added per step [m2]", process_noise, (0, 0.02, 0.1, 0.9), 0),
        ("lane-change probability", change_probability, (0.01, 0.05, 0.1), 0.05),
        ("horizon [steps]", lambda v: planner_value("horizon_steps", int(v)), (2, 3, 5, 8), 3),
        ("lane-change time [s]", lane_change_time, (2, 2.5, 3, 4), 2.5),
    ),
}  # fmt: skip


def variants(case: int) -> Iterator[Variant]:
    """Yield the scenario, then each choice at each other value, then the paper's literal cost."""
    with find_scenario(f"case{case}").open(encoding="utf-8") as file:
        # By way of JSON, since what YAML's aliases share must be varied apart.
        base = json.loads(json.dumps(yaml.safe_load(file)))
    # Other planners have no part in this.
    base["planners"] = {PLANNER: base["planners"][PLANNER]}
    yield Variant(case, "the scenario", "", base)
    for choice, make, values, own in GRIDS[case]:
        for value in values:
            document = copy.deepcopy(base)
            make(value)(document)
            yield Variant(case, choice, f"**{value:g}**" if value == own else f"{value:g}", document)
    document = copy.deepcopy(base)
    literal(0)(document)
    yield Variant(case, "no preferences", "", document)


# ---- what comes out ---------------------------------------------------------------------------------------------


def outcome(variant: Variant) -> Outcome:
    """Run a variant and look for its case's conclusion."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "scenario.yaml"
        file.write_text(yaml.safe_dump(variant.document), encoding="utf-8")
        risk_levels = RISK_LEVELS if variant.case == 3 else (None,)
        records = [execute(load_scenario(file, RunOptions(solver="search", risk_level=e))) for e in risk_levels]
        for record in records:
            if record.traceback:
                raise RuntimeError(record.traceback)
        if variant.case == 3:
            return case3_outcome(records, Path(folder))
    return (case1_outcome if variant.case == 1 else case2_outcome)(records[0], variant.document)


def track(record: RunRecord, vehicle: str) -> pd.DataFrame:
    """Return the rows of one vehicle by time."""
    rows = record.steps[record.steps["vehicle_id"] == vehicle]
    return rows.set_index("time_s")


def changes(record: RunRecord) -> pd.DataFrame:
    """Return the decisions that change the lane."""
    return record.decisions[record.decisions["lateral"] != "keep"]


def uneventful(record: RunRecord) -> bool:
    """Tell whether a run came to its end without a contact."""
    return bool(record.status == "completed")


def kept(record: RunRecord) -> bool:
    """Tell whether every decision found a plan that keeps all distances."""
    return bool((record.decisions["status"] == "optimal").all())


def shares(record: RunRecord) -> str:
    """Return which decisions were not optimal, and by how much the worst of them fell short."""
    short = record.decisions[record.decisions["status"] != "optimal"]
    if record.status != "completed":
        return f"{record.status}: {record.reason}"
    if not len(short):
        return "all optimal"
    return f"{len(short)} of {len(record.decisions)} not optimal, worst {short['violation_m'].max():.2f} m short"


def kept_distance(record: RunRecord) -> float:
    """Return the least distance to a vehicle in the lane that the ego intended for the last period [m].

    It is between front bumpers, and read at the decisions: this is the distance that the decision before promised.
    """
    least = np.inf
    for before, time in zip(record.decisions["lane"], record.decisions["time_s"].iloc[1:], strict=False):
        scene = record.steps[np.isclose(record.steps["time_s"], time)]
        ego = scene[scene["vehicle_id"] == "ego"].iloc[0]
        others = scene[(scene["vehicle_id"] != "ego") & (scene["intended_lane"] == before)]
        least = min(least, (others["x_m"] - ego["x_m"]).abs().min() if len(others) else np.inf)
    return float(least)


CASE1_COLUMNS = (
    "lanes intended, and since when [s]", "lane at the end", "speed at the end [m/s]",
    "ahead of SV1 at the end [m]", "ahead of SV2 at the end [m]", "decisions",
)  # fmt: skip


def case1_outcome(record: RunRecord, document: Document) -> Outcome:
    """Lane 3, then between the vehicles to lane 1, at the desired speed with SV1 passed and every distance kept."""
    ego, moves = track(record, "ego"), changes(record)
    lead = {name: ego["x_m"] - track(record, name)["x_m"] for name in ("sv1", "sv2")}
    planner = document["planners"][PLANNER]
    wanted = planner.get("desired_speed_mps", document["ego"]["speed_mps"])
    # A tenth of a metre a second beside the dead band is the bicycle's.
    at_speed = abs(ego["speed_mps"].iloc[-1] - wanted) <= planner.get("speed_deadband_mps", 0.0) + 0.1
    lane_3 = moves[moves["lane"] == 3]
    gap_taken = False
    if len(lane_3):
        back = moves[(moves["time_s"] > lane_3["time_s"].iloc[0]) & (moves["lane"] == 2)]["time_s"]
        gap_taken = any(lead["sv1"].loc[t] > 0 > lead["sv2"].loc[t] for t in back)
    ahead = [series.iloc[-1] for series in lead.values()]
    concluded = bool(ego["intended_lane"].iloc[-1] == 1 and at_speed and gap_taken and ahead[0] > 0)
    route = ", ".join(f"{d.lane} at {d.time_s:.1f}" for d in moves.itertuples()) or "2 throughout"
    cells = (route, str(ego["lane"].iloc[-1]), f"{ego['speed_mps'].iloc[-1]:.1f}", *(f"{x:.0f}" for x in ahead))
    return Outcome((*cells, shares(record)), verdict(concluded=uneventful(record) and concluded, kept=kept(record)))


CASE2_COLUMNS = (
    "first change [s]", "back to lane 2 [s]", "overtakes SV2", "least distance kept [m]", "decisions",
    "SV1's hardest braking [m/s2]", "ego's distance [m]", "SV1's distance [m]", "ego's top speed [m/s]",
)  # fmt: skip


def case2_outcome(record: RunRecord, _: Document) -> Outcome:
    """Overtakes SV2, and returns to lane 2 with every distance kept and without making SV1 brake."""
    ego, moves = track(record, "ego"), changes(record)
    sv1, sv2 = track(record, "sv1"), track(record, "sv2")
    overtakes = bool(ego["x_m"].iloc[-1] > sv2["x_m"].iloc[-1])
    back = moves[moves["lateral"] == "right"]
    braking = max(0.0, -sv1["accel_mps2"].min())
    at_home = bool(len(back)) and ego["lane"].iloc[-1] == 2
    cells = (
        f"{moves['time_s'].iloc[0]:.1f}" if len(moves) else "none",
        f"{back['time_s'].iloc[-1]:.1f}" if at_home else "no",
        "yes" if overtakes else "no",
        f"{kept_distance(record):.1f}",
        shares(record),
        f"{braking:.1f}",
        f"{ego['x_m'].iloc[-1] - ego['x_m'].iloc[0]:.0f}",
        f"{sv1['x_m'].iloc[-1] - sv1['x_m'].iloc[0]:.0f}",
        f"{ego['speed_mps'].max():.1f}",
    )
    concluded = uneventful(record) and overtakes and at_home and braking == 0.0
    return Outcome(cells, verdict(concluded=concluded, kept=kept(record)))


CASE3_COLUMNS = ("first change [s]", "at x [m]", "as cheap from [s]", "all optimal", "touches SV1")


def case3_outcome(records: Sequence[RunRecord], folder: Path) -> Outcome:
    """The first lane change comes later and farther on for every larger risk level."""
    first = [changes(record).iloc[0] if len(changes(record)) else None for record in records]
    times = [np.inf if row is None else row["time_s"] for row in first]
    places = [np.inf if row is None else row["ego_x_m"] for row in first]
    early = [earliest_tie(record, folder) for record in records]
    optimal = all(kept(record) for record in records)
    touched = [f"{e:g}" for e, record in zip(RISK_LEVELS, records, strict=True) if record.status == "contact"]
    cells = (
        ", ".join(f"{t:.2f}" for t in times),
        ", ".join(f"{x:.1f}" for x in places),
        ", ".join("none" if t is None else f"{t:.2f}" for t in early),
        "yes" if optimal else "no",
        f"eps {', '.join(touched)}" if touched else "no",
    )
    rises = bool(np.isfinite(times).all() and (np.diff(times) > 0).all() and (np.diff(places) > 0).all())
    return Outcome(cells, verdict(concluded=rises, kept=optimal))


def earliest_tie(record: RunRecord, folder: Path) -> float | None:
    """Return the first decision at which a lane change at once is as cheap as what was chosen [s]."""
    file = folder / "problem.json"
    for time, chosen, document in zip(
        record.decisions["time_s"], record.decisions["objective"], record.documents, strict=True
    ):
        # A lane change costs something, so it is not as cheap as a plan that costs nothing.
        if document is None or chosen == 0.0:
            continue
        file.write_text(document, encoding="utf-8")
        problem = read_problem(file)
        found = answer(problem, "search")
        best = [a.objective for a in first_actions(problem, found) if a.lateral != 0 and a.objective is not None]
        if found.objective is not None and best and min(best) <= found.objective + SAME_COST:
            return float(time)
    return None


# ---- the page ---------------------------------------------------------------------------------------------------

INTRODUCTION = """# What hangs on the open choices

Generated by `python analysis/05_sensitivity.py > docs/sensitivity.md`; do not edit.

The paper leaves values open that its three cases need; the scenarios choose them, with a reason each. Here one of them
at a time is varied around the scenario's value (in bold), and `no preferences` is the paper's cost alone.

*Stands* is `yes` where the case's conclusion comes out, `short` where it does but some decision found no plan that
keeps every distance, and `no` where it does not."""

CONCLUSION_1 = """
the ego ends in lane 1 at the desired speed (within the dead band), with SV1 passed, by way of lane 3 and of the gap
between SV1 and SV2."""

CONCLUSION_2 = """
the ego overtakes SV2 and returns to lane 2, and SV1 never brakes. Distances covered are from the start; the least
distance kept is to a vehicle in the lane that the ego intended for the last period."""

CONCLUSION_3 = f"""
time and place of the first lane-change decision rise strictly over the risk levels {", ".join(map(str, RISK_LEVELS))}
(in this order in each cell). *As cheap from* is the first decision at which changing at once costs no more than what
was chosen: between plans of one cost the solver is free."""

CASES = {
    1: (CASE1_COLUMNS, CONCLUSION_1),
    2: (CASE2_COLUMNS, CONCLUSION_2),
    3: (CASE3_COLUMNS, CONCLUSION_3),
}


def page(case: int, rows: Sequence[tuple[Variant, Outcome]]) -> None:
    """Print the section of one case."""
    columns, conclusion = CASES[case]
    print(f"\n## Case {case}\n\nConclusion: {conclusion.strip()}\n")
    head = ("choice", "value", "stands", *columns)
    print(f"| {' | '.join(head)} |")
    print(f"|{'---|' * len(head)}")
    for variant, result in rows:
        print(f"| {' | '.join((variant.choice, variant.value, result.verdict, *result.cells))} |")
    print(f"\nIt stands in {sum(result.verdict == STANDS for _, result in rows)} of {len(rows)} rows.")
    for meaning, sought in (("Not all distances are kept", SHORT), ("It does not stand", FALLS)):
        found: dict[str, list[str]] = {}
        for variant, result in rows:
            if result.verdict == sought:
                found.setdefault(variant.choice, []).append(variant.value)
        if found:
            listed = "; ".join(f"{choice} {', '.join(values)}".strip() for choice, values in found.items())
            print(f"{meaning} for: {listed}.")


def main() -> None:
    """Run everything and print the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, nargs="+", default=[1, 2, 3], choices=(1, 2, 3))
    parser.add_argument("--processes", type=int, default=2)
    arguments = parser.parse_args()
    todo = [variant for case in arguments.cases for variant in variants(case)]
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(arguments.processes, mp_context=context) as pool:
        done = list(zip(todo, pool.map(outcome, todo), strict=True))
    print(INTRODUCTION)
    for case in arguments.cases:
        page(case, [row for row in done if row[0].case == case])


if __name__ == "__main__":
    main()
