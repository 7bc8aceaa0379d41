"""The headline numbers, from beliefs and tables small enough to do by hand."""

from __future__ import annotations

import numpy as np
import polars as pl
import pytest

from pipeline.choice import Posterior
from pipeline.views.headline import studies_headline, task_headline

LABELS = ("a", "a + ½ b")
BELIEF = Posterior(np.eye(2), np.array([1.0, 10.0]), np.log([[0.2, 0.05], [0.3, 0.45]]))
HELD_OUT = pl.DataFrame({"model": ["less", "less", "boltzmann"], "log_predictive": [-2.0, -4.0, -9.0]})


def fits(better: bool) -> pl.DataFrame:
    about = {"model": "less", "demonstration_id": "all", "participant": "all", "better": better}
    return pl.DataFrame({**about, "log_likelihood": [-5.5], "log_chance": [-10.0]})


def summary(**largest: float) -> pl.DataFrame:
    rows = [
        ("less", regime, size, kind, value if (size, kind) == (100, "single") else 7.0)
        for regime, value in largest.items()
        for size in (10, 100)
        for kind in ("single", "batch")
    ]
    return pl.DataFrame(rows, schema=["model", "regime", "set_size", "demonstrations", "value"], orient="row")


def test_a_task_in_a_few_numbers() -> None:
    table = summary(**{"independent": 0.123456789, "sampler-shift": np.inf, "known-density": 1.0})
    numbers = task_headline(
        {"less": BELIEF}, LABELS, HELD_OUT, table, (2, 1), fits(True), pairs=summary(independent=0.25)
    )
    assert numbers["recordings"] == {"used": 2, "rejected": 1}
    assert numbers["less"] == {
        "best": "a + ½ b",
        "gain": 4.5,
        "posterior": pytest.approx(0.75),
        "beta": 10.0,
        "entropy": pytest.approx(-(0.25 * np.log(0.25) + 0.75 * np.log(0.75)), rel=1e-5),
        "held_out": -3.0,
        "kl_aggregate": {"independent": 0.123457, "sampler-shift": "inf"},
        "kl_per_pair": {"independent": 0.25},
    }


def test_what_was_not_computed_is_left_out() -> None:
    numbers = task_headline({"less": BELIEF}, LABELS, HELD_OUT.clear(), None, (1, 0), fits(False))
    assert isinstance(numbers["less"], dict)
    assert set(numbers["less"]) == {"best", "gain", "posterior", "beta", "entropy"}
    assert numbers["less"]["best"] == "nothing found: no better than chance (likeliest: a + ½ b)"


def test_the_studies_in_a_few_numbers() -> None:
    tests = pl.DataFrame({"comparison": "groups", "model": "less", "p_value": [0.4], "minimum_epsilon": [0.2]})
    world = pl.DataFrame(
        {
            "theta_id": [0, None],
            "sampling_model": "less",
            "inference_model": "boltzmann",
            "true_posterior": [0.1, 0.5],
        }
    )
    assert studies_headline(tests, world) == {
        "human_choice": {"groups": {"less": {"p_value": 0.4, "minimum_epsilon": 0.2}}},
        "grid_world": {"people-less": {"boltzmann": 0.5}},
    }
