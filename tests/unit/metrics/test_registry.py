"""The registry refuses what it must, every metric says what it is, and the page is up to date."""

from pathlib import Path

import pytest

from sumo_hmdp.errors import InputError
from sumo_hmdp.metrics.catalogue import METRICS, metrics_page
from sumo_hmdp.metrics.registry import Better, Metric, Registry
from sumo_hmdp.study.record import RUN_COLUMNS

PAGE = Path(__file__).parents[3] / "docs" / "metrics.md"
WRITE = "from sumo_hmdp.metrics.catalogue import metrics_page; print(metrics_page(), end='')"


def test_duplicates_and_unknown_names_are_refused():
    registry = Registry()
    metric = Metric("gap_min_m", "smallest gap", "m", Better.HIGHER, "the smallest gap")
    registry.add(metric)
    assert registry.get("gap_min_m") is metric
    with pytest.raises(InputError, match="metric gap_min_m must be registered once"):
        registry.add(metric)
    with pytest.raises(InputError, match=r"got gap_min: did you mean `gap_min_m`\?"):
        registry.get("gap_min")


def test_every_metric_is_a_column_of_its_kind():
    assert set(METRICS.all) <= set(RUN_COLUMNS)
    for name, metric in METRICS.all.items():
        assert (RUN_COLUMNS[name].lower() == "int64") == metric.is_count
    # What a run is called and how it went is no metric.
    others = {"run_id", "scenario", "planner", "solver", "seed", "risk_level", "status", "reason", "reproducible"}
    assert others <= set(RUN_COLUMNS) - set(METRICS.all)


def test_every_metric_says_what_it_is():
    for metric in METRICS.all.values():
        assert metric.definition
        assert metric.label
        assert metric.unit or metric.is_count
        printed = metric.unit.replace("/km", "pkm").replace("m/s", "mps").replace("/s", "ps")
        assert metric.is_count or metric.name.endswith(("_share", "_rate") if metric.unit == "1" else (f"_{printed}",))


def test_the_page_is_up_to_date():
    assert PAGE.read_text(encoding="utf-8") == metrics_page(), f'write it anew: python -c "{WRITE}" > docs/metrics.md'


def test_every_metric_has_numbers_worked_by_hand():
    tests = [Path(__file__).parent, Path(__file__).parents[1] / "study" / "test_record.py"]
    files = [file for place in tests for file in ([place] if place.is_file() else sorted(place.glob("test_*.py")))]
    text = "".join(file.read_text(encoding="utf-8") for file in files if file.name != Path(__file__).name)
    assert not [name for name in METRICS.all if f'"{name}"' not in text]
