"""How many runs a study needs, judged from a pilot."""

from collections.abc import Callable

import numpy as np
from scipy import stats

from sumo_hmdp.errors import InputError

# With fewer pairs, resamples have too few values to choose from for their tails to mean anything.
FEWEST_PAIRS = 6
# A study that needs more is not worth planning; it also ends the search.
MOST_RUNS = 1_000_000


def runs_for_half_width(std: float, half_width: float, level: float = 0.95) -> int:
    """Return the least number of runs whose mean has an interval of plus or minus `half_width`.

    Args:
        std: standard deviation in a pilot; of the differences where pairs are compared.
        half_width: > 0, in the unit of `std`.
        level: of the interval.

    Raises:
        InputError: if an argument is out of its range or no number of runs suffices.
    """
    _require_positive({"std": std, "half_width": half_width})
    return _least(lambda n: bool(stats.t.ppf((1 + level) / 2, n - 1) * std / np.sqrt(n) <= half_width))


def pairs_for_difference(std: float, difference: float, significance: float = 0.05, power: float = 0.8) -> int:
    """Return the least number of pairs with which a paired t-test finds a true difference.

    Its power is that of the noncentral t distribution (Cohen, Statistical Power Analysis, 1988).

    Args:
        std: standard deviation of the differences in a pilot.
        difference: the smallest one that matters, > 0, in the unit of `std`.
        significance: two-sided.
        power: the probability with which it shall be found.

    Raises:
        InputError: if an argument is out of its range or no number of pairs suffices.
    """
    _require_positive({"std": std, "difference": difference})
    effect = difference / std

    def enough(n: int) -> bool:
        critical = float(stats.t.ppf(1 - significance / 2, n - 1))
        shift = effect * float(np.sqrt(n))
        # The other tail adds nothing that counts once the power is of use; the normal law serves where n is large.
        found = stats.nct.sf(critical, n - 1, shift) if n < 1000 else stats.norm.sf(critical - shift)
        return bool(found >= power)

    return _least(enough)


def pairs_for_rates(comparisons: int, significance: float = 0.05) -> int:
    """Return the least number of pairs in which a difference of two rates can be shown after Holm's correction.

    The score of n pairs, all of which differ the same way, is the root of n.

    Args:
        comparisons: how many are corrected together, >= 1.
        significance: two-sided, of all together.
    """
    return max(FEWEST_PAIRS, int(np.ceil(stats.norm.isf(significance / comparisons / 2) ** 2)))


def runs_for_no_violation(risk_level: float, level: float = 0.95) -> int:
    """Return the least number of runs whose interval, without any violation, is not above a risk level.

    The bound of Clopper and Pearson is 1 - ((1 - level) / 2)^(1/n).

    Args:
        risk_level: in (0, 1).
        level: of the interval, two-sided.
    """
    return int(np.ceil(np.log((1 - level) / 2) / np.log1p(-risk_level)))


def _least(enough: Callable[[int], bool]) -> int:
    """Return the least n >= 2 that is enough, where more never is less."""
    high = 2
    while not enough(high):
        high *= 2
        if high > MOST_RUNS:
            raise InputError([f"no study of up to {MOST_RUNS} runs is large enough. Ask for a larger difference"])
    low = high // 2
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if enough(middle) else (middle, high)
    return max(high, 2)


def _require_positive(values: dict[str, float]) -> None:
    problems = [f"{name} must be above 0, got {value}" for name, value in values.items() if not value > 0]
    if problems:
        raise InputError(problems)
