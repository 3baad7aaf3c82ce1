"""Parquet files with a digest of all their bytes, and what must hold of their rows."""

import hashlib
import io
from pathlib import Path

import pandas as pd
import pyarrow as pa
from pyarrow import parquet

from sumo_hmdp.study.files import DamagedFileError, read_bytes, whole

# In the footer of a study's file: of how many runs it has rows.
RUN_COUNT = "sumo_hmdp.run_count"
# In every footer: SHA-256 of the file, with zeros in place of these very digits. Parquet's own checksums are of the
# data pages alone, and a changed letter in the footer is another column, or other numbers.
_DIGEST_KEY, _MARK, _ZEROS = "sumo_hmdp.digest", b"sumo_hmdp.sha256:", b"0" * 64
TABLE_REMEDY = "Delete it and start the run, or the study, again: its runs, and no others, are run again"
# Below this a second thread costs more than it brings [bytes].
_SMALL = 1_000_000
# What a study's rows of `runs` must have.
_STUDY_KEYS = {"seed", "status"}


def write_parquet(path: Path, frame: pd.DataFrame, run_count: int | None = None) -> None:
    """Write a table whole or not at all, with its digest.

    Args:
        path: the file.
        frame: the table.
        run_count: of how many runs it has rows, of a study's file.
    """
    table = pa.Table.from_pandas(frame, preserve_index=False)
    buffer = io.BytesIO()
    with parquet.ParquetWriter(buffer, table.schema, write_page_checksum=True) as writer:
        writer.write_table(table)
        facts = {} if run_count is None else {RUN_COUNT: str(run_count)}
        writer.add_key_value_metadata({**facts, _DIGEST_KEY: (_MARK + _ZEROS).decode()})
    content = bytearray(buffer.getbuffer())
    at = content.rfind(_MARK) + len(_MARK)
    content[at : at + 64] = hashlib.sha256(content).hexdigest().encode()
    with whole(path) as partial:
        partial.write_bytes(content)


def read_table(file: Path) -> pd.DataFrame:
    """Read one file of a table.

    Raises:
        DamagedFileError: if it is not what was written.
        InputError: if the system does not give it out.
    """
    return _parsed(file, _verified(file))


def check_table(file: Path) -> int | None:
    """Return of how many runs a file holds rows, None where it does not say; its content is checked, not parsed.

    Raises:
        DamagedFileError: if it is not what was written.
        InputError: if the system does not give it out.
    """
    content = _verified(file)
    if _digest_at(content) < 0:
        # Of a file without a digest the pages have their own.
        _parsed(file, content)
    return _run_count(file, content)


def read_with_count(file: Path) -> tuple[pd.DataFrame, int | None]:
    """Return a table, and of how many runs its file says that it holds rows; see `read_table`."""
    content = _verified(file)
    return _parsed(file, content), _run_count(file, content)


def _digest_at(content: bytes) -> int:
    """Return where the digest begins, -1 where there is none."""
    at = content.rfind(_MARK)
    return at if at < 0 else at + len(_MARK)


def _verified(file: Path) -> bytes:
    content = read_bytes(file)
    at = _digest_at(content)
    if at >= 0:
        digest = hashlib.sha256(content[:at])
        digest.update(_ZEROS)
        digest.update(memoryview(content)[at + 64 :])
        if content[at : at + 64] != digest.hexdigest().encode():
            raise DamagedFileError(
                file, "must be a whole Parquet file, but its digest is of another content", TABLE_REMEDY
            )
    return content


def _parsed(file: Path, content: bytes) -> pd.DataFrame:
    try:
        frame: pd.DataFrame = (
            parquet.ParquetFile(io.BytesIO(content), page_checksum_verification=True)
            .read(use_threads=len(content) > _SMALL)
            .to_pandas(use_threads=len(content) > _SMALL)
        )
    except Exception as error:  # noqa: BLE001 - in memory, so that the disk has no part in it
        raise DamagedFileError(file, f"must be a whole Parquet file: {str(error).rstrip('.')}", TABLE_REMEDY) from None
    if "run_id" not in frame:
        raise DamagedFileError(file, "must be a whole Parquet file, but has no column run_id", TABLE_REMEDY)
    return frame


def _run_count(file: Path, content: bytes) -> int | None:
    try:
        facts = parquet.ParquetFile(io.BytesIO(content)).metadata.metadata or {}
        text = facts.get(RUN_COUNT.encode())
        return None if text is None else int(text)
    except Exception as error:  # noqa: BLE001 - as above
        raise DamagedFileError(file, f"must be a whole Parquet file: {str(error).rstrip('.')}", TABLE_REMEDY) from None


def checked_names(runs: pd.DataFrame, file: Path, cell: str | None) -> pd.DataFrame:
    """Return rows of `runs` whose names are those that they must have, so that they can be names of files.

    A study's run is named by its cell and seed; a single run has its file's name.

    Args:
        runs: the rows of one file.
        file: the file.
        cell: its cell, None for a single run.

    Raises:
        DamagedFileError: if one has another name, or stands twice.
    """
    if cell is not None and not set(runs) >= _STUDY_KEYS:
        raise DamagedFileError(file, f"must have the columns {', '.join(sorted(_STUDY_KEYS))}", TABLE_REMEDY)
    expected = [file.stem] * len(runs) if cell is None else [f"{cell}-seed{seed}" for seed in runs["seed"]]
    for name, wanted in zip(runs["run_id"], expected, strict=True):
        if name != wanted:
            raise DamagedFileError(file, f"must hold the run {wanted!r}, got {name!r}", TABLE_REMEDY)
    if runs["run_id"].duplicated().any():
        raise DamagedFileError(
            file,
            f"must hold every run once, got {runs['run_id'][runs['run_id'].duplicated()].iloc[0]} twice",
            TABLE_REMEDY,
        )
    return runs
