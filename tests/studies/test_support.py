"""Where demonstrations stand among the alternatives."""

from __future__ import annotations

import numpy as np
import polars as pl
import pytest

from pipeline.studies.support import at_edge, beyond, support_rows

PEOPLE = pl.DataFrame({"demonstration_id": ["a", "b"], "participant": ["p", "q"]})
ALTERNATIVES = np.array([[0.0, 10.0], [1.0, 20.0], [1.0, 30.0], [2.0, 40.0]])


def test_ranks_and_ends() -> None:
    rows = support_rows(PEOPLE, np.array([[1.0, 41.0], [-0.5, 10.0]]), [ALTERNATIVES] * 2, ["effort", "vase"])
    assert rows.select("demonstration_id", "feature", "low", "high", "rank", "outside").rows() == [
        ("a", "effort", 0.0, 2.0, 0.5, False),  # two of four are equal, of which one counts, and one is below
        ("a", "vase", 10.0, 40.0, 1.0, True),
        ("b", "effort", 0.0, 2.0, 0.0, True),
        ("b", "vase", 10.0, 40.0, 0.125, False),
    ]
    assert [sentence.partition(",")[0] for sentence in beyond(rows)] == [
        "1 of 2 demonstrations is outside the sampled alternatives' range in effort (b; b has -0.5",
        "1 of 2 demonstrations is outside the sampled alternatives' range in vase (a; a has 41",
    ]
    assert "below their 0" in beyond(rows)[0]
    assert "above their 40" in beyond(rows)[1]


def test_each_has_alternatives_of_its_own() -> None:
    rows = support_rows(PEOPLE, np.array([[0.5], [0.5]]), [np.zeros((3, 1)), np.ones((3, 1))], ["effort"])
    assert rows["rank"].to_list() == [1.0, 0.0]
    assert rows["outside"].all()


@pytest.mark.parametrize(
    ("marginal", "word"), [([0.5, 0.3, 0.2], "least"), ([0.2, 0.3, 0.5], "greatest"), ([0.2, 0.6, 0.2], None)]
)
@pytest.mark.parametrize("turned", [False, True])
def test_the_edge_of_the_grid(marginal: list[float], word: str | None, turned: bool) -> None:
    betas = [0.3, 3.0, 30.0]
    step = -1 if turned else 1
    said = at_edge(np.array(marginal[::step]), betas[::step], "LESS")
    assert (said is None) == (word is None)
    assert word is None or f"is the {word} of infer.betas" in str(said)


def test_one_beta_has_no_edge() -> None:
    assert at_edge(np.ones(1), [3.0], "LESS") is None
