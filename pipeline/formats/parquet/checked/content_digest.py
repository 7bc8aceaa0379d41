"""A checksum over the rows of a table, whatever its row groups, pages and compression are."""

from __future__ import annotations

import hashlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterable

    import pyarrow as pa


class ContentDigest:
    """SHA-256 over names, types and values of all columns; rows are added part by part, in order.

    Of each column three streams are hashed: which values are there, how long texts are, and the values, little-endian.
    Parts of other sizes with the same rows in the same order therefore give the same digest.
    """

    def __init__(self, columns: pa.Schema) -> None:
        self._columns = [_ColumnDigest(f"{field.name}\0{_named(field.type)}") for field in columns]

    def add(self, part: pa.Table | pa.RecordBatch) -> None:
        """The next rows."""
        for digest, column in zip(self._columns, part.columns, strict=True):
            for chunk in getattr(column, "chunks", [column]):
                digest.add(chunk)

    def hexdigest(self) -> str:
        """Of the rows so far."""
        whole = hashlib.sha256()
        for column in self._columns:
            whole.update(column.digest())
        return whole.hexdigest()


def content_digest(columns: pa.Schema, batches: Iterable[pa.RecordBatch]) -> str:
    """The digest of a table from all its rows."""
    digest = ContentDigest(columns)
    for batch in batches:
        digest.add(batch)
    return digest.hexdigest()


class _ColumnDigest:
    def __init__(self, heading: str) -> None:
        self._heading = heading
        self._there, self._lengths, self._values = hashlib.sha256(), hashlib.sha256(), hashlib.sha256()

    def digest(self) -> bytes:
        parts = (self._there, self._lengths, self._values)
        return hashlib.sha256(self._heading.encode() + b"".join(part.digest() for part in parts)).digest()

    def add(self, array: pa.Array) -> None:
        import pyarrow as pa
        import pyarrow.compute as pc

        self._there.update(_bytes(pc.is_valid(array)))
        if isinstance(array.type, pa.FixedSizeListType):
            self.add(array.flatten())
        elif pa.types.is_string(array.type):
            there = array.drop_null().cast(pa.binary())
            self._lengths.update(_bytes(pc.binary_length(there)))
            self._values.update(b"".join(there.to_pylist()))
        else:
            self._values.update(_bytes(array.drop_null()))


def _named(type_: pa.DataType) -> str:
    """The type in words that do not depend on what the elements of an array are called."""
    import pyarrow as pa

    return f"{_named(type_.value_type)}[{type_.list_size}]" if isinstance(type_, pa.FixedSizeListType) else str(type_)


def _bytes(array: pa.Array) -> Any:
    """Values that are all there, as they lie in memory; a truth value is a byte."""
    import numpy as np
    import pyarrow as pa

    values = array.to_numpy(zero_copy_only=False)
    if pa.types.is_boolean(array.type):
        values = values.astype(np.uint8)
    return np.ascontiguousarray(values, dtype=values.dtype.newbyteorder("<")).view(np.uint8)
