"""What is said of a calibration on a small project, and where it cannot be made."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from pipeline.commands.calibrate import Wanted, run
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
    run(project, "sweep", Wanted(None, 12))
    said = capsys.readouterr().out.splitlines()
    assert said[0].startswith("sweep: 12 simulated people for each model, who choose from 30 sampled alternatives;")
    assert [line for line in said if line.startswith("if people")] == [
        "if people choose by LESS:", "if people choose by Boltzmann:",
    ]  # fmt: skip
    assert said[-1].startswith("so 3 demonstrations would")
    run(project, "sweep", Wanted(1, 2))
    assert "; 1 demonstration each" in capsys.readouterr().out


def test_alternatives_of_one_demonstration_each(make_project: Make, parameters: dict[str, Any]) -> None:
    parameters["tasks"]["sweep"]["anchor"] = "demonstration"
    with pytest.raises(StageError, match="set it to task"):
        run(make_project(parameters), "sweep", Wanted(None, 2))
