"""The tables of a task that a stage reads: each is opened once, then checked and indexed in one pass."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType

from pipeline.formats.parquet.checked.open_table import OpenTable
from pipeline.formats.parquet.foreign_keys import Keys, ReferenceCheck, check_lengths
from pipeline.formats.parquet.partitions import Contents, SetIndex
from pipeline.formats.parquet.table_file import TableFile, share, unshare


class TaskTables(Mapping[str, OpenTable]):
    """Tables by the names of their schemas, each opened when it is first asked for; a context, which closes them all.

    Args:
        paths: of their files.
    """

    def __init__(self, paths: Mapping[str, Path]) -> None:
        self._paths = dict(paths)
        self._tables: dict[str, OpenTable] = {}
        self._contents: dict[str, Contents] = {}
        self._shared: dict[str, TableFile] = {}
        self._open = ExitStack()

    def __getitem__(self, name: str) -> OpenTable:
        if name not in self._tables:
            self._tables[name] = self._open.enter_context(OpenTable(self._paths[name], name))
        return self._tables[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._paths)

    def __len__(self) -> int:
        return len(self._paths)

    def __enter__(self) -> TaskTables:
        return self

    def __exit__(self, _: type[BaseException] | None, __: BaseException | None, ___: TracebackType | None) -> None:
        self._open.close()

    def check(self, whole: Collection[str] = ()) -> None:
        """Check that no key repeats, and that every row has the counterparts that the schemas ask for.

        Args:
            whole: tables of which every value is checked now; of the others, when it is read.

        Raises:
            TableError: a table is missing, breaks its schema, or does not fit the others.
        """
        check_lengths(self)
        references = [
            ReferenceCheck(reference, table, self[reference.table])
            for table in self.values()
            for reference in table.contract.references
            if reference.table in self
        ]
        for name, table in self.items():
            self._pass(
                name, table, [side for one in references for side in one.sides if side.table is table], name in whole
            )
        for one in references:
            one.finish()

    def for_jobs(self, name: str) -> TableFile:
        """The record that the jobs of a fold find a table by."""
        if name not in self._shared:
            self._shared[name] = share(self[name])
            self._open.callback(unshare, self._shared[name])
        return self._shared[name]

    def contents(self, name: str) -> Contents:
        """Where the sets of alternatives are in a table that has been checked."""
        return self._contents[name]

    def _pass(self, name: str, table: OpenTable, sides: list[Keys], whole: bool) -> None:
        """Read the keys of a table, or all of it, once."""
        index = SetIndex()
        has_sets = set(index.columns) <= set(table.columns)
        needed = table.key_columns.union(*(side.needed for side in sides))
        columns = [column for column in table.columns if whole or column in needed]
        for number, _ in enumerate(table.parts):
            part = table.part(number, columns)
            for side in sides:
                side.add(part)
            if has_sets:
                index.add(number, part)
        self._contents[name] = index.contents
