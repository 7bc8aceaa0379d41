"""What posteriors are formed over, and rows of the tables `posteriors`, `held_out` and `fits`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
import polars as pl

from pipeline.arrays import FloatArray
from pipeline.choice import held_out_from, posterior_from, theta_grid
from pipeline.choice.chance import needed_gain
from pipeline.errors import StageError
from pipeline.params import Infer, Task
from pipeline.vocabulary import ALL, DIRECTIONS

PART_ROWS = 1 << 18  # rows of posteriors that are in memory at once, unless one group alone has more hypotheses
Group = tuple[str, str, list[int]]  # demonstration_id, participant, rows of the demonstrations


def groups_of(people: pl.DataFrame) -> list[Group]:
    """The groups that get a posterior: each demonstration, each participant with several of them, and all together.

    Args:
        people: the columns `demonstration_id` and `participant` of the demonstrations.
    """
    rows: dict[str, list[int]] = {}
    singles: list[Group] = []
    for row, (demonstration_id, participant) in enumerate(people.iter_rows()):
        singles.append((demonstration_id, participant, [row]))
        rows.setdefault(participant, []).append(row)
    several = [(ALL, participant, theirs) for participant, theirs in rows.items() if 1 < len(theirs) < len(singles)]
    return [*singles, *several, (ALL, ALL, list(range(len(singles))))]


def hypotheses(task: Task, settings: Infer, features: Sequence[str], directions: Sequence[str]) -> np.ndarray:
    """The weight vectors (K, F) on scaled features: those the task lists, or a grid of directions.

    In a grid a feature has the values that `thetas` gives for it, else those of `infer.theta_values` with the signs
    of its direction.

    Args:
        task: whose hypotheses.
        settings: the values of the grid.
        features: names of the F features in the order of the tables.
        directions: for each of them, a word of `DIRECTIONS`.

    Raises:
        StageError: the task lists weight vectors, and its features are not those of the tables, in their order.
    """
    if not isinstance(task.thetas, tuple):
        own = {} if task.thetas == "grid" else task.thetas
        amounts = np.array(settings.theta_values)
        signed = {word: [*dict.fromkeys(np.outer(signs, amounts).ravel() + 0.0)] for word, signs in DIRECTIONS.items()}
        values = [own.get(name, signed[word]) for name, word in zip(features, directions, strict=True)]
        return theta_grid(values, sign=1)
    if tuple(task.features) != tuple(features):
        raise StageError(
            f"the tables have the features {', '.join(features)} in this order and params.yaml has "
            f"{', '.join(task.features)}, which the task's thetas are weights of; make the tables again with "
            "`dvc repro --force --single-item featurize@TASK`, then `dvc repro`"
        )
    return np.array(task.thetas, dtype=np.float64)


def posterior_parts(
    groups: Sequence[Group], values: FloatArray, thetas: FloatArray, betas: FloatArray, about: Mapping[str, object]
) -> Iterator[pl.DataFrame]:
    """Rows of the table `posteriors`, group after group, in parts that are small enough for memory.

    Args:
        groups: from `groups_of`.
        values: (n, K, B) log likelihoods of the demonstrations.
        thetas: (K, F) reward weights.
        betas: (B,) inverse temperatures.
        about: columns that have one value in all rows, with that value.
    """
    columns = [pl.lit(value).alias(column) for column, value in about.items()]
    step = max(PART_ROWS // values[0].size, 1)
    for first in range(0, len(groups), step):
        yield _posterior_rows(groups[first : first + step], values, thetas, betas).with_columns(columns)


def _posterior_rows(groups: Sequence[Group], values: FloatArray, thetas: FloatArray, betas: FloatArray) -> pl.DataFrame:
    log_posterior = np.stack(
        [posterior_from(values[rows].sum(axis=0), thetas, betas).log_probability for _, _, rows in groups]
    )
    n, k, b = log_posterior.shape
    group_index = np.repeat(np.arange(n), k * b)
    return pl.DataFrame(
        {
            "demonstration_id": pl.Series([group[0] for group in groups]).gather(group_index),
            "participant": pl.Series([group[1] for group in groups]).gather(group_index),
            "theta_id": np.tile(np.repeat(np.arange(k), b), n),
            "theta": np.tile(np.repeat(thetas, b, axis=0), (n, 1)),
            "beta": np.tile(betas, n * k),
            "log_posterior": log_posterior.ravel(),
            "posterior": np.exp(log_posterior).ravel(),
        }
    )


def held_out_rows(people: pl.DataFrame, values: FloatArray, about: Mapping[str, object]) -> pl.DataFrame:
    """Rows of the table `held_out`: one per demonstration, or none if there is no other to predict it from.

    Args:
        people: the columns `demonstration_id` and `participant` of the demonstrations.
        values: (n, K, B) log likelihoods of the demonstrations.
        about: columns that have one value in all rows, with that value.
    """
    rows = people.with_columns(pl.lit(value).alias(column) for column, value in about.items())
    if people.height < 2:
        return rows.clear().with_columns(log_predictive=pl.lit(None, pl.Float64))
    return rows.with_columns(log_predictive=pl.Series(held_out_from(values).log_predictive))


def fit_rows(
    groups: Sequence[Group], values: FloatArray, by_chance: FloatArray, thetas: FloatArray, about: Mapping[str, object]
) -> pl.DataFrame:
    """Rows of the table `fits`.

    Args:
        groups: from `groups_of`.
        values: (n, K, B) log likelihoods of the demonstrations.
        by_chance: (n,) those under theta = 0.
        thetas: (K, F) reward weights.
        about: columns that have one value in all rows, with that value.
    """
    best = np.array([values[rows].sum(axis=0).max() for _, _, rows in groups])
    chance = np.array([by_chance[rows].sum() for _, _, rows in groups])
    needed = needed_gain(thetas)
    return pl.DataFrame(
        {
            "demonstration_id": [group[0] for group in groups],
            "participant": [group[1] for group in groups],
            "demonstrations": [len(group[2]) for group in groups],
            "log_likelihood": best,
            "log_chance": chance,
            "needed": needed,
            "better": best - chance >= needed,
        }
    ).with_columns(pl.lit(value).alias(column) for column, value in about.items())
