"""How near the ego came to others, along its path; conflicts across it are in conflict.py."""

from collections.abc import Callable

import numpy as np

from sumo_hmdp.metrics.registry import Better, Metric, RunData
from sumo_hmdp.metrics.shortfall import worst_shortfall
from sumo_hmdp.metrics.trace import FloatArray, Trace, greatest, least

# Where exposure to short times to collision begins [s].
TTC_EXPOSURE = 2.0
IN_PATH = "a vehicle is in the path: bodies overlap across the road"
SSM = "SUMO's SSM device"


def ttc(trace: Trace) -> FloatArray:
    """Return the time to collision with each vehicle in the path, shape (T, V) [s]: inf unless closing."""
    closing = trace.closing_speed
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        time = np.where(closing > 0, np.maximum(trace.gap, 0.0) / closing, np.inf)
    return np.where(np.isnan(trace.gap), np.nan, time)


def mttc(trace: Trace) -> FloatArray:
    """Return the time to collision at present accelerations, shape (T, V) [s].

    The smallest root t >= 0 of da t^2 / 2 + dv t = gap with closing speed dv and closing acceleration da; inf without
    one. Written as 2 gap / (dv + sqrt(dv^2 + 2 da gap)), it holds for da = 0 as well.
    """
    gap, dv, da = np.maximum(trace.gap, 0.0), trace.closing_speed, trace.closing_accel
    discriminant = dv**2 + 2 * da * gap
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        bottom = dv + np.sqrt(discriminant)
        time = np.where((discriminant >= 0) & (bottom > 0), 2 * gap / bottom, np.inf)
    touching: FloatArray = np.where((dv > 0) | (da > 0), 0.0, np.inf)
    return np.where(np.isnan(trace.gap), np.nan, np.where(gap == 0, touching, time)).astype(np.float64)


def drac(trace: Trace) -> FloatArray:
    """Return the deceleration that avoids each collision, shape (T, V) [m/s2]: 0 unless closing."""
    closing = np.maximum(trace.closing_speed, 0.0)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        needed = np.where(closing > 0, closing**2 / (2 * np.maximum(trace.gap, 0.0)), 0.0)
    return np.where(np.isnan(trace.gap), np.nan, needed)


def time_gap(trace: Trace) -> FloatArray:
    """Return the time gap of the ego to each vehicle ahead in the path, shape (T, V) [s]: inf at a standstill."""
    speed = trace.ego.speed
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        time = np.where(speed > 0, np.maximum(trace.gap, 0.0) / speed, np.inf)
    return np.where(np.isnan(trace.gap) | ~trace.ahead, np.nan, time)


def _nearest_ttc(trace: Trace) -> FloatArray:
    """Return the smallest time to collision of each instant, shape (T,) [s]: inf without any."""
    return np.asarray(np.min(np.nan_to_num(ttc(trace), nan=np.inf, posinf=np.inf), axis=1, initial=np.inf))


def time_exposed(run: RunData) -> float:
    """Return the time with a time to collision of at most `TTC_EXPOSURE` [s]."""
    return float(np.sum(run.trace.duration[_nearest_ttc(run.trace) <= TTC_EXPOSURE]))


def time_integrated(run: RunData) -> float:
    """Return the integral of what the time to collision lacks of `TTC_EXPOSURE` [s2]."""
    return float(np.sum(run.trace.duration * np.maximum(TTC_EXPOSURE - _nearest_ttc(run.trace), 0.0)))


def per_km(value: float, run: RunData) -> float:
    """Return a value per kilometre that the ego drove, NaN where it drove none."""
    distance = float(run.trace.ego.x[-1, 0] - run.trace.ego.x[0, 0])
    return 1000 * value / distance if distance > 0 else float("nan")


def at_most_zero(values: Callable[[Trace], FloatArray]) -> Callable[[RunData], float]:
    """Return a function for the least of some values, which is at most 0 in a run with a contact.

    Bodies may meet between two instants, or turned, which no value at an instant shows.
    """
    return lambda run: least(np.append(values(run.trace), 0.0 if run.contact else np.nan))


def _of_leaders(values: Callable[[Trace], FloatArray]) -> Callable[[RunData], float]:
    """Return the same for vehicles ahead, whom the ego meets with its front."""

    def compute(run: RunData) -> float:
        ahead = np.where(run.trace.ahead, values(run.trace), np.nan)
        return least(np.append(ahead, 0.0 if run.front_contact else np.nan))

    return compute


def _drac_max(run: RunData) -> float:
    return greatest(np.append(drac(run.trace), np.inf if run.contact else np.nan))


def _shortfall(run: RunData) -> float:
    return float("nan") if run.kept is None else worst_shortfall(run.trace, run.kept)


_LENGTH_BIAS = "the minimum of a longer run is lower: compare runs of equal length"
_ONLY_FINITE = f"inf where no pair ever closed; {_LENGTH_BIAS}"
_MINDERHOUD = "Minderhoud and Bovy, Accid. Anal. Prev. 33 (2001)"

SAFETY = (
    Metric(
        "gap_min_m", "smallest gap", "m", Better.HIGHER,
        "smallest distance bumper to bumper to a vehicle in the path; negative while two bodies overlap along it, "
        "at most 0 in a run with a contact",
        f"{IN_PATH}, or there is a contact", _LENGTH_BIAS, 0.0, "", at_most_zero(lambda trace: trace.gap),
    ),
    Metric(
        "time_gap_min_s", "smallest time gap", "s", Better.HIGHER,
        "smallest gap to a vehicle ahead in the path, at least 0, over the ego's speed; inf at a standstill; 0 in a "
        "run with a contact of the ego's front",
        "a vehicle ahead is in the path", _LENGTH_BIAS, None, "", _of_leaders(time_gap),
    ),
    Metric(
        "ttc_min_s", "smallest time to collision", "s", Better.HIGHER,
        "smallest gap, at least 0, over the closing speed to a vehicle ahead or behind in the path while it closes, "
        "else inf; 0 in a run with a contact",
        f"{IN_PATH}, or there is a contact", _ONLY_FINITE, 3.0,
        f"Hayward, Highway Res. Rec. 384 (1972); threshold of {SSM}", at_most_zero(ttc),
    ),
    Metric(
        "ttc_leader_min_s", "smallest time to collision with a leader", "s", Better.HIGHER,
        "as `ttc_min_s`, to vehicles ahead only, those that the ego itself closes in on; 0 in a run with a contact of "
        "the ego's front",
        "a vehicle ahead is in the path", _ONLY_FINITE, 3.0, "as `ttc_min_s`",
        _of_leaders(ttc),
    ),
    Metric(
        "mttc_min_s", "smallest modified time to collision", "s", Better.HIGHER,
        "smallest t >= 0 with da t^2 / 2 + dv t = gap (at least 0), dv and da closing speed and acceleration; else "
        "inf; 0 in a run with a contact",
        f"{IN_PATH}, or there is a contact", _ONLY_FINITE, None, "Ozbay et al., Transp. Res. Rec. 2083 (2008)",
        at_most_zero(mttc),
    ),
    Metric(
        "tet_s", "time exposed to a short time to collision", "s", Better.LOWER,
        f"time during which the smallest time to collision is at most {TTC_EXPOSURE} s",
        censoring="grows with the length of a run", threshold=TTC_EXPOSURE, reference=_MINDERHOUD,
        compute=time_exposed,
    ),
    Metric(
        "tit_s2", "time integrated of short times to collision", "s2", Better.LOWER,
        f"integral over time of {TTC_EXPOSURE} s less the smallest time to collision, where that is positive",
        censoring="grows with the length of a run", threshold=TTC_EXPOSURE, reference=_MINDERHOUD,
        compute=time_integrated,
    ),
    Metric(
        "tet_spkm", "time exposed per kilometre", "s/km", Better.LOWER, "`tet_s` per kilometre that the ego drove",
        "the ego moved", reference=_MINDERHOUD, compute=lambda run: per_km(time_exposed(run), run),
    ),
    Metric(
        "tit_s2pkm", "time integrated per kilometre", "s2/km", Better.LOWER,
        "`tit_s2` per kilometre that the ego drove", "the ego moved",
        reference=_MINDERHOUD, compute=lambda run: per_km(time_integrated(run), run),
    ),
    Metric(
        "drac_max_mps2", "largest deceleration needed", "m/s2", Better.LOWER,
        "largest (closing speed)^2 / (2 gap) to a vehicle ahead or behind in the path; 0 while none closes",
        f"{IN_PATH}, or there is a contact",
        "inf where bodies overlap along the road while they close, and in a run with a contact", 3.0,
        f"threshold of {SSM}", _drac_max,
    ),
    Metric(
        "distance_shortfall_max_m", "worst shortfall of the safe distance", "m", Better.LOWER,
        "most that was missing to the safe distance of the planner's own rule at any instant, to a vehicle to which "
        "the decision in force kept a distance and that took up a lane which the ego took up, by the planner's own "
        "rule; the whole distance where one passed through the other between two instants; 0 where nothing was "
        "missing. Plans keep the distance at the ends of their steps only",
        "the planner has a safe distance", "the maximum of a longer run is higher: compare runs of equal length", None,
        "docs/guarantees.md, what no rule covers", _shortfall,
    ),
)  # fmt: skip
