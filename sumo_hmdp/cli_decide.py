"""The command that answers decision problems: `sumo-hmdp decide`."""
# ruff: noqa: PLC0415 - a command imports what it needs when it runs, so that `--help` answers at once

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sumo_hmdp.cli_common import BAD_INPUT, FAILED, FILES, SolverOption, complain, say
from sumo_hmdp.errors import InputError, Problem, SumoHmdpError
from sumo_hmdp.validation import nearest

if TYPE_CHECKING:
    from sumo_hmdp.decision.decide import Answer
    from sumo_hmdp.decision.problem import DecisionProblem


def add_commands(app: typer.Typer) -> None:
    """Add the command of this file to the command line."""
    app.command(rich_help_panel=FILES)(decide)


def decide(
    files: Annotated[list[Path], typer.Argument(help="Decision problems, JSON.", show_default=False)],
    solver: SolverOption = "milp",
    explain: Annotated[  # noqa: FBT002 - a flag of the command line
        bool,
        typer.Option("--explain", help="Tell on standard error what was predicted and why no other action was taken."),
    ] = False,
    figure: Annotated[
        Path | None, typer.Option(help="Draw the decision, lanes over time: .svg, .png or .pdf. Takes a single file.")
    ] = None,
    frontier: Annotated[
        Path | None,
        typer.Option(help="Draw cost over risk of the plans, under `joint`: .svg, .png or .pdf. Takes a single file."),
    ] = None,
) -> None:
    """Solve decision problems from files; one line of JSON each, in the order of the files.

    A file with mistakes gets one line per mistake on standard error and none on standard output; the others are
    still answered, and the exit code is 2.

    Examples, after `sumo-hmdp run case2 --dump-decisions`:
    - `sumo-hmdp decide results/decision_files/case2-hmdp_mpc-eps0.05-seed0/0010.json`
    - `sumo-hmdp decide problem.json --explain --figure why.svg`
    - `sumo-hmdp decide problem.json --frontier frontier.svg`

    Files: the figures that are asked for, and no other; docs/decision-files.md has the form of the files.
    """
    from sumo_hmdp.decision.decide import SOLVERS, answer
    from sumo_hmdp.decision.problem_file import answer_document, read_problem
    from sumo_hmdp.decision.risk import RiskBudgetError

    if solver not in SOLVERS:
        raise InputError([f"--solver: must be a known solver, got {solver!r}; {nearest(solver, SOLVERS)}"])
    for option, path in (("--figure", figure), ("--frontier", frontier)):
        if path is not None:
            _require_drawable(path, len(files), option)
    code = 0
    for file in files:
        try:
            problem = read_problem(file)
        except InputError as error:
            complain(error)
            code = BAD_INPUT
            continue
        try:
            found = answer(problem, solver)
        except RiskBudgetError as error:
            complain(InputError([Problem("planner.risk_level", str(error).removeprefix("risk_level "))], str(file)))
            code = BAD_INPUT
            continue
        except SumoHmdpError as error:
            say(f"{file}: {error}", typer.colors.RED)
            code = code or FAILED
            continue
        sys.stdout.write(json.dumps(answer_document(found), allow_nan=False) + "\n")
        sys.stdout.flush()
        if explain or figure is not None:
            _explain(file, problem, found, figure, told=explain)
        if frontier is not None:
            from sumo_hmdp.report.figures import write_frontier

            write_frontier(frontier, found)
    raise typer.Exit(code)


def _require_drawable(figure: Path, file_count: int, option: str) -> None:
    """Refuse a figure that cannot be drawn before anything is solved."""
    from sumo_hmdp.report.figures import figure_path

    if file_count > 1:
        raise InputError([f"{option}: must be given with a single file, got {file_count}. Call once for each file"])
    figure_path(figure, option)


def _explain(file: Path, problem: "DecisionProblem", found: "Answer", figure: Path | None, *, told: bool) -> None:
    """Tell why an answer is as it is, draw it, or both."""
    from sumo_hmdp.decision.explain import explain
    from sumo_hmdp.report.explain_text import explanation_text

    explanation = explain(problem, found)
    if told:
        say(explanation_text(explanation, str(file)))
    if figure is not None:
        from sumo_hmdp.report.figures import write_decision_figure

        write_decision_figure(figure, explanation)
