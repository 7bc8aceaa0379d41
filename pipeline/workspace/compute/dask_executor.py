"""Runs parts on a Dask cluster. Results are merged on the workers, and the calls of a lost worker are run again."""

from __future__ import annotations

import hashlib
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, partial
from importlib.metadata import version
from pathlib import Path
from typing import Any, TypeAlias

from pipeline.errors import StageError

RETRIES = 3  # how often a part that fails is run again, and how many workers may be lost with it
_PATIENCE_S = 15  # how long a scheduler may take to answer
_STARTING_S = 300  # how long to wait for a first worker, or for another when all are lost: batch systems have queues
_LOOK_S = 10.0  # between checks whether there still are workers


@dataclass(frozen=True)
class Remote:
    """A call on a cluster. A lost worker is no error, because another one runs its calls again.

    Attributes:
        call: the future of `distributed`.
        scheduler: address of the cluster's scheduler.
    """

    call: Any
    scheduler: str

    def wait(self) -> None:
        """Wait until a worker has computed the result.

        Raises:
            StageError: the cluster has given up, or has had no worker for too long.
        """
        with self._given_up():
            self._wait_for_cluster()
            if self.call.status != "finished":
                self.call.result()

    def result(self) -> Any:
        """Wait for the result and bring it to this machine.

        Raises:
            StageError: the cluster has given up, or has had no worker for too long.
        """
        with self._given_up():
            self._wait_for_cluster()
            return self.call.result()

    def _wait_for_cluster(self) -> None:
        """Wait until the call is done, and check from time to time whether there still are workers.

        The timeouts of `distributed` are no help: they include the transfer of the result, and may fail near its end.
        """
        deserted = None
        while not self.call.done():
            done = threading.Event()
            self.call.add_done_callback(lambda _, done=done: done.set())
            if done.wait(_LOOK_S):
                continue
            if self.call.client.nthreads():
                deserted = None
                continue
            deserted = deserted or time.monotonic()
            if time.monotonic() - deserted > _STARTING_S:
                raise StageError(
                    f"the scheduler {self.scheduler} has lost all of its workers, and none has come for {_STARTING_S} "
                    "s; start workers and run this again, or name none"
                )

    @contextmanager
    def _given_up(self) -> Iterator[None]:
        from distributed import KilledWorker
        from distributed.client import FutureCancelledError
        from distributed.comm import CommClosedError

        try:
            yield
        except (KilledWorker, FutureCancelledError, CommClosedError) as error:
            raise StageError(
                f"the cluster of {self.scheduler} gave up ({type(error).__name__}: {' '.join(str(error).split())}); "
                "its logs say why, most often a worker had too little memory for compute.partition and "
                "compute.memory_gb; then run this again"
            ) from None

    def cancel(self) -> Any:
        """Cancel the call if it has not started."""
        self.call.cancel()


Call: TypeAlias = Callable[..., Remote]


@contextmanager
def connected(scheduler: str) -> Iterator[tuple[Callable[[], int], Call]]:
    """Connect to a cluster.

    Yields:
        A function that returns the number of cores at present, and one that starts a call on the cluster. The latter
        takes a function and its arguments, which may be results that are still being computed.

    Raises:
        StageError: the scheduler cannot be reached, has no workers, or is lost.
    """
    try:
        from distributed import Client
    except ImportError:
        raise StageError(
            f"the scheduler {scheduler} is named and the package `distributed` is not installed; install lessbench "
            "with its extra `cluster`, or name none"
        ) from None
    try:
        client = Client(scheduler, timeout=_PATIENCE_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise StageError(
            f"the scheduler {scheduler} cannot be reached ({' '.join(str(error).split())}); start it, name another "
            "one, or name none"
        ) from None
    program = fingerprint()

    def call(function: Callable[..., Any], *arguments: Any) -> Remote:
        values = [argument.call if isinstance(argument, Remote) else argument for argument in arguments]
        # pure=False: an earlier result of the same call may be outdated, as the files that a job names change
        return Remote(
            client.submit(partial(_checked, program, function), *values, pure=False, retries=RETRIES), scheduler
        )

    with client:
        try:
            client.wait_for_workers(1, timeout=_STARTING_S)
        except TimeoutError:
            raise StageError(
                f"the scheduler {scheduler} has had no worker for {_STARTING_S} s; start workers, or name none"
            ) from None
        yield lambda: max(sum(client.nthreads().values()), 1), call


def _checked(program: str, function: Callable[..., Any], *arguments: Any) -> Any:
    """Run a function on a worker, whose program must be the one that the stage runs."""
    if fingerprint() != program:
        raise StageError(
            "a worker of the cluster has another version of lessbench, NumPy, SciPy, FINUFFT or MuJoCo than this "
            "machine; start the workers from the same environment"
        )
    return function(*arguments)


@cache
def fingerprint() -> str:
    """SHA-256 over the program's code and the versions of the libraries it computes with."""
    root = Path(__file__).resolve().parents[2]
    digest = hashlib.sha256()
    for name in ("numpy", "scipy", "finufft", "mujoco", "polars"):
        digest.update(f"{name} {version(name)}\n".encode())
    for folder in ("pipeline", "schemas"):
        for path in sorted(p for p in (root / folder).rglob("*") if p.suffix in (".py", ".toml")):
            digest.update(path.relative_to(root).as_posix().encode())
            digest.update(path.read_bytes())
    return digest.hexdigest()
