"""How often intervals hold the truth and verdicts are false, on simulated studies whose truth is known.

    python analysis/17_coverage.py                # the tables of docs/studies.md, about six minutes of one core
    python analysis/17_coverage.py --studies 200  # a small version

Every interval and verdict is the product's own, but for those of the methods that were not chosen. Of a coverage from
1,000 studies, one standard error is 0.7 points at 95 %.
"""

import argparse
from collections.abc import Callable, Iterator
from functools import lru_cache

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import stats

from sumo_hmdp.metrics.proportion import PairedRates, clustered_proportion, rate
from sumo_hmdp.metrics.risk_audit import Verdict, judge
from sumo_hmdp.report.comparison import compare_all, pair_up
from sumo_hmdp.report.mean_test import MeanTest
from sumo_hmdp.report.statistics import mean_interval
from sumo_hmdp.study.schema import StoppingFile
from sumo_hmdp.study.stopping import half_width

FloatArray = NDArray[np.float64]
SIZES = (10, 20, 50)
PLANS = 32  # of a run of 20 s with a decision each 0.6 s
RATES, CORRELATIONS = (0.01, 0.05, 0.1), (0.0, 0.1, 0.3)
METRICS = 8  # of a study with two cells, as the report compares them


def log_normal(sigma: float) -> Callable[[np.random.Generator, tuple[int, ...]], FloatArray]:
    """Return a source of log-normal values whose mean is 0."""
    return lambda rng, shape: np.exp(sigma * rng.normal(size=shape)) - np.exp(sigma**2 / 2)


SOURCES = {
    "normal": lambda rng, shape: rng.normal(size=shape),
    "log-normal, sigma 0.5": log_normal(0.5),
    "log-normal, sigma 1": log_normal(1.0),
}


def student(values: FloatArray, rng: np.random.Generator) -> bool:
    """Tell whether Student's test keeps a mean of 0."""
    del rng
    return bool(stats.ttest_1samp(values, 0.0).pvalue > 0.05)


def sign_flips(values: FloatArray, rng: np.random.Generator) -> bool:
    """Tell whether the studentised sign-flip permutation test keeps a mean of 0."""
    flipped = values * rng.choice([-1.0, 1.0], (999, len(values)))
    t = np.abs(flipped.mean(axis=1)) / flipped.std(axis=1, ddof=1)
    return bool((1 + np.sum(t >= abs(values.mean()) / values.std(ddof=1) * (1 - 1e-12))) / 1000 > 0.05)


def bootstrap_t(values: FloatArray, rng: np.random.Generator) -> bool:
    """Tell whether the bootstrap-t alone keeps a mean of 0."""
    drawn = values[rng.integers(0, len(values), (999, len(values)))]
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (drawn.mean(axis=1) - values.mean()) / drawn.std(axis=1, ddof=1)
    t = t[np.isfinite(t)]
    own = values.mean() / values.std(ddof=1)
    return bool(2 * (1 + min(np.sum(t <= own), np.sum(t >= own))) / (len(t) + 1) > 0.05)


def chosen(values: FloatArray, rng: np.random.Generator) -> bool:
    """Tell whether the product's test keeps a mean of 0."""
    del rng
    return MeanTest(values).p_value() > 0.05


METHODS = {"Student's t": student, "sign flips": sign_flips, "bootstrap-t": bootstrap_t, "both t (chosen)": chosen}


def percent(hits: float, studies: int) -> str:
    """Return a share in percent with its standard error."""
    share = hits / studies
    return f"{100 * share:.1f} ± {100 * np.sqrt(share * (1 - share) / studies):.1f}"


def choice(studies: int, rng: np.random.Generator) -> Iterator[tuple[str, ...]]:
    """Yield how often each method keeps the true mean; what is missing to 100 % are its false discoveries."""
    yield "differences", "pairs", *METHODS
    for name, draw in SOURCES.items():
        for n in SIZES:
            samples = draw(rng, (studies, n))
            kept = (sum(method(sample, rng) for sample in samples) for method in METHODS.values())
            yield name, str(n), *(percent(count, studies) for count in kept)


@lru_cache(maxsize=100_000)
def paired(more: int, fewer: int, pairs: int) -> tuple[float, float, float]:
    """Return the ends of the interval and the p of 0."""
    found = PairedRates(more, fewer, pairs)
    return *found.interval(), found.p_value()


def paired_rates(studies: int, rng: np.random.Generator) -> Iterator[tuple[str, ...]]:
    """Yield coverage and false discoveries of the difference of two rates on the same seeds."""
    yield "rates", "pairs", "coverage [%]", "false discoveries [%]"
    for one, two in ((0.01, 0.01), (0.05, 0.05), (0.1, 0.1), (0.05, 0.01), (0.1, 0.01), (0.1, 0.05)):
        for n in SIZES:
            common = rng.random((studies, n))
            # Half of the seeds are as hard for the one as for the other.
            own = np.where(rng.random((studies, n)) < 0.5, common, rng.random((studies, n)))
            a, b = common < one, own < two
            found = [paired(*map(int, (np.sum(x & ~y), np.sum(y & ~x))), n) for x, y in zip(a, b, strict=True)]
            held = sum(low <= one - two <= high for low, high, _ in found)
            alarms = percent(sum(p <= 0.05 for _, _, p in found), studies) if one == two else "-"
            yield f"{100 * one:g} % and {100 * two:g} %", str(n), percent(held, studies), alarms


def cell_values(studies: int, rng: np.random.Generator) -> Iterator[tuple[str, ...]]:
    """Yield coverage of the mean, or of the rate, that one cell has."""
    yield "values", "runs", "coverage [%]"
    for name, draw in SOURCES.items():
        for n in SIZES:
            ends = [mean_interval(sample) for sample in draw(rng, (studies, n))]
            yield f"mean, {name}", str(n), percent(sum(low <= 0 <= high for low, high in ends), studies)
    for p in RATES:
        for n in SIZES:
            found = [rate(int(hits), n) for hits in rng.binomial(n, p, studies)]
            held = sum(one.low <= p <= one.high for one in found)
            yield f"rate of runs, {100 * p:g} %", str(n), percent(held, studies)


def violation_rates(studies: int, rng: np.random.Generator) -> Iterator[tuple[str, ...]]:
    """Yield coverage and false verdicts of the rate of violated plans, asked for just what is true."""
    yield "rate", "correlation in a run", "runs", "coverage [%]", "false `violated` [%]", "false `conservative` [%]"
    for p in RATES:
        for correlation in CORRELATIONS:
            for n in SIZES:
                true = np.full((studies, n), p)
                if correlation:
                    spread = 1 / correlation - 1
                    true = rng.beta(p * spread, (1 - p) * spread, (studies, n))
                found = [clustered_proportion(hits, [PLANS] * n) for hits in rng.binomial(PLANS, true)]
                held = sum(one.low <= p <= one.high for one in found)
                above = sum(judge(one, p) is Verdict.VIOLATED for one in found)
                below = sum(judge(one, 2 * p) is Verdict.CONSERVATIVE for one in found)
                told = (percent(count, studies) for count in (held, above, below))
                yield f"{100 * p:g} %", f"{correlation:g}", str(n), *told


def families(studies: int, rng: np.random.Generator) -> Iterator[tuple[str, ...]]:
    """Yield how many studies of eight metrics show any difference where there is none, after Holm's correction."""
    yield "differences", "pairs", "studies with a false discovery [%]"
    for name, draw in SOURCES.items():
        for n in SIZES:
            alarms = 0
            for values in draw(rng, (studies, METRICS, n)):
                both = [(pd.Series(one), pd.Series(np.zeros(n))) for one in values]
                found = compare_all([pair_up(*pair, "x", ("a", "b"), binary=False) for pair in both])
                alarms += any(one.shown for one in found)
            yield name, str(n), percent(alarms, studies)


def stopped(studies: int, rng: np.random.Generator) -> Iterator[tuple[str, ...]]:
    """Yield bias and coverage of what a study says that ends once its interval is narrow enough."""
    yield "rule", "values", "seeds at the end", "bias", "coverage [%]"
    means = StoppingFile(metric="gap_min_m", half_width=0.3, seeds_min=10, seeds_max=400, batch_count=10)
    wide = means.model_copy(update={"seeds_min": 50, "batch_count": 50})
    share = StoppingFile(metric="contact_rate", half_width=0.05, seeds_min=20, seeds_max=400, batch_count=20)
    for rule in (means, wide):
        for name, draw in SOURCES.items():
            yield told(rule, name, [stop(rule, draw(rng, (rule.seeds_max,))) for _ in range(studies)], 0.0)
    for p in RATES:
        hits = (rng.random(share.seeds_max) < p for _ in range(studies))
        yield told(share, f"{100 * p:g} %", [stop(share, one.astype(float)) for one in hits], p)


def stop(rule: StoppingFile, values: FloatArray) -> tuple[int, float, float, float]:
    """Return the seeds at the end, the estimate, and the ends of its interval."""
    n = rule.seeds_min
    while n < rule.seeds_max and half_width(_runs(values[:n], rule.metric), rule.metric, 0.95) > rule.half_width:
        n = min(n + rule.batch_count, rule.seeds_max)
    low, high = _ends(values[:n], rule.metric)
    return n, float(values[:n].mean()), low, high


def _runs(values: FloatArray, metric: str) -> pd.DataFrame:
    status = np.where(values > 0, "contact", "completed") if metric == "contact_rate" else "completed"
    return pd.DataFrame({"seed": range(len(values)), "status": status, metric: values})


def _ends(values: FloatArray, metric: str) -> tuple[float, float]:
    if metric == "contact_rate":
        found = rate(int(values.sum()), len(values))
        return found.low, found.high
    return mean_interval(values)


def told(rule: StoppingFile, name: str, found: list[tuple[int, float, float, float]], truth: float) -> tuple[str, ...]:
    """Return one row: the rule, what it measured, and what became of it."""
    seeds, estimates, low, high = (np.array(column) for column in zip(*found, strict=True))
    held = np.sum((low <= truth) & (truth <= high))
    kind = f"{rule.metric.split('_')[0]} within {rule.half_width:g}, from {rule.seeds_min} by {rule.batch_count}"
    bias = f"{estimates.mean() - truth:+.4f} ± {estimates.std(ddof=1) / np.sqrt(len(found)):.4f}"
    return kind.replace("gap", "mean"), name, f"{np.median(seeds):.0f}", bias, percent(float(held), len(found))


TABLES = {
    "Methods for the mean difference: coverage [%]": choice,
    "Differences of rates": paired_rates,
    "Values of one cell": cell_values,
    f"Violated plans, {PLANS} a run": violation_rates,
    f"Studies of {METRICS} metrics without any difference": families,
    "Studies that stop once an interval is narrow enough": stopped,
}


def main() -> None:
    """Print every table as Markdown."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--studies", type=int, default=1000)
    given = parser.parse_args()
    for seed, (title, table) in enumerate(TABLES.items()):
        rng = np.random.default_rng(seed)
        count = max(given.studies // 4, 50) if table in {families, stopped} else given.studies
        head, *rows = table(count, rng)
        print(f"\n{title} ({count:,} studies a row)\n")
        for line in (head, ["---"] * len(head), *rows):
            print(f"| {' | '.join(line)} |", flush=True)


if __name__ == "__main__":
    main()
