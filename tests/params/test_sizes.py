"""Parameters that ask for more than fits are refused before anything is allocated, with the memory they would take."""

from __future__ import annotations

import time
from copy import deepcopy
from pathlib import Path
from typing import Any

import pytest
from ruamel.yaml import YAML

from pipeline.errors import ParameterError
from pipeline.params import parse

ROOT = Path(__file__).resolve().parents[2]
DOCUMENT: dict[str, Any] = YAML(typ="safe", pure=True).load((ROOT / "params.yaml").read_text())
SIXTEEN = {f"f{number}": {"kind": "height"} for number in range(16)}


@pytest.mark.parametrize(
    ("path", "value", "said"),
    [
        ("sample.sizes", [10**12], "sample.sizes.0"),
        ("sample.sets", 10**12, "sample.sets"),
        ("sample.working_set", 10**9, "sample.working_set"),
        ("sample.sizes", [10**8], "numbers of trajectories, which would take 2,624 GB; .*lower sample.sets"),
        ("infer.theta_values", [n / 20_000 for n in range(20_000)], r"8,000,000,000,000 weight vectors, .* 192,000 GB"),
        ("tasks.table.features", SIXTEEN, "weight vectors, which would take .* GB; .*or give tasks.table.thetas"),
        ("infer.betas", list(range(1, 99_001)), "rows of posteriors for each demonstration, which would take .* GB"),
        ("seed", 2**64, "seed is 18446744073709551616; it should be less than 9223372036854775808"),
        ("ingest.waypoints", 10**12, "ingest.waypoints"),
        ("robustness.duplicates.copied", 10**9, "robustness.duplicates.copied"),
        ("studies.grid_world.seeds", 10**9, "studies.grid_world.seeds"),
        ("studies.grid_world.size", 10**9, "studies.grid_world.size"),
        ("simulate.participants", 10**9, "simulate.participants"),
    ],
)
def test_too_much_is_refused_at_once(path: str, value: Any, said: str) -> None:
    document = deepcopy(DOCUMENT)
    *folders, last = path.split(".")
    section = document
    for folder in folders:
        section = section[folder]
    section[last] = value
    begin = time.process_time()
    with pytest.raises(ParameterError, match=said) as refused:
        parse(document)
    assert time.process_time() - begin < 5
    assert "\n" not in str(refused.value)


def test_a_part_that_is_larger_than_memory() -> None:
    document = deepcopy(DOCUMENT)
    document["compute"]["partition"] = 1_000_000
    document["sample"]["working_set"] = 1_000_000
    document["ingest"]["waypoints"] = 10_000
    with pytest.raises(ParameterError, match=r"in one part, which would take 640 GB; .* lower compute.partition"):
        parse(document)


@pytest.mark.parametrize(("values", "features", "betas"), [(3, 7, 9), (6, 6, 9), (2, 16, 9), (20, 3, 100)])
def test_what_fits_is_taken(values: int, features: int, betas: int) -> None:
    document = deepcopy(DOCUMENT)
    document["infer"]["theta_values"] = [number / values for number in range(values)]
    document["infer"]["betas"] = [0.1 * (number + 1) for number in range(betas)]
    document["tasks"] = {"table": document["tasks"]["table"] | {"features": dict(list(SIXTEEN.items())[:features])}}
    document["simulate"]["weights"] = {}
    parse(document)
