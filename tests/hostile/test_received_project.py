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
import json, os, sys
report = os.open(sys.argv[1], os.O_WRONLY | os.O_CREAT | os.O_APPEND)
commands = json.loads(sys.argv[2])
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
from pipeline.cli import main
for words in commands:  # in one process, which has to import the libraries once
    sys.argv = ["lessbench", *words]
    print("$", *words, file=sys.stderr, flush=True)
    try:
        main()
    except SystemExit as end:
        os.write(report, f"status\\t{end.code!r}\\n".encode())
"""
COMMANDS = [
    ["check", "mine/demo-0.mcap", "mine/payload.mcap", "mine/bag/bag_0.mcap", "--task", "sweep"],
    ["scene", "sweep"], ["ingest", "sweep"], ["catalog"], ["sql", "from demonstrations"],
    ["sql", "select * from read_csv('/etc/passwd')"], ["report"], ["verify"], ["verify", "sweep"], ["summary"],
    ["figures", "sweep"], ["infer", "sweep"], ["inspect", "sweep"], ["view", "sweep"], ["enough", "sweep"],
    ["recover"], ["inspect-project", "."],
    ["--overlay", "bomb.yaml", "infer", "sweep"], ["--overlay", "tag.yaml", "infer", "sweep"],
    ["--overlay", "features.yaml", "featurize", "sweep"], ["--overlay", "entity.yaml", "scene", "sweep"],
    ["--overlay", "include.yaml", "scene", "sweep"], ["--overlay", "pipe.yaml", "scene", "sweep"],
    ["new-task", "other", "--scene", "include.xml", "--recordings", "mine"],
]  # fmt: skip
REFUSED = {  # what a command says of it, at the least
    "bomb.yaml": "bomb.yaml: ", "tag.yaml": "tag.yaml: ", "features.yaml": "trust", "entity.yaml": "entity.xml",
    "include.yaml": "include.xml", "pipe.yaml": "pipe.xml",
}  # fmt: skip


TRACED = (
    "trace=execve,connect,open,openat,openat2,creat,rename,renameat,renameat2,unlink,unlinkat,mkdir,mkdirat,symlink,"
    "symlinkat,link,linkat,truncate"
)
OWN_TOOLS = {
    "ldconfig",
    "ldconfig.real",
    "gcc",
    "cc",
    "ld",
    "objdump",
    "uname",
    "sh",
    "dash",
}  # ctypes looks with these


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
    for name, text in hostile_texts(victim).items():
        (root / name).write_text(text)
    (root / "mine" / "bag").mkdir()
    (root / "mine" / "bag" / "metadata.yaml").write_text(BOMB + "rosbag2_bagfile_information: *i\n")
    (root / "mine" / "bag" / "bag_0.mcap").write_bytes(payload)
    (root / "mine" / "bag" / "bag_1.mcap").symlink_to("/etc/passwd")
    os.mkfifo(root / "mesh.stl")
    shutil.rmtree(root / ".lessbench")
    (root / ".lessbench").symlink_to(victim)


BOMB = "a: &a [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{b}: &{b} [{', '.join([f'*{a}'] * 9)}]\n" for a, b in zip("abcdefgh", "bcdefghi", strict=True)
)


def hostile_texts(victim: Path) -> dict[str, str]:
    """Overlays, scenes and code, by file name."""
    overlay = '{{"tasks": {{"sweep": {{"scene": "{}.xml"}}}}}}'
    entities = "".join(f'<!ENTITY e{n + 1} "{f"&e{n};" * 10}">' for n in range(9))
    return {
        "bomb.yaml": BOMB,
        "tag.yaml": f"seed: !!python/object/apply:os.system ['touch {victim}/tag']\n",
        "spy.py": f"open({str(victim / 'spy')!r}, 'w')\n",
        "features.yaml": '{"tasks": {"sweep": {"feature_files": ["spy.py"]}}}',
        **{f"{name}.yaml": overlay.format(name) for name in ("entity", "include", "pipe")},
        "entity.xml": f'<!DOCTYPE m [<!ENTITY e0 "x">{entities}]><mujoco model="&e9;"><worldbody/></mujoco>',
        "include.xml": '<mujoco><include file="/etc/passwd"/><include file="../../../victim/kept"/></mujoco>',
        "pipe.xml": '<mujoco><asset><mesh name="m" file="mesh.stl"/></asset><worldbody>'
        '<geom type="mesh" mesh="m"/></worldbody></mujoco>',
    }


Events = list[tuple[str, str]]


def watched(root: Path, commands: list[list[str]], report: Path) -> tuple[subprocess.CompletedProcess[str], Events]:
    report.unlink(missing_ok=True)
    ended = subprocess.run(
        [sys.executable, "-P", "-c", WATCHED, str(report), json.dumps(commands)], cwd=root, capture_output=True,
        text=True, timeout=200, stdin=subprocess.DEVNULL,
    )  # fmt: skip
    events = [line.split("\t", 1) for line in report.read_text().splitlines()] if report.exists() else []
    assert sum(event == "status" for event, _ in events) == len(commands), ended.stderr
    return ended, [(event, said) for event, said in events]


def harmless(root: Path, event: str, said: str) -> bool:
    """Whether it stays in the project, or is this program's own."""
    if event == "status":
        return said in ("0", "1", "None")
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
    ended, events = watched(root, COMMANDS, tmp_path / "report")
    assert [one for one in events if not harmless(root, *one)] == []
    assert "Traceback" not in ended.stderr, ended.stderr
    assert sorted(path.name for path in victim.iterdir()) == ["kept"]
    assert (victim / "kept").read_text() == "kept"
    for name, said in () if linked else REFUSED.items():
        _, _, of_it = ended.stderr.partition(f"$ --overlay {name} ")
        assert said in of_it.partition("\n$ ")[0], (name, ended.stderr)


@pytest.mark.skipif(shutil.which("strace") is None, reason="there is no strace here (apt-get install strace)")
def test_the_system_sees_nothing_else_either(received: tuple[Path, Path], tmp_path: Path) -> None:
    """What libraries in other languages do passes Python by; what the kernel is asked for does not."""
    root, victim = received
    seen = tmp_path / "seen"
    command = ["strace", "-f", "-qq", "-o", str(seen), "-e", TRACED]
    program = [sys.executable, "-P", "-c", WATCHED, str(tmp_path / "report"), json.dumps(COMMANDS)]
    done = subprocess.run([*command, *program], cwd=root, capture_output=True, timeout=280, stdin=subprocess.DEVNULL)
    assert done.returncode == 0, done.stderr
    calls = seen.read_text(errors="replace").splitlines()
    assert any("gantry.xml" in call for call in calls), "it looks at what it should"
    started = {call.partition("execve(")[2].split('"')[1] for call in calls if "execve(" in call and " = 0" in call}
    allowed = {sys.executable, os.path.realpath(sys.executable)}
    assert {program for program in started if program not in allowed and Path(program).name not in OWN_TOOLS} == set()
    assert [call for call in calls if "connect(" in call and "AF_INET" in call] == []
    changes = ("creat(", "rename", "unlink", "mkdir", "symlink", "link", "truncate(", "O_WRONLY", "O_RDWR")
    written = [call for call in calls if any(change in call for change in changes)]
    assert [call for call in written if str(victim) in call and " = -1" not in call] == []


def test_dvc_repro_of_the_programs_own_stages_runs_nothing_else(received: tuple[Path, Path], tmp_path: Path) -> None:
    """DVC runs what dvc.yaml says, which is the user's own risk; here it says a stage of this program."""
    root, victim = received
    (root / "dvc.yaml").write_text(
        "stages:\n  ingest:\n    cmd: lessbench ingest sweep\n    deps: [mine]\n"
        "    outs: [{datasets/sweep/tables/rejected.parquet: {persist: true}}]\n"
    )
    (root / ".dvc" / "config").write_text("[core]\n    no_scm = true\n")
    (root / ".lessbench").unlink()
    (root / "mine" / "pipe.mcap").unlink()  # DVC itself waits for it without end, which inspect-project says beforehand
    (root / "mine" / "bag" / "bag_1.mcap").unlink()
    environment = os.environ | {"PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}
    ended = subprocess.run(
        [sys.executable, "-P", "-m", "dvc", "repro"], cwd=root, capture_output=True, text=True, timeout=120,
        stdin=subprocess.DEVNULL, env=environment,
    )  # fmt: skip
    assert "Running stage 'ingest'" in ended.stdout, ended.stdout + ended.stderr
    assert "Traceback" not in ended.stderr, ended.stderr
    assert sorted(path.name for path in victim.iterdir()) == ["kept"]


def test_it_is_named_before_anything_runs(received: tuple[Path, Path], tmp_path: Path) -> None:
    root, victim = received
    ended, events = watched(root, [["inspect-project", "."]], tmp_path / "report")
    assert ("status", "1") in events
    for sentence in (
        f"runs code: dvc.yaml: `dvc repro` would run `touch '{victim}/cmd'`", "payload.p: is a pickle", "is a link to",
        "mesh.stl: is not a file but", "names the address https://127.0.0.1:1/", "conftest.py: is Python",
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
    ended, events = watched(made, [["--overlay", str(overlay), "sample", "sweep"]], tmp_path / "report")
    assert ("status", "1") in events
    assert said in ended.stderr
    assert [one for one in events if not harmless(made, *one)] == []
