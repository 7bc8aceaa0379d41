"""Stage: sets from samplers, sets with planned paths and explorations side by side, and how right each is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import polars as pl

from pipeline.arrays import FloatArray, IntArray
from pipeline.choice.explored import Region
from pipeline.choice.logspace import log_sum_exp
from pipeline.errors import StageError
from pipeline.formats.parquet.tables import write_table
from pipeline.formats.parquet.task_tables import TaskTables
from pipeline.params import Regimes
from pipeline.replay.scene import model_hash, scene_files
from pipeline.stages.explore import left_out, plan_of, read_inputs
from pipeline.stages.registry import parameters, stage
from pipeline.studies.robustness.problem import (
    ChoiceSets,
    Demonstrations,
    Problem,
    boltzmann_score,
    less_score,
    log_likelihoods,
    log_posteriors,
    select_bandwidths,
    theta_marginals,
)
from pipeline.studies.robustness.redraws import density_likelihood, explored_scores, held_out_leads
from pipeline.studies.robustness.regimes import (
    MOST_THETAS,
    judged_by_set,
    judged_by_space,
    measured,
    pooled_recovery,
    recovered,
    simulate_people,
    summarised,
    with_costs,
)
from pipeline.trajectories.exploration.archive import spread
from pipeline.trajectories.optimise import Search, optimise_paths
from pipeline.trajectories.random_streams import child_rng
from pipeline.vocabulary import (
    BOLTZMANN,
    EXPLORED_SPACE,
    INDEPENDENT,
    LESS,
    SAMPLER_SHIFT,
    TASK_ANCHOR,
    WITH_OPTIMA,
    WORKING,
)
from pipeline.workspace.choice_sets import demonstrations_of
from pipeline.workspace.compute.executor import Workers, workers
from pipeline.workspace.compute.exploration import Declared, Explored, Plan, explored
from pipeline.workspace.project import Project, recorded_run
from pipeline.workspace.provenance import provenance
from pipeline.workspace.scenes import load_task_scene
from pipeline.workspace.trust import register_task_kinds

MODELS = (BOLTZMANN, LESS)
SEARCH = Search()


@dataclass(frozen=True, eq=False)
class Planned:
    """What a worker needs to plan the paths that one sampler's sets get.

    Attributes:
        declared: the choice space, whose scene and limits the paths keep to.
        thetas: (K, F) what paths are planned for.
        optima: paths for each.
        label: the sampler.
        seed: of the random numbers.
    """

    declared: Declared
    thetas: FloatArray
    optima: int
    label: str
    seed: int


def planned_features(job: Planned) -> FloatArray:
    """(K optima, F) scaled features of paths that are best for each theta, as far as a short search finds."""
    space = job.declared.space()
    weights = -np.repeat(job.thetas, job.optima, axis=0)
    streams = [
        child_rng(job.seed, "optima", job.declared.ends.key, job.label, number) for number in range(len(weights))
    ]
    found = optimise_paths(
        streams, space.anchor, weights, space.assess, lower=space.lower, upper=space.upper,
        n_waypoints=space.n_waypoints, search=SEARCH,
    )  # fmt: skip
    return space.assess(found.waypoints)[0]


@dataclass(frozen=True, eq=False)
class Judged:
    """What a worker needs to let simulated people be judged by one set or exploration under one model.

    Attributes:
        regime, model, set_size: what judges; the size is 0 for an exploration.
        alternatives: (N, F) of the set, or of the rows that an exploration covered.
        log_w: (N,) weights of an exploration's rows; None for a set.
        source: what people choose from, another exploration.
        thetas, betas: the hypotheses.
        which: numbers of the thetas that people have.
        bandwidth: how LESS selects it.
        settings: how many people and choices.
        seed, stream: of the random numbers.
    """

    regime: str
    model: str
    set_size: int
    alternatives: FloatArray
    log_w: FloatArray | None
    source: Region
    thetas: FloatArray
    betas: FloatArray
    which: IntArray
    bandwidth: str | float
    settings: Regimes
    seed: int
    stream: tuple[str | int, ...]


def judge(job: Judged) -> pl.DataFrame:
    """How well simulated people are told: rows of `recovered`, with regime, model and set size."""
    rng = child_rng(job.seed, *job.stream)
    people = simulate_people(
        rng, job.source.features, job.source.log_w, job.thetas, job.betas, job.which, job.settings.repetitions,
        job.settings.choices,
    )  # fmt: skip
    if job.log_w is None:
        values = judged_by_set(job.model, people, job.alternatives, job.bandwidth, job.thetas, job.betas)
    else:
        values = judged_by_space(people, job.alternatives, job.log_w, job.thetas, job.betas)
    return recovered(rng, people, values, job.thetas).select(
        pl.lit(job.regime).alias("regime"),
        pl.lit(job.model).alias("model"),
        pl.lit(job.set_size, pl.Int64).alias("set_size"),
        pl.all(),
    )


def run(project: Project, name: str) -> None:
    """Write the tables of the regimes of the task `name`.

    Raises:
        StageError: the choice space of the task cannot be explored, or a table does not fit the others.
    """
    task, settings = project.params.task(name), project.params.robustness.regimes
    with (
        recorded_run(project, "regimes", name) as record,
        TaskTables(project.tables(name, stage("regimes").reads)) as tables,
        workers() as pool,
    ):
        own_kinds = register_task_kinds(project, task)
        scene = load_task_scene(project, task)
        tables.check()
        given = read_inputs(project, name, scene, tables)
        reason = left_out(task, project.params.explore)
        if reason is not None:
            raise StageError(f"{name}: regimes are compared over a choice space that can be explored, and {reason}")
        stated = provenance(
            project, parameters("regimes", name), [*tables.values(), *scene_files(scene.path), *own_kinds],
            model=model_hash(scene),
        )  # fmt: skip
        people, scales, names = demonstrations_of(tables)
        sets = _sets(tables, names, scales["scale"].to_numpy())
        problem = Problem(people, sets, given.asked.thetas, given.asked.betas)
        labels = sorted({one.set_id for one in sets[SAMPLER_SHIFT]})
        plan = plan_of(project, task, given, _seeds(tables, labels))
        everyone = list(range(len(people.ids)))
        plan = replace(plan, groups=[*([row] for row in everyone), everyone])
        jobs = [Planned(plan.declared, problem.thetas, settings.optima, label, plan.seed) for label in labels]
        optima = dict(zip(labels, pool.mapped(planned_features, jobs, f"regimes {name}: planned paths"), strict=True))
        sets[WITH_OPTIMA] = tuple(_joined(one, optima[one.set_id]) for one in sets[SAMPLER_SHIFT])
        found = explored(pool, plan, f"regimes {name}")
        cost = len(problem.thetas) * settings.optima * SEARCH.population * SEARCH.iterations
        parts = [
            _given(tables, len(problem.thetas)),
            *_with_optima(problem, project.params.density.bandwidth, cost),
            *_explored(problem, found),
        ]
        rows = pl.concat(parts)
        calibration = _calibrated(pool, problem, found, project, name)
        made = {
            "regimes": rows.drop("kl_aggregate", "kl_low", "kl_high"),
            "regimes_summary": summarised(rows),
            "regimes_calibration": calibration,
            "regimes_held_out": _held_out(people, plan, found),
        }
        for table, content in made.items():
            write_table(project.table(name, table), table, content, stated)
        record.produced = f"{len(labels)} samplers and as many explorations compared"


def _sets(tables: TaskTables, names: Sequence[str], scale: FloatArray) -> dict[str, tuple[ChoiceSets, ...]]:
    """Scaled features of the sets of one sampler and of different samplers."""
    is_set = (pl.col("kind") == "alternative") & (pl.col("set_id") != WORKING)
    columns = ["set_size", "set_id", *names]
    found = {}
    for regime, rows in (
        (INDEPENDENT, tables["features"].read(columns, where=is_set)),
        (SAMPLER_SHIFT, tables["shifted_features"].read(columns)),
    ):
        parts = rows.partition_by("set_size", "set_id", maintain_order=True)
        found[regime] = tuple(
            ChoiceSets(part["set_size"][0], part["set_id"][0], {TASK_ANCHOR: part.select(names).to_numpy() / scale}, {})
            for part in parts
        )
    return found


def _seeds(tables: TaskTables, labels: Sequence[str]) -> list[FloatArray]:
    """For each sampler the trajectories of its largest set, from which one exploration begins."""
    rows = tables["shifted_alternatives"].read(["set_size", "set_id", "waypoints"])
    largest = rows.filter(pl.col("set_size") == rows["set_size"].max())
    return [largest.filter(set_id=label)["waypoints"].to_numpy().astype(np.float64) for label in labels]


def _joined(sets: ChoiceSets, optima: FloatArray) -> ChoiceSets:
    features = {anchor: np.concatenate([phi, optima]) for anchor, phi in sets.features.items()}
    return ChoiceSets(sets.set_size, sets.set_id, features, {})


def _given(tables: TaskTables, thetas: int) -> pl.DataFrame:
    """Rows of the robustness study, which are about sets from samplers."""
    return with_costs(tables["robustness"].read(), thetas, pl.col("set_size"))


def _with_optima(problem: Problem, bandwidth: str | float, cost: int) -> list[pl.DataFrame]:
    found = []
    selected = select_bandwidths(problem.regimes[WITH_OPTIMA], bandwidth)
    scores = {BOLTZMANN: boltzmann_score(problem), LESS: less_score(problem, selected.__getitem__)}
    for size, samplings in problem.by_size(WITH_OPTIMA):
        for model, score in scores.items():
            marginals = theta_marginals(log_posteriors(log_likelihoods(problem, samplings, score)))
            found.append(measured(problem, marginals, WITH_OPTIMA, model, size, size + cost))
    return found


def _explored(problem: Problem, found: Explored) -> list[pl.DataFrame]:
    return [
        measured(
            problem, log_sum_exp(one.posteriors[-1], axis=3), EXPLORED_SPACE, model, 0,
            sum(of.costs[-1].evaluations for of in found.models.values()),
        )
        for model, one in sorted(found.models.items())
    ]  # fmt: skip


def _calibrated(pool: Workers, problem: Problem, found: Explored, project: Project, name: str) -> pl.DataFrame:
    """Simulated people judged by every set and exploration, under the model that they choose by."""
    params, thetas = project.params, problem.thetas
    chosen = spread(thetas, MOST_THETAS)
    which = np.array([int(((thetas - theta) ** 2).sum(axis=1).argmin()) for theta in chosen])
    which.sort()

    def job(model: str, regime: str, size: int, number: int, rows: FloatArray, log_w: FloatArray | None) -> Judged:
        sources = found.models[model].rows
        return Judged(
            regime, model, size, rows, log_w, sources[(number + 1) % len(sources)], thetas, problem.betas, which,
            params.density.bandwidth, params.robustness.regimes, params.seed,
            ("regimes", name, model, number),
        )  # fmt: skip

    jobs = [
        job(model, regime, size, number, sets.features[TASK_ANCHOR], None)
        for model in MODELS
        for regime in problem.regimes
        for size, samplings in problem.by_size(regime)
        for number, sets in enumerate(samplings)
    ] + [
        job(model, EXPLORED_SPACE, 0, number, one.features, one.log_w)
        for model in MODELS
        for number, one in enumerate(found.models[model].rows)
    ]
    return pooled_recovery(list(pool.mapped(judge, jobs, f"regimes {name}: simulated people")))


def _held_out(people: Demonstrations, plan: Plan, found: Explored) -> pl.DataFrame:
    """The lead of each model in held-out score over explorations and people, as densities of the scaled features."""
    asked = plan.asked
    likelihoods = {
        model: [
            density_likelihood(
                model, people.features, one.features, one.log_w, plan.cell, asked.thetas, asked.betas
            )
            for one in found.models[model].rows
        ]
        for model in MODELS
    }  # fmt: skip
    return held_out_leads(explored_scores(people, likelihoods, asked.betas))
