"""A copy of the whole project with one task and settings so small that every stage runs in a second or two."""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
from pathlib import Path

from ruamel.yaml import YAML

from pipeline.stages.dvc_yaml import dvc_yaml
from pipeline.stages.registry import STAGES, stage
from pipeline.workspace.project import Project

ROOT = Path(__file__).resolve().parents[2]
TASK, OTHERS = "table", ("laptop", "human")
# what to type to come to an answer, stage by stage
TO_AN_ANSWER = tuple(one.command for one in STAGES[: STAGES.index(stage("answer")) + 1])
COPIED = ("pipeline", "schemas", "datasets/robots", "datasets/scenes", "datasets/studies/human_choice")
CATALOG_LOOK = """
import duckdb, hashlib, sys
with duckdb.connect(sys.argv[1], read_only=True, config={"threads": 1}) as con:
    for (name,) in con.execute("select table_name from duckdb_tables() order by all").fetchall():
        print(name, hashlib.sha256(repr(con.execute(f"from {name} order by all").fetchall()).encode()).hexdigest())
"""


def make_small_project(root: Path) -> None:
    """Write the project into the new folder `root`; `dvc repro` there is one with DVC's own files inside the folder."""
    for name in COPIED:
        shutil.copytree(ROOT / name, root / name, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / ".dvcignore", root)
    yaml = YAML(typ="safe", pure=True)
    params = yaml.load((ROOT / "params.yaml").read_text(encoding="utf-8"))
    for task in OTHERS:
        del params["tasks"][task], params["simulate"]["weights"][task]
    params["simulate"]["participants"] = 3
    params["ingest"]["waypoints"] = 11
    params["sample"] |= {"sizes": [5, 20], "sets": 2, "working_set": 30}
    params["sample"]["planner"]["paths"] = 2
    params["infer"]["betas"] = [0.3, 3, 30]
    params["explore"] |= {"evaluations": 2000, "most_evaluations": 2000}
    robustness = params["robustness"]
    robustness["samplers"] = {name: robustness["samplers"][name] for name in ("deformation_narrow", "deformation")}
    robustness["duplicates"] |= {"set_size": 20, "copied": 2, "copies": [1], "spreads": [0, 0.1]}
    robustness["bandwidth_factors"] = [1, 2]
    params["studies"]["grid_world"] |= {"size": 5, "objects": [[1, 3], [3, 1]], "demonstrations": 2, "seeds": 3}
    with (root / "params.yaml").open("w", encoding="utf-8") as stream:
        yaml.dump(params, stream)
    (root / "dvc.yaml").write_text(dvc_yaml(Project(root).params), encoding="utf-8")
    (root / ".dvc").mkdir()
    (root / ".dvc" / "config").write_text(
        "[core]\n    no_scm = true\n    analytics = false\n    check_update = false\n"
    )


def environment(root: Path) -> dict[str, str]:
    """What the commands of the project in `root` run with."""
    own = {"PYTHONPATH": str(root), "DVC_SITE_CACHE_DIR": str(root / ".dvc" / "site"), "DVC_NO_ANALYTICS": "1"}
    return os.environ | own | {"PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}


def run(root: Path, *command: str, check: bool = True, **changes: str) -> subprocess.CompletedProcess[str]:
    """Run a command of the environment (dvc, lessbench) in the project; its output is kept."""
    done = subprocess.run(
        [str(Path(sys.executable).parent / command[0]), *command[1:]],
        cwd=root, env=environment(root) | changes, capture_output=True, text=True, timeout=800,
    )  # fmt: skip
    assert not check or done.returncode == 0, done.stdout + done.stderr
    return done


def outputs(root: Path) -> dict[str, str]:
    """Hashes of the tables, figures and recordings, and of the contents of every table of the catalog."""
    found = {
        path.relative_to(root).as_posix(): sha256(path)
        for path in sorted((root / "datasets").rglob("*"))
        if path.is_file() and path.suffix not in {".rrd", ".duckdb"}  # never the same bytes: their contents are
    }
    look = subprocess.run(
        [sys.executable, "-c", CATALOG_LOOK, root / "datasets" / "catalog.duckdb"],
        env=environment(root), capture_output=True, text=True, check=True,
    )  # fmt: skip
    recordings = [path for path in (root / "datasets").rglob("*.rrd") if path.stat().st_size]
    return found | {"catalog": look.stdout, "recordings": " ".join(sorted(path.parent.name for path in recordings))}


def sha256(path: Path) -> str:
    """Of a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()
