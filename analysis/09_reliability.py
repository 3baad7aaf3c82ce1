"""How often the planner ends in contact, and how many of its decisions are optimal: the table of the reliability study.

Reads what `sumo-hmdp study reliability --out DIR` has left so far and prints a page in Markdown, with one row for each
setting and the numbers that the method's authors report beside the total. A study that is not finished gives the
same page of what is there, and says how much that is.

    python analysis/09_reliability.py results/reliability --page docs/reliability.md
"""

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

import sumo_hmdp
from sumo_hmdp.metrics.proportion import ProportionInterval, Rate, clustered_proportion, rate
from sumo_hmdp.report.statistics import mean_interval
from sumo_hmdp.study.design import Design, load_design

DENSITY, LIMIT, DRIVERS = "traffic.density_vpkm_per_lane", "speed_limit", "drivers"
ENDED_WELL = ("completed", "contact")
# arXiv 2603.17802, abstract: 8,050 trials in 18 settings, 0.05 % collisions, 98.77 % nominal decisions.
AUTHORS_TRIALS, AUTHORS_COLLISIONS, AUTHORS_NOMINAL = 8050, 0.0005, 0.9877
NO_NUMBER = "-"

HEAD = """# Reliability

Written by `python analysis/09_reliability.py DIR --page docs/reliability.md` from what
`sumo-hmdp study reliability --out DIR` has left. What the settings are, and why, is said in
`scenarios/studies/reliability.yaml`. A run is 60 s in `highway`, with `hmdp_mpc` and the solver `search`.
"""
INTERVALS = "Intervals are exact, 95 %; that of the mean speed is Student's over runs."
TAIL = """The authors' numbers are those of arXiv 2603.17802: 8,050 trials in 18 settings, 0.05 % collisions (4 of
8,050), and 98.77 % of decisions by the nominal optimisation. We know its abstract only: their settings are others,
their method has margins that grow with speed and a hysteresis which ours has not, and whose fault the collisions were
is not said. The two rows are of one scale, not of one experiment.
"""


@dataclass(frozen=True)
class Summary:
    """What some runs show.

    Attributes:
        runs: how many ended well, by completion or contact.
        lost: how many did not, and count for nothing else.
        at_fault: the rate of runs with a contact at the ego's fault.
        contacts: runs with any contact.
        optimal: the share of decisions, corrected for how much alike those of one run are.
        relaxed: share of decisions.
        fallback: share of decisions.
        speed: mean over runs and the ends of its interval [m/s].
    """

    runs: int
    lost: int
    at_fault: Rate
    contacts: int
    optimal: ProportionInterval
    relaxed: float
    fallback: float
    speed: tuple[float, float, float]


def summarise(rows: pd.DataFrame) -> Summary:
    """Count runs and decisions of one setting, or of all."""
    ended = rows[rows["status"].isin(ENDED_WELL)]
    trials = ended["decision_count"].to_numpy(dtype=np.int64)
    # Shares of a run are whole numbers of decisions over their number.
    hits = {
        name: np.rint(ended[f"{name}_share"].to_numpy(dtype=np.float64) * trials).astype(np.int64)
        for name in ("optimal", "relaxed", "fallback")
    }
    decisions = int(trials.sum())
    speeds = ended["speed_mean_mps"].to_numpy(dtype=np.float64)
    ends = mean_interval(speeds) if len(speeds) > 1 else (float("nan"), float("nan"))
    return Summary(
        runs=len(ended),
        lost=len(rows) - len(ended),
        at_fault=rate(int((ended["contact_at_fault_count"] > 0).sum()), len(ended)),
        contacts=int((ended["contact_count"] > 0).sum()),
        optimal=clustered_proportion(hits["optimal"], trials),
        relaxed=float(hits["relaxed"].sum()) / decisions if decisions else float("nan"),
        fallback=float(hits["fallback"].sum()) / decisions if decisions else float("nan"),
        speed=(float(np.mean(speeds)) if len(speeds) else float("nan"), *ends),
    )


def percent(found: Rate | ProportionInterval, digits: int) -> str:
    """Return a rate and its interval in percent."""
    value = found.value if isinstance(found, Rate) else found.rate
    return f"{100 * value:.{digits}f} ({100 * found.low:.{digits}f} to {100 * found.high:.{digits}f})"


def cells_of(found: Summary) -> tuple[str, ...]:
    """Return the numbers of one row of the table."""
    if not found.runs:
        return ("0", *[NO_NUMBER] * 7)
    mean, low, high = found.speed
    return (
        f"{found.runs:,}",
        str(found.at_fault.hits),
        percent(found.at_fault, 2),
        str(found.contacts - found.at_fault.hits),
        percent(found.optimal, 2),
        f"{100 * found.relaxed:.2f}",
        f"{100 * found.fallback:.3f}",
        f"{mean:.1f} ({low:.1f} to {high:.1f})",
    )


def table(runs: pd.DataFrame, design: Design) -> list[str]:
    """Return the lines of the table: a row for each setting of the study, the total, and what the authors report."""
    headings = (
        "vehicles/km/lane", "limit", "drivers", "runs", "contacts at fault", "rate [%]", "other contacts",
        "decisions optimal [%]", "relaxed [%]", "fallback [%]", "mean speed [m/s]",
    )  # fmt: skip
    lines = [headings, ["---"] * len(headings)]
    for cell in design.cells:
        names = (f"{cell.factors[DENSITY]:g}", cell.factors[LIMIT], cell.factors[DRIVERS])
        lines.append((*names, *cells_of(summarise(runs[runs["cell"] == cell.id]))))
    lines.append(("all", "", "", *cells_of(summarise(runs))))
    collisions = rate(round(AUTHORS_COLLISIONS * AUTHORS_TRIALS), AUTHORS_TRIALS)
    lines.append(
        ("authors' 18", "", "", f"{AUTHORS_TRIALS:,}", str(collisions.hits), percent(collisions, 2), NO_NUMBER,
         f"{100 * AUTHORS_NOMINAL:.2f}", NO_NUMBER, NO_NUMBER, NO_NUMBER)
    )  # fmt: skip
    return [f"| {' | '.join(line)} |" for line in lines]


def part_of(runs: pd.DataFrame, design: Design) -> str:
    """Say how much of the study there is."""
    planned = len(design.cells) * len(design.seeds)
    counts = runs.groupby("cell").size().reindex([cell.id for cell in design.cells], fill_value=0)
    if len(runs) == planned:
        return f"All {planned:,} runs of the study: {len(design.cells)} settings with {len(design.seeds)} seeds each."
    return (
        f"**A part of the study**: {len(runs):,} of {planned:,} runs, {counts.min()} to {counts.max()} of the "
        f"{len(design.seeds)} seeds in each of {len(design.cells)} settings. The numbers are those of this part."
    )


def notes(runs: pd.DataFrame) -> list[str]:
    """Say what the table means, and name every run that a reader would look at first."""
    found = summarise(runs)
    lines = [
        (
            f"- Contact at the ego's fault in {found.at_fault.hits} of {found.runs:,} runs: at most "
            f"{100 * found.at_fault.high:.3f} % with 97.5 % confidence (Clopper and Pearson)."
        ),
        (
            f"- {found.optimal.violations:,} of {found.optimal.plans:,} decisions are optimal. A run's are alike: all "
            f"together tell what {found.optimal.effective_n:,.0f} independent ones would "
            f"({found.optimal.runs:,} runs), which the intervals reckon with."
        ),
        (
            f"- Background vehicles that touched each other: {int(runs['background_contact_count'].fillna(0).sum())} "
            "pairs. Anything above 0 would make a run worthless."
        ),
    ]
    if found.lost:
        counts = runs.loc[~runs["status"].isin(ENDED_WELL), "status"].value_counts()
        told = ", ".join(f"{count} {status}" for status, count in counts.items())
        lines.append(f"- **{found.lost} runs did not end well and are in no row**: {told}.")
    first = runs[runs["status"] != "completed"].sort_values("run_id").to_dict("records")
    return lines + [f"- `{row['run_id']}`: {row['status']}, {row['reason']}." for row in first]


def page(folder: Path) -> str:
    """Return the page of a study's folder."""
    design = load_design(folder / "study.yaml")
    runs = sumo_hmdp.load(folder).runs
    runs = runs[runs["cell"].isin([cell.id for cell in design.cells]) & runs["seed"].isin(design.seeds)]
    return "\n".join([HEAD, part_of(runs, design), "", *table(runs, design), "", INTERVALS, "", *notes(runs), "", TAIL])


def main() -> None:
    """Print the page, or write it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="as given to --out")
    parser.add_argument("--page", type=Path, help="write it there")
    arguments = parser.parse_args()
    text = page(arguments.folder)
    if arguments.page is None:
        print(text)
    else:
        arguments.page.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
