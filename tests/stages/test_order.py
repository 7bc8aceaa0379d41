"""Names and orders change nothing: files, tasks and people renamed and put in another order give the same numbers."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import polars as pl
import pytest

from pipeline.formats.mcap.joint_states import read_joint_states
from pipeline.formats.parquet.tables import read_table
from pipeline.stages import density, featurize, infer, ingest, robustness, sample, shift, simulate
from pipeline.workspace.project import Project
from tests.support.gantry_project import record

Make = Callable[[dict[str, Any]], Project]
STAGES = (ingest, sample, featurize, density, infer, shift, robustness)
PEOPLE = {"p0": (0.0, (0.3, 0.9, -0.2)), "p1": (0.1, (0.2, 0.7, 0.3)), "p2": (-0.2, (0.4, 1.0, -0.4))}
POSTERIOR = ["participant", "model", "set_size", "set_id", "theta_id", "beta"]


def made(
    make_project: Make, parameters: dict[str, Any], anchor: str, task: str, files: dict[str, str], first: bool
) -> dict[str, pl.DataFrame]:
    """Tables of a project whose recordings and task have these names; `files` names the file of each person."""
    mine = parameters["tasks"]["sweep"] | {"anchor": anchor, "recordings": f"of_{task}"}
    other = mine | {"recordings": "elsewhere"}
    tasks = {task: mine, "another": other} if first else {"another": other, task: mine}
    sampled = parameters["sample"] | {"sizes": [6, 20]}
    project = make_project(
        parameters | {"tasks": tasks, "simulate": parameters["simulate"] | {"weights": {}}, "sample": sampled}
    )
    for person, name in files.items():
        bow, goal = PEOPLE[person]
        record(project.root / f"of_{task}" / f"{name}.mcap", bow, goal=goal, participant=person)
    for stage in STAGES:
        stage.run(project, task)
    return {
        name: read_table(project.table(task, name), name)
        for name in ("posteriors", "sampling", "robustness", "duplicates")
    }


@pytest.mark.parametrize("anchor", ["task", "demonstration"])
def test_renamed_and_reordered(make_project: Make, parameters: dict[str, Any], anchor: str) -> None:
    straight = {"p0": "a", "p1": "b", "p2": "c"}
    turned = {"p0": "zebra", "p1": "Äpfel 7", "p2": "0"}  # the first is the last now
    before = made(make_project, parameters, anchor, "sweep", straight, first=True)
    after = made(make_project, parameters, anchor, "fegen", turned, first=False)
    one, other = (tables["posteriors"].sort(POSTERIOR) for tables in (before, after))
    assert one.select(POSTERIOR).equals(other.select(POSTERIOR))
    np.testing.assert_allclose(other["posterior"], one["posterior"], atol=1e-12)
    for name, value, key in (
        ("robustness", "kl_aggregate", ["participant", "regime", "model", "set_size"]),
        ("duplicates", "kl_from_clean", ["participant", "model", "copies", "spread"]),
    ):
        one, other = (tables[name].sort(key) for tables in (before, after))
        assert one.select(key).equals(other.select(key))
        np.testing.assert_allclose(other[value], one[value], rtol=1e-9, atol=1e-12)


def test_every_anchor_has_equal_parts_of_a_mixture(make_project: Make, parameters: dict[str, Any]) -> None:
    files = {person: person for person in PEOPLE}
    shares = made(make_project, parameters, "demonstration", "sweep", files, first=True)["sampling"]
    assert shares["anchor"].unique(maintain_order=True).to_list() == ["p0", "p1", "p2"]
    kept = shares.pivot("sampler", index=["anchor", "set_size", "set_id"], values="kept")
    parts = kept.select("deformation", "planner", "via-point").to_numpy()
    np.testing.assert_array_equal(parts.sum(axis=1), kept["set_size"])
    assert (np.ptp(parts, axis=1) <= 1).all()
    refused = shares["proposed"] - shares["outside_limits"] - shares["through_surface"] - shares["in_collision"]
    assert refused.equals(shares["kept"].rename("proposed"))


def test_simulated_people_are_made_by_what_they_want(make_project: Make, parameters: dict[str, Any]) -> None:
    project = make_project(parameters)
    simulate.run(project, "sweep")
    renamed = parameters | {
        "tasks": {"fegen": parameters["tasks"]["sweep"]},
        "simulate": parameters["simulate"] | {"weights": {"fegen": parameters["simulate"]["weights"]["sweep"]}},
    }
    other = make_project(renamed)
    simulate.run(other, "fegen")
    files = sorted((project.datasets / "sweep" / "recordings").iterdir())
    assert len(files) == 3
    for file in files:
        one, twin = (
            read_joint_states(path, joints=("rail", "swing", "bend"))
            for path in (file, other.datasets / "fegen" / "recordings" / file.name)
        )
        np.testing.assert_array_equal(one.positions, twin.positions)


def test_given_trajectories_may_stand_in_any_order(make_project: Make, parameters: dict[str, Any]) -> None:
    paths = np.linspace([-0.3, -0.6, 0.1], [0.3, 0.9, -0.2], 15) + 0.05 * np.random.default_rng(0).normal(
        size=(40, 15, 3)
    )
    parameters["sample"] |= {"sampler": "given", "given": "given.parquet"}
    found = []
    for order in (np.arange(40), np.random.default_rng(1).permutation(40)):
        project = make_project(parameters)
        pl.DataFrame({"waypoints": paths[order].reshape(40, -1).tolist()}).write_parquet(project.root / "given.parquet")
        for stage in STAGES[:5]:
            stage.run(project, "sweep")
        found.append(read_table(project.table("sweep", "posteriors"), "posteriors").sort(POSTERIOR))
    assert found[0].equals(found[1])


def test_tasks_of_different_scenes_draw_different_alternatives(make_project: Make, parameters: dict[str, Any]) -> None:
    sweep = parameters["tasks"]["sweep"]
    tasks = {"sweep": sweep, "alike": sweep, "apart": sweep | {"scene": "apart.xml"}}
    project = make_project(parameters | {"tasks": tasks, "simulate": parameters["simulate"] | {"weights": {}}})
    scene = (project.root / "gantry.xml").read_text()
    (project.root / "apart.xml").write_text(scene.replace('pos="0.4 0.3 0"', 'pos="0.3 0.3 0"'))  # the vase
    drawn = {}
    for task in tasks:
        ingest.run(project, task)
        sample.run(project, task)
        drawn[task] = read_table(project.table(task, "alternatives"), "alternatives")["waypoints"].to_numpy()
    assert np.array_equal(drawn["alike"], drawn["sweep"])
    assert not np.isclose(drawn["apart"][:, 7], drawn["sweep"][:, 7]).all(axis=1).any()
