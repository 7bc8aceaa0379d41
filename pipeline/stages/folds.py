"""Folds over parts: a pure function of each part, on this machine's cores or on a cluster, its results in a fixed order.

What is submitted is a function of a module and a small record: names of files, numbers of parts, parameters. Results are
merged by the stage alone, in the order of the parts, so the number of threads, workers or failures changes no bit.
"""

from __future__ import annotations

import hashlib
import os
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, partial
from importlib.metadata import version
from pathlib import Path
from typing import Any, Protocol, TypeVar

from pipeline.errors import StageError
from pipeline.stages.progress import tracked
from pipeline.stages.project import Project

Job = TypeVar("Job")
Result = TypeVar("Result")
Item = TypeVar("Item")

SCHEDULER = "LESSBENCH_SCHEDULER"  # the environment variable that names a scheduler before params.yaml does
RETRIES = 3  # of a part that fails, and workers that may be lost with it
_PATIENCE_S = 15  # for a scheduler to answer
_STARTING_S = 300  # for a first worker to come, a batch system's queue permitting


class Future(Protocol):
    """What `concurrent.futures` and `distributed` have in common."""

    def result(self) -> Any:
        """Wait for the result."""

    def cancel(self) -> Any:
        """Do not begin."""


@dataclass(frozen=True)
class Workers:
    """Where functions of parts are computed.

    Attributes:
        count: parts that can be computed at once.
        submit: begins a call of a function with one job.
    """

    count: int
    submit: Callable[[Callable[[Any], Any], Any], Future]

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
        waiting, started = iter(jobs), deque[Future]()
        try:
            for _ in tracked(jobs, what):
                for job in _up_to(self.count + 1 - len(started), waiting):
                    started.append(self.submit(function, job))
                yield started.popleft().result()
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
        with _cluster(scheduler) as cluster:
            yield cluster
        return
    count = os.cpu_count() or 1
    pool = ThreadPoolExecutor(count)
    try:
        yield Workers(count, lambda function, job: pool.submit(function, job))
    finally:
        pool.shutdown(cancel_futures=True)


@contextmanager
def _cluster(scheduler: str) -> Iterator[Workers]:
    try:
        from distributed import Client
    except ImportError:
        raise StageError(
            f"the scheduler {scheduler} is named and the package `distributed` is not installed; install lessbench with "
            "its extra `cluster`, or set compute.scheduler to null"
        ) from None
    try:
        client = Client(scheduler, timeout=_PATIENCE_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise StageError(
            f"the scheduler {scheduler} cannot be reached ({' '.join(str(error).split())}); start it, name another one, or "
            "set compute.scheduler to null"
        ) from None
    program = fingerprint()

    def submit(function: Callable[[Any], Any], job: Any) -> Future:
        # a key of its own for each call: the files that a job names may be others than in an earlier run
        call = client.submit(partial(_checked, program, function), job, pure=False, retries=RETRIES)
        return Remote(call, scheduler)

    with client:
        try:
            client.wait_for_workers(1, timeout=_STARTING_S)
        except TimeoutError:
            raise StageError(
                f"the scheduler {scheduler} has had no worker for {_STARTING_S} s; start workers, or set compute.scheduler "
                "to null"
            ) from None
        yield Workers(2 * sum(client.nthreads().values()), submit)


@dataclass(frozen=True)
class Remote:
    """A call on a cluster. A worker that is lost is no error: another one begins its calls again.

    Attributes:
        call: future of `distributed`.
        scheduler: of the cluster.
    """

    call: Any
    scheduler: str

    def result(self) -> Any:
        """Wait for the result.

        Raises:
            StageError: the cluster has given up.
        """
        from distributed import KilledWorker
        from distributed.client import FutureCancelledError
        from distributed.comm import CommClosedError

        try:
            return self.call.result()
        except (KilledWorker, FutureCancelledError, CommClosedError) as error:
            raise StageError(
                f"the cluster of {self.scheduler} gave up ({type(error).__name__}: {' '.join(str(error).split())}); its logs "
                "say why, most often a worker had too little memory for compute.partition; then run this again"
            ) from None

    def cancel(self) -> Any:
        """Do not begin."""
        self.call.cancel()


def _checked(program: str, function: Callable[[Job], Result], job: Job) -> Result:
    """On a worker: the function of the job, by the program that the stage is of."""
    if fingerprint() != program:
        raise StageError(
            "a worker of the cluster has another version of lessbench, NumPy, SciPy, FINUFFT or MuJoCo than this machine; "
            "start the workers from the same environment"
        )
    return function(job)


@cache
def fingerprint() -> str:
    """SHA-256 over the program's code and the versions of what it computes with."""
    root = Path(__file__).resolve().parents[2]
    digest = hashlib.sha256()
    for name in ("numpy", "scipy", "finufft", "mujoco", "polars"):
        digest.update(f"{name} {version(name)}\n".encode())
    for folder in ("pipeline", "schemas"):
        for path in sorted(p for p in (root / folder).rglob("*") if p.suffix in (".py", ".toml")):
            digest.update(path.relative_to(root).as_posix().encode())
            digest.update(path.read_bytes())
    return digest.hexdigest()


def _up_to(count: int, items: Iterator[Item]) -> Iterator[Item]:
    for _, item in zip(range(count), items, strict=False):
        yield item
