"""The plan of a small project: where it goes, what it may not pass, and the files for a controller."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import polars as pl
import pytest

from pipeline.commands import plan
from pipeline.commands.plan import Wanted, run, timed
from pipeline.errors import StageError
from pipeline.replay.contacts import Contacts
from pipeline.replay.scene import load_scene
from pipeline.stages import answer, density, featurize, ingest, sample
from pipeline.workspace.project import Project

Make = Callable[[dict[str, Any]], Project]
JOINTS = ["rail", "swing", "bend"]


def test_a_plan_for_someone_new_and_for_one_person(
    make_project: Make, parameters: dict[str, Any], capsys: pytest.CaptureFixture[str]
) -> None:
    parameters["sample"] |= {"sampler": "deformation", "sizes": [5]}
    project = make_project(parameters)
    with pytest.raises(StageError, match="there are no weights yet"):
        run(project, "sweep", Wanted(None, "less", True))
    for one in (ingest, sample, featurize, density, answer):
        one.run(project, "sweep")
    capsys.readouterr()
    run(project, "sweep", Wanted(None, "less", True))
    said = capsys.readouterr().out
    assert said.startswith("sweep: the motion that is best for someone new under LESS")
    assert "no contact, and no limit is passed" in said
    assert "the answer that it rests on: do not trust" in said

    folder = project.datasets / "sweep" / "plan"
    rows = pl.read_csv(folder / "plan.csv")
    path = rows.select(JOINTS).to_numpy()
    assert path.shape == (15, 3)
    np.testing.assert_allclose(path[[0, -1]], [[-0.3, -0.6, 0.1], [0.3, 0.9, -0.2]], atol=1e-6)
    assert (np.abs(path[:, 0]) <= 1).all()
    scene = load_scene(project.root / "gantry.xml", end_effector="tip", joints=JOINTS)
    assert Contacts(scene).free(path[None]).all()
    before = {file.name: file.read_bytes() for file in folder.iterdir() if file.suffix != ".rrd"}
    run(project, "sweep", Wanted(None, "less", True))
    assert {name: (folder / name).read_bytes() for name in before} == before

    run(project, "sweep", Wanted("person-1", "boltzmann", False))
    with pytest.raises(StageError, match="no demonstration of 'nobody'; there are person-0, person-1"):
        run(project, "sweep", Wanted("nobody", "less", True))
    with pytest.raises(StageError, match="--model may be less or boltzmann"):
        run(project, "sweep", Wanted(None, "psychic", True))


def test_a_scene_that_lets_nothing_touch(
    make_project: Make, parameters: dict[str, Any], capsys: pytest.CaptureFixture[str]
) -> None:
    parameters["sample"] |= {"sampler": "deformation", "sizes": [5]}
    project = make_project(parameters)
    scene = project.root / "gantry.xml"
    loose = '<default><geom contype="0" conaffinity="0"/></default><worldbody>'
    scene.write_text(scene.read_text().replace("<worldbody>", loose, 1))
    for one in (ingest, sample, featurize, density, answer):
        one.run(project, "sweep")
    capsys.readouterr()
    run(project, "sweep", Wanted(None, "less", True))
    said = capsys.readouterr().out
    assert "so all drawn solids count: those that move against those that stay" in said
    assert "(limits, surface, contacts)" in said or "(limits, contacts)" in said
    run(project, "sweep", Wanted(None, "less", False))
    said = capsys.readouterr().out
    assert "drawn solids" not in said
    assert "were checked (limits, surface): no limit is passed" in said
    assert "contact" not in said


def test_a_way_that_is_narrower_than_the_clearance(
    make_project: Make, parameters: dict[str, Any], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    parameters["sample"] |= {"sampler": "deformation", "sizes": [5]}
    project = make_project(parameters)
    for one in (ingest, sample, featurize, density, answer):
        one.run(project, "sweep")
    capsys.readouterr()
    real, tried = plan.plan_in_expectation, []

    def first_fails(*arguments: Any, **settings: Any) -> Any:
        tried.append(1)
        if len(tried) == 1:
            raise StageError("no admissible path was found")
        return real(*arguments, **settings)

    monkeypatch.setattr(plan, "plan_in_expectation", first_fails)
    run(project, "sweep", Wanted(None, "less", True))
    assert "no motion with 1 cm of clearance was found, so it was planned without" in capsys.readouterr().out
    tried.clear()
    with pytest.raises(StageError, match="no admissible path"):
        run(project, "sweep", Wanted(None, "less", False))
    assert len(tried) == 1


def test_a_motion_starts_and_ends_at_rest_and_passes_its_waypoints() -> None:
    waypoints = np.random.default_rng(0).normal(size=(9, 2))
    points, states = timed(waypoints, 4.0)
    np.testing.assert_allclose(points.positions, waypoints, atol=1e-12)
    np.testing.assert_allclose(points.velocities[[0, -1]], 0, atol=1e-12)
    assert len(states.time_ns) == 401
    np.testing.assert_allclose(states.velocities[1:-1], np.gradient(states.positions, 0.01, axis=0)[1:-1], atol=2e-2)
