"""Names of planners and solvers without importing any, so that the tab key answers at once."""

import sys
from functools import lru_cache
from importlib.metadata import EntryPoint, entry_points

ENTRY_POINT_GROUP = "sumo_hmdp.planners"
# Tests compare them with what is there.
BUILT_IN_PLANNERS = ("hmdp_mpc", "idm_mobil", "idm_mobil_published", "constant", "sumo", "python")
SOLVER_NAMES = ("milp", "search", "both")


def planner_names() -> tuple[str, ...]:
    """Return the names of all planners; of other packages those of their entry points, which need not import."""
    return tuple(sorted({*BUILT_IN_PLANNERS, *(entry.name for entry in offered())}))


def offered() -> tuple[EntryPoint, ...]:
    """Return what installed packages offer."""
    return _offered(tuple(sys.path))


@lru_cache(maxsize=4)
def _offered(path: tuple[str, ...]) -> tuple[EntryPoint, ...]:
    """Return what the packages on a path offer; looking through all of them takes several milliseconds."""
    del path
    return tuple(entry_points(group=ENTRY_POINT_GROUP))
