"""Stage: the posterior over theta and beta under every model, for every set, each demonstration and all together.

The same log likelihoods score how well each model predicts a demonstration from the others. Beside that, where people
stand among the alternatives, since a posterior from people whom no alternative resembles is a guess.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import polars as pl

from pipeline.arrays import FloatArray
from pipeline.choice import posterior_from
from pipeline.errors import StageError
from pipeline.formats.parquet.partitions import Scaled, gathered
from pipeline.formats.parquet.tables import table_writer, write_table
from pipeline.formats.parquet.task_tables import TaskTables
from pipeline.params import Infer, Task
from pipeline.stages.registry import parameters
from pipeline.studies.posteriors import PART_ROWS, fit_rows, groups_of, held_out_rows, hypotheses, posterior_parts
from pipeline.studies.support import at_edge, beyond, chance_notes, support_rows
from pipeline.vocabulary import WORKING, model_name
from pipeline.workspace.compute.executor import Workers, workers
from pipeline.workspace.compute.likelihoods import Question, likelihoods
from pipeline.workspace.project import Project, recorded_run
from pipeline.workspace.provenance import provenance

INPUTS = ("demonstrations", "features", "scales", "densities")


def run(project: Project, name: str) -> None:
    """Write posteriors.parquet, held_out.parquet, support.parquet and fits.parquet of the task `name`."""
    task, settings, partition = project.params.task(name), project.params.infer, project.params.compute.partition
    with (
        recorded_run(project, "infer", name) as record,
        TaskTables(project.tables(name, INPUTS)) as tables,
        workers() as pool,
    ):
        tables.check(whole=["demonstrations", "densities"])  # of which only some columns are used
        people = tables["demonstrations"].read(["demonstration_id", "participant"])
        question = _question(task, settings, people, tables)
        groups, thetas, betas = groups_of(people), question.thetas, question.betas
        stated = provenance(project, parameters("infer", name), tables.values())
        held_out, fits = [], []
        by_chance = _by_chance(pool, question, tables, partition, f"infer {name}: chance")
        with (
            table_writer(project.table(name, "posteriors"), "posteriors", stated) as writer,
            gathered(writer, PART_ROWS) as posteriors,
        ):
            for sets, found in likelihoods(pool, question, tables, partition, f"infer {name}"):
                for label, likely in found.items():
                    _check_complete(likely, question.ids)
                    about = {"task": name, "model": label, "set_size": sets[0].set_size, "set_id": sets[0].set_id}
                    for rows in posterior_parts(groups, likely, thetas, betas, about):
                        posteriors.add(rows)
                    held_out.append(held_out_rows(people, likely, about))
                    if sets[0].set_id == WORKING:
                        together = posterior_from(likely.sum(axis=0), thetas, betas).log_probability
                        edge = at_edge(np.exp(together).sum(axis=0), settings.betas, model_name(label))
                        record.notes += [edge] if edge else []
                        fits.append(fit_rows(groups, likely, by_chance[label], thetas, about))
        write_table(project.table(name, "held_out"), "held_out", pl.concat(held_out), stated)
        fitted = pl.concat(fits).drop("set_size", "set_id")
        write_table(project.table(name, "fits"), "fits", fitted, stated)
        record.notes += chance_notes(fitted)
        support = _support(people, question, tables)
        write_table(project.table(name, "support"), "support", support, stated)
        record.notes += beyond(support)
        count = len(held_out) * len(groups)
        record.produced = f"{count:,} posteriors over {len(thetas)} thetas x {len(betas)} betas"


def _question(task: Task, settings: Infer, people: pl.DataFrame, tables: TaskTables) -> Question:
    scales = tables["scales"].read()
    features = Scaled(tables.for_jobs("features"), tuple(scales["feature"]), scales["scale"].to_numpy())
    phi = np.ascontiguousarray(_values(people, features.names, tables) / features.scale)
    thetas, betas = hypotheses(task, settings, features.names, tuple(scales["direction"])), np.array(settings.betas)
    return Question(features, settings.models, tuple(people["demonstration_id"]), phi, thetas, betas)


def _by_chance(
    pool: Workers, question: Question, tables: TaskTables, partition: int, label: str
) -> dict[str, FloatArray]:
    """(n,) log likelihoods of the demonstrations under theta = 0, by model, for the working set."""
    indifferent = replace(question, thetas=np.zeros((1, question.thetas.shape[1])), betas=np.ones(1))
    ((_, found),) = likelihoods(pool, indifferent, tables, partition, label, set_id=WORKING)
    return {model: values[:, 0, 0] for model, values in found.items()}


def _values(people: pl.DataFrame, features: Sequence[str], tables: TaskTables) -> FloatArray:
    """Features (n, F) of the demonstrations, not scaled."""
    table = tables["features"]
    rows = pl.concat(table.pieces(tables.contents("features").others, ["id", *features]))
    rows = people.join(rows, left_on="demonstration_id", right_on="id", how="left", maintain_order="left")
    absent = rows.filter(pl.any_horizontal(pl.col(features).is_null()))["demonstration_id"]
    if len(absent):
        raise StageError(f"{table.path}: has the demonstration {absent[0]!r} in a set of alternatives; run `dvc repro`")
    return rows.select(features).to_numpy()


def _support(people: pl.DataFrame, question: Question, tables: TaskTables) -> pl.DataFrame:
    names = question.features.names
    alternatives = dict[str, FloatArray]()
    for one in tables.contents("features").sets:
        if one.set_id == WORKING:
            rows = tables["features"].numbers(one.pieces, names)
            alternatives |= {question.ids[row]: rows for row in question.rows_with(one.anchor)}
    compared = [alternatives[key] for key in question.ids]
    return support_rows(people, _values(people, names, tables), compared, names)


def _check_complete(values: FloatArray, ids: Sequence[str]) -> None:
    missing = np.isnan(values).any(axis=(1, 2))
    if missing.any():
        raise StageError(
            f"demonstration {ids[int(missing.argmax())]!r} has no alternatives with its anchor; run `dvc repro`"
        )
