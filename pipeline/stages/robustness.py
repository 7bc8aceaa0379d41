"""Stage: how far the posteriors of a task depend on the alternatives that were sampled, and on the choices made."""

from __future__ import annotations

from functools import partial

import numpy as np
import polars as pl

from pipeline.arrays import FloatArray
from pipeline.choice.scaling import feature_scale
from pipeline.errors import StageError
from pipeline.formats.parquet.tables import table_writer
from pipeline.formats.parquet.task_tables import TaskTables
from pipeline.params import Task
from pipeline.replay.features import FeatureSet, bind_features
from pipeline.replay.scene import model_hash, scene_files
from pipeline.stages.registry import parameters
from pipeline.studies.posteriors import PART_ROWS, hypotheses
from pipeline.studies.robustness.duplicates import inject_duplicates
from pipeline.studies.robustness.problem import ChoiceSets, Problem
from pipeline.studies.robustness.samplings import COMPARED, RobustnessResult, compare_samplings
from pipeline.studies.robustness.sensitivity import vary_choices
from pipeline.studies.robustness.tests import ANOVA, POST_HOC, analyse_regime, summarise
from pipeline.trajectories.random_streams import child_rng
from pipeline.vocabulary import INDEPENDENT, KNOWN_DENSITY, SAMPLER_SHIFT, WORKING
from pipeline.workspace.anchors import anchor_keys
from pipeline.workspace.choice_sets import demonstrations_of
from pipeline.workspace.progress import tracked
from pipeline.workspace.project import Project, Run, recorded_run
from pipeline.workspace.provenance import provenance
from pipeline.workspace.scenes import load_task_scene
from pipeline.workspace.trust import register_task_kinds

INPUTS = ("demonstrations", "features", "scales", "shifted_alternatives")
PEOPLE = ("demonstration_id", "participant", "true_theta")
SCALES = ("range", "std", "none")
POSTERIORS = "robustness_posteriors"  # has many rows where there are many hypotheses, in the order of its key


def run(project: Project, name: str) -> None:
    """Write the tables of the robustness study of the task `name`."""
    task = project.params.task(name)
    with recorded_run(project, "robustness", name) as record, TaskTables(project.tables(name, INPUTS)) as sources:
        sources.check(whole=["demonstrations"])  # of which only some columns are used
        own_kinds = register_task_kinds(project, task)
        scene = load_task_scene(project, task)
        order = sources["scales"].read()["feature"].to_list()
        if set(order) != set(task.features):
            raise StageError(
                f"{sources['scales'].path}: has features other than tasks.{name}.features; run `dvc repro`"
            )
        features = bind_features(scene, {feature: task.features[feature] for feature in order})
        tables = _tables(project, name, task, features, sources, record)
        stated = provenance(
            project,
            parameters("robustness", name),
            [*sources.values(), *scene_files(scene.path), *own_kinds],
            model=model_hash(scene),
        )
        for table, rows in tables.items():
            with table_writer(project.table(name, table), table, stated) as writer:
                for part in rows.iter_slices(PART_ROWS) if table == POSTERIORS else [rows]:
                    writer.write(part)


def _tables(
    project: Project, name: str, task: Task, features: FeatureSet, sources: TaskTables, record: Run
) -> dict[str, pl.DataFrame]:
    settings, bandwidth = project.params.robustness, project.params.density.bandwidth
    is_alternative = pl.col("kind") == "alternative"
    own = sources["features"].read(where=~is_alternative | (pl.col("set_id") != WORKING))
    alternatives = own.filter(is_alternative).rename({"id": "alternative_id"})
    shifted = _featurized(sources["shifted_alternatives"].read(), features)
    _require_sets(alternatives, settings.duplicates.set_size)
    scales = sources["scales"].read()
    scale = scales["scale"].to_numpy()
    people = sources["demonstrations"].read([*PEOPLE, "waypoints"])
    problem = Problem(
        demonstrations_of(sources)[0],
        {
            INDEPENDENT: _choice_sets(alternatives, features.names, scale),
            SAMPLER_SHIFT: _choice_sets(shifted, features.names, scale),
        },
        hypotheses(task, project.params.infer, features.names, features.directions),
        np.array(project.params.infer.betas),
    )
    watched = [
        partial(tracked, what=f"robustness {name}: {part}") for part in ("posteriors", "other choices", "copies")
    ]
    result = compare_samplings(problem, bandwidth, watched[0])
    pool = sources["features"].read(features.names, where=is_alternative).to_numpy()
    used = scales["method"][0]
    shown = own.filter(kind="demonstration").select(features.names).to_numpy()
    ratios = {method: scale / feature_scale(pool, method, features.names, shown) for method in SCALES if method != used}
    sensitivity = vary_choices(problem, result, bandwidth, settings.bandwidth_factors, ratios, used, watched[1])
    keys = anchor_keys(features.scene, task, people)
    duplicates = inject_duplicates(
        problem,
        tuple(sets for sets in problem.regimes[INDEPENDENT] if sets.set_size == settings.duplicates.set_size),
        settings.duplicates,
        bandwidth,
        lambda set_id, anchor: child_rng(project.params.seed, "duplicates", keys[anchor], set_id),
        watched[2],
    )
    record.produced = f"{result.posteriors.height // len(problem.thetas):,} posteriors over theta compared"
    return {
        "shifted_features": shifted.drop("log_proposal"),
        "robustness": result.robustness,
        POSTERIORS: result.posteriors,
        "robustness_sets": result.sets,
        "robustness_summary": summarise(result.robustness, ["regime", "model", "set_size"], "kl_aggregate"),
        **_statistics(result, record),
        "sensitivity": sensitivity,
        "sensitivity_summary": summarise(
            sensitivity, ["regime", "choice", "setting", "is_default", "model", "set_size"], "kl_aggregate"
        ),
        "duplicates": duplicates,
        "duplicates_summary": summarise(duplicates, ["model", "copies", "spread"], "kl_from_clean"),
    }


def _statistics(result: RobustnessResult, record: Run) -> dict[str, pl.DataFrame]:
    found = [
        analyse_regime(result.robustness.filter(pl.col("model").is_in(COMPARED)), regime)
        for regime in (INDEPENDENT, SAMPLER_SHIFT, KNOWN_DENSITY)
        if regime in result.robustness["regime"]
    ]
    effects = [tests[0] for tests in found if tests is not None]
    pairs = [tests[1] for tests in found if tests is not None]
    if len(effects) < len(found):
        record.notes.append("too few participants, or no difference between them, for an analysis of variance")
    return {
        "robustness_anova": pl.concat([pl.DataFrame(schema=ANOVA), *effects]),
        "robustness_post_hoc": pl.concat([pl.DataFrame(schema=POST_HOC), *pairs]),
    }


def _featurized(alternatives: pl.DataFrame, features: FeatureSet) -> pl.DataFrame:
    values = features.evaluate(alternatives["waypoints"].to_numpy().astype(np.float64))
    return alternatives.drop("waypoints", "sampler").with_columns(
        pl.Series(name, values[:, f]) for f, name in enumerate(features.names)
    )


def _choice_sets(table: pl.DataFrame, names: tuple[str, ...], scale: FloatArray) -> tuple[ChoiceSets, ...]:
    found = []
    for rows in table.partition_by("set_size", "set_id", maintain_order=True):
        anchors = {part["anchor"][0]: part for part in rows.partition_by("anchor", maintain_order=True)}
        known = "log_proposal" in rows.columns and rows["log_proposal"].null_count() == 0
        found.append(
            ChoiceSets(
                rows["set_size"][0],
                rows["set_id"][0],
                {anchor: part.select(names).to_numpy() / scale for anchor, part in anchors.items()},
                {anchor: part["log_proposal"].to_numpy() for anchor, part in anchors.items()} if known else {},
            )
        )
    return tuple(found)


def _require_sets(alternatives: pl.DataFrame, size: int) -> None:
    counts = dict(alternatives.group_by("set_size").agg(pl.col("set_id").n_unique()).iter_rows())
    if min(counts.values(), default=0) < 2:
        raise StageError(
            "the study compares sets of one size, and there are not two; give sample.sizes and set sample.sets to 2 or "
            "more"
        )
    if size not in counts:
        raise StageError(
            f"robustness.duplicates.set_size is {size}; it must be one of sample.sizes, "
            f"{', '.join(map(str, sorted(counts)))}"
        )
