"""Log likelihoods of a task's demonstrations under every hypothesis, for each set of alternatives.

Sets of up to one partition are computed as a whole, several at once. A larger set is computed part by part, see
`pipeline.choice.streaming`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np
import polars as pl

from pipeline.arrays import FloatArray
from pipeline.choice import log_likelihood
from pipeline.choice.models import choice_model
from pipeline.choice.streaming import STREAMED_MODELS, JoinedSums, joined_sums
from pipeline.errors import StageError
from pipeline.formats.parquet.checked.open_table import Piece
from pipeline.formats.parquet.partitions import PARTITIONS, Scaled, SetKey, SetRows, cut
from pipeline.formats.parquet.table_file import TableFile
from pipeline.formats.parquet.task_tables import TaskTables
from pipeline.vocabulary import BOLTZMANN, LESS, TASK_ANCHOR
from pipeline.workspace.compute.executor import Workers


@dataclass(frozen=True, eq=False)
class Question:
    """The demonstrations of a task, and the models and hypotheses under which their likelihoods are computed.

    Attributes:
        features: the scaled features of the alternatives.
        models: names of the models.
        ids: names of the n demonstrations.
        demonstrations: (n, F) scaled features of the demonstrations.
        thetas: (K, F) reward weights.
        betas: (B,) inverse temperatures.
    """

    features: Scaled
    models: tuple[str, ...]
    ids: tuple[str, ...]
    demonstrations: FloatArray
    thetas: FloatArray
    betas: FloatArray

    def rows_with(self, anchor: str) -> list[int]:
        """Rows of the demonstrations that choose among alternatives with this anchor: all, or the one it names."""
        return [row for row, key in enumerate(self.ids) if anchor in (TASK_ANCHOR, key)]

    def not_computed(self) -> FloatArray:
        """(n, K, B) of NaN, to be filled with likelihoods."""
        return np.full((len(self.ids), len(self.thetas), len(self.betas)), np.nan)


@dataclass(frozen=True, eq=False)
class Part:
    """A part of a set that is too large to be computed as a whole.

    Attributes:
        question: demonstrations, models and hypotheses.
        anchor: the anchor of the set.
        rows: the rows of the part in the table of features.
        densities: the table of log kernel sums.
        density_rows: the rows of the same alternatives in that table.
        sigma: the bandwidth of the set.
    """

    question: Question
    anchor: str
    rows: tuple[Piece, ...]
    densities: TableFile
    density_rows: tuple[Piece, ...]
    sigma: float


def likelihoods(
    pool: Workers, question: Question, tables: TaskTables, partition: int, label: str, set_id: str | None = None
) -> Iterator[tuple[tuple[SetRows, ...], dict[str, FloatArray]]]:
    """(n, K, B) log likelihoods under each model, with the sets they belong to.

    Args:
        pool: the workers that compute.
        question: demonstrations, models and hypotheses.
        tables: `features` and `densities`, checked.
        partition: the most rows of a set that are computed as a whole.
        label: what the progress bar says is computed.
        set_id: of the sets to compute; None: all.

    Yields:
        The sets of one size and number, one for each anchor, and their likelihoods by model.

    Raises:
        StageError: a model cannot compute a set part by part, or the two tables have different orders.
    """
    file, sigmas = tables.for_jobs("densities"), bandwidths(tables)
    density_rows = {set_rows.key: set_rows for set_rows in tables.contents("densities").sets}
    by_number: dict[tuple[int, str], list[SetRows]] = {}
    for set_rows in tables.contents("features").sets:
        if set_id in (None, set_rows.set_id):
            by_number.setdefault((set_rows.set_size, set_rows.set_id), []).append(set_rows)
    groups = [tuple(group) for group in by_number.values()]
    for large, consecutive in groupby(groups, lambda group: max(set_rows.rows for set_rows in group) > partition):
        if not large:
            small = list(consecutive)
            jobs = [(question, group, tuple(sigmas[set_rows.key] for set_rows in group)) for group in small]
            yield from zip(small, pool.mapped(set_likelihoods, jobs, label), strict=True)
            continue
        for group in consecutive:
            _require_streamed(question.models, group[0], partition)
            parts = {
                set_rows: _parts(
                    question, set_rows, file, density_rows[set_rows.key], sigmas[set_rows.key], PARTITIONS * partition
                )
                for set_rows in group
                if question.rows_with(set_rows.anchor)
            }
            yield group, _streamed(pool, question, parts, label)


def bandwidths(tables: TaskTables) -> dict[SetKey, float]:
    """The bandwidth of each set of the table `densities`, which has been checked."""
    densities = tables["densities"]
    firsts = ((set_rows.key, set_rows.pieces[0]) for set_rows in tables.contents("densities").sets)
    return {key: float(densities.part(piece.part, ["bandwidth"])["bandwidth"][piece.first]) for key, piece in firsts}


def set_likelihoods(job: tuple[Question, tuple[SetRows, ...], tuple[float, ...]]) -> dict[str, FloatArray]:
    """(n, K, B) log likelihoods under each model. Each demonstration chooses among the alternatives with its anchor."""
    question, sets, sigmas = job
    log_likelihoods = {name: question.not_computed() for name in question.models}
    for set_rows, sigma in zip(sets, sigmas, strict=True):
        rows = question.rows_with(set_rows.anchor)
        if not rows:
            continue
        # row by row in memory, because the memory layout changes how sums over features round
        alternatives = np.ascontiguousarray(question.features.read(set_rows.pieces))
        phi = question.demonstrations[rows]
        for name, values in log_likelihoods.items():
            model = choice_model(name, sigma)
            values[rows] = log_likelihood(model, phi, alternatives, question.thetas, question.betas)
    return log_likelihoods


def _require_streamed(models: Sequence[str], set_rows: SetRows, partition: int) -> None:
    for name in models:
        if name not in STREAMED_MODELS:
            raise StageError(
                f"infer.models lists {name}, which compares every alternative with all others, and the set "
                f"{set_rows.set_id!r} of {set_rows.rows:,} is larger than compute.partition ({partition:,}); leave "
                "that model out, or make the partition larger"
            )


def _parts(
    question: Question, set_rows: SetRows, densities: TableFile, density_rows: SetRows, sigma: float, most_rows: int
) -> list[Part]:
    """The parts of a set, of up to `most_rows` rows each."""
    bounds = [(first, first + count) for first, count in cut(set_rows.rows, most_rows)]
    return [
        Part(question, set_rows.anchor, set_rows.between(*part), densities, density_rows.between(*part), sigma)
        for part in bounds
    ]


def _streamed(
    pool: Workers, question: Question, parts: Mapping[SetRows, Sequence[Part]], label: str
) -> dict[str, FloatArray]:
    """(n, K, B) log likelihoods under each model, from the merged sums over the parts of each set."""
    log_likelihoods = {name: question.not_computed() for name in question.models}
    for set_rows, parts_of_set in parts.items():
        sums = pool.merged(part_sums, parts_of_set, _added, f"{label} {set_rows.set_id}")
        rows = question.rows_with(set_rows.anchor)
        phi = question.demonstrations[rows]
        for name, values in log_likelihoods.items():
            values[rows] = sums[name].log_likelihood(phi, question.thetas, question.betas, phi.mean(axis=0))
    return log_likelihoods


def part_sums(part: Part) -> dict[str, JoinedSums]:
    """What a part of a set adds to the likelihoods under each model."""
    question, features = part.question, part.question.features
    densities = pl.concat(part.densities.table().pieces(part.density_rows, ["alternative_id", "log_density"]))
    ids = pl.concat(features.file.table().pieces(part.rows, ["id"]))
    if not densities["alternative_id"].equals(ids["id"]):
        raise StageError(
            f"{part.densities.path}: its alternatives are not in the order of features.parquet; make it again with "
            "`dvc repro`"
        )
    phi = question.demonstrations[question.rows_with(part.anchor)]
    alternatives = features.read(part.rows)
    weights = {LESS: densities["log_density"].to_numpy(), BOLTZMANN: None}
    return {
        name: joined_sums(
            alternatives, phi, question.thetas, question.betas, phi.mean(axis=0), weights[name], part.sigma
        )
        for name in question.models
    }


def _added(earlier: Mapping[str, JoinedSums], later: Mapping[str, JoinedSums]) -> dict[str, JoinedSums]:
    return {name: earlier[name] + later[name] for name in earlier}
