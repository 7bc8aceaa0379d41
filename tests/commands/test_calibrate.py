"""What is said of a calibration on a small project, and where it cannot be made."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import polars as pl
import pytest

from pipeline.commands.calibrate import Wanted, rank_lines, run
from pipeline.errors import StageError
from pipeline.stages import density, featurize, ingest, sample
from pipeline.workspace.project import Project

Make = Callable[[dict[str, Any]], Project]


def test_what_three_demonstrations_would_tell(
    make_project: Make, parameters: dict[str, Any], capsys: pytest.CaptureFixture[str]
) -> None:
    parameters["sample"] |= {"sampler": "deformation", "sizes": [5]}
    project = make_project(parameters)
    for one in (ingest, sample, featurize, density):
        one.run(project, "sweep")
    capsys.readouterr()
    run(project, "sweep", Wanted(None, 50))
    said = capsys.readouterr().out.splitlines()
    assert said[0].startswith("sweep: 50 simulated people for each model, who choose from 30 sampled alternatives;")
    assert [line for line in said if line.startswith("if people")] == [
        "if people choose by LESS:", "if people choose by Boltzmann:",
    ]  # fmt: skip
    assert any(line.startswith("so 3 demonstrations would") for line in said)
    assert said[-1].startswith("so nothing speaks against the calibration of the inference here; ")
    folder = project.datasets / "sweep" / "calibration"
    assert {path.name for path in folder.iterdir()} >= {"ranks.csv", "ranks.svg", "ranks.txt"}
    ranks = pl.read_csv(folder / "ranks.csv")
    each = ranks.group_by("model", "of", maintain_order=True).agg(pl.col("count").sum())
    assert "sweep: " in (folder / "ranks.txt").read_text()
    assert "50 simulated people for each model, 3 demonstrations each" in (folder / "ranks.txt").read_text()
    assert ranks.select("task", "demonstrations").unique().rows() == [("sweep", 3)]
    of = [*project.params.task("sweep").features, "beta", "direction"]
    assert each.rows() == [(model, name, 50) for model in ("less", "boltzmann") for name in of]
    for name in of:
        assert f">{name}<" in (folder / "ranks.svg").read_text()
    run(project, "sweep", Wanted(1, 2))
    said = capsys.readouterr().out.splitlines()
    assert "; 1 demonstration each" in said[0]
    assert said[-1] == "no rank histograms: fewer than 50 repetitions are too few to show anything"
    assert not folder.exists()


def test_histograms_that_are_not_flat_are_named() -> None:
    flat, steep = [(0.0, 0.5, 6), (0.5, 1.0, 6)], [(0.0, 0.5, 12), (0.5, 1.0, 0)]
    ranks = pl.DataFrame(
        [
            {
                "model": "less",
                "of": of,
                "from": a,
                "to": b,
                "count": n,
                "lower": 1.0,
                "upper": 11.0,
                "p_value": p,
                "flat": p == 1.0,
            }
            for of, bins, p in (("beta", flat, 1.0), ("direction", steep, 0.0005))
            for a, b, n in bins
        ]
    )
    first, last = rank_lines(ranks, "here")
    assert first.endswith("1 of 2 rank histograms of the truth are flat (least p 0.0005); not direction")
    assert last == "so the inference is NOT calibrated here; see here/ranks.svg"


def test_alternatives_of_one_demonstration_each(make_project: Make, parameters: dict[str, Any]) -> None:
    parameters["tasks"]["sweep"]["anchor"] = "demonstration"
    with pytest.raises(StageError, match="set it to task"):
        run(make_project(parameters), "sweep", Wanted(None, 2))
