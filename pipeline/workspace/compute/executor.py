"""Folds over parts: a pure function of each part, on this machine or on a cluster, its results in a fixed order.

What is submitted is a function of a module and a small record: names of files, numbers of parts, parameters. Results
are used in the order of the parts, or merged in pairs as a tree whose shape depends on their number alone, so the
number of threads, workers or failures changes no bit. Large results, as sketches are, meet on the workers; the last one
comes here.
"""

from __future__ import annotations

import concurrent.futures
import os
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar, cast

from pipeline.workspace.progress import tracked
from pipeline.workspace.project import Project

Job = TypeVar("Job")
Result = TypeVar("Result")
Item = TypeVar("Item")

SCHEDULER = "LESSBENCH_SCHEDULER"  # the environment variable that names a scheduler before params.yaml does


class Future(Protocol):
    """A result that is under way, wherever it will be."""

    def wait(self) -> None:
        """Until it is there, or its failure is raised."""

    def result(self) -> Any:
        """Wait for it and bring it here."""

    def cancel(self) -> Any:
        """Do not begin."""


@dataclass(frozen=True)
class Workers:
    """Where functions of parts are computed.

    Attributes:
        cores: how many parts can be computed at once, now.
        ahead: parts that are under way for each core.
        submit: begins a call of a function with one job.
        join: begins to merge two results where they are.
    """

    cores: Callable[[], int]
    ahead: int
    submit: Callable[[Callable[[Any], Any], Any], Future]
    join: Callable[[Callable[[Any, Any], Any], Any, Any], Future]

    def mapped(self, function: Callable[[Job], Result], jobs: Sequence[Job], what: str) -> Iterator[Result]:
        """The function's result for each job, in the order of the jobs; a few are under way, the others wait.

        Args:
            function: of a module, not of an object; the same job gives the same result, to the last bit.
            jobs: small records.
            what: is computed, for the progress bar.

        Raises:
            StageError: the cluster is lost.
            WorkbenchError: what the function raises.
        """
        for found in self._in_order(function, jobs, what):
            yield found.result()

    def merged(
        self,
        function: Callable[[Job], Result],
        jobs: Sequence[Job],
        merge: Callable[[Result, Result], Result],
        what: str,
    ) -> Result:
        """The function's results for all jobs, merged in pairs of neighbours, then pairs of pairs, and so on.

        Besides those under way, there is at most one result for each power of two up to the number of jobs.

        Args:
            function, jobs, what: as in `mapped`; there is at least one job.
            merge: two results that follow each other; a function of a module.

        Raises:
            StageError: the cluster is lost.
            WorkbenchError: what a function raises.
        """
        trees: list[tuple[int, Future]] = []  # each of 2^height results, the heights descending
        for found in self._in_order(function, jobs, what):
            found.wait()
            height = 0
            while trees and trees[-1][0] == height:
                earlier = trees.pop()[1]
                earlier.wait()  # a merge that fails is not found out at the end
                found, height = self.join(merge, earlier, found), height + 1
            trees.append((height, found))
        last = trees.pop()[1]
        while trees:
            last = self.join(merge, trees.pop()[1], last)
        return cast(Result, last.result())

    def _in_order(self, function: Callable[[Job], Result], jobs: Sequence[Job], what: str) -> Iterator[Future]:
        waiting, started = iter(jobs), deque[Future]()
        try:
            for _ in tracked(jobs, what):
                for job in _up_to(self.ahead * self.cores() + 1 - len(started), waiting):
                    started.append(self.submit(function, job))
                yield started.popleft()
        finally:
            for future in started:
                future.cancel()


@contextmanager
def workers(project: Project) -> Iterator[Workers]:
    """This machine's cores, or the cluster of the scheduler that the environment or params.yaml names.

    Raises:
        StageError: the scheduler cannot be reached, has no workers, or is lost.
    """
    scheduler = os.environ.get(SCHEDULER) or project.params.compute.scheduler
    if scheduler is not None:
        from pipeline.workspace.compute.dask_executor import connected

        with connected(scheduler) as (cores, call):
            yield Workers(cores, 2, call, call)  # while one is computed, the next is on its way
        return
    count = os.cpu_count() or 1
    pool = ThreadPoolExecutor(count)
    try:
        yield Workers(
            lambda: count,
            1,
            lambda function, job: Local(pool.submit(function, job)),
            lambda merge, one, other: Local(_done(merge(one.result(), other.result()))),
        )
    finally:
        pool.shutdown(cancel_futures=True)


@dataclass(frozen=True)
class Local:
    """A call in a thread of this process."""

    call: concurrent.futures.Future[Any]

    def wait(self) -> None:
        """Raise what the call raised."""
        self.call.result()

    def result(self) -> Any:
        """Wait for the result."""
        return self.call.result()

    def cancel(self) -> Any:
        """Do not begin."""
        self.call.cancel()


def _done(value: Any) -> concurrent.futures.Future[Any]:
    future = concurrent.futures.Future[Any]()
    future.set_result(value)
    return future


def _up_to(count: int, items: Iterator[Item]) -> Iterator[Item]:
    for _, item in zip(range(count), items, strict=False):
        yield item
