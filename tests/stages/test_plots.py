"""`dvc metrics` and `dvc plots` compare two settings, and their page asks nothing of the network."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from ruamel.yaml import YAML

ROOT = Path(__file__).resolve().parents[2]
SMALL = """
stages:
  figures:
    cmd: cp ${shown}.svg figure.svg && cp ${shown}.json metrics.json
    params: [shown]
    outs:
      - figure.svg: {persist: true}
    metrics:
      - metrics.json: {persist: true}
plots:
  - figure.svg
"""
PICTURE = '<svg xmlns="http://www.w3.org/2000/svg" width="{0}" height="9"><rect width="{0}" height="9"/></svg>'
TASK_FIGURES = "posterior held_out densities density_map robustness accuracy duplicates sensitivity"
STUDY_FIGURES = "human_choice grid_world_true_posterior grid_world_overall grid_world_sets grid_world_density"


def dvc(folder: Path, *words: str) -> str:
    """What DVC prints; git and DVC see no settings but the folder's own."""
    quiet = {
        name: str(folder / ".git" / "dvc")
        for name in ("DVC_GLOBAL_CONFIG_DIR", "DVC_SYSTEM_CONFIG_DIR", "DVC_SITE_CACHE_DIR")
    }
    identity = {f"GIT_{who}_{what}": "someone@here" for who in ("AUTHOR", "COMMITTER") for what in ("NAME", "EMAIL")}
    environment = os.environ | quiet | identity | {"GIT_CONFIG_GLOBAL": os.devnull, "DVC_NO_ANALYTICS": "1"}
    command = [sys.executable, "-m", "dvc", *words] if words[0] != "git" else list(words)
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture
def compared(tmp_path: Path) -> Path:
    """A repository with our DVC settings whose one stage ran with two settings, as the experiments `one` and `two`."""
    (tmp_path / "dvc.yaml").write_text(SMALL)
    (tmp_path / "params.yaml").write_text("shown: one\n")
    for size, name in enumerate(("one", "two"), start=1):
        (tmp_path / f"{name}.svg").write_text(PICTURE.format(size))
        (tmp_path / f"{name}.json").write_text(json.dumps({"less": {"posterior": size / 4}}))
    dvc(tmp_path, "git", "init", "-q")
    shutil.copytree(ROOT / ".dvc", tmp_path / ".dvc", ignore=shutil.ignore_patterns("cache", "tmp"))
    (tmp_path / ".gitignore").write_text("figure.svg\nmetrics.json\ndvc_plots\n")
    dvc(tmp_path, "git", "add", "-A")
    dvc(tmp_path, "git", "commit", "-qm", "small")
    for name in ("one", "two"):
        (tmp_path / "params.yaml").write_text(f"shown: {name}\n")
        dvc(tmp_path, "exp", "run", "-n", name)
    return tmp_path


def test_two_settings_are_compared_without_network(compared: Path) -> None:
    (changed,) = json.loads(dvc(compared, "metrics", "diff", "one", "two", "--json")).values()
    assert changed == {"less.posterior": {"old": 0.25, "new": 0.5, "diff": 0.25}}
    dvc(compared, "plots", "diff", "one", "two")
    page = (compared / "dvc_plots" / "index.html").read_text()
    shown = [(compared / "dvc_plots" / source).read_text() for source in re.findall(r'src="([^"]+)"', page)]
    assert shown == [PICTURE.format(1), PICTURE.format(2)]
    assert "://" not in page
    assert "default-src 'none'" in page
    assert "{" + "plot_divs" + "}" not in page


def test_every_figure_of_the_tasks_and_studies_is_a_plot() -> None:
    plots = YAML(typ="safe", pure=True).load((ROOT / "dvc.yaml").read_text())["plots"]
    names = {"studies": STUDY_FIGURES} | dict.fromkeys(("table", "laptop", "human"), TASK_FIGURES)
    assert set(plots) == {f"datasets/{task}/figures/{name}.svg" for task, of in names.items() for name in of.split()}
