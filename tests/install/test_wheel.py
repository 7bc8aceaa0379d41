"""A wheel adds one name to an environment, works there without the repository, and gets on with its neighbours."""

from __future__ import annotations

import os
import re
import runpy
import shutil
import subprocess
import sys
import tomllib
import venv
import zipfile
from pathlib import Path

import numpy as np
import pytest
from ruamel.yaml import YAML

import pipeline.choice
from pipeline.commands.init import BEGINNING, init
from pipeline.errors import StageError
from tests.support.small_project import TO_AN_ANSWER

ROOT = Path(__file__).resolve().parents[2]
LIBRARIES = Path(np.__file__).parents[1]  # what a wheel asks for; its own names are in the new environment alone
CONDA_NAMES = {
    "finufft": "python-finufft", "duckdb": "python-duckdb", "mujoco": "mujoco-python", "matplotlib": "matplotlib-base",
}  # fmt: skip
SMALL = """
sample: {sizes: [5, 20], sets: 2, working_set: 60}
ingest: {waypoints: 11}
robustness: {duplicates: {set_size: 20, copied: 2, copies: [1], spreads: [0]}, bandwidth_factors: [1]}
explore: {evaluations: 2000, most_evaluations: 2000}
"""
STAGES = [command for command in TO_AN_ANSWER if command != "simulate"]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Built from the files that git has."""
    folder = tmp_path_factory.mktemp("wheel")
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    for name in filter(None, listed.split("\0")):
        if (ROOT / name).is_file():
            (folder / "source" / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, folder / "source" / name)
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", "-w", folder]
    subprocess.run([*command, folder / "source"], check=True, timeout=200)
    (built,) = folder.glob("*.whl")
    return built


@pytest.fixture(scope="module")
def programs(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The programs of a new environment, in which a neighbour is called `pipeline` as well."""
    place = tmp_path_factory.mktemp("environment") / "env"
    venv.create(place)
    python = place / "bin" / "python"
    command = [sys.executable, "-m", "pip", "--python", python, "install", "--quiet", "--no-deps", "--no-index", wheel]
    subprocess.run(command, check=True, timeout=200)
    (site,) = place.glob("lib/python*/site-packages")
    (site / "pipeline").mkdir()
    (site / "pipeline" / "__init__.py").write_text("NEIGHBOUR = True\n")
    return place / "bin"


def run(
    programs: Path, folder: Path, program: str, *words: str, check: bool = True
) -> subprocess.CompletedProcess[str]:
    env = {name: value for name, value in os.environ.items() if not name.startswith("LESSBENCH")}
    return subprocess.run(
        [programs / program, *words], cwd=folder, env=env | {"PYTHONPATH": str(LIBRARIES)}, check=check, timeout=300,
        capture_output=True, text=True,
    )  # fmt: skip


def test_it_brings_one_name(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
    assert {name.split("/")[0] for name in names if ".dist-info/" not in name} == {"lessbench"}
    here = {str(path.relative_to(ROOT)) for top in ("pipeline", "schemas") for path in (ROOT / top).rglob("*.py")}
    assert {
        name.removeprefix("lessbench/_code/") for name in names if re.match(r"lessbench/_code/.*\.py$", name)
    } == here
    for data in ("pipeline/survey/pages/index.html", "pipeline/py.typed", "schemas/posteriors.toml", "params.yaml"):
        assert f"lessbench/_code/{data}" in names
    assert wheel.stat().st_size < 3_000_000


def test_it_explains_itself(programs: Path, tmp_path: Path) -> None:
    assert "Usage: lessbench" in run(programs, tmp_path, "lessbench", "--help").stdout
    assert run(programs, tmp_path, "python", "-m", "lessbench", "--version").stdout.startswith("lessbench ")


def test_its_names_can_be_imported(programs: Path, tmp_path: Path) -> None:
    code = "import lessbench; print(*lessbench.__all__); from lessbench import LESS, feature; print(LESS.__module__)"
    offered, module = run(programs, tmp_path, "python", "-c", code).stdout.splitlines()
    assert set(offered.split()) == {*pipeline.choice.__all__, "Motion", "feature"}
    assert module == "pipeline.choice.models"
    missing = run(programs, tmp_path, "python", "-c", "import lessbench; lessbench.MORE", check=False)
    assert "module 'lessbench' has no attribute 'MORE'" in missing.stderr


def test_a_neighbour_of_the_same_inner_name_is_left_alone(programs: Path, tmp_path: Path) -> None:
    alone = run(programs, tmp_path, "python", "-c", "import pipeline; print(pipeline.NEIGHBOUR)")
    assert alone.stdout == "True\n"
    both = run(programs, tmp_path, "python", "-c", "import pipeline, lessbench", check=False)
    assert "another package called `pipeline` is in use" in both.stderr


@pytest.mark.timeout(900)
def test_it_goes_from_recordings_to_an_answer(programs: Path, tmp_path: Path) -> None:
    run(programs, tmp_path, "lessbench", "init", "mine")
    mine = tmp_path / "mine"
    assert run(programs, mine, "lessbench", "check", "examples/carry_mug").stdout.count(": usable") == 8
    words = ["--scene", "datasets/scenes/table.xml", "--recordings", "examples/carry_mug"]
    assert "then run: lessbench run mug" in run(programs, mine, "lessbench", "new-task", "mug", *words).stdout
    (mine / "small.yaml").write_text(SMALL)
    for stage in STAGES:
        run(programs, mine, "lessbench", "--overlay", "small.yaml", *stage.split(), "mug")
    assert run(programs, mine, "lessbench", "answer", "mug").stdout.startswith("mug: ")
    run(programs, mine, "lessbench", "catalog")
    assert "8" in run(programs, mine, "lessbench", "sql", "select count(*) from demonstrations").stdout


def test_a_project_begins_whole_or_not_at_all(tmp_path: Path) -> None:
    setup = (ROOT / "setup.py").read_text(encoding="utf-8")
    assert re.search(r"(?m)^BEGINNING = (.*)$", setup)[1] == str(BEGINNING).replace("'", '"')  # type: ignore[index]
    init(tmp_path / "new")
    for name in BEGINNING:
        assert (tmp_path / "new" / name).exists()
    with pytest.raises(StageError, match="has something in it"):
        init(tmp_path / "new")
    (tmp_path / "file").write_text("")
    with pytest.raises(StageError, match="has something in it"):
        init(tmp_path / "file")
    with pytest.raises(StageError, match="cannot be written"):
        init(tmp_path / "file" / "below")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "new"]


def test_the_repository_offers_the_same() -> None:
    offered = runpy.run_path(str(ROOT / "lessbench" / "__init__.py"))
    assert offered["__getattr__"]("LESS") is pipeline.choice.LESS


def test_the_recipe_for_conda_asks_for_what_the_package_asks_for() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    recipe = YAML(typ="safe").load((ROOT / "conda" / "recipe.yaml").read_text(encoding="utf-8"))
    assert recipe["context"]["version"] == project["version"]
    asked = dict(map(str.split, recipe["requirements"]["run"]))
    assert asked.pop("python") == project["requires-python"]
    for requirement in project["dependencies"]:
        name, bounds = re.match(r"([\w.-]+)(?:\[\w+\])?(.*)", requirement).groups()  # type: ignore[union-attr]
        assert asked.pop(CONDA_NAMES.get(name, name)) == bounds
    assert not asked
