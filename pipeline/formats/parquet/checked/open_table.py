"""A table that is open: its file is opened once, its schema checked once, each of its values checked when first read.

Its rows are handed out by parts, which are the row groups of the file. Columns that were read lately are kept, up to a
bound: a small table is read once however often it is asked for, and a large one never fills the memory.
"""

from __future__ import annotations

import hashlib
import os
import threading
import weakref
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING

from pipeline.errors import TableError
from pipeline.formats.parquet.checked.conformance import (
    CONTENT_KEY,
    GROUPS,
    REMEDY,
    check_file_schema,
    check_keys,
    check_values,
    columns_of,
    stored_provenance,
)
from pipeline.formats.parquet.checked.kept_columns import kept
from pipeline.formats.parquet.checked.key_ranges import KeyRanges
from schemas import schema

if TYPE_CHECKING:
    import polars as pl
    import pyarrow as pa
    import pyarrow.parquet as pq

    from pipeline.arrays import FloatArray


@dataclass(frozen=True)
class Piece:
    """Rows of one part: `count` of them from `first` on."""

    part: int
    first: int
    count: int


class OpenTable:
    """A Parquet file that holds a table of `schemas/`. Threads may share it. Also a context, which closes it.

    Args:
        path: of the file.
        name: of the schema.

    Attributes:
        path, contract: the file and the schema.
        columns: names of all columns.
        key_columns: those that the keys are checked from; they are checked when all of these are read together.
        lengths: of its arrays, by the letters of the schema.
        parts: how many rows each part has.
        provenance: what is stored about where the rows came from.
        content: the checksum of the rows when they were written; see `content_digest`.

    Raises:
        TableError: the file is missing, or is no such table. Every method raises it when rows break the schema.
    """

    def __init__(self, path: Path, name: str) -> None:
        import pyarrow as pa

        self.path, self.contract = path, schema(name)
        self._lock = threading.RLock()
        self._key = object()  # of its columns among those that are kept, which do not keep the table itself
        weakref.finalize(self, kept.forget, self._key)
        self._checked: set[tuple[int, str]] = set()
        self._keys_checked: set[int] = set()
        self._key_ranges = KeyRanges(path, self.contract)
        try:
            self._stream, self._file = _open(path)
        except FileNotFoundError:
            raise TableError(f"{path}: there is no such file; run the stage that makes it with `dvc repro`") from None
        except (pa.ArrowException, OSError, ValueError, OverflowError, MemoryError) as error:
            raise _unreadable(path, error) from None
        columns, metadata = self._file.schema_arrow, self._file.metadata
        self.lengths = check_file_schema(columns, self.contract, path)
        self.columns: tuple[str, ...] = tuple(columns.names)
        self.key_columns = frozenset(name for name in self.columns if name in (*self.contract.key, *GROUPS))
        groups = range(metadata.num_row_groups)  # a file may have none, which makes one part without rows
        self.parts: tuple[int, ...] = tuple(metadata.row_group(number).num_rows for number in groups) or (0,)
        self.provenance = stored_provenance(columns.metadata, path)
        self.content = (metadata.metadata or {}).get(CONTENT_KEY, b"").decode("ascii", "replace")

    @property
    def rows(self) -> int:
        """How many there are."""
        return sum(self.parts)

    def part(self, number: int, columns: Sequence[str] | None = None) -> pl.DataFrame:
        """The rows of one part, in the columns asked for or in all."""
        import polars as pl

        return pl.DataFrame(self._columns(number, self.columns if columns is None else tuple(dict.fromkeys(columns))))

    def pieces(self, pieces: Sequence[Piece], columns: Sequence[str]) -> Iterator[pl.DataFrame]:
        """The rows of each of some pieces, in their order."""
        for piece in pieces:
            yield self.part(piece.part, columns).slice(piece.first, piece.count)

    def numbers(self, pieces: Sequence[Piece], columns: Sequence[str]) -> FloatArray:
        """(M, F) of the rows of some pieces, in F columns of doubles."""
        import numpy as np

        values = np.empty((sum(piece.count for piece in pieces), len(columns)), order="F")
        first = 0
        for piece in pieces:
            last = first + piece.count
            for place, column in enumerate(self._columns(piece.part, columns)):
                values[first:last, place] = column.to_numpy()[piece.first : piece.first + piece.count]
            first = last
        return values

    def read(self, columns: Sequence[str] | None = None, where: pl.Expr | None = None) -> pl.DataFrame:
        """All rows, or those for which `where` is true; of parts without such rows only its columns are read."""
        import polars as pl

        wanted = self.columns if columns is None else tuple(columns)
        found = []
        for number in range(len(self.parts)):
            if where is None:
                found.append(self.part(number, wanted))
                continue
            chosen = self.part(number, where.meta.root_names()).select(where).to_series()
            if chosen.any():
                found.append(self.part(number, wanted).filter(chosen))
        return pl.concat(found) if found else self._empty(wanted)

    def at(self, rows: Sequence[int], columns: Sequence[str]) -> pl.DataFrame:
        """The rows of these numbers, which are in order, with one part in memory at a time."""
        import polars as pl

        found, before = [], 0
        for number, count in enumerate(self.parts):
            here = [row - before for row in rows if before <= row < before + count]
            if here:
                found.append(self.part(number, columns)[here])
            before += count
        return pl.concat(found) if found else self._empty(columns)

    def batches(self) -> Iterator[pa.RecordBatch]:
        """All rows and columns for other libraries, part by part, in the types of the file."""
        for number in range(len(self.parts)):
            with self._lock:
                part = self._raw(number, self.columns)
            yield from part.to_batches()

    @property
    def arrow_schema(self) -> pa.Schema:
        """Names and types of the columns of `batches`."""
        return _plain(self._file.schema_arrow)

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the end of the file, which says where everything is in it and what the rows were made from."""
        with self._lock:
            size = self._stream.size()
            self._stream.seek(size - 8)
            self._stream.seek(size - 8 - int.from_bytes(self._stream.read(4), "little"))
            return hashlib.sha256(self._stream.read()).hexdigest()

    def close(self) -> None:
        """Close the file and forget what was read."""
        with self._lock:
            kept.forget(self._key)
            self._file.close(force=True)
            self._stream.close()

    def __enter__(self) -> OpenTable:
        return self

    def __exit__(self, _: type[BaseException] | None, __: BaseException | None, ___: TracebackType | None) -> None:
        self.close()

    def _columns(self, number: int, names: Sequence[str]) -> list[pl.Series]:
        """Columns of a part, which are read, checked and kept unless they are at hand."""
        at_hand = self._at_hand(number, names)
        if len(at_hand) < len(names) or self._keys_unchecked(number, at_hand):
            with self._lock:
                at_hand = self._at_hand(number, names)  # another thread may have read them meanwhile
                at_hand |= self._read(number, [name for name in names if name not in at_hand])
                self._check(number, at_hand)
                for name, column in at_hand.items():
                    kept.keep((self._key, number, name), column)
        return [at_hand[name] for name in names]

    def _at_hand(self, number: int, names: Sequence[str]) -> dict[str, pl.Series]:
        columns = ((name, kept.get((self._key, number, name))) for name in names)
        return {name: column for name, column in columns if column is not None}

    def _keys_unchecked(self, number: int, columns: Mapping[str, object]) -> bool:
        return number not in self._keys_checked and self.key_columns <= columns.keys()

    def _read(self, number: int, names: Sequence[str]) -> dict[str, pl.Series]:
        import polars as pl

        absent = [name for name in names if name not in self.columns]
        if absent:
            raise TableError(
                f"{self.path}: table {self.contract.name!r} lacks the column {absent[0]!r}; it has "
                f"{', '.join(self.columns)}; {REMEDY}"
            )
        return {column.name: column for column in pl.DataFrame(self._raw(number, names)).rechunk()} if names else {}

    def _check(self, number: int, columns: Mapping[str, pl.Series]) -> None:
        """Check values and keys that are read for the first time."""
        import polars as pl

        part, first = pl.DataFrame(list(columns.values())), sum(self.parts[:number])
        fresh = [name for name in columns if (number, name) not in self._checked]
        check_values(part, columns_of(fresh, self.contract), self.path, first)
        self._checked.update((number, name) for name in fresh)
        if self._keys_unchecked(number, columns):
            check_keys(part, self.contract, self.path, first)
            self._key_ranges.add(part)
            self._keys_checked.add(number)

    def _raw(self, number: int, names: Sequence[str]) -> pa.Table:
        """Columns of a part as they are in the file; texts and arrays are validated, as others do not."""
        import pyarrow as pa

        try:
            if self._file.metadata.num_row_groups:
                part = self._file.read_row_group(number, columns=list(names)).select(list(names))
            else:
                part = self._file.schema_arrow.empty_table().select(list(names))
            part.validate(full=True)
        except (pa.ArrowException, OSError, ValueError, OverflowError, MemoryError) as error:
            raise _unreadable(self.path, error) from None
        return part.cast(_plain(part.schema))

    def _empty(self, columns: Sequence[str]) -> pl.DataFrame:
        import polars as pl

        return pl.DataFrame(self.arrow_schema.empty_table()).select(columns)


def _open(path: Path) -> tuple[pa.OSFile, pq.ParquetFile]:
    """The one place where the file of a table is opened: this file, whatever characters are in its name."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    stream = pa.OSFile(os.fsencode(path))
    return stream, pq.ParquetFile(stream, page_checksum_verification=True)


def _plain(columns: pa.Schema) -> pa.Schema:
    """Names and types alone."""
    import pyarrow as pa

    return pa.schema([pa.field(field.name, field.type) for field in columns])


def _unreadable(path: Path, error: Exception) -> TableError:
    return TableError(f"{path}: cannot be read as Parquet ({' '.join(str(error).split())}); {REMEDY}")
