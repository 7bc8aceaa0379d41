"""Rows of posteriors and of held-out scores, some groups of demonstrations at a time."""

from __future__ import annotations

import numpy as np
import polars as pl
import pytest

from pipeline.choice import theta_grid
from pipeline.studies import posteriors
from pipeline.studies.posteriors import groups_of, held_out_rows, posterior_parts

PEOPLE = pl.DataFrame({"demonstration_id": ["a1", "a2", "b1"], "participant": ["ana", "ana", "bea"]})
THETAS, BETAS = theta_grid([[0, 0.5, 1]] * 2), np.array([0.1, 1.0, 10.0])
ABOUT = {"task": "t", "model": "less", "set_size": 5, "set_id": "00"}


@pytest.fixture
def values() -> np.ndarray:
    """Log likelihoods of three demonstrations."""
    return np.random.default_rng(2).normal(-3, 2, size=(3, len(THETAS), len(BETAS)))


def test_each_demonstration_each_person_with_several_and_all_together() -> None:
    assert groups_of(PEOPLE) == [
        ("a1", "ana", [0]), ("a2", "ana", [1]), ("b1", "bea", [2]), ("all", "ana", [0, 1]), ("all", "all", [0, 1, 2]),
    ]  # fmt: skip


def test_each_group_has_the_product_of_its_likelihoods(values: np.ndarray) -> None:
    table = pl.concat(posterior_parts(groups_of(PEOPLE), values, THETAS, BETAS, ABOUT))
    assert table.select("task", "model", "set_size", "set_id").unique().rows() == [("t", "less", 5, "00")]
    for (key, person), rows in table.group_by("demonstration_id", "participant", maintain_order=True):
        of = next(of for label, who, of in groups_of(PEOPLE) if (label, who) == (key, person))
        product = np.exp(values[of].sum(axis=0)).ravel()
        np.testing.assert_allclose(rows["posterior"], product / product.sum(), rtol=1e-12)
        np.testing.assert_allclose(rows["log_posterior"], np.log(product / product.sum()), rtol=1e-12)
        assert rows["theta_id"].to_list() == np.repeat(np.arange(len(THETAS)), 3).tolist()
        assert rows["beta"].to_list() == BETAS.tolist() * len(THETAS)
        np.testing.assert_array_equal(rows["theta"].to_numpy(), np.repeat(THETAS, 3, axis=0))


@pytest.mark.parametrize(("rows", "heights"), [(1, [15] * 5), (31, [30, 30, 15]), (10_000, [75])])
def test_few_rows_are_in_memory_and_they_are_the_same(
    values: np.ndarray, rows: int, heights: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = pl.concat(posterior_parts(groups_of(PEOPLE), values, THETAS, BETAS, ABOUT))
    monkeypatch.setattr(posteriors, "PART_ROWS", rows)
    parts = list(posterior_parts(groups_of(PEOPLE), values, THETAS, BETAS, ABOUT))
    assert [part.height for part in parts] == heights
    assert pl.concat(parts).equals(whole)


def test_one_demonstration_alone_is_not_held_out(values: np.ndarray) -> None:
    assert held_out_rows(PEOPLE, values, ABOUT).height == 3
    alone = held_out_rows(PEOPLE[:1], values[:1], ABOUT)
    assert alone.is_empty()
    assert alone.columns == held_out_rows(PEOPLE, values, ABOUT).columns
