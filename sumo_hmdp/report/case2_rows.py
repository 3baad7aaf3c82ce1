"""What the paper claims of its Case 2 and of the comparison with rules, row by row, against what our runs give."""

from collections.abc import Iterator

import numpy as np

from sumo_hmdp.domain.maneuver import Lateral, Mode
from sumo_hmdp.report.case_claims import Row, changes_told, distance_row, number, statement, told
from sumo_hmdp.report.case_data import CaseRun, Motion
from sumo_hmdp.report.case_instants import DISTANCES_AT, PROPOSED_EV, PROPOSED_SV1, begins_mode
from sumo_hmdp.report.case_numbers import (
    ARRIVED,
    arrives_at,
    hardest_decel,
    lane_at,
    mean_speed,
    overtakes_at,
)

# What the paper says that EV and SV1 cover under the rules [m].
RULES_EV, RULES_SV1 = 1250.0, 1150.0
# What the published code of the rules gives instead [m].
PUBLISHED_EV, PUBLISHED_SV1 = 1375.3, 1323.8
# From when SV1 may be faster, in the paper [s].
FASTER_FROM = 7.8
SPEED, ACCEL = "m/s", "m/s\N{SUPERSCRIPT TWO}"


def case2_rows(run: CaseRun, literal: CaseRun) -> Iterator[Row]:
    """Yield the claims of Case 2 under the proposed planner.

    Args:
        run: Case 2.
        literal: the same with the paper's cost alone.
    """
    ego, sv2 = run.ego, run.motions["sv2"]
    accelerates, brakes = begins_mode(run, Mode.ACCELERATE), begins_mode(run, Mode.DECELERATE)
    left = next((d for d in run.changes() if d.lateral is Lateral.LEFT), None)
    right = next((d for d in run.changes() if d.lateral is Lateral.RIGHT), None)
    begins, arrives = (left.time, arrives_at(run, left)) if left is not None else (None, None)
    second = next((time for time in accelerates if begins is not None and time > begins), None)
    yield statement(
        "The EV accelerates at first and then changes to lane 1",
        f"accelerates at {told(accelerates[0] if accelerates else None, 2)} s, changes lanes at {told(begins, 2)} s",
        holds=bool(accelerates) and begins is not None and accelerates[0] < begins,
    )
    early = second is not None and arrives is not None and second < arrives
    yield statement(
        "SV1 closes in during the change and the EV accelerates again before it is completed",
        f"second acceleration at {told(second, 2)} s; within {100 * ARRIVED:g} cm of the lane's centre at "
        f"{told(arrives, 2)} s",
        holds=early,
        why=""
        if early
        else "When SV1 comes too near hangs on how it drives; that, and the time of a lane change, is open.",
    )
    passed, slower = overtakes_at(ego, sv2), brakes[0] if brakes else None
    yield statement(
        "After overtaking SV2 it slows down toward the desired speed",
        f"ahead of SV2 at {told(passed, 2)} s, slows down from {told(slower, 2)} s",
        holds=passed is not None and slower is not None and passed < slower,
    )
    cap = run.vehicle_file("sv1")["driver"]["speed_max_mps"]
    yield statement(
        "SV1 approaches from behind and the EV returns to lane 2",
        f"it begins to return at {told(right.time if right is not None else None, 2)} s",
        holds=right is not None,
        why=f"When it does hangs on SV1: ours drives up to {cap:g} m/s, as in the published code of the rules.",
    )
    yield distance_row(run, "It keeps sufficient safety margins")
    yield from _distances(run, cap)
    yield from _motion_rows(run)
    yield statement(
        "The cost is c alone",
        f"with c alone (`{literal.name}`): lane changes {changes_told(literal.changes())}, "
        f"{told(float(literal.ego.speed[-1]))} m/s at the end",
        holds=bool(literal.changes()),
        why="As in Case 1: nothing in c values speed.",
    )


def _distances(run: CaseRun, cap: float) -> Iterator[Row]:
    desired, deadband = run.parameters["desired_speed_mps"], run.parameters["speed_deadband_mps"]
    sv1 = run.motions["sv1"]
    start = float(sv1.x[0]) + float(sv1.speed[0]) * FASTER_FROM
    paper_speed = (PROPOSED_SV1 - start) / (DISTANCES_AT - FASTER_FROM)
    passes = overtakes_at(sv1, run.ego)
    wanted = f"The speed that the paper's EV wants is open; ours wants {desired:g} m/s, within {deadband:g} m/s."
    slow = (
        f"The paper's SV1 drives {told(paper_speed)} m/s on average after {FASTER_FROM:g} s; how is open. Ours gets to "
        f"{cap:g} m/s, as in the published code of the rules, and is "
        f"{'never ahead of the ego' if passes is None else f'ahead of the ego from {told(passes, 2)} s on'}."
    )
    rows = (("EV", run.ego, PROPOSED_EV, wanted), ("SV1", sv1, PROPOSED_SV1, slow))
    for name, motion, paper, why in rows:
        yield number(f"{name} after {DISTANCES_AT:g} s", x_at(motion), "m", paper=paper, about=True, why=why)


def _motion_rows(run: CaseRun) -> Iterator[Row]:
    """Yield numbers that the paper does not give, for comparing the planners."""
    for name, motion in (("the EV", run.ego), ("SV1", run.motions["sv1"])):
        yield number(f"(not given) mean speed of {name}", mean_speed(motion), SPEED)
        yield number(f"(not given) hardest braking of {name}", hardest_decel(motion), ACCEL)


def x_at(motion: Motion) -> float:
    """Return where a vehicle is when the paper gives distances [m]."""
    return float(motion.x[motion.index(DISTANCES_AT)])


def rule_rows(run: CaseRun, proposed: CaseRun) -> Iterator[Row]:
    """Yield the claims of the rule-based comparison.

    Args:
        run: the rule-based run.
        proposed: Case 2 under the proposed planner.
    """
    ego, sv1, sv2 = run.ego, run.motions["sv1"], run.motions["sv2"]
    decided = next((decision.time for decision in run.changes()), None)
    off = next((float(t) for t, y in zip(ego.times, ego.y, strict=True) if y != run.center_y(2)), None)
    there = next((float(t) for t, y in zip(ego.times, ego.y, strict=True) if y == run.center_y(1)), None)
    changed = np.flatnonzero(sv1.speed != sv1.speed[0])
    before = float(sv1.times[changed[0] - 1]) if len(changed) else None
    speed_then = float(sv1.speed[sv1.index(FASTER_FROM)])
    yield number("The EV begins its lane change: decided", decided, "s", paper=5.85, digits=2)
    yield number("The same: first instant off the centre of lane 2", off, "s", published=6.0, digits=2)
    yield number("SV1 begins to accelerate: last instant at its first speed", before, "s", paper=FASTER_FROM, digits=2)
    yield number("The same: its speed then", speed_then, SPEED, published=25.0)
    yield number("The lane change is complete", there, "s", published=13.95, digits=2)
    yield number("Peak speed of SV1", float(sv1.speed.max()), SPEED, published=36.25, digits=2)
    yield number("SV1 has to brake abruptly: hardest braking", hardest_decel(sv1), ACCEL, published=3.0)
    passed, lane = overtakes_at(ego, sv2), lane_at(run, ego, float(ego.times[-1]))
    yield statement(
        "The EV overtakes SV2, stays in lane 1 and does not return",
        f"ahead of SV2 at {told(passed, 2)} s, in lane {lane} after {ego.times[-1]:g} s",
        holds=passed is not None and lane == 1,
    )
    rows = (("EV", ego, RULES_EV, PUBLISHED_EV), ("SV1", sv1, RULES_SV1, PUBLISHED_SV1))
    for name, motion, paper, published in rows:
        off_by = told(x_at(motion) - paper, 0, sign=True)
        why = f"The paper's text and its authors' published code differ; ours is that code's, {off_by} m to the text."
        claim = f"{name} after {DISTANCES_AT:g} s"
        yield number(claim, x_at(motion), "m", paper=paper, published=published, about=True, why=why)
    yield from _motion_rows(run)
    farther = 100 * (x_at(proposed.ego) / x_at(ego) - 1)
    wants = proposed.parameters["desired_speed_mps"], run.parameters["desired_speed_mps"]
    yield number(
        "The proposed planner is more efficient: how much farther the EV gets",
        farther,
        "%",
        paper=100 * (PROPOSED_EV / RULES_EV - 1),
        why=f"Part of it is what they want: {wants[0]:g} m/s with the planner, {wants[1]:g} m/s with the rules.",
    )
    gentle, hard = hardest_decel(proposed.motions["sv1"]), hardest_decel(sv1)
    yield statement(
        "The proposed planner prevents sudden braking of SV1",
        f"SV1 brakes with at most {told(gentle)} {ACCEL} behind the planner, {told(hard)} {ACCEL} behind the rules",
        holds=gentle < hard,
    )
    gentle, hard = hardest_decel(proposed.ego), hardest_decel(ego)
    yield statement(
        "It moves the EV more smoothly",
        f"the EV brakes with at most {told(gentle)} {ACCEL} with the planner, {told(hard)} {ACCEL} with the rules",
        holds=gentle < hard,
        why="There is little between them.",
    )
