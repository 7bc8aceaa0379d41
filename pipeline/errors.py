"""The errors a user can meet. Each message says what was wrong, what was got, what is allowed and what to do."""

from __future__ import annotations

from difflib import get_close_matches
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence


class WorkbenchError(Exception):
    """Root of every error that is the input's fault; the command line prints its message and exits with 1."""


class ArgumentError(WorkbenchError, ValueError):
    """An argument of a Python function is outside what is allowed; the message names the argument."""


class BandwidthError(WorkbenchError):
    """No bandwidth could be selected.

    Attributes:
        estimate: the last bandwidth looked at, in the features' (scaled) units, or None if there was none.
    """

    def __init__(self, message: str, estimate: float | None = None) -> None:
        super().__init__(message)
        self.estimate = estimate

    def of(self, size: int, set_id: str, anchor: str) -> BandwidthError:
        """The same, said of one set of alternatives."""
        return BandwidthError(f"set {set_id!r} of {size} alternatives with anchor {anchor!r}: {self}", self.estimate)


class ParameterError(WorkbenchError):
    """A field of params.yaml is unknown, missing or out of range; the message gives its path."""


class RecordingError(WorkbenchError):
    """A recording cannot be used.

    Attributes:
        reason: short stable code, the `reason` column of rejected.parquet.
        detail: one sentence for a person.
    """

    def __init__(self, reason: str, detail: str) -> None:
        super().__init__(detail)
        self.reason = reason
        self.detail = detail


class SceneError(WorkbenchError):
    """An MJCF file cannot be read or lacks a name that the parameters ask for."""


class TableError(WorkbenchError):
    """A table does not follow its schema."""


class SurveyError(WorkbenchError):
    """A study for the browser, or the file of its choices, is not what it should be."""


class StageError(WorkbenchError):
    """A stage cannot go on with the inputs it found."""


class QueryError(WorkbenchError):
    """A question to the catalog cannot be answered."""


class OutputError(WorkbenchError):
    """What is printed cannot be written: a full disk, for example."""


def one_of(names: Iterable[str]) -> str:
    """The valid names as they are listed at the end of a message."""
    return ", ".join(sorted(names))


def nearest(name: str, names: Iterable[str]) -> str:
    """Which valid name was perhaps meant, to follow the wrong one in a message; nothing if none is alike."""
    alike = get_close_matches(name, sorted(names), 1)
    return f" (did you mean {alike[0]!r}?)" if alike else ""


def few_of(names: Sequence[str], most: int = 3) -> str:
    """The first names of a list and how many more there are, such as "a, b, c and 4 more"."""
    more = len(names) - most
    return ", ".join(names[:most]) + (f" and {more} more" if more > 0 else "")
