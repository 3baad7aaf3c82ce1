"""Versions of runs beside each other: how they are named, stored and told apart."""

import hashlib
import json
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from sumo_hmdp.study.files import read_sealed, write_sealed

Versions = Mapping[str, str]


def versions_hash(found: Versions) -> str:
    """Return a short name of versions, by which a run's row refers to them."""
    return hashlib.sha256(json.dumps(dict(found), sort_keys=True).encode()).hexdigest()[:12]


def differences(then: Versions, now: Versions) -> tuple[str, ...]:
    """Return what is not the same, in words."""
    names = dict.fromkeys([*then, *now])
    return tuple(
        f"{name} {then.get(name, 'not recorded')}, now {now.get(name, 'not recorded')}"
        for name in names
        if then.get(name) != now.get(name)
    )


def mixture(found: Iterable[tuple[Versions, int]]) -> str:
    """Return in what the versions of runs differ, empty if in nothing.

    Args:
        found: versions, and how many runs have them.
    """
    several = [(dict(one), count) for one, count in found]
    words = []
    for name in dict.fromkeys(name for one, _ in several for name in one):
        counts: Counter[str] = Counter()
        for one, count in several:
            counts[one.get(name, "not recorded")] += count
        if len(counts) > 1:
            words.append(f"{name} {_listed(sorted(counts.items()))}")
    return "; ".join(words)


def _listed(counts: Sequence[tuple[str, int]]) -> str:
    return ", ".join(f"{value} ({count} {'run' if count == 1 else 'runs'})" for value, count in counts)


def versions_path(folder: Path, name: str) -> Path:
    """Return where a study's store has the versions that some of its rows refer to."""
    return folder / "versions" / f"{name}.json"


def write_versions(folder: Path, found: Versions) -> str:
    """Keep versions in a store; return their name."""
    name = versions_hash(found)
    if not versions_path(folder, name).exists():
        write_sealed(versions_path(folder, name), found)
    return name


def read_versions(folder: Path, name: object) -> dict[str, str]:
    """Return the versions that a row refers to; nothing where the store does not have them.

    Raises:
        DamagedFileError: if the file is not what was written.
        InputError: if the system does not give it out.
    """
    if not isinstance(name, str) or not name.isalnum() or not versions_path(folder, name).exists():
        return {}
    return {key: str(value) for key, value in read_sealed(versions_path(folder, name), {}).items()}
