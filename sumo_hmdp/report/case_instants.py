"""The instants of the paper's snapshots, what its text lets happen at each, and when that happens in a run.

The paper names six instants in each of Cases 1 and 2 and tells the course of events in words, without saying which
event belongs to which instant. The readings here take the events in the order of its text.
"""

from collections.abc import Iterable
from dataclasses import dataclass

from sumo_hmdp.domain.maneuver import Lateral, Mode
from sumo_hmdp.report.case_data import CaseDecision, CaseRun
from sumo_hmdp.report.case_numbers import arrives_at

# The paper's snapshots [s]. Case 1's show the state one control step of 0.2 s after the decision, by their caption.
CASE1_SNAPSHOTS = (12.2, 21.0, 23.4, 29.8, 30.6, 41.0)
CASE1_DECISIONS = (12.0, 20.8, 23.2, 29.6, 30.4, 40.8)
CASE2_SNAPSHOTS = (0.00, 5.85, 12.45, 14.85, 29.25, 36.15)
# When the paper gives distances [s], and what it says that EV and SV1 cover in Case 2 [m].
DISTANCES_AT = 45.0
PROPOSED_EV, PROPOSED_SV1 = 1400.0, 1300.0


@dataclass(frozen=True)
class Instant:
    """One snapshot.

    Attributes:
        label: its letter.
        paper: when, in the paper [s]; of Case 1 its decision.
        what: what happens then, as we read the text.
        ours: when that happens in the run [s], None if never.
        there: what the ego of the run does at the paper's instant.
    """

    label: str
    paper: float
    what: str
    ours: float | None
    there: str


def case1_instants(run: CaseRun) -> tuple[Instant, ...]:
    """Return the six of Case 1; the text says of none which it is."""
    into3 = _first(d for d in run.changes() if d.lane == 3)
    returns = [d.time for d in run.changes() if d.lateral is Lateral.LEFT and into3 is not None and d.time > into3]
    back = [*returns, None, None]
    modes = mode_changes(run)
    following = [t for t in modes if into3 is not None and t > into3 and (not returns or t < returns[0])]
    slower, other = _in_order(following, CASE1_DECISIONS[1:3])
    resumes = [d.time for d in run.decisions if d.time in modes and d.mode is Mode.CRUISE and returns]
    resumes = [time for time in resumes if time > returns[-1]]
    found = (
        ("changes to lane 3, behind SV2", into3),
        ("changes its mode while it follows SV2", slower),
        ("changes its mode again", other),
        ("begins to return: lane 2", back[0]),
        ("goes on to lane 1", back[1]),
        ("resumes cruising in lane 1", resumes[-1] if resumes else None),
    )
    return _instants(run, CASE1_DECISIONS, found)


def case2_readings(run: CaseRun) -> dict[str, tuple[Instant, ...]]:
    """Return the six of Case 2 by both readings of the last two, which the text leaves open."""
    accelerates, brakes = begins_mode(run, Mode.ACCELERATE), begins_mode(run, Mode.DECELERATE)
    left = next((d for d in run.changes() if d.lateral is Lateral.LEFT), None)
    right = next((d for d in run.changes() if d.lateral is Lateral.RIGHT), None)
    change = left.time if left is not None else None
    again = next((t for t in accelerates if change is not None and t > change), None)
    slows = next((t for t in brakes if again is not None and t > again), None)
    later = [t for t in brakes if slows is not None and t > slows]
    first = (
        ("accelerates", accelerates[0] if accelerates else None),
        ("begins its lane change", change),
        ("accelerates again, since SV1 closes in", again),
        ("has passed SV2 and slows down", slows),
    )
    returns = right.time if right is not None else None
    early = (
        ("begins to return to lane 2", returns),
        ("is back on the centre of lane 2", arrives_at(run, right) if right is not None else None),
    )
    late = (
        ("slows down further", min(later, key=lambda t: abs(t - CASE2_SNAPSHOTS[4]), default=None)),
        ("begins to return to lane 2", returns),
    )
    return {
        "early": _instants(run, CASE2_SNAPSHOTS, (*first, *early)),
        "late": _instants(run, CASE2_SNAPSHOTS, (*first, *late)),
    }


def case2_instants(run: CaseRun) -> tuple[Instant, ...]:
    """Return the six of Case 2 by the reading that the run is nearer to."""
    return min(
        case2_readings(run).values(),
        key=lambda instants: sum(min(abs(i.ours - i.paper), 12.0) if i.ours is not None else 12.0 for i in instants),
    )


def case2_places(run: CaseRun) -> tuple[tuple[str, float, float], ...]:
    """Return (name, ours, the paper's) of the places after 45 s [m]."""
    rows = (("EV", run.ego, PROPOSED_EV), ("SV1", run.motions["sv1"], PROPOSED_SV1))
    return tuple((name, float(motion.x[motion.index(DISTANCES_AT)]), paper) for name, motion, paper in rows)


def mode_changes(run: CaseRun) -> tuple[float, ...]:
    """Return when the ego changes its mode [s]; it begins in cruise."""
    before = [Mode.CRUISE, *(decision.mode for decision in run.decisions)]
    return tuple(d.time for previous, d in zip(before, run.decisions, strict=False) if d.mode is not previous)


def begins_mode(run: CaseRun, mode: Mode) -> tuple[float, ...]:
    """Return when the ego begins to be in a mode [s]."""
    changes = mode_changes(run)
    return tuple(d.time for d in run.decisions if d.mode is mode and d.time in changes)


def _first(decisions: Iterable[CaseDecision]) -> float | None:
    return next((decision.time for decision in decisions), None)


def _in_order(times: list[float], papers: tuple[float, float]) -> tuple[float | None, float | None]:
    """Return two times in order, each as near to the paper's as the order lets it be."""
    pairs = [(a, b) for i, a in enumerate(times) for b in times[i + 1 :]]
    if not pairs:
        return (times[0], None) if times else (None, None)
    return min(pairs, key=lambda pair: abs(pair[0] - papers[0]) + abs(pair[1] - papers[1]))


def _instants(
    run: CaseRun, papers: tuple[float, ...], found: Iterable[tuple[str, float | None]]
) -> tuple[Instant, ...]:
    return tuple(
        Instant(label, paper, what, ours, _doing(run, paper))
        for label, paper, (what, ours) in zip("abcdef", papers, found, strict=True)
    )


def _doing(run: CaseRun, time: float) -> str:
    decision, ego = run.decision_at(time), run.ego
    return f"lane {decision.lane}, {decision.mode.label}, {float(ego.speed[ego.index(time)]):.1f} m/s"
