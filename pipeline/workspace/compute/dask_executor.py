"""The parts of folds on a Dask cluster: begun, merged where they are, begun again where a worker is lost."""

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

RETRIES = 3  # of a part that fails, and workers that may be lost with it
_PATIENCE_S = 15  # for a scheduler to answer
_STARTING_S = 300  # for a first worker to come, or another once all are lost, a batch system's queue permitting
_LOOK_S = 10.0  # between looks whether there still are workers


@dataclass(frozen=True)
class Remote:
    """A call on a cluster. A worker that is lost is no error: another one begins its calls again.

    Attributes:
        call: future of `distributed`.
        scheduler: of the cluster.
    """

    call: Any
    scheduler: str

    def wait(self) -> None:
        """Until the result is on some worker.

        Raises:
            StageError: the cluster has given up, or no worker has come for too long.
        """
        with self._given_up():
            self._arrived()
            if self.call.status != "finished":
                self.call.result()

    def result(self) -> Any:
        """Wait for the result and bring it here.

        Raises:
            StageError: as `wait`.
        """
        with self._given_up():
            self._arrived()
            return self.call.result()

    def _arrived(self) -> None:
        """Look from time to time whether there still are workers.

        What `distributed` offers with a timeout counts the transfer of a result too, and fails at random near its end.
        """
        deserted = None
        while not self.call.done():
            there = threading.Event()
            self.call.add_done_callback(lambda _, there=there: there.set())
            if there.wait(_LOOK_S):
                continue
            if self.call.client.nthreads():
                deserted = None
                continue
            deserted = deserted or time.monotonic()
            if time.monotonic() - deserted > _STARTING_S:
                raise StageError(
                    f"the scheduler {self.scheduler} has lost all of its workers, and none has come for {_STARTING_S} "
                    "s; start workers and run this again, or set compute.scheduler to null"
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
        """Do not begin."""
        self.call.cancel()


Call: TypeAlias = Callable[..., Remote]


@contextmanager
def connected(scheduler: str) -> Iterator[tuple[Callable[[], int], Call]]:
    """How many cores there are now, and how to begin a call of a function, which may take results that are under way.

    Raises:
        StageError: the scheduler cannot be reached, has no workers, or is lost.
    """
    try:
        from distributed import Client
    except ImportError:
        raise StageError(
            f"the scheduler {scheduler} is named and the package `distributed` is not installed; install lessbench "
            "with its extra `cluster`, or set compute.scheduler to null"
        ) from None
    try:
        client = Client(scheduler, timeout=_PATIENCE_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise StageError(
            f"the scheduler {scheduler} cannot be reached ({' '.join(str(error).split())}); start it, name another "
            "one, or set compute.scheduler to null"
        ) from None
    program = fingerprint()

    def call(function: Callable[..., Any], *arguments: Any) -> Remote:
        known = [argument.call if isinstance(argument, Remote) else argument for argument in arguments]
        # a key of its own for each call: the files that a job names may be others than in an earlier run
        return Remote(
            client.submit(partial(_checked, program, function), *known, pure=False, retries=RETRIES), scheduler
        )

    with client:
        try:
            client.wait_for_workers(1, timeout=_STARTING_S)
        except TimeoutError:
            raise StageError(
                f"the scheduler {scheduler} has had no worker for {_STARTING_S} s; start workers, or set "
                "compute.scheduler to null"
            ) from None
        yield lambda: max(sum(client.nthreads().values()), 1), call


def _checked(program: str, function: Callable[..., Any], *arguments: Any) -> Any:
    """On a worker: the function of its arguments, by the program that the stage is of."""
    if fingerprint() != program:
        raise StageError(
            "a worker of the cluster has another version of lessbench, NumPy, SciPy, FINUFFT or MuJoCo than this "
            "machine; start the workers from the same environment"
        )
    return function(*arguments)


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
