"""Feature files run once their user has agreed to what is in them, and no sooner."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import polars as pl
import pytest

from pipeline.commands.inspect_project import inspect_project
from pipeline.errors import ParameterError
from pipeline.formats.parquet.tables import read_table
from pipeline.params import parse
from pipeline.replay.kinds import own
from pipeline.replay.kinds.register import KINDS
from pipeline.stages import featurize, ingest, sample
from pipeline.stages.dvc_yaml import dvc_yaml
from pipeline.stages.registry import STAGES
from pipeline.workspace.project import Project
from pipeline.workspace.trust import trust, trusted_files

Make = Callable[[dict[str, Any]], Project]
LISTED = r"\[own\.py,"
CODE = """
from pathlib import Path

from pipeline.replay import feature

Path(__file__).with_name("ran").touch()


@feature("reach", unit="m", direction="either", over_time="greatest")
def reach(motion, *, of: str):
    return motion.position(of)[..., 0].max(axis=1)
"""


@pytest.fixture(autouse=True)
def apart(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A configuration of its own, and no kinds that stay."""
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    before = dict(KINDS)
    yield
    KINDS.clear()
    KINDS.update(before)
    own._registered.clear()


@pytest.fixture
def project(make_project: Make, parameters: dict[str, Any]) -> Project:
    """A project with a feature file."""
    task = parameters["tasks"]["sweep"]
    task["feature_files"] = ["own.py"]
    task["features"]["reach"] = {"kind": "reach", "of": "tip"}
    project = make_project(parameters)
    (project.root / "own.py").write_text(CODE)
    return project


def files(project: Project) -> tuple[own.FeatureFile, ...]:
    return trusted_files(project, project.params.tasks["sweep"])


def test_untrusted_code_does_not_run(project: Project) -> None:
    remedy = rf"own\.py: .* runs only once trusted; read it, then say `lessbench trust {project.root}`"
    with pytest.raises(ParameterError, match=remedy):
        sample.run(project, "sweep")
    assert trust(project)[0].startswith("own.py may run as it is now (sha256 ")
    assert not (project.root / "ran").exists()


def test_trusted_code_gives_a_feature_in_tables_and_provenance(project: Project) -> None:
    trust(project)
    for stage in (ingest, sample, featurize):
        stage.run(project, "sweep")
    units = read_table(project.table("sweep", "feature_units"), "feature_units").filter(feature="reach")
    assert units.row(0) == ("reach", "reach", "m", "either", "greatest")
    assert read_table(project.table("sweep", "features"), "features")["reach"].is_between(0, 2).all()
    assert (project.root / "ran").exists()
    metadata = pl.read_parquet_metadata(project.table("sweep", "features"))
    assert any("own.py" in value for value in metadata.values())
    assert not list(project.root.rglob("*.pyc"))


def test_trust_ends_with_a_change_and_is_of_one_folder(project: Project, tmp_path: Path) -> None:
    trust(project)
    assert len(files(project)) == 1
    elsewhere = project.root.rename(tmp_path / "elsewhere")
    with pytest.raises(ParameterError, match="runs only once trusted"):
        files(Project(elsewhere))
    elsewhere.rename(project.root)
    (project.root / "own.py").write_text(CODE + "\n")
    with pytest.raises(ParameterError, match="has changed since it was trusted"):
        files(project)


def test_an_experiment_of_dvc_is_trusted_with_its_project(project: Project) -> None:
    trust(project)
    copy = project.root / ".dvc" / "tmp" / "exps" / "tmp1"
    copy.mkdir(parents=True)
    for name in ("own.py", "params.yaml"):
        (copy / name).write_bytes((project.root / name).read_bytes())
    assert files(Project(copy))[0].path == copy / "own.py"


def test_a_file_that_changes_after_it_was_agreed_to_is_not_run(project: Project) -> None:
    trust(project)
    agreed = files(project)
    (project.root / "own.py").write_text("raise SystemExit")
    with pytest.raises(ParameterError, match="changed while this was running"):
        own.register_kinds(agreed)


@pytest.mark.parametrize(
    ("code", "message"),
    [
        ("1 / 0", r"own\.py: the feature file cannot be run: ZeroDivisionError"),
        ("def", r"own\.py: the feature file cannot be run: SyntaxError"),
        (CODE.replace('"reach", unit', '"height", unit'), "feature kind 'height' is registered already"),
        (CODE.replace('"either"', '"up"'), "direction is 'up'; allowed are cost, either, wish"),
    ],
)
def test_what_fails_is_one_sentence(project: Project, code: str, message: str) -> None:
    (project.root / "own.py").write_text(code)
    trust(project)
    before = dict(KINDS)
    with pytest.raises(ParameterError, match=message):
        own.register_kinds(files(project))
    assert before == KINDS


def test_what_is_missing_or_damaged_is_said(project: Project, tmp_path: Path) -> None:
    trust(project)
    store = tmp_path / "config" / "lessbench" / "trusted.json"
    assert list(json.loads(store.read_text())) == [str(project.root.resolve())]
    for damaged in ("{", "[]", '{"a": 1}'):
        store.write_text(damaged)
        with pytest.raises(ParameterError, match=r"trusted\.json: .*remove it, and trust your projects anew"):
            files(project)
    (project.root / "own.py").unlink()
    with pytest.raises(ParameterError, match=r"feature_files names own\.py, which cannot be read"):
        trust(project)


def test_dvc_must_see_the_file(project: Project, parameters: dict[str, Any]) -> None:
    trust(project)
    text = dvc_yaml(parse(parameters))
    assert len(re.findall(LISTED, text)) == sum(stage.features for stage in STAGES) == 7
    (project.root / "dvc.yaml").write_text(text)
    assert files(project)
    (project.root / "dvc.yaml").write_text(re.sub(LISTED, "[other.py,", text))
    with pytest.raises(ParameterError, match=r"dvc\.yaml does not list the feature file own\.py"):
        files(project)


def test_a_received_project_lists_them(project: Project) -> None:
    said = "\n".join(inspect_project(project.root).lines())
    assert "runs code: params.yaml: tasks.sweep.feature_files.0 names the feature file own.py, which runs once" in said
    assert not (project.root / "ran").exists()


def test_no_feature_files_nothing_to_trust(make_project: Make, parameters: dict[str, Any]) -> None:
    project = make_project(parameters)
    assert "names no feature files" in trust(project)[0]
    assert files(project) == ()
