"""What is needed follows the stated rules, checked where they have a closed form."""

from __future__ import annotations

import numpy as np
import polars as pl
import pytest

from pipeline.answers.enough import alternatives, demonstrations, evaluations, width_of


def rounds(*apart: float, change: float = 0.0) -> pl.DataFrame:
    """A table of one model whose evaluations double from round to round."""
    return pl.DataFrame(
        {
            "model": "less",
            "round": range(len(apart)),
            "demonstration_id": "all",
            "participant": "all",
            "evaluations": [1000 * 2**number for number in range(len(apart))],
            "disagreement": apart,
            "change": [None, *[change] * (len(apart) - 1)],
        },
        schema_overrides={"change": pl.Float64},
    )


@pytest.mark.parametrize(
    ("table", "tolerance", "converged", "further"),
    [
        (rounds(0.4, 0.2), 0.05, False, 6000),  # halves at each doubling: 8,000 are needed and 2,000 are there
        (rounds(0.4, 0.1), 0.1, True, 0),
        (rounds(0.4, 0.1, change=0.2), 0.1, False, 2000),
        (rounds(0.1, 0.4), 0.2, False, None),
        (rounds(0.01), 0.1, False, None),  # one round says nothing of change
    ],
)
def test_evaluations(table: pl.DataFrame, tolerance: float, converged: bool, further: int | None) -> None:
    (found,) = evaluations(table, tolerance)
    assert (found.converged, found.whose) == (converged, "all together")
    assert found.further == (further if further is None else pytest.approx(further, abs=2))


def study(power: float) -> pl.DataFrame:
    sizes = np.array([10, 100, 1000])
    return pl.DataFrame(
        {"regime": "independent", "model": "less", "demonstrations": "single", "set_size": sizes,
         "value": 90 * 10.0 * sizes**power}
    )  # fmt: skip


def test_alternatives() -> None:
    (found,) = alternatives(study(-1.0), {"independent": 10}, 0.001)
    assert found.disagreement == pytest.approx(0.01)
    assert found.slope == pytest.approx(1)
    assert found.needed == pytest.approx(10_000, abs=2)
    (grows,) = alternatives(study(0.5), {"independent": 10}, 0.001)
    assert grows.needed is None
    assert alternatives(study(-1.0), {}, 0.001) == []


def test_demonstrations() -> None:
    angle = np.radians(20)
    thetas = np.array([[np.cos(angle), np.sin(angle)], [np.cos(angle), -np.sin(angle)]])
    assert width_of(thetas, np.array([0.5, 0.5])) == pytest.approx(20)
    assert width_of(thetas, np.array([1.0, 0.0])) == pytest.approx(0, abs=1e-5)
    assert width_of(np.array([[1.0, 0.0], [-1.0, 0.0]]), np.array([0.5, 0.5])) == 180
    keys = {"model": "less", "exploration": "pooled", "posterior": 0.5, "beta": 1.0}
    everybody = keys | {"demonstration_id": "all", "participant": "all"}
    together = [everybody | {"theta_id": k, "theta": thetas[k]} for k in (0, 1)]
    one = keys | {"participant": "p", "theta_id": 0, "theta": thetas[0]}
    singles = [one | {"demonstration_id": f"d{k}"} for k in range(4)]
    table = pl.DataFrame([*together, *singles], schema_overrides={"theta": pl.Array(pl.Float64, 2)})
    assert demonstrations(table, 20.1)[0].needed == 4
    assert demonstrations(table, 10.0)[0].needed is None  # the two hypotheses lie 40 degrees apart
