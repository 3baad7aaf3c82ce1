"""How near the ego came to others, along its path; conflicts across it are in conflict.py."""

import numpy as np

from sumo_hmdp.metrics.registry import Better, Metric, RunData
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


_LENGTH_BIAS = "the minimum of a longer run is lower: compare runs of equal length"
_ONLY_FINITE = f"inf where no pair ever closed; {_LENGTH_BIAS}"
_MINDERHOUD = "Minderhoud and Bovy, Accid. Anal. Prev. 33 (2001)"

SAFETY = (
    Metric(
        "gap_min_m", "smallest gap", "m", Better.HIGHER,
        "smallest distance bumper to bumper to a vehicle in the path; negative while two bodies overlap along the road",
        IN_PATH, _LENGTH_BIAS, 0.0, "", lambda run: least(run.trace.gap),
    ),
    Metric(
        "time_gap_min_s", "smallest time gap", "s", Better.HIGHER,
        "smallest gap to a vehicle ahead in the path, at least 0, over the ego's speed; inf at a standstill",
        "a vehicle ahead is in the path", _LENGTH_BIAS, None, "", lambda run: least(time_gap(run.trace)),
    ),
    Metric(
        "ttc_min_s", "smallest time to collision", "s", Better.HIGHER,
        "smallest gap, at least 0, over the closing speed to a vehicle ahead or behind in the path while it closes, "
        "else inf",
        IN_PATH, _ONLY_FINITE, 3.0, f"Hayward, Highway Res. Rec. 384 (1972); threshold of {SSM}",
        lambda run: least(ttc(run.trace)),
    ),
    Metric(
        "ttc_leader_min_s", "smallest time to collision with a leader", "s", Better.HIGHER,
        "as `ttc_min_s`, to vehicles ahead only: those that the ego itself closes in on",
        "a vehicle ahead is in the path", _ONLY_FINITE, 3.0, "as `ttc_min_s`",
        lambda run: least(np.where(run.trace.ahead, ttc(run.trace), np.nan)),
    ),
    Metric(
        "mttc_min_s", "smallest modified time to collision", "s", Better.HIGHER,
        "smallest t >= 0 with da t^2 / 2 + dv t = gap (at least 0), dv and da closing speed and acceleration; else inf",
        IN_PATH, _ONLY_FINITE, None, "Ozbay et al., Transp. Res. Rec. 2083 (2008)", lambda run: least(mttc(run.trace)),
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
        IN_PATH, "inf where bodies overlap along the road while they close", 3.0, f"threshold of {SSM}",
        lambda run: greatest(drac(run.trace)),
    ),
)  # fmt: skip
