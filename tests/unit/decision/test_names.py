"""Names for the tab key are those of what is there, and cost no import of it."""

import subprocess
import sys

from sumo_hmdp.decision.decide import SOLVERS
from sumo_hmdp.decision.names import BUILT_IN_PLANNERS, SOLVER_NAMES, planner_names
from sumo_hmdp.decision.registry import BUILT_IN, planner_kinds


def test_the_names_are_those_of_what_is_there():
    assert tuple(kind.name for kind in BUILT_IN) == BUILT_IN_PLANNERS
    assert planner_names() == tuple(sorted(planner_kinds()))
    assert SOLVER_NAMES == SOLVERS


def test_completing_a_planner_or_solver_imports_neither():
    code = (
        "import sys; from sumo_hmdp.cli_common import complete_planner, complete_solver;"
        "print(complete_planner('idm'), complete_solver('s'), 'numpy' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-P", "-c", code], capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout.strip() == "['idm_mobil', 'idm_mobil_published'] ['search'] False"
