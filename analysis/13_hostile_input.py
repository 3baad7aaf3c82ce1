"""Thousands of broken scenarios, studies and decisions: what the program says of each, and what that costs.

Every input is a good file of the package with one to three changes: of the document (a value taken out, exchanged,
doubled, of another type, extreme) or of its bytes. Each is given to `sumo-hmdp check`, a decision to `sumo-hmdp
decide`; of the scenarios that are accepted, some are run for a second. An input fails that ends in a traceback, takes
more than 10 s of computing, or is refused without a line. Batches have processes of their own, whose memory is told.

    python analysis/13_hostile_input.py --count 5000 --page docs/hostile-input.md
"""

import argparse
import contextlib
import copy
import io
import json
import math
import random
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import yaml

from sumo_hmdp import cli
from sumo_hmdp.errors import SumoHmdpError
from sumo_hmdp.scenario.load import RunOptions, load_scenario
from sumo_hmdp.study.run import execute

ROOT = Path(__file__).parents[1]
# Of computing, so that a busy machine makes no difference [s].
LIMIT_S = 10
BATCH = 250
# Of the scenarios that are accepted, one in so many is run.
RUN_EVERY = 5

STUDY = """
name: small
scenarios: [case2]
factors:
  planner: [constant, hmdp_mpc]
  risk_level: [0.01, 0.05]
  pace: {slow: {ego.speed_mps: 20.0, duration_s: 1.5}, fast: {ego.speed_mps: 30.0, duration_s: 3.0}}
seeds: {first: 0, count: 3}
solver: search
trace: ego
wall_limit_s: 60.0
"""

VALUES: tuple[Any, ...] = (
    0, -0.0, 1, -1, 2, 0.5, 1e-300, 1e-9, 1e-3, 1e6, 1e9, 1e12, 1e300, -1e300, math.inf, -math.inf, math.nan, 2**31,
    2**63, 10**400, True, False, None, "", "x", "0", "1:30", "\u202e", "\x1b[31m", "\0", "[/red]", "a" * 5000, "ego",
    "../..", "/dev/zero", "/etc/passwd", "case2", "hmdp_mpc", "search", [], {}, [[]], [1, 2], {"x": 1},
    {"": None}, [None] * 50,
)  # fmt: skip
TOKENS = (
    b"\0", b"\x1b[2J", b"\xff", b"\xef\xbb\xbf", b"[", b"]", b"{", b"}", b":", b"- ", b"\n", b"\t", b'"', b"&a ", b"*a",
    b"!!int ", b"!!python/object:os.system ", b"---\n", b"...\n", b"<<: ", b"? ", b"| ", b"%YAML 9.9\n", b"e999", b"0x",
    b"NaN", b"\\ud800", b",", b"1e", b"#", b"999999999999", b"-", b".", b"\r", b"\xc2\x9b", "\u0435".encode(),
)  # fmt: skip


@dataclass(frozen=True)
class Mutant:
    """A broken file: `scenario`, `study` or `decision`, and its bytes."""

    kind: str
    data: bytes

    @property
    def suffix(self) -> str:
        """Of its file."""
        return ".json" if self.kind == "decision" else ".yaml"


def mutants(seed: int, numbers: range, kinds: tuple[str, ...] = ("scenario", "study", "decision")) -> Iterator[Mutant]:
    """Yield some of the endless list of mutants of a seed; each has a random stream of its own."""
    bases = _bases()
    for number in numbers:
        chance = random.Random(f"{seed}/{number}")  # noqa: S311 - no secret
        kind = kinds[number % len(kinds)]
        content = copy.deepcopy(chance.choice(bases[kind]))
        way = chance.random()
        if way < 0.35:
            for _ in range(chance.choice((1, 1, 2))):
                _nudged(content, chance)
            yield Mutant(kind, _text(kind, content))
        elif way < 0.75:
            for _ in range(chance.choice((1, 1, 2, 3))):
                content = _changed(content, chance)
            yield Mutant(kind, _text(kind, content))
        else:
            yield Mutant(kind, _bytes_changed(_text(kind, content), chance))


def _bases() -> dict[str, list[Any]]:
    def read(name: str) -> Any:  # noqa: ANN401 - any YAML
        return yaml.safe_load((ROOT / "scenarios" / f"{name}.yaml").read_text(encoding="utf-8"))

    decisions = sorted((ROOT / "tests" / "fixtures" / "decisions").glob("*.json"))
    scenarios = ("case1", "case2", "case2_rule_based", "case3", "matched", "highway")
    return {
        # Drawn traffic takes longer to check.
        "scenario": [read(name) for name in scenarios for _ in range(1 if name == "highway" else 3)],
        "study": [yaml.safe_load(STUDY)],
        "decision": [json.loads(path.read_text(encoding="utf-8"))["problem"] for path in decisions],
    }


def _text(kind: str, content: Any) -> bytes:  # noqa: ANN401
    if kind == "decision":
        return json.dumps(content).encode()
    return yaml.safe_dump(content, allow_unicode=True, sort_keys=False).encode("utf-8", "replace")


def _places(content: Any, place: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:  # noqa: ANN401
    if place:
        yield place
    pairs = content.items() if isinstance(content, dict) else enumerate(content) if isinstance(content, list) else ()
    for key, value in pairs:
        yield from _places(value, (*place, key))


def _nudged(content: Any, chance: random.Random) -> None:  # noqa: ANN401
    """Change one number of a document in place so that it may well be valid: what comes after the checks is tried."""
    numbers = [place for place in _places(content) if _is_number(_at(content, place))]
    if not numbers:
        return
    *way, last = chance.choice(numbers)
    holder = _at(content, way)
    value = holder[last]
    if isinstance(value, int):
        holder[last] = value + chance.choice((-2, -1, 1, 2, 5, 15))
    else:
        holder[last] = chance.choice(
            (0.0, 1.0, 1e-3, 1e3, 1e6, -value, *(value * f for f in (0.01, 0.5, 0.9, 1.1, 2, 10)))
        )


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _at(content: Any, place: Sequence[Any]) -> Any:  # noqa: ANN401
    for part in place:
        content = content[part]
    return content


def _changed(content: Any, chance: random.Random) -> Any:  # noqa: ANN401 - a list of changes
    """Change one value of a document in place; a document that is no mapping any more is left as it is."""
    places = list(_places(content))
    if not places:
        return content
    *way, last = chance.choice(places)
    holder = _at(content, way)
    value = holder[last]
    change = chance.choice(
        ("set", "set", "set", "scale", "scale", "delete", "double", "swap", "rename", "wrap", "text")
    )
    if change == "delete":
        del holder[last]
    elif change == "scale" and _is_number(value):
        holder[last] = type(value)(
            min(max(value * chance.choice((-1, 0, 1e-6, 0.1, 0.9, 1.1, 2, 10, 1e3)), -1e15), 1e15)
        )
    elif change == "double":
        if isinstance(holder, list):
            holder.extend(copy.deepcopy(value) for _ in range(chance.choice((1, 3, 30))))
        else:
            holder[f"{last}_again"] = copy.deepcopy(value)
    elif change == "swap":
        *other_way, other = chance.choice(places)
        with contextlib.suppress(KeyError, IndexError, TypeError):
            other_holder = _at(content, other_way)
            holder[last], other_holder[other] = copy.deepcopy(other_holder[other]), copy.deepcopy(value)
    elif change == "rename" and isinstance(holder, dict):
        holder[chance.choice((f"{last}x", str(last)[:-1], 1, "", "[/x]", "sp\u0435ed", "a" * 5000))] = holder.pop(last)
    elif change == "wrap":
        holder[last] = chance.choice(([value], {"value": value}, [[value]] * 3))
    elif change == "text":
        holder[last] = str(value)
    else:
        holder[last] = copy.deepcopy(chance.choice(VALUES))
    return content


def _bytes_changed(data: bytes, chance: random.Random) -> bytes:
    for _ in range(chance.choice((1, 2, 5))):
        at = chance.randrange(len(data) + 1)
        end = min(len(data), at + chance.choice((1, 1, 4, 40)))
        change = chance.choice(("flip", "cut", "double", "token", "token", "end"))
        if change == "flip" and at < len(data):
            data = data[:at] + bytes([data[at] ^ (1 << chance.randrange(8))]) + data[at + 1 :]
        elif change == "cut":
            data = data[:at] + data[end:]
        elif change == "double":
            data = data[:end] + data[at:end] * chance.choice((1, 50)) + data[end:]
        elif change == "end":
            data = data[:at]
        else:
            data = data[:at] + chance.choice(TOKENS) * chance.choice((1, 1, 700)) + data[at:]
    return data


class TooSlowError(BaseException):
    """An input took too long; nothing of the program catches this."""


@dataclass(frozen=True)
class Found:
    """What became of an input.

    Attributes:
        kind: of the input.
        outcome: refused, accepted, ran, or what is wrong: `traceback`, `slow`, `silent`.
        seconds: of computing.
        detail: of what is wrong.
    """

    kind: str
    outcome: str
    seconds: float
    detail: str = ""

    @property
    def bad(self) -> bool:
        """Whether the program broke its word."""
        return self.outcome in {"traceback", "slow", "silent"}


def tried(mutant: Mutant, folder: Path, *, run: bool = False) -> Found:
    """Give one input to the program, in this process, and see what it does."""
    file = folder / f"input{mutant.suffix}"
    file.write_bytes(mutant.data)
    command = ["decide", "--solver", "search", str(file)] if mutant.kind == "decision" else ["check", str(file)]
    started = time.process_time()
    try:
        with _watched():
            code, lines = _called(command)
            outcome, detail = _judged(code, lines)
            if run and outcome == "accepted" and mutant.kind == "scenario":
                outcome, detail = _run(file)
    except TooSlowError:
        outcome, detail = "slow", f"more than {LIMIT_S} s"
    except Exception as error:  # noqa: BLE001 - this is what is looked for
        outcome, detail = "traceback", f"{type(error).__name__}: {error}"
    return Found(mutant.kind, outcome, time.process_time() - started, detail[:300])


@contextlib.contextmanager
def _watched() -> Iterator[None]:
    def stop(*_: object) -> None:
        raise TooSlowError

    before = signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, LIMIT_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)


def _called(arguments: list[str]) -> tuple[int, list[str]]:
    """Return the exit code of a command and what it wrote to standard error."""
    argv, told = sys.argv, io.StringIO()
    sys.argv = ["sumo-hmdp", *arguments]
    code: Any = 0
    try:
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(told):
            cli.main()
    except SystemExit as end:
        code = end.code or 0
    finally:
        sys.argv = argv
    return int(code), told.getvalue().splitlines()


def _judged(code: int, lines: list[str]) -> tuple[str, str]:
    if code == 0:
        return "accepted", ""
    if code != 2 or not lines or any(len(line) > 1400 or "Traceback" in line for line in lines):
        return "silent", f"exit code {code}: {lines[:1]}"
    return "refused", ""


def _run(file: Path) -> tuple[str, str]:
    """Run an accepted scenario for about a second; it may fail by an error of the package's own."""
    ready = load_scenario(file, RunOptions(solver="search"))
    period = max(ready.planner.period, ready.episode.dt)
    duration = ready.episode.dt * round(max(1.0, period) / ready.episode.dt)
    ready = load_scenario(file, RunOptions(solver="search", overrides={"duration_s": duration}))
    record = execute(ready, detailed=False)
    own = {error.__name__ for error in _subclasses(SumoHmdpError)}
    if record.traceback and record.reason.partition(":")[0] not in own:
        return "traceback", record.traceback[-300:]
    return "ran", record.reason


def _subclasses(kind: type) -> Iterator[type]:
    yield kind
    for below in kind.__subclasses__():
        yield from _subclasses(below)


def batch(seed: int, numbers: range) -> dict[str, Any]:
    """Try some inputs; return what was found and this process's largest memory [MB]."""
    with tempfile.TemporaryDirectory(prefix="sumo-hmdp-hostile-") as folder:
        found = []
        for number, mutant in zip(numbers, mutants(seed, numbers), strict=True):
            found.append(asdict(tried(mutant, Path(folder), run=number % RUN_EVERY == 0)) | {"number": number})
            if found[-1]["outcome"] in {"traceback", "slow", "silent"}:
                sys.stderr.write(f"{seed}/{number}: {found[-1]}\n")
    return {"found": found, "memory_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024}


def page(found: list[dict[str, Any]], memory: float, seed: int) -> str:
    """Return the counts as a page in Markdown."""
    outcomes = ("refused", "accepted", "ran", "traceback", "slow", "silent")
    rows = []
    for kind in ("scenario", "study", "decision"):
        own = [one for one in found if one["kind"] == kind]
        counts = Counter(one["outcome"] for one in own)
        cells = [
            kind,
            len(own),
            *(counts[outcome] for outcome in outcomes),
            f"{max(one['seconds'] for one in own):.1f}",
        ]
        rows.append("| " + " | ".join(map(str, cells)) + " |")
    return "\n".join([
        "# Hostile input", "",
        f"Written by `python analysis/13_hostile_input.py --count {len(found)} --seed {seed} --page",
        "docs/hostile-input.md`:",
        "good scenarios, studies and decision problems with one to three random changes each, of the document or of",
        "its bytes. *Refused* is exit code 2 with a line for each mistake; *accepted* scenarios and studies are valid,",
        "decisions solved; one accepted scenario in five *ran* for a second. *Slow* is more than 10 s of computing,",
        "*silent* any other end. The last column is the longest time of one input.", "",
        "| input | tried | " + " | ".join(outcomes) + " | most s |", "|---" * (len(outcomes) + 3) + "|", *rows, "",
        f"Most memory of a process that tried {BATCH} inputs one after the other: {memory:.0f} MB.", "",
    ])  # fmt: skip


def main() -> None:
    """Try them all, batch by batch, each in a process of its own."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=5000, help="how many inputs")
    parser.add_argument("--seed", type=int, default=0, help="of the list of inputs")
    parser.add_argument("--page", type=Path, help="write the page there instead of to standard output")
    parser.add_argument("--batch", type=int, nargs=2, metavar=("FIRST", "END"), help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.batch:
        print(json.dumps(batch(arguments.seed, range(*arguments.batch))))
        return
    found: list[dict[str, Any]] = []
    memory = 0.0
    for first in range(0, arguments.count, BATCH):
        end = min(arguments.count, first + BATCH)
        command = [sys.executable, __file__, "--seed", str(arguments.seed), "--batch", str(first), str(end)]
        done = subprocess.run(command, stdout=subprocess.PIPE, check=True, text=True)  # noqa: S603 - this very file
        answer = json.loads(done.stdout.splitlines()[-1])
        found += answer["found"]
        memory = max(memory, answer["memory_mb"])
        sys.stderr.write(f"{end} of {arguments.count}, {memory:.0f} MB\n")
    text = page(found, memory, arguments.seed)
    if arguments.page:
        arguments.page.write_text(text, encoding="utf-8")
    else:
        print(text)


if __name__ == "__main__":
    main()
