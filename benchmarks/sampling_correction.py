"""What a correction for who sampled can do: `python -m benchmarks.sampling_correction TASK`.

McFadden's correction weighs each alternative by one over the density with which it was drawn. Here the target is the
base measure of the choice space, so a weight is mu(z) / q(z), and the chosen trajectory has its own. Every sampler of
`robustness.samplers` draws 1,000 trajectories of the space, with the jitter that gives it a density everywhere
(pipeline/trajectories/sampler_density.py). Kish's effective size says how many of them still count; the last columns
compare the corrected posteriors of ten samplers with one another and with those over the explored base measure.
--project is a folder in which `dvc repro` has run.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from benchmarks.exploration_settings import Case, answers, case
from benchmarks.measuring import show
from pipeline.arrays import FloatArray
from pipeline.choice.convergence import TEN, disagreement
from pipeline.choice.explored import region_log_likelihood, sampling_corrected
from pipeline.choice.reweighting import base_weights
from pipeline.formats.parquet.task_tables import TaskTables
from pipeline.stages.shift import Shifted, named_samplers
from pipeline.studies.robustness.importance import effective_sample_size, weighted_log_likelihood
from pipeline.trajectories.exploration.tempering import Tempering, temper
from pipeline.trajectories.random_streams import child_rng
from pipeline.trajectories.sampler_density import jittered, log_density
from pipeline.trajectories.samplers import Sampler
from pipeline.workspace.anchors import ends_of
from pipeline.workspace.project import Project
from pipeline.workspace.scenes import load_task_scene

COUNT, SWEEPS = 1000, 50


def samplers_of(project: Project, name: str) -> dict[str, Sampler]:
    """Those of `robustness.samplers`, with the paths that the stage `shift` plans."""
    task, params = project.params.task(name), project.params
    with TaskTables(project.tables(name, ("demonstrations",))) as tables:
        (ends,) = ends_of(load_task_scene(project, task), task, tables["demonstrations"].read())
    preferences = json.dumps({key: dict(spec) for key, spec in task.preferences.items()})
    specs = tuple(params.robustness.samplers.items())
    job = Shifted(ends, preferences, params.sample, specs, params.ingest.waypoints, params.seed)
    return named_samplers(job, ends.room(), ("shift-planner", ends.key))[0]


def members(which: Case, sampler: Sampler, label: str) -> tuple[FloatArray, FloatArray]:
    """Draws z (COUNT, K, J) of a jittered sampler that are in the space, and their scaled features."""
    rng, z, phi = child_rng(0, which.name, label), [], []
    while sum(map(len, z)) < COUNT:
        drawn = jittered(sampler, rng, which.space, COUNT)
        features, inside = which.space.evaluate(drawn)
        z.append(drawn[inside])
        phi.append(features[inside])
    return np.concatenate(z)[:COUNT], np.concatenate(phi)[:COUNT]


def report(project: Project, which: Case) -> None:
    """Print one row a sampler, and how the corrected answers agree."""
    space, asked = which.space, (which.thetas, which.betas)
    draws = temper(space, which.thetas, which.betas.max(), child_rng(0, "base"), Tempering(sweeps=SWEEPS))
    base = base_weights(draws.features, draws.omegas, draws.counts, draws.log_normalisers)
    right = answers(which, region_log_likelihood(which.demonstrations, base.features, base.log_w, *asked))
    shown = space.encode(which.given.shown)
    rows, corrected, plain = [], [], []
    for label, sampler in samplers_of(project, which.name).items():
        z, phi = members(which, sampler, label)
        log_mu = -0.5 * (z**2).sum(axis=(1, 2))
        log_w = sampling_corrected(log_mu, log_density(sampler, z, space))
        own = sampling_corrected(-0.5 * (shown**2).sum(axis=(1, 2)), log_density(sampler, shown, space))
        apart = answers(which, weighted_log_likelihood(which.demonstrations, phi, log_w, *asked, joined=False))
        joined = np.concatenate(
            [
                weighted_log_likelihood(
                    which.demonstrations[[i]], np.vstack([phi, which.demonstrations[[i]]]), np.append(log_w, own[i]),
                    *asked, joined=False,
                )
                for i in range(len(own))
            ]
        )  # fmt: skip
        joined = answers(which, joined)
        uncorrected = weighted_log_likelihood(which.demonstrations, phi, np.zeros(COUNT), *asked, joined=False)
        corrected.append(joined)
        plain.append(answers(which, uncorrected))
        divergence = [(np.exp(right) * (right - one)).sum(axis=1)[:-1] for one in (apart, joined, plain[-1])]
        shares = np.exp(own - np.logaddexp(own, np.logaddexp.reduce(log_w)))
        rows.append(
            [label, f"{effective_sample_size(log_w):.1f}", f"{np.median(shares):.2g}"]
            + [f"{np.median(one):.2f}" for one in divergence]
        )
    columns = ("sampler", "effective size of 1,000", "weight of the chosen", "KL, corrected", "chosen joins", "plain")
    show(f"{which.name}: weights to the base measure; KL from the explored answer, median person, nats", columns, rows)
    summary = [
        [label, f"{TEN * np.median(disagreement(np.stack(of))[:-1]):.1f}"]
        for label, of in (("corrected, the chosen joins", corrected), ("not corrected", plain))
    ]
    show("KLAggregate of ten samplers, median person", ("answers", "nats"), summary)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("tasks", nargs="*", default=["table", "laptop", "human"])
    parser.add_argument("--project", type=Path, default=Path())
    asked = parser.parse_args()
    for task in asked.tasks:
        project = Project(asked.project)
        with case(project, task) as which:
            report(project, which)


if __name__ == "__main__":
    main()
