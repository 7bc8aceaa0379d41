"""The example of a plug-in package: installed, its feature, model and sampler work, and mistakes are one sentence."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from ruamel.yaml import YAML

from pipeline.choice import Boltzmann, log_probabilities
from pipeline.choice.models import choice_model
from pipeline.errors import ArgumentError, ParameterError
from pipeline.params import parse
from pipeline.replay.kinds.register import KINDS
from pipeline.trajectories.installed_sampler import InstalledSampler, installed_sampler
from pipeline.trajectories.paths import Anchor
from tests.support.small_project import ROOT, TASK, TO_AN_ANSWER, environment, make_small_project

PAGE = (ROOT / "docs" / "plug-ins.md").read_text(encoding="utf-8")
STAGES = [command for command in TO_AN_ANSWER if command != "conclude"]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that the package is installed in."""
    folder = tmp_path_factory.mktemp("site")
    source = ROOT / "examples" / "plug_in"
    (command,) = re.findall(r"^python -m pip (install .*)$", PAGE, re.MULTILINE)
    words = [str(source) if word == "examples/plug_in" else word for word in command.split()]
    subprocess.run([sys.executable, "-m", "pip", *words, "--target", folder, "--quiet"], check=True, cwd=folder)
    for made in ("build", "src/lessbench_example.egg-info"):
        assert not (source / made).exists() or _remove(source / made)
    return folder


def _remove(folder: Path) -> bool:
    import shutil

    shutil.rmtree(folder)
    return True


@pytest.fixture
def installed(site: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.syspath_prepend(str(site))
    before = dict(KINDS)
    yield
    sys.modules.pop("lessbench_example", None)
    KINDS.clear()
    KINDS.update(before)


@pytest.mark.timeout(600)
def test_all_three_work_in_a_small_project(site: Path, tmp_path: Path) -> None:
    root = tmp_path / "project"
    make_small_project(root)
    yaml = YAML(typ="safe", pure=True)
    (block,) = re.findall(r"```yaml\n(.*?)```", PAGE, re.DOTALL)
    (root / "own.yaml").write_text(block)
    env = environment(root)
    env["PYTHONPATH"] = f"{env['PYTHONPATH']}:{site}"
    for stage in STAGES:
        subprocess.run(
            [sys.executable, "-m", "pipeline", "--overlay", "own.yaml", *stage.split(), TASK],
            cwd=root, env=env, check=True, timeout=300, capture_output=True,
        )  # fmt: skip
    tables = root / "datasets" / TASK / "tables"
    own = yaml.load(block)
    assert set(pl.read_parquet(tables / "alternatives.parquet")["sampler"]) == {own["sample"]["sampler"]}
    features = pl.read_parquet(tables / "features.parquet")
    assert features["turn"].is_between(0, np.pi).all()
    assert features["turn"].n_unique() > 10
    posteriors = pl.read_parquet(tables / "posteriors.parquet")
    assert set(posteriors["model"]) == set(own["infer"]["models"])


@pytest.mark.usefixtures("installed")
def test_the_model_is_half_way() -> None:
    model = choice_model("half-less", 0.3)
    rows = np.array([[0.0, 0.0], [0.05, 0.0], [1.0, 1.0]])
    less = choice_model("less", 0.3)
    half, whole, none = (np.exp(log_probabilities(m, rows, theta=[0.0, 0.0]))[2] for m in (model, less, Boltzmann()))
    assert none < half < whole
    with pytest.raises(ArgumentError, match=r"there is no model 'full-less'; there are .*half-less"):
        choice_model("full-less", 0.3)


@pytest.mark.usefixtures("installed")
def test_names_and_settings_are_checked(parameters: dict[str, Any]) -> None:
    parameters["infer"]["models"] = ["half-less"]
    parameters["sample"] |= {"sampler": "arcs", "settings": {"height_rad": 0.1}}
    assert parse(parameters).sample.settings == {"height_rad": 0.1}
    parameters["sample"]["sampler"] = "arc"
    with pytest.raises(ParameterError, match="'given' or 'arcs'"):
        parse(parameters)
    parameters["sample"]["sampler"] = "deformation"
    with pytest.raises(ParameterError, match="settings is for samplers of installed packages"):
        parse(parameters)
    with pytest.raises(ParameterError, match=r"'arcs' cannot be made with sample.settings .*width"):
        installed_sampler("arcs", {"width": 1.0})


def test_without_the_package_its_names_are_unknown(parameters: dict[str, Any]) -> None:
    parameters["sample"]["sampler"] = "arcs"
    with pytest.raises(ParameterError, match=r"sample\.sampler"):
        parse(parameters)
    with pytest.raises(ParameterError, match="no installed package has a sampler"):
        installed_sampler("arcs", {})


class Drawing:
    """A sampler that draws what it is given."""

    name = "drawing"

    def __init__(self, paths: Any) -> None:
        self._paths = paths

    def sample(self, rng: np.random.Generator, anchor: Anchor, count: int, n_waypoints: int) -> Any:
        return self._paths


@pytest.mark.parametrize(
    ("paths", "said"),
    [
        (np.zeros((2, 3)), r"of shape \(2, 3\); needed are finite numbers of shape \(2, 5, 3\)"),
        (np.full((2, 5, 3), np.nan), "needed are finite"),
        (np.ones((2, 5, 3)), "do not start and end at their anchor"),
        ("words", "fails: ValueError"),
    ],
)
def test_what_a_sampler_draws_is_checked(paths: Any, said: str) -> None:
    anchor = Anchor(np.zeros(3), np.ones(3))
    with pytest.raises(ParameterError, match=said):
        InstalledSampler("mine", Drawing(paths)).sample(np.random.default_rng(0), anchor, 2, 5)
