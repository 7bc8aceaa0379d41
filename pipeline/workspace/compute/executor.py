"""Runs a function for each of many parts, on the cores of this machine or on a cluster, and merges the results.

What is submitted is a function of a module and a small record: names of files, numbers of parts, parameters. Results
are returned in the order of the parts, or merged in pairs as a tree whose shape depends on their number alone. So the
number of threads, workers or failures changes no bit. On a cluster, large results such as sketches are merged on the
workers, and only the last one is sent to this machine.
"""

from __future__ import annotations

import concurrent.futures
import os
import re
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar, cast

from pipeline.errors import StageError
from pipeline.vocabulary import SCHEDULER
from pipeline.workspace.progress import tracked

Job = TypeVar("Job")
Result = TypeVar("Result")
Item = TypeVar("Item")

_ADDRESS = re.compile(r"(tcp|tls)://[^/\s]+:\d+")


class Future(Protocol):
    """A result that is being computed, in a thread or on a cluster."""

    def wait(self) -> None:
        """Wait until the result has been computed; raise the error if it failed."""

    def result(self) -> Any:
        """Wait for the result and return it."""

    def cancel(self) -> Any:
        """Cancel the call if it has not started."""


@dataclass(frozen=True)
class Workers:
    """The threads or cluster workers that compute.

    Attributes:
        cores: returns how many parts can be computed at once at present.
        ahead: number of parts that are submitted for each core.
        submit: starts a call of a function with one job.
        join: starts to merge two results, without moving them to this machine.
    """

    cores: Callable[[], int]
    ahead: int
    submit: Callable[[Callable[[Any], Any], Any], Future]
    join: Callable[[Callable[[Any, Any], Any], Any, Any], Future]

    def mapped(self, function: Callable[[Job], Result], jobs: Sequence[Job], label: str) -> Iterator[Result]:
        """The function's result for each job, in the order of the jobs. Only a few jobs are submitted at a time.

        Args:
            function: a function of a module, not a method; the same job gives the same result, to the last bit.
            jobs: small records.
            label: what the progress bar says is computed.

        Raises:
            StageError: the cluster is lost.
            WorkbenchError: the function raised it.
        """
        for future in self._in_order(function, jobs, label):
            yield future.result()

    def merged(
        self,
        function: Callable[[Job], Result],
        jobs: Sequence[Job],
        merge: Callable[[Result, Result], Result],
        label: str,
    ) -> Result:
        """The function's results for all jobs, merged: neighbours in pairs, then pairs of pairs, and so on.

        At most one merged result for each power of two up to the number of jobs is held at a time.

        Args:
            function: a function of a module, not a method; the same job gives the same result, to the last bit.
            jobs: small records, at least one.
            merge: a function of a module that merges two consecutive results, the earlier one first.
            label: what the progress bar says is computed.

        Raises:
            StageError: the cluster is lost.
            WorkbenchError: one of the functions raised it.
        """
        trees: list[tuple[int, Future]] = []  # (height, result of 2^height merged jobs), heights descending
        for future in self._in_order(function, jobs, label):
            future.wait()
            merged, height = future, 0
            while trees and trees[-1][0] == height:
                earlier = trees.pop()[1]
                earlier.wait()  # so that a merge that fails is noticed now and not at the end
                merged, height = self.join(merge, earlier, merged), height + 1
            trees.append((height, merged))
        merged = trees.pop()[1]
        while trees:
            merged = self.join(merge, trees.pop()[1], merged)
        return cast(Result, merged.result())

    def _in_order(self, function: Callable[[Job], Result], jobs: Sequence[Job], label: str) -> Iterator[Future]:
        waiting, started = iter(jobs), deque[Future]()
        try:
            for _ in tracked(jobs, label):
                for job in _up_to(self.ahead * self.cores() + 1 - len(started), waiting):
                    started.append(self.submit(function, job))
                yield started.popleft()
        finally:
            for future in started:
                future.cancel()


@contextmanager
def workers() -> Iterator[Workers]:
    """The cores of this machine, or the cluster if the environment names its scheduler, which no file can.

    Raises:
        StageError: what is named is no address, or the scheduler cannot be reached, has no workers, or is lost.
    """
    if scheduler := os.environ.get(SCHEDULER):
        if not _ADDRESS.fullmatch(scheduler):
            raise StageError(
                f"{SCHEDULER} is {scheduler!r}, which is no address of a scheduler; it should be tcp://HOST:PORT or "
                "tls://HOST:PORT"
            )
        from pipeline.workspace.compute.dask_executor import connected

        with connected(scheduler) as (cores, call):
            yield Workers(cores, 2, call, call)  # the next job travels while one is computed
        return
    count = os.cpu_count() or 1
    pool = ThreadPoolExecutor(count)
    try:
        yield Workers(
            lambda: count,
            1,
            lambda function, job: Local(pool.submit(function, job)),
            lambda merge, earlier, later: Local(_done(merge(earlier.result(), later.result()))),
        )
    finally:
        pool.shutdown(cancel_futures=True)


@dataclass(frozen=True)
class Local:
    """A call in a thread of this process."""

    call: concurrent.futures.Future[Any]

    def wait(self) -> None:
        """Wait until the result has been computed; raise the error if it failed."""
        self.call.result()

    def result(self) -> Any:
        """Wait for the result and return it."""
        return self.call.result()

    def cancel(self) -> Any:
        """Cancel the call if it has not started."""
        self.call.cancel()


def _done(value: Any) -> concurrent.futures.Future[Any]:
    future = concurrent.futures.Future[Any]()
    future.set_result(value)
    return future


def _up_to(count: int, items: Iterator[Item]) -> Iterator[Item]:
    for _, item in zip(range(count), items, strict=False):
        yield item
