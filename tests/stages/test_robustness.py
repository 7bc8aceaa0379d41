"""The robustness study on an arm of another shape, and on people's own recordings."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from pipeline.errors import ParameterError, StageError
from pipeline.formats.duckdb.questions import ask
from pipeline.formats.parquet.tables import read_table
from pipeline.params import parse
from pipeline.stages import catalog, density, featurize, figures, infer, ingest, robustness, sample, shift, simulate
from pipeline.trajectories.paths import Anchor
from pipeline.trajectories.samplers import Deformation
from pipeline.workspace.project import Project
from schemas import names

Make = Callable[[dict[str, Any]], Project]
STUDY = [name for name in names() if name.startswith(("robustness", "sensitivity", "duplicates", "shifted"))]


def table(project: Project, name: str, task: str = "sweep") -> pl.DataFrame:
    return read_table(project.table(task, name), name)


def prepare(project: Project, task: str = "sweep") -> None:
    for stage in (ingest, sample, featurize, density, infer, shift):
        stage.run(project, task)


def test_the_study_of_simulated_people(make_project: Make, parameters: dict[str, Any]) -> None:
    parameters["tasks"]["sweep"]["recordings"] = "datasets/sweep/recordings"
    project = make_project(parameters)
    simulate.run(project, "sweep")
    prepare(project)
    robustness.run(project, "sweep")
    catalog.run(project)

    # the independent regime compares what the infer stage wrote
    posteriors = table(project, "posteriors").group_by(
        "demonstration_id", "model", "set_size", "set_id", "theta_id", maintain_order=True
    ).agg(pl.col("posterior").sum())  # fmt: skip
    mine = table(project, "robustness_posteriors").filter(regime="independent")
    both = mine.join(posteriors, on=["demonstration_id", "model", "set_size", "set_id", "theta_id"], validate="1:1")
    assert both.height == mine.height == 2 * 2 * 2 * 4 * 5
    np.testing.assert_allclose(both["posterior"], both["posterior_right"], rtol=1e-12)

    measured = table(project, "robustness")
    assert measured["true_posterior"].null_count() == 0
    assert set(measured["regime"]) == {"independent", "sampler-shift", "known-density"}
    assert dict(measured.select("regime", "sets").unique().rows()) == {
        "independent": 2, "sampler-shift": 5, "known-density": 3,
    }  # fmt: skip
    effective = table(project, "robustness_sets").filter(pl.col("effective_sample_size").is_not_null())
    assert set(effective["set_id"]) == {"near", "far", "both"}
    assert table(project, "robustness_anova").height == 3 * 2 * 3

    answer = ask(
        project.catalog,
        "select regime, model, median(kl_aggregate) from robustness where demonstration_id <> 'all' group by all",
    )
    assert answer.height == 9  # two models, and five where the density is known
    for name in STUDY:
        assert ask(project.catalog, f"select count(*) as n from {name}")["n"].item() == table(project, name).height > 0

    before = {name: project.table("sweep", name).read_bytes() for name in STUDY}
    shift.run(project, "sweep")
    robustness.run(project, "sweep")
    assert {name: project.table("sweep", name).read_bytes() for name in STUDY} == before

    figures.run(project, "sweep")
    drawn = {path.stem for path in project.figures("sweep").iterdir()}
    assert {"robustness", "two_posteriors", "importance", "accuracy", "duplicates", "sensitivity"} <= drawn


def test_shifted_sets_and_their_densities(make_project: Make, parameters: dict[str, Any]) -> None:
    project = make_project(parameters)
    for stage in (ingest, sample, shift):
        stage.run(project, "sweep")
    shifted = table(project, "shifted_alternatives")
    assert shifted.group_by("set_size", "set_id").len().filter(pl.col("set_size") != pl.col("len")).is_empty()
    assert set(shifted.filter(set_id="both")["sampler"]) == {"near", "far"}
    assert shifted.filter(pl.col("set_id").is_in(["via", "planned"]))["log_proposal"].null_count() == 50
    anchor = Anchor(np.array([-0.3, -0.6, 0.1]), np.array([0.3, 0.9, -0.2]))
    for set_id, widths in (("near", (0.1,)), ("both", (0.1, 0.3))):
        rows = shifted.filter(set_id=set_id, set_size=20)
        paths = rows["waypoints"].to_numpy().astype(np.float64)
        parts = [np.exp(Deformation(width, 4).log_proposal(paths, anchor)) for width in widths]
        np.testing.assert_allclose(rows["log_proposal"], np.log(np.mean(parts, axis=0)), atol=1e-4)  # float32 paths

    # another size or sampler leaves every other set as it was
    parameters["sample"]["sizes"] = [20, 7]
    parameters["robustness"]["samplers"]["wide"] = {"kind": "deformation", "width_rad": 0.5}
    changed = make_project(parameters)
    shift.run(changed, "sweep")
    kept = table(changed, "shifted_alternatives").filter(
        pl.col("alternative_id").is_in(shifted["alternative_id"].implode())
    )
    assert kept.equals(shifted.filter(set_size=20))


def test_people_who_start_where_they_like(make_project: Make, parameters: dict[str, Any]) -> None:
    parameters["tasks"]["sweep"]["anchor"] = "demonstration"
    project = make_project(parameters)
    prepare(project)
    robustness.run(project, "sweep")
    measured = table(project, "robustness")
    assert measured["true_posterior"].null_count() == measured.height
    assert measured["map_angle_rad"].null_count() == measured.height
    assert set(measured["demonstration_id"]) == {"demo-0", "demo-1", "demo-2", "all"}
    assert table(project, "robustness_sets")["anchor"].n_unique() == 3


def test_the_lab_recordings(shared: Path, make_project: Make, parameters: dict[str, Any]) -> None:
    root = Path(__file__).resolve().parents[2]
    folder = shared / "real" / "jaco" / "recordings"
    project = make_project(parameters)
    lab = project.root / "lab"
    lab.mkdir()
    for file in sorted(folder.glob("tablelaptop_case1_*.mcap")):
        (lab / file.name).symlink_to(file)
    terms = {"efficiency": {"kind": "efficiency"}, "table": {"kind": "height"}}
    parameters["tasks"] = {
        "given": {
            "scene": str(root / "datasets" / "scenes" / "laptop.xml"), "end_effector": "j2s7s300_link_7",
            "surface": "table_top", "recordings": "lab", "anchor": "demonstration", "preferences": terms,
            "thetas": "grid",
            "features": terms | {"laptop": {"kind": "proximity", "object": "laptop", "radius_m": 0.4}},
        }
    }  # fmt: skip
    parameters["simulate"]["weights"] = {}
    parameters["sample"] |= {"sizes": [8], "sets": 2, "working_set": 8}
    parameters["robustness"]["duplicates"] |= {"set_size": 8}
    project = make_project(parameters)
    prepare(project, "given")
    robustness.run(project, "given")
    measured = table(project, "robustness", "given")
    single = measured.filter((pl.col("demonstration_id") != "all") & (pl.col("regime") == "independent"))
    assert single.filter(model="less").height == 20
    assert (single["kl_aggregate"] > 0).all()
    assert measured["true_posterior"].null_count() == measured.height
    assert table(project, "robustness_anova", "given").filter(regime="sampler-shift")["df_error"][0] == 19


def run(project: Project, *words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "pipeline", *words], cwd=project.root, capture_output=True, text=True, timeout=120
    )


MISTAKES: dict[str, tuple[tuple[str, ...], str]] = {
    "no such study": (
        ("study", "astrology"),
        "no study 'astrology'; there are grid-world, human-choice, redraws, regimes, robustness",
    ),
    "no task": (("study", "robustness"), "robustness needs a task; there are sweep"),
    "a task too much": (("study", "grid-world", "sweep"), "grid-world takes no task; leave 'sweep' out"),
    "nothing sampled": (("study", "robustness", "sweep"), "shifted_alternatives.parquet: there is no such file"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_ends_in_one_sentence(make_project: Make, parameters: dict[str, Any], mistake: str) -> None:
    words, message = MISTAKES[mistake]
    project = make_project(parameters)
    if mistake == "nothing sampled":
        for stage in (ingest, sample, featurize, density):
            stage.run(project, "sweep")
    done = run(project, *words)
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr.count("\n") == 1
    assert message in done.stderr


@pytest.mark.parametrize(
    ("change", "message"),
    [({"sets": 1}, r"set sample\.sets to 2 or more"), ({"sizes": [5, 9]}, r"set_size is 20; .* sample\.sizes, 5, 9$")],
)
def test_sets_that_cannot_be_compared(
    make_project: Make, parameters: dict[str, Any], change: dict[str, Any], message: str
) -> None:
    parameters["sample"] |= change
    project = make_project(parameters)
    prepare(project)
    with pytest.raises(StageError, match=message):
        robustness.run(project, "sweep")


SETTINGS: dict[str, tuple[Callable[[dict[str, Any]], object], str]] = {
    "argument of another kind": (
        lambda r: r["samplers"]["near"].update(reach_rad=1),
        "sampler of kind deformation takes width_rad alone, got reach_rad, width_rad",
    ),
    "unknown part": (
        lambda r: r["samplers"]["both"].update(of=["near", "mine"]),
        r"both\.of names 'mine'; .*far, near",
    ),
    "mixture of mixtures": (
        lambda r: r["samplers"].update(x={"kind": "mixture", "of": ["near", "both"]}),
        "names 'both'",
    ),
    "misspelt": (lambda r: r["samplers"]["near"].update(width=1), "samplers.near.width.*did you mean 'width_rad'"),
    "more copied than there are": (lambda r: r["duplicates"].update(copied=21), "copied is 21; a set has 20"),
    "twice": (lambda r: r.update(bandwidth_factors=[1, 1.0]), "bandwidth_factors lists a value twice"),
}  # fmt: skip


@pytest.mark.parametrize("setting", SETTINGS)
def test_parameters_are_checked(parameters: dict[str, Any], setting: str) -> None:
    change, message = SETTINGS[setting]
    change(parameters["robustness"])
    with pytest.raises(ParameterError, match=message):
        parse(parameters)
