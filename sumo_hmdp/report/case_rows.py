"""What the paper claims of its Cases 1 and 3, and of all cases, row by row, against what our runs give."""

from collections.abc import Iterator, Sequence
from itertools import pairwise

from sumo_hmdp.domain.maneuver import Lateral, Mode
from sumo_hmdp.report.case3_figures import moment, never_earlier, place
from sumo_hmdp.report.case_claims import Row, changes_told, distance_row, statement, told
from sumo_hmdp.report.case_data import CaseDecision, CaseRun
from sumo_hmdp.report.case_numbers import arrives_at, lane_at, overtakes_at, worst_joint_probability


def case1_rows(run: CaseRun, literal: CaseRun) -> Iterator[Row]:
    """Yield the claims of Case 1.

    Args:
        run: Case 1.
        literal: the same with the paper's cost alone.
    """
    sv1, sv2, ego = run.motions["sv1"], run.motions["sv2"], run.ego
    first, last = run.decisions[0], run.decisions[-1]
    yield statement(
        "Initially the EV cruises in lane 2 at constant speed",
        f"lane changes: {changes_told(run.changes())}; {told(float(ego.speed[ego.index(2.4)]))} m/s after 2.4 s",
        holds=first.lane == 2,
        why=f"SV2 is only {told(float(sv2.x[0] - ego.x[0]), 0)} m ahead then, and may merge in the first step with "
        f"probability {told(_enters(first, 'sv2', 2), 2)}. That branch takes the {run.safe_distance or 0.0:g} m that "
        f"the paper asks for from every plan that keeps lane 2: none is feasible, while lane 1 is free.",
    )
    passed = overtakes_at(ego, sv1)
    passed_lane = lane_at(run, ego, passed) if passed is not None else None
    yield statement(
        "Both SVs may merge into lane 2, so the EV does not overtake straight ahead",
        f"it passes SV1 at {told(passed)} s, in lane {passed_lane}",
        holds=passed_lane not in {None, 2},
    )
    ahead = overtakes_at(sv2, sv1)
    yield statement("The green vehicle (SV2) passes the blue one (SV1)", f"at {told(ahead)} s", holds=ahead is not None)
    into, out = _stay(run, 3)
    spell = [k for k, time in enumerate(ego.times) if into is not None and into <= time < (out or ego.times[-1])]
    nearest = min((float(sv2.x[k] - ego.x[k]) for k in spell), default=None)
    yield statement(
        "The EV changes to lane 3 behind the faster SV and follows it for a time",
        f"it intends lane 3 from {told(into)} to {told(out)} s, at least {told(nearest)} m behind SV2",
        holds=nearest is not None and nearest > 0,
    )
    yield statement(
        "After that it returns to lane 1 and resumes cruising",
        f"lane {last.lane}, {last.mode.label}, {told(float(ego.speed[-1]))} m/s at the end",
        holds=last.lane == 1 and last.mode is Mode.CRUISE,
    )
    yield distance_row(run, "It keeps safe distances")
    ends = [float(literal.motions[name].x[-1]) for name in ("sv1", "sv2")]
    stalls = float(literal.ego.x[-1]) < min(ends)
    yield statement(
        "The cost is c alone",
        f"with c alone (`{literal.name}`): {changes_told(literal.changes())}; {told(float(literal.ego.speed[-1]))} m/s "
        f"and {'behind' if stalls else 'not behind'} both SVs after {literal.ego.times[-1]:g} s, "
        f"{told(float(literal.ego.x[-1] - ego.x[-1]), 0, sign=True)} m against `{run.name}`",
        holds=not stalls,
        why="Nothing in c values speed: once slow, the ego stays slow, since accelerating costs and cruising is free. "
        "The paper's return to lane 1 takes a preference for speed, which its general J allows.",
    )


def _enters(decision: CaseDecision, vehicle_id: str, lane: int) -> float:
    """Return the probability that a vehicle intends a lane after the first step."""
    return sum(b.probability for b in decision.branches if b.vehicle_id == vehicle_id and b.lanes[0] == lane)


def _stay(run: CaseRun, lane: int) -> tuple[float | None, float | None]:
    """Return when the ego begins and when it ends to intend a lane [s], for the first time."""
    inside = [decision for decision in run.decisions if decision.lane == lane]
    if not inside:
        return None, None
    after = [d.time for d in run.decisions if d.time > inside[0].time and d.lane != lane]
    return inside[0].time, after[0] if after else None


def case3_rows(runs: Sequence[CaseRun], more: Sequence[CaseRun]) -> Iterator[Row]:
    """Yield the claims of Case 3.

    Args:
        runs: of the risk levels that are compared, the smallest first.
        more: of all risk levels that were run, the smallest first.
    """
    changing = [run for run in more if run.changes()]
    later = sum(moment(b) > moment(a) for a, b in pairwise(changing))
    from_to = [f"{told(moment(run), 2)} s and {told(place(run))} m" for run in changing]
    yield statement(
        "A smaller risk level changes lanes earlier, in time and along the road",
        f"at {len(changing)} of {len(more)} levels the ego changes lanes, from {from_to[0]} to {from_to[-1]}; from "
        f"level to level it is later {later} times of {len(changing) - 1}"
        if changing
        else "no lane change",
        holds=bool(changing) and never_earlier(changing),
        why=f"Decisions fall on multiples of {runs[0].period:g} s, so neighbouring levels may share one.",
    )
    counts = {len(decision.branches) for run in runs for decision in run.decisions}
    dropped = max(decision.pruned_prob for run in runs for decision in run.decisions)
    yield statement(
        "With delta = 0.2 only the likeliest maneuver of each SV is kept",
        f"branches a decision: {', '.join(map(str, sorted(counts)))}, for {len(runs[0].motions) - 1} SVs; up to "
        f"{told(dropped, 2)} of a vehicle's probability is dropped",
        holds=counts == {len(runs[0].motions) - 1},
        why="What is dropped carries no constraint, so no risk level can be promised for it.",
    )
    touching = [run for run in runs if run.row["contact_count"]]
    where = ", ".join(f"{run.risk_level:g} (at {told(float(run.ego.times[-1]), 2)} s)" for run in touching)
    distance, bodies = runs[0].safe_distance or 0.0, runs[0].motions["sv1"].length
    change_time = runs[0].configuration["ego"]["lane_change_time_s"]
    yield statement(
        "Decisions are safe, at every level",
        f"the ego touches SV1 at risk level {where}" if touching else "no contact",
        holds=not touching,
        why=f"{distance:g} m between front bumpers are {told(distance - bodies)} m between vehicles, and the paper's "
        f"rule drops SV1 the instant the ego intends another lane. The time of a lane change is open; ours is "
        f"{change_time:g} s. `occupancy: swept` counts the lane that is being left.",
    )


def joint_rows(runs: Sequence[tuple[str, CaseRun]]) -> Iterator[Row]:
    """Yield, per named run, the largest probability that the joint constraint is violated, against the risk level."""
    for name, run in runs:
        level = run.risk_level or 0.0
        joint = worst_joint_probability(run)
        events = (len(run.motions) - 1) * max(len(decision.plan) for decision in run.decisions)
        yield Row(
            f"{name}: any distance falls short within the horizon, with probability at most",
            told(level, 3),
            "",
            told(joint, 4),
            "holds" if joint <= level else "does not hold",
            f"{events} events of probability {level:g} each: up to {told(1 - (1 - level) ** events, 3)} if all are at "
            f"their bound and independent.",
        )


def lateral_rows(run: CaseRun) -> Iterator[Row]:
    """Yield which way y goes in a lane change to the left."""
    left = next((decision for decision in run.changes() if decision.lateral is Lateral.LEFT), None)
    end = arrives_at(run, left) if left is not None else None
    if left is None or end is None:
        return
    moved = float(run.ego.y[run.ego.index(end)] - run.ego.y[run.ego.index(left.time)])
    formula, tables = -run.lane_width, run.lane_width
    yield Row(
        "Lateral displacement of an action a_lat = \N{MINUS SIGN}1 (left)",
        f"{told(formula, sign=True)} m by its formula, {told(tables, sign=True)} m by its tables",
        "",
        f"{told(moved, sign=True)} m",
        "as in the tables" if moved > 0 else "as in the formula",
        "The formula multiplies the lane width by a_lat, but the tables of initial conditions put lane 1, the "
        "leftmost, at y = +4 m.",
    )
