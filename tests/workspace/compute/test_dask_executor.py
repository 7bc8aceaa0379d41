"""The folds of the stages on a real cluster of processes, one of which is killed half way: bytes as without that."""

from __future__ import annotations

import json
import operator
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from pipeline.errors import ParameterError, StageError, TableError
from pipeline.formats.parquet.checked.open_table import Piece
from pipeline.formats.parquet.partitions import Gathered, Scaled
from pipeline.formats.parquet.table_file import TableFile
from pipeline.stages import density, featurize, infer, ingest, sample
from pipeline.workspace.compute import dask_executor, executor
from pipeline.workspace.project import Project
from tests.support.listening import LOOPBACK, listening

MakeProject = Callable[[dict[str, Any]], Project]
ROOT = Path(__file__).resolve().parents[3]
TABLES = ("alternatives", "sampling", "features", "feature_units", "scales", "densities", "posteriors", "held_out")


@dataclass(frozen=True)
class Cluster:
    """A scheduler and its workers, processes of this machine that listen on 127.0.0.1 alone."""

    address: str
    scheduler: subprocess.Popen[bytes]
    workers: list[subprocess.Popen[bytes]]


@contextmanager
def process(folder: Path, name: str, *arguments: str) -> Iterator[subprocess.Popen[bytes]]:
    """A command of Dask's that ends with the block."""
    command = [
        sys.executable,
        "-m",
        f"distributed.cli.dask_{name}",
        "--host",
        "127.0.0.1",
        "--dashboard-address",  # `--no-dashboard` leaves its server open on all interfaces
        "127.0.0.1:0",
        *arguments,
    ]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    with (folder / "log").open("ab") as log:
        running = subprocess.Popen(command, cwd=folder, env=environment, stdout=log, stderr=log)
        try:
            yield running
        finally:
            running.terminate()
            try:
                running.wait(10)
            except subprocess.TimeoutExpired:
                running.kill()
                running.wait()


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[Cluster]:
    with cluster_in(tmp_path / "dask") as cluster:
        yield cluster


@contextmanager
def cluster_in(folder: Path, protocol: str = "tcp://") -> Iterator[Cluster]:
    """A scheduler and two workers, whose files are in the folder."""
    folder.mkdir()
    file = folder / "scheduler.json"
    with ExitStack() as stack:
        options = ["--port", "0", "--scheduler-file", str(file), "--protocol", protocol.removesuffix("://")]
        scheduler = stack.enter_context(process(folder, "scheduler", *options))
        for _ in range(600):
            if file.exists():
                break
            time.sleep(0.1)
        options = ["--scheduler-file", str(file), "--no-nanny", "--nthreads", "1", "--local-directory", str(folder)]
        workers = [stack.enter_context(process(folder, "worker", *options)) for _ in range(2)]
        yield Cluster(json.loads(file.read_text())["address"], scheduler, workers)


@pytest.fixture
def large(parameters: dict[str, Any]) -> dict[str, Any]:
    parameters["compute"]["partition"] = 100
    parameters["sample"] |= {"sizes": [5, 20], "sets": 1, "working_set": 3050}
    parameters["density"]["bandwidth"] = 0.05
    return parameters


def bytes_of(project: Project) -> dict[str, bytes]:
    for stage in (ingest, sample, featurize, density, infer):
        stage.run(project, "sweep")
    return {name: project.table("sweep", name).read_bytes() for name in TABLES}


def alive(cluster: Cluster) -> int:
    from distributed import Client

    with Client(cluster.address, set_as_default=False) as client:
        return len(client.scheduler_info(n_workers=-1)["workers"])


def await_workers(cluster: Cluster) -> None:
    for _ in range(300):
        if alive(cluster) == 2:
            return
        time.sleep(0.1)
    raise AssertionError("the workers do not come")


def test_a_cluster_that_loses_a_worker_half_way_gives_the_same_bytes(
    make_project: MakeProject, large: dict[str, Any], cluster: Cluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    here = bytes_of(make_project(large))
    monkeypatch.setenv(executor.SCHEDULER, cluster.address)
    monkeypatch.setattr(executor, "ThreadPoolExecutor", None)  # nothing is computed on the side
    killed: list[int] = []
    add = Gathered.add

    def kill_at_the_tenth(table: Gathered, rows: pl.DataFrame) -> None:
        add(table, rows)
        if table.rows >= 1000 and not killed:  # of 31 parts, 21 are not yet here
            killed.append(alive(cluster))
            cluster.workers[0].send_signal(signal.SIGKILL)

    monkeypatch.setattr(Gathered, "add", kill_at_the_tenth)
    there = bytes_of(make_project(large))
    assert killed == [2]
    assert cluster.workers[0].wait(10) == -signal.SIGKILL
    assert alive(cluster) == 1
    for name in TABLES:
        assert there[name] == here[name], name


def test_results_are_merged_on_the_workers_as_a_tree(
    make_project: MakeProject, large: dict[str, Any], cluster: Cluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The shape is that of `test_folds`; nothing but the last result is brought here."""
    monkeypatch.setenv(executor.SCHEDULER, cluster.address)
    fetched: list[int] = []
    result = dask_executor.Remote.result

    def counted(remote: dask_executor.Remote) -> Any:
        found = result(remote)
        fetched.append(len(found))
        return found

    monkeypatch.setattr(dask_executor.Remote, "result", counted)
    with executor.workers() as pool:
        assert pool.merged(str, range(7), _pair, "numbers") == "(((01)(23))((45)6))"
        assert fetched == [19]
        with pytest.raises(ValueError, match="invalid literal"):
            pool.merged(int, ["1", "2", "three"], max, "numbers")


def _pair(one: str, other: str) -> str:
    return f"({one}{other})"


def test_a_cluster_that_has_lost_all_workers_is_given_up(
    make_project: MakeProject, large: dict[str, Any], cluster: Cluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(executor.SCHEDULER, cluster.address)
    with executor.workers() as pool:
        assert list(pool.mapped(str, [1, 2], "numbers")) == ["1", "2"]
        monkeypatch.setattr(dask_executor, "_LOOK_S", 0.2)
        monkeypatch.setattr(dask_executor, "_STARTING_S", 2)
        with pytest.raises(TimeoutError, match="its own"):
            list(pool.mapped(_late, [0], "numbers"))
        for worker in cluster.workers:
            worker.kill()
        with pytest.raises(StageError, match=r"lost all of its workers, and none has come for 2 s; start workers"):
            list(pool.mapped(str, [1, 2], "numbers"))


def test_looks_at_the_workers_disturb_no_result(
    make_project: MakeProject, large: dict[str, Any], cluster: Cluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Looks about as far apart as calls take, and results whose transfer takes longer than that."""
    monkeypatch.setenv(executor.SCHEDULER, cluster.address)
    monkeypatch.setattr(dask_executor, "_LOOK_S", 0.02)
    with executor.workers() as pool:
        assert list(pool.mapped(_slow, range(100), "numbers")) == [str(number) for number in range(100)]
        (found,) = pool.mapped(bytes, [50_000_000], "many")
        assert len(found) == 50_000_000


def test_a_worker_lost_while_results_are_merged_changes_nothing(
    cluster: Cluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    with executor.workers() as pool:
        here = pool.merged(str, range(60), _pair, "numbers")
    monkeypatch.setenv(executor.SCHEDULER, cluster.address)
    await_workers(cluster)
    with executor.workers() as pool:
        killing = threading.Timer(0.7, cluster.workers[0].kill)
        killing.start()
        assert pool.merged(_slow, range(60), _pair, "numbers") == here
        killing.join()
        assert cluster.workers[0].wait(10) == -signal.SIGKILL


def test_a_merge_that_fails_ends_the_fold_at_once(cluster: Cluster, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(executor.SCHEDULER, cluster.address)
    begin = time.monotonic()
    with executor.workers() as pool, pytest.raises(TypeError, match="unsupported operand"):
        pool.merged(_slow, range(10_000), operator.sub, "numbers")  # eight minutes in all
    assert time.monotonic() - begin < 60


def _slow(number: int) -> str:
    time.sleep(0.05)
    return str(number)


def _late(_: int) -> None:
    raise TimeoutError("its own")


@pytest.mark.skipif(not Path("/proc/net/tcp").exists(), reason="no /proc to read the listening sockets from")
def test_dask_with_these_options_listens_on_the_loopback_address_alone(cluster: Cluster) -> None:
    await_workers(cluster)
    for running in (cluster.scheduler, *cluster.workers):
        found = listening(running.pid)
        assert found
        assert found <= LOOPBACK


def test_what_a_part_raises_on_a_worker_is_raised_here(
    make_project: MakeProject, large: dict[str, Any], cluster: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(executor.SCHEDULER, cluster.address)
    job = Scaled(TableFile(tmp_path / "none.parquet", "features", ""), ("f",), np.ones(1)), [Piece(0, 0, 1)]
    with executor.workers() as pool:
        with pytest.raises(TableError, match=r"none\.parquet: there is no such file"):
            list(pool.mapped(density.spread_of, [job], "one"))
        monkeypatch.setattr(dask_executor, "fingerprint", lambda: "of another program")
    with executor.workers() as pool, pytest.raises(StageError, match="another version of lessbench"):
        list(pool.mapped(density.spread_of, [job], "one"))


def test_a_scheduler_that_does_not_answer_is_named(
    make_project: MakeProject, large: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(dask_executor, "_PATIENCE_S", 1)
    monkeypatch.setenv(executor.SCHEDULER, "tcp://127.0.0.1:1")
    with (
        pytest.raises(StageError, match=r"scheduler tcp://127\.0\.0\.1:1 cannot be reached"),
        executor.workers(),
    ):
        pass
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(StageError, match="extra `cluster`"), executor.workers():
        pass


def test_a_scheduler_must_be_an_address(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(executor.SCHEDULER, "somewhere")
    with pytest.raises(StageError, match="'somewhere', which is no address of a scheduler"), executor.workers():
        pass


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:8786", "somewhere", ""])
def test_no_file_names_a_scheduler(make_project: MakeProject, large: dict[str, Any], address: str) -> None:
    """Whoever answers as a scheduler can run code here, and parameters travel with projects."""
    large["compute"]["scheduler"] = address
    with pytest.raises(ParameterError, match=r"compute: scheduler is no parameter, .* `lessbench --scheduler`"):
        _ = make_project(large).params
    large["compute"]["scheduler"] = None
    assert make_project(large).params.compute.partition == 100


def test_a_scheduler_for_one_command(make_project: MakeProject, large: dict[str, Any]) -> None:
    project = make_project(large)
    ingest.run(project, "sweep")
    command = [sys.executable, "-m", "pipeline", "--scheduler", "tcp://127.0.0.1:1", "sample", "sweep"]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    ended = subprocess.run(command, cwd=project.root, env=environment, capture_output=True, text=True, timeout=120)
    assert ended.returncode == 1
    assert "the scheduler tcp://127.0.0.1:1 cannot be reached" in ended.stderr


@pytest.mark.skipif(shutil.which("openssl") is None, reason="certificates are made by openssl, which is not there")
def test_encrypted_and_for_those_with_a_certificate_alone(
    make_project: MakeProject, large: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    here = bytes_of(make_project(large))
    for name, value in certified(tmp_path, "ours").items():
        monkeypatch.setenv(name, value)
    refresh()
    with cluster_in(tmp_path / "dask", "tls://") as cluster:
        assert cluster.address.startswith("tls://127.0.0.1:")
        monkeypatch.setenv(executor.SCHEDULER, cluster.address)
        assert bytes_of(make_project(large)) == here
        for name, value in certified(tmp_path, "theirs").items():
            monkeypatch.setenv(name, value)
        monkeypatch.setattr(dask_executor, "_PATIENCE_S", 2)
        refresh()
        with pytest.raises(StageError, match="cannot be reached"), executor.workers():
            pass
    monkeypatch.undo()
    refresh()


def certified(folder: Path, authority: str) -> dict[str, str]:
    """Dask's settings, in the environment, for a certificate that signs itself."""
    certificate, key = folder / f"{authority}.pem", folder / f"{authority}.key"
    command = ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "1", "-subj", "/CN=127.0.0.1"]
    subprocess.run([*command, "-keyout", str(key), "-out", str(certificate)], check=True, capture_output=True)
    settings = {"REQUIRE_ENCRYPTION": "true", "TLS__CA_FILE": str(certificate)}
    for role in ("CLIENT", "SCHEDULER", "WORKER"):
        settings |= {f"TLS__{role}__CERT": str(certificate), f"TLS__{role}__KEY": str(key)}
    return {f"DASK_DISTRIBUTED__COMM__{name}": value for name, value in settings.items()}


def refresh() -> None:
    """Read Dask's settings from the environment again."""
    import dask

    dask.config.refresh()
