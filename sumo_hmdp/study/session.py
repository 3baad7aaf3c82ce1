"""A run that is stepped from outside: by a notebook, by an agent, by a loop of one's own."""

from contextlib import ExitStack
from datetime import UTC, datetime
from types import TracebackType
from typing import Self

from sumo_hmdp.domain.plan import Command, Decision
from sumo_hmdp.domain.scene import Scene
from sumo_hmdp.errors import SimulationError
from sumo_hmdp.scenario.load import ReadyRun
from sumo_hmdp.sim.episode import Loop, Moment
from sumo_hmdp.study.record import Recorder, RunStatus
from sumo_hmdp.study.run import RunRecord, record_of, run_id_of


class Session:
    """One run, a step of dt at a time; a process can have one SUMO world open at a time.

    With `sumo_hmdp.scenario("case2")` as its run:

        with Session(run) as session:
            moment = session.reset()
            while not session.ended:
                moment = session.step()
            record = session.record()

    Attributes:
        run: as given.
    """

    def __init__(self, run: ReadyRun, *, detailed: bool = False) -> None:
        """Take the run; nothing is opened before `reset`.

        Args:
            run: from `sumo_hmdp.scenario` or `scenario.load.load_scenario`.
            detailed: whether `record` also has what decisions rest on: branches, forbidden intervals, problems.
        """
        self.run = run
        self._detailed = detailed
        self._open: ExitStack | None = None
        self._loop: Loop | None = None
        self._recorder = Recorder(run_id_of(run), detailed)
        self._started = datetime.now(tz=UTC)

    def __enter__(self) -> Self:
        """Return the session."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the world."""
        self.close()

    @property
    def ended(self) -> bool:
        """Whether the run is over: its time, its goal, or a contact.

        Raises:
            SimulationError: the session is not open.
        """
        return self._opened().ended

    @property
    def now(self) -> Moment:
        """The present instant.

        Raises:
            SimulationError: the session is not open.
        """
        return self._opened().now

    def reset(self) -> Moment:
        """Open the world, or open it anew, and return its first instant.

        Raises:
            InputError: with every mistake in the run's input.
            SimulationError: another session or run has its world open in this process.
            decision.contract.PlannerError: if the planner's period cannot be kept.
        """
        self.close()
        self._recorder, self._started = Recorder(run_id_of(self.run), self._detailed), datetime.now(tz=UTC)
        with ExitStack() as stack:
            world = stack.enter_context(self.run.open_world())
            self._loop = Loop(self.run.episode, world, self.run.planner, self._recorder.observe)
            self._open = stack.pop_all()
        return self._loop.now

    def step(self, order: Command | Decision | None = None) -> Moment:
        """Carry the run on by dt and return the next instant.

        Args:
            order: a command, or a decision of which more is told, that holds from now on; None asks the run's planner
                where its next decision is due, and otherwise leaves the last one in force.

        Raises:
            SimulationError: the run has ended, or the session is not open.
            decision.contract.PlannerError: if the order cannot be carried out.
        """
        return self._opened().step(order)

    def perceived(self) -> Scene:
        """Return the present scene as the run's planner measures it.

        Raises:
            SimulationError: the session is not open.
        """
        return self._opened().perceived()

    def record(self) -> RunRecord:
        """Return what has happened since `reset`: `.row`, `.steps` and `.decisions`, as a run has them.

        A run that has not ended is recorded as interrupted. It can be asked for after `close`, too.
        """
        loop, recorder = self._loop, self._recorder
        status, reason = RunStatus.COMPLETED, ""
        if recorder.contacts:
            status, reason = RunStatus.CONTACT, "; ".join(recorder.contact_sentences())
        elif loop is None or not loop.ended:
            status, reason = RunStatus.INTERRUPTED, "the session was not stepped to the end of the run"
        return record_of(self.run, recorder, status, reason, "", self._started)

    @property
    def trace_hash(self) -> str:
        """The hash of all instants that are complete, as in a run's row; of a whole run once it has ended."""
        return self._recorder.trace.hexdigest()

    def close(self) -> None:
        """Close the world; what was recorded stays until the next `reset`."""
        if self._open is not None:
            opened, self._open = self._open, None
            opened.close()

    def _opened(self) -> Loop:
        if self._open is None or self._loop is None:
            raise SimulationError("the session must be open to be stepped; call reset() first")
        return self._loop
