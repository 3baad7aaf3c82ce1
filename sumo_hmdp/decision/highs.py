"""HiGHS under the Pyomo model: compiled once a shape, filled with numbers and solved once a decision.

Every coefficient of the model is a constant or a constant times one datum (a fixed variable of
`decision/milp_data.py`). Compiling reads this off the Pyomo expressions, so that filling in a decision is one sparse
matrix-vector product instead of a new Pyomo model.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import highspy
import numpy as np
import pyomo.environ as pyo
from numpy.typing import NDArray
from pyomo.repn import generate_standard_repn
from scipy import sparse

from sumo_hmdp.decision.affine import Affine, AffineBuilder
from sumo_hmdp.decision.milp import build_model
from sumo_hmdp.decision.milp_data import Shape

FloatArray = NDArray[np.float64]

# Objectives must agree with an enumeration to 1e-6; positions are integers, so whole columns can be near whole.
OPTIONS: dict[str, Any] = {
    "output_flag": False,
    "threads": 1,
    "mip_rel_gap": 0.0,
    "mip_abs_gap": 1e-9,
    "mip_feasibility_tolerance": 1e-9,
    "primal_feasibility_tolerance": 1e-9,
    "dual_feasibility_tolerance": 1e-9,
    # What small problems do not need: sub-MIP heuristics, symmetry, restarts.
    "mip_heuristic_run_feasibility_jump": False,
    "mip_heuristic_run_rins": False,
    "mip_heuristic_run_rens": False,
    "mip_heuristic_run_root_reduced_cost": False,
    "mip_detect_symmetry": False,
    "mip_allow_restart": False,
}
# Presolving a model with fewer columns takes longer than solving it (analysis/04_decision_times.py measures it).
PRESOLVE_FROM_COLUMNS = 200


@dataclass(frozen=True)
class CompiledModel:
    """A model of one shape, ready to be filled in.

    Attributes:
        shape: what it was compiled for.
        columns: where the columns of each decision variable lie, by name; indices run in row-major order.
        slots: where the data of each name lie, likewise.
        column_count: number of columns.
        slot_count: number of data.
        rows: (nonzeros,) row of each coefficient; coefficients are sorted by column, then row.
        cols: (nonzeros,) its column.
        row_count: number of rows.
        numbers: values of the coefficients, then lower and upper bounds of the rows, then costs of the columns.
        integer: (columns,) 1 where a column is binary, else 0.
        high: (columns,) upper bounds of the columns; all lower ones are 0.
    """

    shape: Shape
    columns: Mapping[str, slice]
    slots: Mapping[str, slice]
    column_count: int
    slot_count: int
    rows: NDArray[np.int32]
    cols: NDArray[np.int32]
    row_count: int
    numbers: Affine
    integer: NDArray[np.int32]
    high: FloatArray

    def filled(self, data: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return coefficients, lower and upper bounds of the rows, and costs of the columns for some data."""
        numbers = self.numbers.at(data)
        low, high, cost = (len(self.rows) + n * self.row_count for n in range(3))
        return numbers[:low], numbers[low:high], numbers[high:cost], numbers[cost:]

    @property
    def window_shape(self) -> tuple[int, int, int, int]:
        """Steps, openings, speed levels, phases: of an array with a place for every window of the model, and more."""
        shape = self.shape
        if not shape.levelled:
            return shape.steps, shape.windows, 1, 1
        return shape.steps, shape.windows, 2 * shape.steps + 1, 1 + shape.stopping

    @cached_property
    def window_mask(self) -> NDArray[np.bool_]:
        """Which places of such an array are windows: step k ends at most k speed levels from the present one."""
        steps, levels = self.window_shape[0], self.window_shape[2]
        near = np.abs(np.arange(levels) - levels // 2) <= np.arange(1, steps + 1)[:, None]
        return np.broadcast_to(near[:, None, :, None], self.window_shape)


def _numbered(block: pyo.Block) -> tuple[dict[str, slice], list[Any]]:
    """List the variables of a block, and where those of each name lie in the list."""
    places: dict[str, slice] = {}
    variables: list[Any] = []
    for component in block.component_objects(pyo.Var, descend_into=False):
        start = len(variables)
        variables.extend(component.values())
        places[component.local_name] = slice(start, len(variables))
    return places, variables


@lru_cache(maxsize=128)
def compile_model(shape: Shape) -> CompiledModel:
    """Build the Pyomo model of a shape and read its coefficients off.

    Raises:
        ValueError: if a row is not linear in the columns, or not affine in the data.
    """
    model = build_model(shape)
    slots, data = _numbered(model.data)
    columns, unknowns = _numbered(model)
    slot = {id(variable): number for number, variable in enumerate(data)}
    column = {id(variable): number for number, variable in enumerate(unknowns)}
    coefficients, low, high = AffineBuilder(), AffineBuilder(), AffineBuilder()
    rows: list[int] = []
    cols: list[int] = []
    for number, row in enumerate(model.component_data_objects(pyo.Constraint)):
        terms, constant, shifts = _terms(row.body, slot, column)
        for at, factor, datum in terms:
            position = coefficients.add(factor if datum is None else 0.0)
            if datum is not None:
                coefficients.depend(position, datum, factor)
            rows.append(number)
            cols.append(at)
        for bound, builder, missing in ((row.lower, low, -np.inf), (row.upper, high, np.inf)):
            position = builder.add(missing if bound is None else pyo.value(bound) - constant)
            if bound is not None:
                for datum, factor in shifts:
                    builder.depend(position, datum, -factor)
    cost = AffineBuilder()
    for _ in unknowns:
        cost.add()
    for at, factor, datum in _terms(model.cost.expr, slot, column)[0]:
        if datum is None:
            cost.constant[at] += factor
        else:
            cost.depend(at, datum, factor)
    entries = coefficients.build(len(data))
    # By column, then row, as HiGHS wants them; terms of one relation with the same column add up.
    places, place = np.unique(np.stack([cols, rows]), axis=1, return_inverse=True)
    adding = sparse.csr_array(
        (np.ones(len(rows)), (place.ravel(), np.arange(len(rows)))), shape=(places.shape[1], len(rows))
    )
    parts = [
        Affine(adding @ entries.constant, sparse.csr_array(adding @ entries.matrix)),
        *(builder.build(len(data)) for builder in (low, high, cost)),
    ]
    integer = np.array([variable.is_binary() for variable in unknowns], dtype=np.int32)
    return CompiledModel(
        shape=shape,
        columns=columns,
        slots=slots,
        column_count=len(unknowns),
        slot_count=len(data),
        rows=places[1].astype(np.int32),
        cols=places[0].astype(np.int32),
        row_count=len(low.constant),
        numbers=Affine(
            np.concatenate([part.constant for part in parts]),
            sparse.csr_array(sparse.vstack([part.matrix for part in parts])),
        ),
        integer=integer,
        high=np.where(integer == 1, 1.0, highspy.kHighsInf),
    )


def _terms(
    expression: Any,  # noqa: ANN401 - Pyomo has no types
    slot: Mapping[int, int],
    column: Mapping[int, int],
) -> tuple[list[tuple[int, float, int | None]], float, list[tuple[int, float]]]:
    """Split an expression into (column, factor, datum or None), its constant, and (datum, factor) without column."""
    linear = generate_standard_repn(expression, quadratic=True)
    if linear.nonlinear_expr is not None:
        raise ValueError(f"a relation must be linear in the columns, got {linear.nonlinear_expr}")
    terms: list[tuple[int, float, int | None]] = []
    shifts: list[tuple[int, float]] = []
    for variable, factor in zip(linear.linear_vars, linear.linear_coefs, strict=True):
        if id(variable) in column:
            terms.append((column[id(variable)], factor, None))
        else:
            shifts.append((slot[id(variable)], factor))
    for (one, other), factor in zip(linear.quadratic_vars, linear.quadratic_coefs, strict=True):
        datum, unknown = (one, other) if id(one) in slot else (other, one)
        if id(datum) not in slot or id(unknown) not in column:
            raise ValueError(f"a relation must be affine in the data, got {one} * {other}")
        terms.append((column[id(unknown)], factor, slot[id(datum)]))
    return terms, float(linear.constant), shifts


@dataclass(frozen=True)
class MilpResult:
    """What HiGHS answered.

    Attributes:
        status: HiGHS' model status in words.
        values: of the columns, None where there is no solution.
    """

    status: str
    values: FloatArray | None

    @property
    def optimal(self) -> bool:
        """Tell whether the values are a proven optimum."""
        return self.status == "Optimal"

    @property
    def timed_out(self) -> bool:
        """Tell whether the time limit ended the solve."""
        return self.status == "Time limit reached"


def solve(
    compiled: CompiledModel,
    data: FloatArray,
    time_limit: float = highspy.kHighsInf,
    start: FloatArray | None = None,
    *,
    presolve: bool | None = None,
) -> MilpResult:
    """Fill a compiled model in and solve it.

    Args:
        compiled: the model.
        data: one number a slot.
        time_limit: of the solve [s]; what is known then is returned.
        start: values of the columns to start from, None for none.
        presolve: whether to presolve the model; None leaves it to its size.
    """
    coefficients, row_low, row_high, cost = compiled.filled(data)
    there = np.flatnonzero(coefficients)
    begins = np.zeros(compiled.column_count + 1, dtype=np.int32)
    np.cumsum(np.bincount(compiled.cols[there], minlength=compiled.column_count), out=begins[1:])
    solver = _solver()
    if presolve is None:
        presolve = compiled.column_count >= PRESOLVE_FROM_COLUMNS
    solver.setOptionValue("presolve", "choose" if presolve else "off")
    # HiGHS counts the time of all solves in its life.
    solver.setOptionValue("time_limit", solver.getRunTime() + time_limit)
    solver.passModel(
        compiled.column_count,
        compiled.row_count,
        len(there),
        int(highspy.MatrixFormat.kColwise),
        int(highspy.ObjSense.kMinimize),
        0.0,
        cost,
        np.zeros(compiled.column_count),
        compiled.high,
        row_low,
        row_high,
        begins,
        compiled.rows[there],
        coefficients[there],
        compiled.integer,
    )
    if start is not None:
        solution = highspy.HighsSolution()
        solution.col_value = start.tolist()
        solver.setSolution(solution)
    return _result(solver)


def solve_model(model: pyo.ConcreteModel, time_limit: float = highspy.kHighsInf) -> MilpResult:
    """Solve a linear model in Pyomo as it is; values come in the order of its variables.

    Args:
        model: with numbers only, no data to fill in.
        time_limit: of the solve [s].
    """
    _, unknowns = _numbered(model)
    column = {id(variable): number for number, variable in enumerate(unknowns)}
    rows: list[int] = []
    cols: list[int] = []
    values: list[float] = []
    low: list[float] = []
    high: list[float] = []
    for number, row in enumerate(model.component_data_objects(pyo.Constraint)):
        linear = generate_standard_repn(row.body)
        rows += [number] * len(linear.linear_vars)
        cols += [column[id(variable)] for variable in linear.linear_vars]
        values += linear.linear_coefs
        low.append(-np.inf if row.lower is None else pyo.value(row.lower) - linear.constant)
        high.append(np.inf if row.upper is None else pyo.value(row.upper) - linear.constant)
    cost = np.zeros(len(unknowns))
    linear = generate_standard_repn(model.cost.expr)
    for variable, factor in zip(linear.linear_vars, linear.linear_coefs, strict=True):
        cost[column[id(variable)]] += factor
    matrix = sparse.csc_array((values, (rows, cols)), shape=(len(low), len(unknowns)))
    integer = np.array([variable.is_binary() for variable in unknowns], dtype=np.int32)
    top = np.array([highspy.kHighsInf if v.ub is None else v.ub for v in unknowns], dtype=np.float64)
    return _run(matrix, np.array(low), np.array(high), cost, top, integer, time_limit)


def _run(
    matrix: sparse.csc_array,
    low: FloatArray,
    high: FloatArray,
    cost: FloatArray,
    top: FloatArray,
    integer: NDArray[np.int32],
    time_limit: float,
) -> MilpResult:
    """Pass one whole model to HiGHS and solve it."""
    solver = _solver()
    presolve = len(cost) >= PRESOLVE_FROM_COLUMNS
    solver.setOptionValue("presolve", "choose" if presolve else "off")
    solver.setOptionValue("time_limit", solver.getRunTime() + time_limit)
    solver.passModel(
        len(cost),
        len(low),
        matrix.nnz,
        int(highspy.MatrixFormat.kColwise),
        int(highspy.ObjSense.kMinimize),
        0.0,
        cost,
        np.zeros(len(cost)),
        top,
        low,
        high,
        matrix.indptr.astype(np.int32),
        matrix.indices.astype(np.int32),
        matrix.data,
        integer,
    )
    return _result(solver)


def _result(solver: highspy.Highs) -> MilpResult:
    """Run HiGHS and return what it found."""
    solver.run()
    status = solver.modelStatusToString(solver.getModelStatus())
    found = solver.getInfoValue("primal_solution_status")[1] == int(highspy.SolutionStatus.kSolutionStatusFeasible)
    result = MilpResult(status, np.array(solver.getSolution().col_value) if found else None)
    solver.clearModel()
    return result


@lru_cache(maxsize=1)
def _solver() -> highspy.Highs:
    """Make the one HiGHS object of this process; every solve passes a whole model, so nothing is carried over."""
    solver = highspy.Highs()  # type: ignore[no-untyped-call]
    for option, value in OPTIONS.items():
        if solver.setOptionValue(option, value) != highspy.HighsStatus.kOk:
            raise ValueError(f"HiGHS must know the option {option!r}; this package needs highspy 1.15 or newer")
    return solver


def solver_version() -> str:
    """Return HiGHS' version."""
    return str(_solver().version())
