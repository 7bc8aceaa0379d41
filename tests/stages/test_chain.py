"""The whole chain on an arm of another shape with other features: nothing in the pipeline knows the JACO."""

import subprocess
import sys
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from mcap.reader import make_reader
from ruamel.yaml import YAML

from pipeline.errors import StageError
from pipeline.formats.duckdb.questions import ask
from pipeline.formats.parquet.tables import read_table
from pipeline.replay import load_scene, model_hash
from pipeline.stages import catalog, density, featurize, infer, ingest, sample, simulate
from pipeline.workspace.project import Project, recorded_runs
from tests.support.tables import provenance_of

Make = Callable[[dict[str, Any]], Project]
CHAIN = (ingest, sample, featurize, density, infer)


def run_chain(project: Project, task: str = "sweep") -> None:
    for stage in CHAIN:
        stage.run(project, task)


def table(project: Project, name: str) -> pl.DataFrame:
    return read_table(project.table("sweep", name), name)


def test_recordings_to_posteriors_and_answers(make_project: Make, parameters: dict[str, Any]) -> None:
    project = make_project(parameters)
    run_chain(project)
    catalog.run(project)

    demonstrations = table(project, "demonstrations")
    assert demonstrations["participant"].to_list() == ["person-0", "person-1", "person-2"]
    paths = demonstrations["waypoints"].to_numpy()
    assert paths.shape == (3, 15, 3)
    # idle ends trimmed to within the threshold of start and goal, the extra turn of `swing` taken back
    np.testing.assert_allclose(paths[:, 0], np.tile([-0.3, -0.6, 0.1], (3, 1)), atol=0.02)
    np.testing.assert_allclose(paths[:, -1], np.tile([0.3, 0.9, -0.2], (3, 1)), atol=0.02)

    alternatives = table(project, "alternatives")
    assert alternatives.group_by("set_size", "set_id").len().sort("set_size", "set_id").rows() == [
        (5, "00", 5), (5, "01", 5), (20, "00", 20), (20, "01", 20), (30, "working", 30),
    ]  # fmt: skip
    waypoints = alternatives["waypoints"].to_numpy()
    assert (np.abs(waypoints[:, :, 0]) <= 1).all()
    assert (np.abs(waypoints[:, :, 2]) <= 2).all()
    np.testing.assert_array_equal(waypoints[:, 0], np.tile(np.float32([-0.3, -0.6, 0.1]), (80, 1)))

    features = table(project, "features")
    assert features.columns[-2:] == ["effort", "vase"]
    steps = np.diff(paths, axis=1)
    effort = features.filter(kind="demonstration")["effort"].to_numpy()
    np.testing.assert_allclose(effort, (steps**2).sum(axis=(1, 2)), rtol=1e-12)

    posteriors = table(project, "posteriors")
    totals = posteriors.group_by("demonstration_id", "model", "set_size", "set_id").agg(pl.col("posterior").sum())
    assert totals.height == 4 * 2 * 5
    np.testing.assert_allclose(totals["posterior"], 1, atol=1e-12)
    answer = ask(project.catalog, "select count(*) from posteriors where task = 'sweep'")
    assert answer.item() == posteriors.height
    assert {run["stage"] for run in recorded_runs(project)} == {
        "ingest", "sample", "featurize", "density", "infer", "catalog"
    }  # fmt: skip


def test_the_posterior_is_that_of_a_slow_loop(make_project: Make, parameters: dict[str, Any]) -> None:
    project = make_project(parameters)
    run_chain(project)
    features, scales = table(project, "features"), table(project, "scales")["scale"].to_numpy()
    bandwidth = table(project, "densities").filter(set_id="working")["bandwidth"][0]
    names = ["effort", "vase"]
    phi = features.filter(kind="alternative", set_id="working").select(names).to_numpy() / scales
    demos = features.filter(kind="demonstration").select(names).to_numpy() / scales
    posteriors = table(project, "posteriors").filter(set_id="working", demonstration_id="all")
    for model in ("boltzmann", "less"):
        rows = posteriors.filter(model=model).sort("theta_id", "beta")
        log_likelihood = []
        for row in rows.iter_rows(named=True):
            total = 0.0
            for demo in demos:
                joined = np.vstack([phi, demo])
                log_weight = np.zeros(len(joined))
                if model == "less":
                    for i, x in enumerate(joined):
                        mass = np.exp(-((joined - x) ** 2).sum(axis=1) / (2 * bandwidth**2)).sum()
                        log_weight[i] = -np.log(mass)
                utility = row["beta"] * joined @ np.array(row["theta"]) + log_weight
                total += utility[-1] - np.log(np.exp(utility - utility.max()).sum()) - utility.max()
            log_likelihood.append(total)
        expected = np.exp(np.array(log_likelihood) - np.max(log_likelihood))
        np.testing.assert_allclose(rows["posterior"], expected / expected.sum(), atol=1e-12)


def test_alternatives_anchored_at_each_demonstration(make_project: Make, parameters: dict[str, Any]) -> None:
    parameters["tasks"]["sweep"]["anchor"] = "demonstration"
    parameters["sample"] |= {"sampler": "deformation", "sets": 1}
    project = make_project(parameters)
    run_chain(project)
    alternatives, demonstrations = table(project, "alternatives"), table(project, "demonstrations")
    assert alternatives["anchor"].unique(maintain_order=True).to_list() == demonstrations["demonstration_id"].to_list()
    for row in demonstrations.iter_rows(named=True):
        ends = alternatives.filter(anchor=row["demonstration_id"])["waypoints"].to_numpy()[:, [0, -1]]
        np.testing.assert_allclose(ends, np.tile(np.array(row["waypoints"])[[0, -1]], (len(ends), 1, 1)), atol=1e-6)
    assert table(project, "posteriors")["demonstration_id"].n_unique() == 4


def test_the_same_inputs_give_the_same_bytes_and_a_set_more_changes_no_other(
    make_project: Make, parameters: dict[str, Any]
) -> None:
    project = make_project(parameters)
    run_chain(project)
    files = sorted(project.datasets.rglob("*.parquet"))
    before = {file: file.read_bytes() for file in files}
    run_chain(project)
    assert {file: file.read_bytes() for file in files} == before

    old = table(project, "alternatives")
    parameters["sample"] |= {"sets": 3, "sizes": [5, 7, 20]}
    project = make_project(parameters)
    run_chain(project)
    kept = table(project, "alternatives").filter(pl.col("alternative_id").is_in(old["alternative_id"].implode()))
    assert kept.equals(old)


def test_simulated_participants_are_recordings_like_any_other(make_project: Make, parameters: dict[str, Any]) -> None:
    parameters["tasks"]["sweep"]["recordings"] = "datasets/sweep/recordings"
    project = make_project(parameters)
    simulate.run(project, "sweep")
    files = sorted((project.datasets / "sweep" / "recordings").iterdir())
    assert [file.name for file in files] == [f"participant-0{i}.mcap" for i in (1, 2, 3)]
    with files[0].open("rb") as stream:
        metadata = next(make_reader(stream).iter_metadata()).metadata
    assert metadata["simulated"] == "true"
    before = [file.read_bytes() for file in files]
    simulate.run(project, "sweep")
    assert [file.read_bytes() for file in files] == before
    run_chain(project)
    demonstrations = table(project, "demonstrations")
    assert demonstrations["simulated"].all()
    assert demonstrations["true_theta"].null_count() == 0
    paths = demonstrations["waypoints"].to_numpy()
    np.testing.assert_allclose(paths[:, 0], np.tile([-0.3, -0.6, 0.1], (3, 1)), atol=0.15)


def test_provenance_names_the_inputs_by_content(make_project: Make, parameters: dict[str, Any]) -> None:
    project = make_project(parameters)
    run_chain(project)
    stated = provenance_of(project.table("sweep", "features"))
    assert set(stated["inputs"]) == {  # type: ignore[call-overload]
        "datasets/sweep/tables/demonstrations.parquet", "datasets/sweep/tables/alternatives.parquet", "gantry.xml"
    }  # fmt: skip
    scene = load_scene(project.root / "gantry.xml")
    for name in (
        "demonstrations",
        "rejected",
        "alternatives",
        "features",
        "scales",
        "densities",
        "posteriors",
        "held_out",
    ):
        about = provenance_of(project.table("sweep", name))
        assert about["program"] == f"lessbench {version('lessbench')}"
        assert (about["mujoco"], about["model"]) == (version("mujoco"), model_hash(scene))
        # no random number has gone into recordings of people; whatever comes of the alternatives inherits theirs
        assert about["seed"] == (None if name in ("demonstrations", "rejected") else 7)
        assert len(str(about["parameters"])) == 64
    parameters["infer"]["betas"] = [1]
    changed = make_project(parameters)
    featurize.run(changed, "sweep")
    assert provenance_of(changed.table("sweep", "features")) == stated


@pytest.mark.parametrize("scale", ["std", "none", {"effort": 2.0, "vase": 3.0}])
def test_other_scales(make_project: Make, parameters: dict[str, Any], scale: object, tmp_path: Path) -> None:
    parameters["features"]["scale"] = scale
    project = make_project(parameters)
    run_chain(project)
    scales = table(project, "scales")
    pool = table(project, "features").filter(kind="alternative").select("effort", "vase").to_numpy()
    expected = {"std": pool.std(axis=0), "none": [1.0, 1.0]}.get(str(scale), [2.0, 3.0])
    np.testing.assert_allclose(scales["scale"], expected, rtol=1e-12)


def test_given_alternatives_are_drawn_without_repeating_one(make_project: Make, parameters: dict[str, Any]) -> None:
    parameters["sample"] |= {"sampler": "given", "given": "mine.parquet"}
    project = make_project(parameters)
    along, ends = np.linspace(0, 1, 15)[:, None], (np.array([-0.3, -0.6, 0.1]), np.array([0.3, 0.9, -0.2]))
    bow = np.random.default_rng(3).normal(scale=0.1, size=(40, 1, 3))
    pool = ends[0] + along * (ends[1] - ends[0]) + bow * np.sin(np.pi * along)
    pool[:, :, 1] += 2 * np.pi  # another turn of the joint without limits
    pl.DataFrame({"waypoints": pl.Series(pool.reshape(40, 45))}).write_parquet(project.root / "mine.parquet")
    run_chain(project)
    pool[:, :, 1] -= 2 * np.pi
    drawn = table(project, "alternatives").filter(set_id="working")["waypoints"].to_numpy()
    distances = np.abs(drawn[:, None] - pool[None]).max(axis=(2, 3))
    assert (distances.min(axis=1) < 1e-6).all()
    assert len(set(distances.argmin(axis=1))) == 30
    pl.DataFrame({"waypoints": pl.Series(pool.reshape(40, 45)[:10])}).write_parquet(project.root / "mine.parquet")
    with pytest.raises(StageError, match=r"a set of 30 is wanted, and 10 of the 10 trajectories of sample\.given"):
        sample.run(project, "sweep")


def test_an_overlay_runs_a_task_that_params_yaml_does_not_have(
    make_project: Make, parameters: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    project = make_project(parameters)
    task = parameters["tasks"]["sweep"] | {"anchor": "demonstration"}
    with (project.root / "mine.yaml").open("w") as stream:
        YAML(typ="safe", pure=True).dump({"tasks": {"wave": task}, "sample": {"sampler": "deformation"}}, stream)
    before = (project.root / "params.yaml").read_bytes()
    done = subprocess.run(
        [sys.executable, "-m", "pipeline", "--overlay", "mine.yaml", "run", "wave"],
        cwd=project.root, capture_output=True, text=True, timeout=240,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert (project.root / "params.yaml").read_bytes() == before
    assert (project.datasets / "wave" / "inspect.rrd").is_file()
    assert list((project.datasets / "wave" / "figures").glob("*.svg"))
