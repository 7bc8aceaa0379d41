"""Log likelihoods of a task's demonstrations under every hypothesis, set by set of alternatives.

Sets of up to one partition are computed whole, side by side; a larger set is a fold over its parts, see
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
    """What the likelihoods of a task's demonstrations are wanted for.

    Attributes:
        features: of the alternatives.
        models: labels of the models.
        ids: of the n demonstrations.
        demonstrations: (n, F) their scaled features.
        thetas, betas: the hypotheses.
    """

    features: Scaled
    models: tuple[str, ...]
    ids: tuple[str, ...]
    demonstrations: FloatArray
    thetas: FloatArray
    betas: FloatArray

    def of(self, anchor: str) -> list[int]:
        """Which demonstrations alternatives with this anchor are compared with: all, or its own."""
        return [row for row, key in enumerate(self.ids) if anchor in (TASK_ANCHOR, key)]

    def unknown(self) -> FloatArray:
        """(n, K, B) of NaN."""
        return np.full((len(self.ids), len(self.thetas), len(self.betas)), np.nan)


@dataclass(frozen=True, eq=False)
class Part:
    """A part of a set that does not go through at once.

    Attributes:
        question: what is asked.
        anchor: of the set.
        rows: of the features.
        densities: the table of the log kernel sums.
        density_rows: of the same alternatives in it.
        sigma: the set's bandwidth.
    """

    question: Question
    anchor: str
    rows: tuple[Piece, ...]
    densities: TableFile
    density_rows: tuple[Piece, ...]
    sigma: float


def likelihoods(
    pool: Workers, question: Question, tables: TaskTables, partition: int, what: str
) -> Iterator[tuple[tuple[SetRows, ...], dict[str, FloatArray]]]:
    """The sets of each size and number, of all anchors, with (n, K, B) log likelihoods under each model.

    Args:
        pool: where they are computed.
        question: what is asked.
        tables: `features` and `densities`, checked.
        partition: rows of a set that go through at once.
        what: is computed, for the progress bar.

    Raises:
        StageError: a model needs the whole of a set that is larger than a partition, or the tables are in other orders.
    """
    file, sigmas = tables.for_jobs("densities"), bandwidths(tables)
    density_rows = {one.key: one for one in tables.contents("densities").sets}
    alike: dict[tuple[int, str], list[SetRows]] = {}
    for one in tables.contents("features").sets:
        alike.setdefault((one.set_size, one.set_id), []).append(one)
    sets = [tuple(some) for some in alike.values()]
    for large, some in groupby(sets, lambda same: max(one.rows for one in same) > partition):
        if not large:
            small = list(some)
            jobs = [(question, same, tuple(sigmas[one.key] for one in same)) for same in small]
            yield from zip(small, pool.mapped(set_likelihoods, jobs, what), strict=True)
            continue
        for same in some:
            _require_streamed(question.models, same[0], partition)
            parts = {
                one: _parts(question, one, file, density_rows[one.key], sigmas[one.key], PARTITIONS * partition)
                for one in same
                if question.of(one.anchor)
            }
            yield same, _streamed(pool, question, parts, what)


def bandwidths(tables: TaskTables) -> dict[SetKey, float]:
    """The bandwidth of each set of the table `densities`, which has been checked."""
    densities = tables["densities"]
    firsts = ((one.key, one.pieces[0]) for one in tables.contents("densities").sets)
    return {key: float(densities.part(piece.part, ["bandwidth"])["bandwidth"][piece.first]) for key, piece in firsts}


def set_likelihoods(job: tuple[Question, tuple[SetRows, ...], tuple[float, ...]]) -> dict[str, FloatArray]:
    """(n, K, B) under each model: each demonstration against the alternatives that share its anchor."""
    question, sets, sigmas = job
    found = {label: question.unknown() for label in question.models}
    for one, sigma in zip(sets, sigmas, strict=True):
        mine = question.of(one.anchor)
        if not mine:
            continue
        # row by row in memory, so that sums over features round as they always did
        alternatives = np.ascontiguousarray(question.features.read(one.pieces))
        phi = question.demonstrations[mine]
        for label, values in found.items():
            model = choice_model(label, sigma)
            values[mine] = log_likelihood(model, phi, alternatives, question.thetas, question.betas)
    return found


def _require_streamed(models: Sequence[str], one: SetRows, partition: int) -> None:
    for label in models:
        if label not in STREAMED_MODELS:
            raise StageError(
                f"infer.models lists {label}, which compares every alternative with all others, and the set "
                f"{one.set_id!r} of {one.rows:,} is larger than compute.partition ({partition:,}); leave that model "
                "out, or make the partition larger"
            )


def _parts(
    question: Question, one: SetRows, densities: TableFile, density_rows: SetRows, sigma: float, most: int
) -> list[Part]:
    """The parts of a set, of up to `most` rows."""
    ranges = [(first, first + count) for first, count in cut(one.rows, most)]
    return [
        Part(question, one.anchor, one.between(*some), densities, density_rows.between(*some), sigma) for some in ranges
    ]


def _streamed(
    pool: Workers, question: Question, parts: Mapping[SetRows, Sequence[Part]], what: str
) -> dict[str, FloatArray]:
    """(n, K, B) under each model, each set a fold over its parts."""
    found = {label: question.unknown() for label in question.models}
    for one, own in parts.items():
        sums = pool.merged(part_sums, own, _added, f"{what} {one.set_id}")
        mine = question.of(one.anchor)
        phi = question.demonstrations[mine]
        for label, values in found.items():
            values[mine] = sums[label].log_likelihood(phi, question.thetas, question.betas, phi.mean(axis=0))
    return found


def part_sums(part: Part) -> dict[str, JoinedSums]:
    """What a part of a set adds under each model."""
    question, features = part.question, part.question.features
    own = pl.concat(part.densities.table().pieces(part.density_rows, ["alternative_id", "log_density"]))
    ids = pl.concat(features.file.table().pieces(part.rows, ["id"]))
    if not own["alternative_id"].equals(ids["id"]):
        raise StageError(
            f"{part.densities.path}: its alternatives are not in the order of features.parquet; make it again with "
            "`dvc repro`"
        )
    phi = question.demonstrations[question.of(part.anchor)]
    alternatives = features.read(part.rows)
    weights = {LESS: own["log_density"].to_numpy(), BOLTZMANN: None}
    return {
        label: joined_sums(
            alternatives, phi, question.thetas, question.betas, phi.mean(axis=0), weights[label], part.sigma
        )
        for label in question.models
    }


def _added(one: Mapping[str, JoinedSums], other: Mapping[str, JoinedSums]) -> dict[str, JoinedSums]:
    return {label: one[label] + other[label] for label in one}
