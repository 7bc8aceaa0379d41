"""How much a column of a Parquet file says it holds, found out in a process of its own.

The library ends the whole process when some fields of a file's end are damaged, where it should raise an error. So what
is not trusted is looked at here first, with bounded memory and time.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

ADDRESS_SPACE_BYTES = 4 << 30
PATIENCE_S = 60
PROCESSOR_S = 20


@dataclass(frozen=True)
class Measured:
    """What the end of the file states: values of the column, over all row groups, and their bytes when inflated."""

    numbers: int
    size: int


def measured(descriptor: int, column: str) -> Measured | None:
    """What an open file states of a column; None if its end is damaged beyond what can be told.

    Args:
        descriptor: of the open file; its position is left as it is.
        column: the name of the column.
    """
    root = str(Path(__file__).parents[3])
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, [root, os.environ.get("PYTHONPATH")]))}
    command = [sys.executable, "-P", "-m", __name__, str(descriptor), column]
    try:
        done = subprocess.run(  # noqa: S603, this program itself
            command, pass_fds=[descriptor], env=environment, stdin=subprocess.DEVNULL, capture_output=True,
            timeout=PATIENCE_S, check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return None
    if done.returncode != 0:
        return None
    return Measured(**json.loads(done.stdout))


def main() -> None:
    """Print what the open file states of the column."""
    import pyarrow.parquet as pq

    resource.setrlimit(resource.RLIMIT_CPU, (PROCESSOR_S, PROCESSOR_S))
    resource.setrlimit(resource.RLIMIT_AS, (ADDRESS_SPACE_BYTES, ADDRESS_SPACE_BYTES))
    descriptor, column = int(sys.argv[1]), sys.argv[2]
    with pq.ParquetFile(f"/proc/self/fd/{descriptor}") as file:
        about = file.metadata
        leaves = [at for at in range(about.num_columns) if file.schema.column(at).path.split(".")[0] == column]
        parts = [about.row_group(number).column(at) for number in range(about.num_row_groups) for at in leaves]
        found = Measured(sum(part.num_values for part in parts), sum(part.total_uncompressed_size for part in parts))
    sys.stdout.write(json.dumps(found.__dict__))


if __name__ == "__main__":
    main()
