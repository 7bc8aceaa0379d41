"""`--help` of a benchmark without options: what its module says of itself."""

from __future__ import annotations

import sys


def explain(documentation: str | None) -> None:
    """Print the documentation and end, if `-h` or `--help` was typed."""
    if {"-h", "--help"} & set(sys.argv[1:]):
        print(documentation)
        sys.exit(0)
