"""A folder in which everything is hostile goes through the commands, watched from outside: nothing of it runs."""

from __future__ import annotations

import json
import os
import pickle
import shutil
import subprocess
import sys
from copy import deepcopy
from pathlib import Path
from typing import Any

import polars as pl
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from ruamel.yaml import YAML

from pipeline.stages import density, featurize, infer, ingest, sample, scene
from pipeline.workspace.project import Project
from tests.support import gantry_project

WATCHED = """
import os, sys
report = os.open(sys.argv.pop(1), os.O_WRONLY | os.O_CREAT | os.O_APPEND)
WRITES = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC
CHANGES = {"os.remove", "os.rename", "os.rmdir", "os.mkdir", "os.symlink", "os.link", "os.chmod", "os.truncate"}
STARTS = {"subprocess.Popen", "os.system", "os.exec", "os.posix_spawn", "os.fork", "os.spawn"}
def watch(event, arguments):
    if event == "open" and isinstance(arguments[0], (str, bytes)) and (arguments[2] or 0) & WRITES:
        said = os.path.realpath(arguments[0])
    elif event in CHANGES:
        said = os.path.realpath(arguments[0])
    elif event in STARTS:
        said = list(arguments[1]) if event == "subprocess.Popen" else arguments
    elif event in {"socket.connect", "pickle.find_class"}:
        said = arguments[1:]
    else:
        return
    os.write(report, f"{event}\\t{said!r}\\n".encode())
sys.addaudithook(watch)
sys.argv[0] = "lessbench"
from pipeline.cli import main
main()
"""
COMMANDS = [
    ["check", "mine/demo-0.mcap", "mine/payload.mcap", "--task", "sweep"],
    ["scene", "sweep"], ["ingest", "sweep"], ["catalog"], ["sql", "from demonstrations"],
    ["sql", "select * from read_csv('/etc/passwd')"], ["report"], ["verify"], ["verify", "sweep"], ["summary"],
    ["figures", "sweep"], ["infer", "sweep"], ["recover"], ["inspect-project", "."],
]  # fmt: skip


class Payload:
    """A pickle of it writes a file when it is loaded."""

    def __init__(self, target: Path) -> None:
        self.target = target

    def __reduce__(self) -> tuple[Any, ...]:
        return (os.system, (f"touch '{self.target}'",))


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A project as it is before anybody harms it, below a folder that looks like a partition."""
    root = tmp_path_factory.mktemp("made") / "beta=10" / "participant=p07" / "project"
    root.mkdir(parents=True)
    parameters: dict[str, Any] = deepcopy(gantry_project.PARAMETERS)
    parameters["sample"] |= {"sampler": "deformation", "sets": 1, "sizes": [5, 20], "working_set": 10}
    parameters["ingest"]["on_rejected"] = "continue"
    (root / "gantry.xml").write_text(gantry_project.GANTRY)
    with (root / "params.yaml").open("w") as stream:
        YAML(typ="safe", pure=True).dump(parameters, stream)
    for number in range(2):
        gantry_project.record(root / "mine" / f"demo-{number}.mcap", bow=0.1 * number)
    project = Project(root)
    for stage in (scene, ingest, sample, featurize, density, infer):
        stage.run(project, "sweep")
    return root


@pytest.fixture
def received(made: Path, tmp_path: Path) -> tuple[Path, Path]:
    """The hostile project, and a folder beside it that all of it aims at."""
    victim = tmp_path / "victim"
    victim.mkdir()
    (victim / "kept").write_text("kept")
    root = tmp_path / "beta=10" / "participant=p07" / "project"
    shutil.copytree(made, root)
    harm(root, victim)
    return root, victim


def harm(root: Path, victim: Path) -> None:
    payload = pickle.dumps(Payload(victim / "pickled"))
    (root / "mine" / "payload.mcap").write_bytes(payload)
    (root / "mine" / "payload.p").write_bytes(payload)
    (root / "mine" / "empty.mcap").write_bytes(b"")
    os.mkfifo(root / "mine" / "pipe.mcap")
    for module in ("duckdb", "polars", "sitecustomize", "usercustomize", "conftest", "ctypes", "glob"):
        (root / f"{module}.py").write_text(f"open({str(victim / module)!r}, 'w')\n")
    (root / "dvc.yaml").write_text(f"stages: {{a: {{cmd: touch '{victim}/cmd'}}}}\n")
    (root / ".dvc").mkdir()
    (root / ".dvc" / "config").write_text("[core]\n    remote = x\n['remote \"x\"']\n    url = https://127.0.0.1:1/\n")
    tables = root / "datasets" / "sweep" / "tables"
    sql = f"""x"); copy (select 42) to '{victim}/copied'; select ("y"""
    features = pq.read_table(tables / "features.parquet")
    pq.write_table(features.append_column(sql, pa.array([0.0] * features.num_rows)), tables / "features.parquet")
    posteriors = pl.read_parquet(tables / "posteriors.parquet")
    posteriors.with_columns(demonstration_id=pl.lit(f"'; copy (select 1) to '{victim}/value")).write_parquet(
        tables / "posteriors.parquet"
    )
    (tables / "held_out.parquet").write_bytes(payload)
    (root / "datasets" / "sweep" / "figures").symlink_to(victim)
    (root / "datasets" / "report.html").symlink_to(victim / "kept")
    (root / "datasets" / "catalog.duckdb").symlink_to(victim / "catalog")
    shutil.rmtree(root / ".lessbench")
    (root / ".lessbench").symlink_to(victim)


Events = list[tuple[str, str]]


def watched(root: Path, words: list[str], report: Path) -> tuple[subprocess.CompletedProcess[str], Events]:
    report.unlink(missing_ok=True)
    ended = subprocess.run(
        [sys.executable, "-P", "-c", WATCHED, str(report), *words], cwd=root, capture_output=True, text=True,
        timeout=120, stdin=subprocess.DEVNULL,
    )  # fmt: skip
    events = [line.split("\t", 1) for line in report.read_text().splitlines()] if report.exists() else []
    return ended, [(event, said) for event, said in events]


def harmless(root: Path, event: str, said: str) -> bool:
    """Whether it stays in the project, or is this program's own."""
    if event == "subprocess.Popen":  # questions are asked in a process of their own; MuJoCo looks for a library in one
        ours = "'pipeline.formats.duckdb.query_process'" in said or "get_version(library_handle)" in said
        return said.startswith(f"[{sys.executable!r}, ") and ours
    if event in {"socket.connect", "pickle.find_class", "os.system", "os.exec", "os.posix_spawn", "os.fork"}:
        return False
    place = Path(said.strip("b'\""))
    own = (root.resolve(), Path(sys.prefix).resolve(), Path("/dev"), Path.home() / ".cache", Path.home() / ".config")
    return any(place.is_relative_to(folder) for folder in own) or place.name.startswith(("tmp", "matplotlib"))


@pytest.mark.parametrize("linked", [True, False], ids=["with links", "without links"])
def test_nothing_of_it_runs_and_nothing_is_written_elsewhere(
    received: tuple[Path, Path], tmp_path: Path, linked: bool
) -> None:
    root, victim = received
    if not linked:
        for place in ("datasets/sweep/figures", "datasets/report.html", "datasets/catalog.duckdb", ".lessbench"):
            (root / place).unlink()
    for words in COMMANDS:
        ended, events = watched(root, words, tmp_path / "report")
        assert [one for one in events if not harmless(root, *one)] == [], words
        assert "Traceback" not in ended.stderr, (words, ended.stderr)
        assert sorted(path.name for path in victim.iterdir()) == ["kept"], words
    assert (victim / "kept").read_text() == "kept"


def test_it_is_named_before_anything_runs(received: tuple[Path, Path], tmp_path: Path) -> None:
    root, victim = received
    ended, _ = watched(root, ["inspect-project", "."], tmp_path / "report")
    assert ended.returncode == 1
    for sentence in (
        f"runs code: dvc.yaml: `dvc repro` would run `touch '{victim}/cmd'`", "payload.p: is a pickle", "is a link to",
        "mine/pipe.mcap: is no file", "names the address https://127.0.0.1:1/", "conftest.py: is Python",
    ):  # fmt: skip
        assert sentence in ended.stdout, ended.stdout


@pytest.mark.parametrize(
    ("section", "value", "said"),
    [
        ("compute", {"scheduler": "tcp://127.0.0.1:1"}, "scheduler is no parameter"),
        ("sample", {"sizes": [10**12]}, "sample.sizes"),
        ("infer", {"theta_values": [number / 20_000 for number in range(20_000)]}, "weight vectors"),
    ],
)
def test_parameters_and_overlays_are_refused_alike(
    made: Path, tmp_path: Path, section: str, value: dict[str, Any], said: str
) -> None:
    overlay = tmp_path / "overlay.yaml"
    overlay.write_text(json.dumps({section: value}))
    ended, events = watched(made, ["--overlay", str(overlay), "sample", "sweep"], tmp_path / "report")
    assert ended.returncode == 1
    assert said in ended.stderr
    assert [one for one in events if not harmless(made, *one)] == []
