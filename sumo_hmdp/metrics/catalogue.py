"""The catalogue of all metrics, and its page docs/metrics.md."""

import textwrap

from sumo_hmdp.metrics.comfort import COMFORT
from sumo_hmdp.metrics.conflict import CONFLICT
from sumo_hmdp.metrics.decisions import DECISIONS
from sumo_hmdp.metrics.efficiency import EFFICIENCY
from sumo_hmdp.metrics.registry import Better, Metric, Registry
from sumo_hmdp.metrics.safety import SAFETY

GROUPS = {
    "Efficiency": EFFICIENCY,
    "Safety along the lane": SAFETY,
    "Conflicts": CONFLICT,
    "Comfort": COMFORT,
    "Decisions and counts": DECISIONS,
}

_INTRODUCTION = """\
# Metrics

Columns of `runs`, computed once a run from its `steps` and `decisions` before `--trace` thins them out. Written by
`metrics_page()` of `sumo_hmdp/metrics/catalogue.py`; do not edit.

A value that is not defined is missing. `inf` stands only where it is said, for more than was seen.
Medians hold with it, a mean does not exist; statistics say how many values were missing or infinite.
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
    return "\n".join(parts)


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
