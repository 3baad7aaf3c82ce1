"""Damaged stores of studies: how often reading one, or going on with one, ends in anything but an answer.

Each store is a copy of a sound one in which one to three files are damaged by chance: a byte flipped, cut short,
emptied, other text, a directory in place of the file, a copy beside it, two files exchanged. In a process of its own
each is read, which must give its tables or an error that names a file; then its study goes on, which must give the
tables and the hash of the sound store. Prints counts as a Markdown table.

    python analysis/14_damaged_stores.py --stores 1000
"""

import argparse
import os
import random
import shutil
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from sumo_hmdp.errors import InputError
from sumo_hmdp.study.design import Design, load_design
from sumo_hmdp.study.ledger import Ledger
from sumo_hmdp.study.parts import Writer, opened
from sumo_hmdp.study.record import RunStatus
from sumo_hmdp.study.recovery import sweep
from sumo_hmdp.study.resume import changes, keep_file, take_back
from sumo_hmdp.study.runner import Study, asked_of
from sumo_hmdp.study.store import load
from sumo_hmdp.study.worker import Job, Outcome, run_job

STUDY = """
name: damaged
scenarios: [case2]
factors: {planner: [constant], duration_s: [0.6, 0.9]}
seeds: {count: 2}
trace: all
"""
LIMIT = 60.0
OTHER_TEXTS = (
    b"",
    b"[]",
    b"{}",
    b"null",
    b'{"cells": [',
    b"\xff\xfe\x00",
    b"\x00" * 40,
    b"[" * 5000,
    b'{"status": "failed"}\n',
)


def flip(file: Path, chance: random.Random) -> None:
    """Change one bit of one byte."""
    content = bytearray(file.read_bytes())
    if content:
        content[chance.randrange(len(content))] ^= 1 << chance.randrange(8)
    file.write_bytes(bytes(content))


def cut(file: Path, chance: random.Random) -> None:
    """Cut the file short."""
    content = file.read_bytes()
    file.write_bytes(content[: chance.randrange(len(content) + 1)])


def overwrite(file: Path, chance: random.Random) -> None:
    """Put another text in its place."""
    file.write_bytes(chance.choice(OTHER_TEXTS))


def make_directory(file: Path, chance: random.Random) -> None:
    """Put a directory in its place, empty or not."""
    file.unlink()
    file.mkdir()
    if chance.random() < 0.5:
        (file / "something").write_bytes(b"")


def remove(file: Path, chance: random.Random) -> None:
    """Remove the file."""
    del chance
    file.unlink()


def copy(file: Path, chance: random.Random) -> None:
    """Put a copy beside the file."""
    shutil.copy(file, file.with_name(f"{chance.randrange(10**6)}{file.suffix}"))


def append(file: Path, chance: random.Random) -> None:
    """Add bytes at the end."""
    with file.open("ab") as end:
        end.write(chance.randbytes(chance.randrange(1, 50)))


def exchange(file: Path, chance: random.Random) -> None:
    """Exchange its content with that of another file of its kind."""
    other = chance.choice(sorted(file.parent.parent.rglob(f"*{file.suffix}")))
    content = file.read_bytes()
    if other.is_file():
        file.write_bytes(other.read_bytes())
        other.write_bytes(content)


DAMAGES: tuple[Callable[[Path, random.Random], None], ...] = (
    flip, flip, flip, cut, overwrite, make_directory, remove, copy, append, exchange,
)  # fmt: skip


def damage(folder: Path, seed: int) -> list[str]:
    """Damage one to three files of a store; return what was done."""
    chance = random.Random(seed)  # noqa: S311 - no secret
    done = []
    for _ in range(chance.randint(1, 3)):
        files = sorted(file for file in folder.rglob("*") if file.is_file())
        file, how = chance.choice(files), chance.choice(DAMAGES)
        how(file, chance)
        done.append(f"{how.__name__} {file.relative_to(folder)}")
    return done


@dataclass
class Here:
    """A pool that does runs in this process."""

    do: Callable[[Job], Outcome] = run_job
    jobs: list[Job] = field(default_factory=list)

    @property
    def free(self) -> int:
        """One at a time."""
        return 1 - len(self.jobs)

    def submit(self, job: Job) -> None:
        """Take a job."""
        self.jobs.append(job)

    def collect(self, timeout: float) -> list[Outcome]:
        """Do it."""
        del timeout
        return [self.do(self.jobs.pop())]

    def close(self) -> None:
        """Nothing is open."""


def go_on(design: Design, file: Path, folder: Path, do: Callable[[Job], Outcome] = run_job) -> tuple[str, list[str]]:
    """Go on with a study as the command does; return its hash and what was said."""
    with opened(folder):
        finished = sweep(folder)
        Writer(folder, design.cells).describe_cells()
        asked = asked_of(design, design.seeds)
        left, told = take_back(folder, finished, asked, retry_failed=False)
        said = [*finished.damaged, *told, *changes(folder, left, asked)]
        keep_file(file, folder / "study.yaml", None)
        study = Study(design, folder, left, Here(do))
        study.run()
        return study.hash(), said


def sound_store(design: Design, file: Path, folder: Path, do: Callable[[Job], Outcome] = run_job) -> str:
    """Make the store that is damaged; return its hash."""
    found, _ = go_on(design, file, folder, do)
    Ledger(folder).note(Outcome(design.cells[0].run_id(0), RunStatus.CRASHED, "signal 9"))
    return found


def trial(
    design: Design, file: Path, folder: Path, expected: str, do: Callable[[Job], Outcome] = run_job
) -> tuple[str, str]:
    """Read a damaged store and go on with it; return what became of either.

    Raises:
        AssertionError: if going on does not give what the sound store had.
    """
    try:
        load(folder)
        read = "read"
    except InputError as error:
        _require(str(folder) in str(error), error)
        read = "a file named"
    try:
        found, said = go_on(design, file, folder, do)
    except InputError as error:
        # The lock is no result, and what is in its place is not touched.
        _require(".lock" in str(error) or "single runs" in str(error), error)
        return read, "refused in one line"
    _require(found == expected, "another hash")
    results = load(folder)
    _require(set(results.runs["run_id"]) == {c.run_id(s) for c in design.cells for s in design.seeds}, "other runs")
    _require(not results.notes, results.notes)
    return read, "set aside and done again" if said else "as it was"


def _require(holds: bool, what: object) -> None:  # noqa: FBT001 - like `assert`
    if not holds:
        raise AssertionError(what)


def in_a_process_of_its_own(do: Callable[[], tuple[str, str]]) -> tuple[str, str]:
    """Do a trial in a copy of this process, which ends at a limit of time."""
    ours, theirs = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            answer = "|".join(do())
        except BaseException:  # noqa: BLE001 - whatever it is, it is counted
            traceback.print_exc()
            answer = "traceback|traceback"
        os.write(theirs, answer.encode())
        os._exit(0)
    os.close(theirs)
    until = time.monotonic() + LIMIT
    while os.waitpid(child, os.WNOHANG) == (0, 0):
        if time.monotonic() > until:
            os.kill(child, 9)
            os.waitpid(child, 0)
            break
        time.sleep(0.002)
    with os.fdopen(ours, encoding="utf-8") as pipe:
        read, _, went = pipe.read().partition("|")
    return read or "hung or crashed", went or "hung or crashed"


def main() -> None:
    """Damage stores and print what became of them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--stores", type=int, default=1000)
    parser.add_argument("--first", type=int, default=0)
    arguments = parser.parse_args()
    counts: Counter[tuple[str, str]] = Counter()
    with tempfile.TemporaryDirectory() as scratch:
        file, base = Path(scratch) / "study.yaml", Path(scratch) / "base"
        file.write_text(STUDY, encoding="utf-8")
        design = load_design(file)
        expected = sound_store(design, file, base)
        for seed in range(arguments.first, arguments.first + arguments.stores):
            folder = Path(scratch) / "damaged"
            shutil.copytree(base, folder)
            done = damage(folder, seed)

            def one(folder: Path = folder) -> tuple[str, str]:
                return trial(design, file, folder, expected)

            found = in_a_process_of_its_own(one)
            if "traceback" in found or "hung or crashed" in found:
                print(f"seed {seed}: {found}: {', '.join(done)}", file=sys.stderr)
            counts[found] += 1
            shutil.rmtree(folder)
    print("| load | the study | stores |\n|---|---|---:|")
    for (read, went), count in sorted(counts.items()):
        print(f"| {read} | {went} | {count} |")


if __name__ == "__main__":
    main()
