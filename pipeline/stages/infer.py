"""Stage: the posterior over theta and beta under every model, for every set, each demonstration and all together.

The same log likelihoods score how well each model predicts a demonstration from the others. Sets of up to one partition
are computed whole, side by side; a larger set is a fold over its parts, see `pipeline.choice.streaming`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

import numpy as np
import polars as pl

from pipeline.arrays import FloatArray
from pipeline.choice import held_out_from, log_likelihood, posterior_from, theta_grid
from pipeline.choice.models import choice_model
from pipeline.choice.streaming import STREAMED_MODELS, JoinedSums, joined_sums
from pipeline.errors import StageError
from pipeline.formats.parquet.foreign_keys import check_references, check_table
from pipeline.formats.parquet.partitions import PARTITIONS, Contents, Piece, Scaled, SetRows, contents, cut, read_pieces
from pipeline.formats.parquet.tables import GROUPS, part_rows, read_part, read_table, write_table
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
        densities: file of the log kernel sums.
        density_rows: of the same alternatives in it.
        sigma: the set's bandwidth.
    """

    question: Question
    anchor: str
    rows: tuple[Piece, ...]
    densities: Path
    density_rows: tuple[Piece, ...]
    sigma: float


def run(project: Project, name: str) -> None:
    """Write posteriors.parquet and held_out.parquet of the task `name`."""
    task, settings, partition = project.params.task(name), project.params.infer, project.params.compute.partition
    with recorded_run(project, "infer", name) as record, workers(project) as pool:
        sources = [project.table(name, table) for table in INPUTS]
        check_table(sources[3], "densities")  # of which only some columns are used
        check_references(dict(zip(INPUTS, sources, strict=True)))
        people = read_table(sources[0], "demonstrations", ["demonstration_id", "participant"])
        there = contents(sources[1], "features")
        question = _question(task, settings, people, there, sources[1], read_table(sources[2], "scales"))
        groups, thetas, betas = groups_of(people), question.thetas, question.betas
        posteriors, held_out = [], []
        for sets, found in _likelihoods(pool, question, there, sources[3], partition, f"infer {name}"):
            for label, values in found.items():
                _check_complete(values, question.ids)
                about = {"task": name, "model": label, "set_size": sets[0].set_size, "set_id": sets[0].set_id}
                columns = [pl.lit(value).alias(column) for column, value in about.items()]
                posteriors.append(posterior_rows(groups, values, thetas, betas).with_columns(columns))
                held_out.append(_held_out(people, values).with_columns(columns))
        stated = provenance(project, parameters("infer", name), sources)
        write_table(project.table(name, "posteriors"), "posteriors", pl.concat(posteriors), stated)
        write_table(project.table(name, "held_out"), "held_out", pl.concat(held_out), stated)
        count = len(posteriors) * len(groups)
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


def _question(
    task: Task, settings: Infer, people: pl.DataFrame, there: Contents, path: Path, scales: pl.DataFrame
) -> Question:
    features = Scaled(path, tuple(scales["feature"]), scales["scale"].to_numpy())
    rows = read_pieces(path, "features", there.others, ["id", *features.names])
    rows = people.join(rows, left_on="demonstration_id", right_on="id", how="left", maintain_order="left")
    if rows.select(features.names).null_count().sum_horizontal().item():
        absent = rows.filter(pl.any_horizontal(pl.col(features.names).is_null()))["demonstration_id"][0]
        raise StageError(f"{path}: lacks the demonstration {absent!r} that demonstrations.parquet has; run `dvc repro`")
    phi = np.ascontiguousarray(rows.select(features.names).to_numpy() / features.scale)
    thetas, betas = hypotheses(task, settings, features.names), np.array(settings.betas)
    return Question(features, settings.models, tuple(people["demonstration_id"]), phi, thetas, betas)


def _likelihoods(
    pool: Workers, question: Question, there: Contents, densities: Path, partition: int, what: str
) -> Iterator[tuple[tuple[SetRows, ...], dict[str, FloatArray]]]:
    """The sets of each size and number, of all anchors, with (n, K, B) log likelihoods under each model."""
    known, sigmas = {one.key: one for one in contents(densities, "densities").sets}, _bandwidths(densities)
    alike: dict[tuple[int, str], list[SetRows]] = {}
    for one in there.sets:
        alike.setdefault((one.set_size, one.set_id), []).append(one)
    sets = [tuple(some) for some in alike.values()]
    for large, some in groupby(sets, lambda same: max(one.rows for one in same) > partition):
        if large:
            for same in some:
                yield same, _streamed(pool, question, same, densities, known, sigmas, partition, what)
        else:
            small = list(some)
            jobs = [(question, same, tuple(sigmas[one.key] for one in same)) for same in small]
            yield from zip(small, pool.mapped(set_likelihoods, jobs, what), strict=True)


def _bandwidths(path: Path) -> dict[tuple[str, int, str], float]:
    """The bandwidth of each set."""
    found: dict[tuple[str, int, str], float] = {}
    for number in range(len(part_rows(path, "densities"))):
        part = read_part(path, "densities", number, [*GROUPS, "bandwidth"]).unique(GROUPS, maintain_order=True)
        found |= {(anchor, size, set_id): sigma for anchor, size, set_id, sigma in part.iter_rows()}
    return found


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


def _streamed(
    pool: Workers, question: Question, sets: tuple[SetRows, ...], densities: Path,
    known: Mapping[tuple[str, int, str], SetRows], sigmas: Mapping[tuple[str, int, str], float], partition: int, what: str,
) -> dict[str, FloatArray]:  # fmt: skip
    """(n, K, B) under each model, each set a fold over its parts."""
    whole = [label for label in question.models if label not in STREAMED_MODELS]
    if whole:
        raise StageError(
            f"infer.models lists {whole[0]}, which compares every alternative with all others, and the set "
            f"{sets[0].set_id!r} of {sets[0].rows:,} is larger than compute.partition ({partition:,}); leave that model out, "
            "or make the partition larger"
        )
    found = {label: question.unknown() for label in question.models}
    for one in sets:
        mine = question.of(one.anchor)
        if not mine:
            continue
        ranges = [(first, first + count) for first, count in cut(one.rows, PARTITIONS * partition)]
        jobs = [
            Part(question, one.anchor, one.between(*rows), densities, known[one.key].between(*rows), sigmas[one.key])
            for rows in ranges
        ]
        sums = pool.merged(part_sums, jobs, _added, f"{what} {one.set_id}")
        phi = question.demonstrations[mine]
        for label, values in found.items():
            values[mine] = sums[label].log_likelihood(phi, question.thetas, question.betas, phi.mean(axis=0))
    return found


def part_sums(part: Part) -> dict[str, JoinedSums]:
    """What a part of a set adds under each model."""
    question = part.question
    own = read_pieces(part.densities, "densities", part.density_rows, ["alternative_id", "log_density"])
    rows = read_pieces(question.features.path, "features", part.rows, ["id", *question.features.names])
    if not own["alternative_id"].equals(rows["id"]):
        raise StageError(
            f"{part.densities}: its alternatives are not in the order of features.parquet; make it again with `dvc repro`"
        )
    phi = question.demonstrations[question.of(part.anchor)]
    alternatives = rows.select(question.features.names).to_numpy() / question.features.scale
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


def posterior_rows(groups: Sequence[Group], values: FloatArray, thetas: FloatArray, betas: FloatArray) -> pl.DataFrame:
    """Rows of posteriors.parquet for each group, from (n, K, B) log likelihoods of the demonstrations."""
    log_posterior = np.stack(
        [posterior_from(values[of].sum(axis=0), thetas, betas).log_probability for _, _, of in groups]
    )
    n, k, b = log_posterior.shape
    return pl.DataFrame(
        {
            "demonstration_id": np.repeat([group[0] for group in groups], k * b),
            "participant": np.repeat([group[1] for group in groups], k * b),
            "theta_id": np.tile(np.repeat(np.arange(k), b), n),
            "theta": np.tile(np.repeat(thetas, b, axis=0), (n, 1)),
            "beta": np.tile(betas, n * k),
            "log_posterior": log_posterior.ravel(),
            "posterior": np.exp(log_posterior).ravel(),
        }
    )


def _held_out(people: pl.DataFrame, values: FloatArray) -> pl.DataFrame:
    """One row per demonstration; none of fewer than two, as there are no others to predict it from."""
    if people.height < 2:
        return people.clear().with_columns(log_predictive=pl.lit(None, pl.Float64))
    return people.with_columns(log_predictive=pl.Series(held_out_from(values).log_predictive))
