"""Stage: the posterior over theta and beta under every model, for every set, each demonstration and all together.

The same log likelihoods score how well each model predicts a demonstration from the others. Sets of up to one partition
are computed whole, side by side; a larger set is a fold over its parts, see `pipeline.choice.streaming`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np
import polars as pl

from pipeline.arrays import FloatArray
from pipeline.choice import held_out_from, log_likelihood, posterior_from, theta_grid
from pipeline.choice.models import choice_model
from pipeline.choice.streaming import STREAMED_MODELS, JoinedSums, joined_sums
from pipeline.errors import StageError
from pipeline.formats.parquet.checked.open_table import Piece
from pipeline.formats.parquet.partitions import PART_ROWS, PARTITIONS, Scaled, SetRows, cut, gathered
from pipeline.formats.parquet.table_file import TableFile
from pipeline.formats.parquet.tables import table_writer, write_table
from pipeline.formats.parquet.task_tables import TaskTables
from pipeline.params import Infer, Task
from pipeline.stages.registry import parameters
from pipeline.vocabulary import ALL, BOLTZMANN, LESS, TASK_ANCHOR
from pipeline.workspace.compute.executor import Workers, workers
from pipeline.workspace.project import Project, recorded_run
from pipeline.workspace.provenance import provenance

INPUTS = ("demonstrations", "features", "scales", "densities")
Group = tuple[str, str, list[int]]  # demonstration_id, participant, rows of the demonstrations


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


def run(project: Project, name: str) -> None:
    """Write posteriors.parquet and held_out.parquet of the task `name`."""
    task, settings, partition = project.params.task(name), project.params.infer, project.params.compute.partition
    with (
        recorded_run(project, "infer", name) as record,
        TaskTables(project.tables(name, INPUTS)) as tables,
        workers(project) as pool,
    ):
        tables.check(whole=["demonstrations", "densities"])  # of which only some columns are used
        people = tables["demonstrations"].read(["demonstration_id", "participant"])
        question = _question(task, settings, people, tables)
        groups, thetas, betas = groups_of(people), question.thetas, question.betas
        stated = provenance(project, parameters("infer", name), tables.values())
        held_out = []
        with (
            table_writer(project.table(name, "posteriors"), "posteriors", stated) as writer,
            gathered(writer, PART_ROWS) as posteriors,
        ):
            for sets, found in _likelihoods(pool, question, tables, partition, f"infer {name}"):
                for label, values in found.items():
                    _check_complete(values, question.ids)
                    about = {"task": name, "model": label, "set_size": sets[0].set_size, "set_id": sets[0].set_id}
                    for rows in posterior_parts(groups, values, thetas, betas, about):
                        posteriors.add(rows)
                    held_out.append(_held_out(people, values, about))
        write_table(project.table(name, "held_out"), "held_out", pl.concat(held_out), stated)
        count = len(held_out) * len(groups)
        record.produced = f"{count:,} posteriors over {len(thetas)} thetas x {len(betas)} betas"


def hypotheses(task: Task, settings: Infer, features: Sequence[str]) -> np.ndarray:
    """The weight vectors (K, F) on scaled features: those the task lists, or the grid of cost directions.

    Args:
        task: whose hypotheses.
        settings: the values of the grid.
        features: names of the F features in the order of the tables.

    Raises:
        StageError: the task lists weight vectors, and its features are not those of the tables, in their order.
    """
    if task.thetas == "grid":
        return theta_grid([settings.theta_values] * len(features))
    if tuple(task.features) != tuple(features):
        raise StageError(
            f"the tables have the features {', '.join(features)} in this order and params.yaml has "
            f"{', '.join(task.features)}, which the task's thetas are weights of; make the tables again with "
            "`dvc repro --force featurize@TASK` and `dvc repro`"
        )
    return np.array(task.thetas, dtype=np.float64)


def _question(task: Task, settings: Infer, people: pl.DataFrame, tables: TaskTables) -> Question:
    scales, table = tables["scales"].read(), tables["features"]
    features = Scaled(tables.for_jobs("features"), tuple(scales["feature"]), scales["scale"].to_numpy())
    rows = pl.concat(table.pieces(tables.contents("features").others, ["id", *features.names]))
    rows = people.join(rows, left_on="demonstration_id", right_on="id", how="left", maintain_order="left")
    absent = rows.filter(pl.any_horizontal(pl.col(features.names).is_null()))["demonstration_id"]
    if len(absent):
        raise StageError(f"{table.path}: has the demonstration {absent[0]!r} in a set of alternatives; run `dvc repro`")
    phi = np.ascontiguousarray(rows.select(features.names).to_numpy() / features.scale)
    thetas, betas = hypotheses(task, settings, features.names), np.array(settings.betas)
    return Question(features, settings.models, tuple(people["demonstration_id"]), phi, thetas, betas)


def _likelihoods(
    pool: Workers, question: Question, tables: TaskTables, partition: int, what: str
) -> Iterator[tuple[tuple[SetRows, ...], dict[str, FloatArray]]]:
    """The sets of each size and number, of all anchors, with (n, K, B) log likelihoods under each model."""
    densities = tables["densities"]
    density_rows = {one.key: one for one in tables.contents("densities").sets}
    sigmas = {
        key: float(densities.part(one.pieces[0].part, ["bandwidth"])["bandwidth"][one.pieces[0].first])
        for key, one in density_rows.items()
    }
    alike: dict[tuple[int, str], list[SetRows]] = {}
    for one in tables.contents("features").sets:
        alike.setdefault((one.set_size, one.set_id), []).append(one)
    sets = [tuple(some) for some in alike.values()]
    for large, some in groupby(sets, lambda same: max(one.rows for one in same) > partition):
        if large:
            for same in some:
                parts = _Parts(question, tables.for_jobs("densities"), density_rows, sigmas, partition)
                yield same, _streamed(pool, parts, same, what)
        else:
            small = list(some)
            jobs = [(question, same, tuple(sigmas[one.key] for one in same)) for same in small]
            yield from zip(small, pool.mapped(set_likelihoods, jobs, what), strict=True)


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


@dataclass(frozen=True, eq=False)
class _Parts:
    """What the parts of all large sets have in common; attributes as in `Part`, those of a set by its key."""

    question: Question
    densities: TableFile
    density_rows: Mapping[tuple[str, int, str], SetRows]
    sigmas: Mapping[tuple[str, int, str], float]
    partition: int

    def of(self, one: SetRows) -> list[Part]:
        """The parts of a set."""
        ranges = [(first, first + count) for first, count in cut(one.rows, PARTITIONS * self.partition)]
        rows = self.density_rows[one.key]
        return [
            Part(
                self.question, one.anchor, one.between(*some), self.densities, rows.between(*some), self.sigmas[one.key]
            )
            for some in ranges
        ]


def _streamed(pool: Workers, parts: _Parts, sets: tuple[SetRows, ...], what: str) -> dict[str, FloatArray]:
    """(n, K, B) under each model, each set a fold over its parts."""
    question = parts.question
    whole = [label for label in question.models if label not in STREAMED_MODELS]
    if whole:
        raise StageError(
            f"infer.models lists {whole[0]}, which compares every alternative with all others, and the set "
            f"{sets[0].set_id!r} of {sets[0].rows:,} is larger than compute.partition ({parts.partition:,}); leave that model "
            "out, or make the partition larger"
        )
    found = {label: question.unknown() for label in question.models}
    for one in sets:
        mine = question.of(one.anchor)
        if not mine:
            continue
        sums = pool.merged(part_sums, parts.of(one), _added, f"{what} {one.set_id}")
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


def _check_complete(values: FloatArray, ids: Sequence[str]) -> None:
    missing = np.isnan(values).any(axis=(1, 2))
    if missing.any():
        raise StageError(
            f"demonstration {ids[int(missing.argmax())]!r} has no alternatives with its anchor; run `dvc repro`"
        )


def groups_of(people: pl.DataFrame) -> list[Group]:
    """Each demonstration, each participant with several, and all together."""
    rows: dict[str, list[int]] = {}
    singles: list[Group] = []
    for row, (demonstration_id, participant) in enumerate(people.iter_rows()):
        singles.append((demonstration_id, participant, [row]))
        rows.setdefault(participant, []).append(row)
    several = [(ALL, participant, of) for participant, of in rows.items() if 1 < len(of) < len(singles)]
    return [*singles, *several, (ALL, ALL, list(range(len(singles))))]


def posterior_parts(
    groups: Sequence[Group], values: FloatArray, thetas: FloatArray, betas: FloatArray, about: Mapping[str, object]
) -> Iterator[pl.DataFrame]:
    """Rows of posteriors.parquet for each group in turn, some groups at a time, so that few rows are in memory.

    Args:
        groups: from `groups_of`.
        values: (n, K, B) log likelihoods of the demonstrations.
        thetas, betas: the hypotheses.
        about: columns that are the same in all rows, with their value.
    """
    columns = [pl.lit(value).alias(column) for column, value in about.items()]
    for first, count in cut(len(groups), max(PART_ROWS // values[0].size, 1)):
        yield _posterior_rows(groups[first : first + count], values, thetas, betas).with_columns(columns)


def _posterior_rows(groups: Sequence[Group], values: FloatArray, thetas: FloatArray, betas: FloatArray) -> pl.DataFrame:
    log_posterior = np.stack(
        [posterior_from(values[of].sum(axis=0), thetas, betas).log_probability for _, _, of in groups]
    )
    n, k, b = log_posterior.shape
    of = np.repeat(np.arange(n), k * b)
    return pl.DataFrame(
        {
            "demonstration_id": pl.Series([group[0] for group in groups]).gather(of),
            "participant": pl.Series([group[1] for group in groups]).gather(of),
            "theta_id": np.tile(np.repeat(np.arange(k), b), n),
            "theta": np.tile(np.repeat(thetas, b, axis=0), (n, 1)),
            "beta": np.tile(betas, n * k),
            "log_posterior": log_posterior.ravel(),
            "posterior": np.exp(log_posterior).ravel(),
        }
    )


def _held_out(people: pl.DataFrame, values: FloatArray, about: Mapping[str, object]) -> pl.DataFrame:
    """One row per demonstration; none of fewer than two, as there are no others to predict it from."""
    rows = people.with_columns(pl.lit(value).alias(column) for column, value in about.items())
    if people.height < 2:
        return rows.clear().with_columns(log_predictive=pl.lit(None, pl.Float64))
    return rows.with_columns(log_predictive=pl.Series(held_out_from(values).log_predictive))
