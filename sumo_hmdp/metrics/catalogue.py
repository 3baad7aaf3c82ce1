"""The catalogue of all metrics, and its page docs/metrics.md."""

import textwrap

from sumo_hmdp.metrics.comfort import COMFORT, RATE_WINDOW, TIME_BASE
from sumo_hmdp.metrics.conflict import CONFLICT
from sumo_hmdp.metrics.decisions import DECISIONS
from sumo_hmdp.metrics.efficiency import EFFICIENCY
from sumo_hmdp.metrics.registry import Better, Metric, Registry
from sumo_hmdp.metrics.risk import RISK
from sumo_hmdp.metrics.safety import SAFETY

GROUPS = {
    "Efficiency": EFFICIENCY,
    "Safety along the lane": SAFETY,
    "Conflicts": CONFLICT,
    "Risk": RISK,
    "Comfort": COMFORT,
    "Decisions and counts": DECISIONS,
}

_INTRODUCTION = f"""\
# Metrics

Columns of `runs`, computed once a run from its `steps` and `decisions` before `--trace` thins them out. Written by
`metrics_page()` of `sumo_hmdp/metrics/catalogue.py`; do not edit.

A value that is not defined is missing. `inf` stands only where it is said, for more than was seen.
Medians hold with it, a mean does not exist; statistics say how many values were missing or infinite.

Comfort is looked at on a *time base*: every {TIME_BASE:g} s, straight between the recorded instants. A *mean rate of
change* is over {RATE_WINDOW:g} s (at most half of the run) around such a time. So jerk and the other rates compare
between scenarios of different `dt_s`: halving it changes their root mean squares by less than 5 %, for steps up to
0.2 s (`tests/unit/metrics/test_time_base.py`). Minima, maxima and shares of the other groups are over the recorded
instants.
"""

_SSM = """\
## Beside SUMO's SSM device
In car-following `ttc_min_s` and `drac_max_mps2` are what SUMO's surrogate safety measures give at every instant, to the
two decimals that SUMO writes; `tests/integration/test_ssm_device.py` drives both over one scene. Known differences:

- **Who counts.** Here every vehicle whose body is in the path of the ego's, ahead and behind, at any distance. The
  device goes by SUMO's lanes and its own kinds of encounters, within `device.ssm.range` (50 m), and leaves out
  neighbours to whom only lateral motion leads; for these there is `ttc2d_min_s`.
- **The gap.** Both are bumper to bumper. SUMO's getters of the leader give it less the follower's `minGap`.
- **When.** The device speaks of the encounters that last; here minima and maxima are over the whole run.
- **Without closing** the device has no value; here the time is `inf`, the deceleration 0.
- **In contact** the device keeps the deceleration of the last instant before; here it is `inf`. The time is 0 in both.
"""


def _all_metrics() -> Registry:
    registry = Registry()
    for metrics in GROUPS.values():
        for metric in metrics:
            registry.add(metric)
    return registry


METRICS = _all_metrics()


def metrics_page() -> str:
    """Return docs/metrics.md."""
    parts = [_INTRODUCTION]
    for title, metrics in GROUPS.items():
        parts.append(f"## {title}\n" + "\n".join(_entry(metric) for metric in metrics) + "\n")
    return "\n".join([*parts, _SSM])


def _entry(metric: Metric) -> str:
    """Return one metric as a list item."""
    unit = "" if metric.unit in {"", "1"} else f" [{metric.unit}]"
    facts = [
        f"defined where {metric.defined}" if metric.defined != "always" else "",
        metric.censoring,
        f"{metric.better} is better" if metric.better is not Better.NEITHER else "",
        f"threshold {metric.threshold:g}" if metric.threshold is not None else "",
        metric.reference,
    ]
    rest = "; ".join(fact for fact in facts if fact)
    text = f"`{metric.name}`{unit}, {metric.label}: {metric.definition}." + (f" ({rest}.)" if rest else "")
    return textwrap.fill(text, 120, initial_indent="- ", subsequent_indent="  ", break_on_hyphens=False)
