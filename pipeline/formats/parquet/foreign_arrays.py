"""Arrays of numbers in a Parquet file of another program, which follows no schema and is not trusted.

The file is opened once: its bytes are hashed and its rows are read through the same handle, and if it has changed
meanwhile that is said. How many numbers it may hold is known from its end before any of them is decoded.
"""

from __future__ import annotations

import hashlib
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from io import BufferedReader
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.errors import StageError
from pipeline.formats.parquet.measured import measured

if TYPE_CHECKING:
    import pyarrow as pa
    import pyarrow.parquet as pq

    from pipeline.arrays import FloatArray

LARGEST_BYTES = 16 << 30
MOST_NUMBERS = 300_000_000  # 2.4 GB as float64
MOST_ROWS = 10_000_000
MOST_COLUMNS, MOST_GROUPS = 10_000, 100_000
_AT_ONCE = 4_096  # rows that are decoded together
_FEW_NUMBERS = 2_000_000  # are decoded whatever their rows are like, so that the row can be named


@dataclass(frozen=True, eq=False)
class Rows:
    """Rows of the file that follow each other and have one shape.

    Attributes:
        first: the number of the first, from 1.
        values: (B, ...) float64; None if the row is not regular (uneven lists, or a missing value), which then is one.
    """

    first: int
    values: FloatArray | None


class ForeignArrays:
    """A column of a Parquet file whose cells are lists of numbers, or lists of such lists.

    Attributes:
        path: the file.
        digest: SHA-256 of its bytes.
        count: of its rows.
    """

    def __init__(self, path: Path, file: pq.ParquetFile, column: str, digest: str) -> None:
        self.path, self.digest, self.count = path, digest, file.metadata.num_rows
        self._file, self._column = file, column

    def rows(self) -> Iterator[Rows]:
        """All rows, in their order.

        Raises:
            StageError: they cannot be decoded.
        """
        first = 1
        with _one_sentence(self.path):
            for batch in self._file.iter_batches(_AT_ONCE, columns=[self._column], use_threads=False):
                cells = batch.column(0)
                whole = _regular(cells)
                if whole is not None:
                    yield Rows(first, whole)
                else:
                    for place in range(len(cells)):
                        yield Rows(first + place, _regular(cells.slice(place, 1)))
                first += len(cells)


@contextmanager
def foreign_arrays(path: Path, column: str, named_by: str, each: int | None = None) -> Iterator[ForeignArrays]:
    """Open the file; when it is closed, it must still be what was opened.

    Args:
        path: of the file.
        column: its name.
        named_by: the parameter that names the file, for messages.
        each: how many numbers a row should have; a large file with more is refused before they are decoded.

    Raises:
        StageError: the file is missing, is none that can be read, has no such column or one of something else than
            lists of numbers, holds more than is read, or has changed while it was read.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    with _opened(path, named_by) as stream:
        before = _state(stream)
        digest = hashlib.file_digest(stream, "sha256").hexdigest()
        stream.seek(0)
        with _one_sentence(path), pq.ParquetFile(pa.PythonFile(stream, mode="r")) as file:
            _check(path, file, column, named_by, stream.fileno(), each)
            yield ForeignArrays(path, file, column, digest)
        if _state(stream) != before:
            raise StageError(f"{path}: was changed while it was read; run it again once it is complete")


@contextmanager
def _opened(path: Path, named_by: str) -> Iterator[BufferedReader]:
    try:
        # without waiting, as for a named pipe that nobody writes to
        stream = os.fdopen(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC), "rb")
    except FileNotFoundError:
        raise StageError(f"{path}: there is no such file; {named_by} names it") from None
    except OSError as error:
        raise StageError(f"{path}: cannot be opened ({(error.strerror or str(error)).lower()})") from None
    with stream:
        about = os.fstat(stream.fileno())
        if not stat.S_ISREG(about.st_mode):
            raise StageError(f"{path}: is not a regular file; {named_by} names a Parquet file")
        if about.st_size > LARGEST_BYTES:
            raise StageError(f"{path}: is larger than {LARGEST_BYTES >> 30} GiB; give fewer trajectories")
        yield stream


@contextmanager
def _one_sentence(path: Path) -> Iterator[None]:
    import pyarrow as pa

    try:
        yield
    except MemoryError:
        raise StageError(f"{path}: there is too little memory to read it; give fewer trajectories") from None
    except (pa.ArrowException, OSError, ValueError, OverflowError) as error:
        raise StageError(f"{path}: cannot be read as Parquet ({' '.join(str(error).split())[:500]})") from None


def _state(stream: BufferedReader) -> tuple[int, ...]:
    about = os.fstat(stream.fileno())
    return about.st_size, about.st_mtime_ns


def _check(path: Path, file: pq.ParquetFile, column: str, named_by: str, descriptor: int, each: int | None) -> None:
    """What the end of the file says, before any value is decoded."""
    about = file.metadata
    if about.num_columns > MOST_COLUMNS or about.num_row_groups > MOST_GROUPS:
        raise StageError(
            f"{path}: has {about.num_columns:,} columns and {about.num_row_groups:,} row groups; at most "
            f"{MOST_COLUMNS:,} and {MOST_GROUPS:,} are read"
        )
    names = file.schema_arrow.names
    if column not in names:
        shown = ", ".join(names[:20]) + (", ..." if len(names) > 20 else "")
        raise StageError(f"{path}: has no column `{column}`; it has {shown}; {named_by} names the file")
    if names.count(column) > 1:
        raise StageError(f"{path}: has the column `{column}` more than once; keep one")
    if about.num_rows and not _holds_numbers(file.schema_arrow.field(column).type):
        kind = str(file.schema_arrow.field(column).type)[:100]
        raise StageError(f"{path}: row 1: the column `{column}` has cells of type {kind}; lists of numbers are needed")
    stated = measured(descriptor, column)
    if stated is None:
        raise StageError(f"{path}: cannot be read as Parquet (its end is damaged); {named_by} names the file")
    if each is not None and stated.numbers > max(_FEW_NUMBERS, about.num_rows * each):
        raise StageError(
            f"{path}: says that its {about.num_rows:,} rows hold {stated.numbers:,} numbers, and rows of {each} are "
            f"needed, which would be {about.num_rows * each:,}"
        )
    if about.num_rows > MOST_ROWS or stated.numbers > MOST_NUMBERS or stated.size > 16 * MOST_NUMBERS:
        raise StageError(
            f"{path}: says that it holds {about.num_rows:,} rows with {stated.numbers:,} numbers in {stated.size:,} "
            f"bytes; at most {MOST_ROWS:,} rows with {MOST_NUMBERS:,} numbers are read; give fewer trajectories"
        )


def _holds_numbers(kind: pa.DataType) -> bool:
    """Whether cells are lists of numbers, or lists of lists of them."""
    import pyarrow.types as types

    depth = 0
    while types.is_list(kind) or types.is_large_list(kind) or types.is_fixed_size_list(kind):
        kind, depth = kind.value_type, depth + 1
    return 1 <= depth <= 2 and (types.is_floating(kind) or types.is_integer(kind))


def _regular(cells: Any) -> FloatArray | None:
    """Some cells as one array, if they all have the same shape and miss nothing."""
    shape = [len(cells)]
    while hasattr(cells, "flatten") and hasattr(cells.type, "value_type"):
        if cells.null_count:
            return None
        inner = cells.flatten()
        lengths = {len(cells[0])} if len(cells) == 1 else set(np.unique(cells.value_lengths().to_numpy()).tolist())
        if len(lengths) > 1:
            return None
        shape.append(int(lengths.pop()) if lengths else 0)
        cells = inner
    if cells.null_count:
        return None
    values: FloatArray = cells.to_numpy(zero_copy_only=False).astype(np.float64)
    return values.reshape(shape)
