"""Files that are written as a whole or not at all, and of which damage is told from what merely cannot be read.

Only a file's own format says that it is damaged: then it may be set aside and made again. Any other error of the
system, such as a missing permission, says nothing about the file, and nothing is touched.
"""

import errno
import hashlib
import json
import os
import stat
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from sumo_hmdp.errors import InputError, Problem

DIGEST = "sha256"
# The disk, or what one user may have of it, is full.
FULL = (errno.ENOSPC, errno.EDQUOT)
REMEDY = "Start the study again: it sets the file aside and makes what was in it again"


class DamagedFileError(InputError):
    """A file that is there but does not hold what was written into it.

    Args:
        file: the file.
        problem: what must hold, and what was found.
        remedy: what to do.
    """

    def __init__(self, file: Path, problem: str, remedy: str = REMEDY) -> None:
        super().__init__([f"{problem}. {remedy}"], str(file))
        self.file = file
        self.problem = f"{file}: {problem}"


def unreadable(file: Path, error: OSError) -> InputError:
    """Return the error of a file of which nothing is known but that the system does not give it out."""
    message = f"cannot be read: {error.strerror or error}. Nothing was changed; check its permissions and the disk"
    return InputError([Problem("", message)], str(file))


def read_bytes(file: Path) -> bytes:
    """Return a file's content.

    Raises:
        DamagedFileError: if there is no file, or something else in its place.
        InputError: if the system does not give it out.
    """
    try:
        mode = file.stat().st_mode
        # A pipe would be waited for.
        if not stat.S_ISREG(mode):
            what = "a directory" if stat.S_ISDIR(mode) else "a device or pipe"
            raise DamagedFileError(file, f"must be a file, got {what}")
        return file.read_bytes()
    except (FileNotFoundError, NotADirectoryError):
        raise DamagedFileError(file, "must be there, got no such file") from None
    except OSError as error:
        raise unreadable(file, error) from None


def names_in(folder: Path) -> list[str]:
    """Return what a folder holds, in order; nothing where it does not exist.

    Raises:
        InputError: if the system does not give it out. A pattern would pass over it as if it were empty.
    """
    try:
        return sorted(path.name for path in folder.iterdir())
    except (FileNotFoundError, NotADirectoryError):
        return []
    except OSError as error:
        raise unreadable(folder, error) from None


def set_aside(file: Path) -> Path:
    """Give a damaged file, or whatever is in its place, a name that no reader looks at; nothing is deleted."""
    number = 0
    while (aside := file.with_name(f".{file.name}.damaged{number or ''}")).exists():
        number += 1
    file.replace(aside)
    return aside


@contextmanager
def whole(path: Path) -> Iterator[Path]:
    """Give a name to write a file under, which gets its real name when it is complete and on the disk."""
    path.parent.mkdir(parents=True, exist_ok=True)
    # The dot and the ending keep readers of whole folders away from it.
    partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
    try:
        yield partial
        with partial.open("rb") as file:
            os.fsync(file.fileno())
        partial.replace(path)
    except OSError:
        # On a full disk what was written is worth nothing and in the way.
        with suppress(OSError):
            partial.unlink(missing_ok=True)
        raise


def write_text(path: Path, text: str) -> None:
    """Write a file whole or not at all."""
    with whole(path) as partial:
        partial.write_text(text, encoding="utf-8")


def write_sealed(path: Path, content: Mapping[str, Any]) -> None:
    """Write a JSON file with a digest of its content, so that no change of it passes for what was written."""
    plain = json.loads(json.dumps(content, default=str))
    write_text(path, json.dumps({DIGEST: _digest(plain), **plain}, indent=1) + "\n")


def read_sealed(path: Path, keys: Mapping[str, type], *, sealed: bool = True) -> dict[str, Any]:
    """Read a JSON file that was written with a digest.

    Args:
        path: the file.
        keys: what it must hold, and of which kind.
        sealed: whether it must have a digest; files of before there was one have none.

    Raises:
        DamagedFileError: if it is not what was written.
        InputError: if the system does not give it out.
    """
    try:
        content = json.loads(read_bytes(path).decode("utf-8-sig"))
    except (ValueError, RecursionError) as error:
        raise DamagedFileError(path, f"must be JSON: {error}") from None
    if not isinstance(content, dict):
        raise DamagedFileError(path, f"must hold one JSON object, got {type(content).__name__}")
    digest = content.pop(DIGEST, None)
    if (digest is not None or sealed) and digest != _digest(content):
        raise DamagedFileError(path, "must be as it was written, but its digest is of another content")
    for key, kind in keys.items():
        if not isinstance(content.get(key), kind):
            raise DamagedFileError(path, f"must hold `{key}` ({kind.__name__}), got {content.get(key)!r}")
    return content


def _digest(content: object) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def error_number(error: BaseException | None) -> int | None:
    """Return the system's number of an error or of what it was raised from, None where the system has no part in it."""
    seen: set[int] = set()
    while error is not None and id(error) not in seen:
        if isinstance(error, OSError):
            return error.errno
        seen.add(id(error))
        error = error.__cause__ or (None if error.__suppress_context__ else error.__context__)
    return None
