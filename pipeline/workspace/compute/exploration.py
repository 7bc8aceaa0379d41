"""Independent explorations of one choice space, as jobs for workers: rounds of the map and of the draws."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from pipeline.arrays import FloatArray
from pipeline.choice.convergence import Convergence, run_until
from pipeline.choice.explored import Region, expected_choice, region_log_likelihood, region_log_weights
from pipeline.choice.inference import posterior_from
from pipeline.choice.reweighting import base_weights
from pipeline.replay.assessment import assessment
from pipeline.replay.features import bind_features
from pipeline.trajectories.exploration.archive import Grid, spread
from pipeline.trajectories.exploration.choice_space import ChoiceSpace
from pipeline.trajectories.exploration.search import Exploration, explore
from pipeline.trajectories.exploration.tempering import Tempering, temper
from pipeline.trajectories.random_streams import child_rng
from pipeline.vocabulary import BOLTZMANN, LESS
from pipeline.workspace.anchors import Ends
from pipeline.workspace.compute.executor import Workers
from pipeline.workspace.scenes import loaded

MOST_RAYS = 24  # thetas along which draws are tempered; of more, those furthest from one another
STEPS = 5  # in beta along a ray, about
FEW_CELLS, SHORT = 4000, 50_000  # cells that so many evaluations should fill


@dataclass(frozen=True, eq=False)
class Declared:
    """What a worker needs to make a choice space.

    Attributes:
        ends: where trajectories start and end, and the scene.
        features: JSON of the task's features, in the order of the scales.
        scales: (F,) what each feature is divided by.
        waypoints: T.
        effort_multiple, width, modes: see `ChoiceSpace`.
        largest_step: of any joint from one waypoint to the next; None: no limit.
    """

    ends: Ends
    features: str
    scales: FloatArray
    waypoints: int
    effort_multiple: float
    width: float
    modes: int
    largest_step: float | None

    def space(self) -> ChoiceSpace:
        """The choice space.

        Raises:
            ArgumentError: see `ChoiceSpace`.
            StageError, SceneError: the ends are not possible.
        """
        room, scene = self.ends.room(), loaded(self.ends.scene)
        assess, measure = assessment(bind_features(scene, json.loads(self.features)), self.scales, room)
        step = None if self.largest_step is None else np.full(room.anchor.start.size, self.largest_step)
        return ChoiceSpace(
            room.anchor, self.waypoints, scene.lower, scene.upper, assess, self.effort_multiple, self.width,
            self.modes, largest_step=step, measure=measure,
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Hypotheses:
    """What is asked: directions (K, F) on scaled features and inverse temperatures (B,)."""

    thetas: FloatArray
    betas: FloatArray

    @property
    def omegas(self) -> FloatArray:
        """(K B, F) every product of the two."""
        return np.asarray((self.betas[:, None, None] * self.thetas).reshape(-1, self.thetas.shape[1]))


@dataclass(frozen=True, eq=False)
class Tempered:
    """One population of draws that is wanted: rays (R, F), how many moves, and the labels of its random stream."""

    declared: Declared
    asked: Hypotheses
    rays: FloatArray
    tempering: Tempering
    seed: int
    stream: tuple[str | int, ...]


@dataclass(frozen=True, eq=False)
class Draws:
    """A weighted sample of the base measure: features (M, F), log weights (M,), walkers at the largest beta."""

    features: FloatArray
    log_w: FloatArray
    walkers: FloatArray
    evaluations: int
    effective_size: float


def draw(job: Tempered) -> Draws:
    """Temper a population and pool its draws."""
    rng = child_rng(job.seed, *job.stream)
    found = temper(job.declared.space(), job.rays, float(job.asked.betas.max()), rng, job.tempering)
    weights = base_weights(found.features, found.omegas, found.counts, found.log_normalisers)
    effective = float(weights.effective_sizes(job.asked.omegas).min())
    return Draws(weights.features, weights.log_w, found.walkers, found.evaluations, effective)


@dataclass(frozen=True, eq=False)
class Mapped:
    """One round of one map that is wanted.

    Attributes:
        declared: the space.
        asked: what matters in it.
        paths: (N, T, J) waypoints to begin with; none when going on.
        walkers: (M, K, J) coefficients to begin with.
        start: the map of the round before.
        cell: width of a cell and of the kernel.
        evaluations: in all.
        seed, stream: of the random numbers.
    """

    declared: Declared
    asked: Hypotheses
    paths: FloatArray
    walkers: FloatArray
    start: Exploration | None
    cell: float
    evaluations: int
    seed: int
    stream: tuple[str | int, ...]


def cover(job: Mapped) -> Exploration:
    """Explore until so many trajectories have been looked at."""
    space = job.declared.space()
    seeds = job.walkers if job.start is not None else np.concatenate([space.encode(job.paths), job.walkers])
    return explore(
        space, seeds, child_rng(job.seed, *job.stream), job.evaluations, Grid(job.cell),
        interest=lambda phi: expected_choice(phi, job.asked.thetas, job.asked.betas), start=job.start,
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Cost:
    """What a round has cost and found, means over the explorations but for the least effective size."""

    evaluations: int
    rows: int
    growth: float | None = None
    effective_size: float | None = None


@dataclass(eq=False)
class Rounds:
    """The rounds of one model.

    Attributes:
        rows: of each exploration, after the last round.
        posteriors: (R, G, K, B) log posteriors of the groups under each exploration, for each round.
        costs: one for each round.
        convergence: of the posteriors over theta.
    """

    convergence: Convergence = field(init=False)
    rows: list[Region] = field(default_factory=list)
    posteriors: list[FloatArray] = field(default_factory=list)
    costs: list[Cost] = field(default_factory=list)


@dataclass(frozen=True, eq=False)
class Explored:
    """All that was found: by model, and the last maps."""

    models: dict[str, Rounds]
    maps: list[Exploration]


@dataclass(frozen=True, eq=False)
class Plan:
    """How a choice space is explored.

    Attributes:
        declared: the space.
        asked: the hypotheses.
        demonstrations: (n, F) scaled features.
        groups: rows of the demonstrations that get a posterior together, for each of G groups.
        seeds: for each exploration (N, T, J) waypoints to begin with.
        cell: width of a cell and of the kernel.
        evaluations, most_evaluations: of the first round and in all, of each exploration.
        tolerance: see `Convergence`.
        seed: of the random numbers.
    """

    declared: Declared
    asked: Hypotheses
    demonstrations: FloatArray
    groups: Sequence[Sequence[int]]
    seeds: Sequence[FloatArray]
    cell: float
    evaluations: int
    most_evaluations: int
    tolerance: float
    seed: int


def with_fine_cells(plan: Plan) -> Plan:
    """The plan, its cells so narrow that a first short search fills `FEW_CELLS`, if it fills fewer.

    Where beta is large, what lies in one cell differs by much in probability, so cells are as narrow as a search fills.
    """
    none = np.empty((0, plan.declared.modes, plan.seeds[0].shape[2]))
    few = min(SHORT, plan.evaluations)
    stream = ("explore", plan.declared.ends.key, "short")
    job = Mapped(plan.declared, plan.asked, plan.seeds[0], none, None, plan.cell, few, plan.seed, stream)
    filled = len(cover(job).archive)
    return replace(plan, cell=plan.cell * min(1.0, float((filled / FEW_CELLS) ** (1 / len(plan.declared.scales)))))


def explored(pool: Workers, plan: Plan, label: str) -> Explored:
    """Explore until independent explorations agree, first the draws from the base measure and then the map.

    The map begins where the draws have ended, at the largest beta, and at the samplers' trajectories.

    Args:
        pool: who computes.
        plan: what.
        label: of the progress bar.

    Raises:
        ArgumentError, StageError: the space cannot be sampled.
    """
    count = len(plan.seeds)
    thetas = plan.asked.thetas
    rays = spread(thetas, MOST_RAYS) if len(thetas) > MOST_RAYS else thetas
    boltzmann, less = Rounds(), Rounds()
    walkers: list[FloatArray] = []
    maps: list[Exploration] = []

    def drawn(evaluations: int) -> FloatArray:
        base = Tempering()
        sweeps = max(2, round(evaluations / (len(rays) * base.walkers * STEPS)))
        jobs = [
            Tempered(
                plan.declared, plan.asked, rays, Tempering(sweeps=sweeps), plan.seed,
                ("explore", plan.declared.ends.key, "draws", number, sweeps),
            )
            for number in range(count)
        ]  # fmt: skip
        found = list(pool.mapped(draw, jobs, f"{label}: {BOLTZMANN}, {evaluations:,}"))
        walkers[:] = [one.walkers for one in found]
        boltzmann.costs.append(
            Cost(
                round(np.mean([one.evaluations for one in found])), round(np.mean([len(one.log_w) for one in found])),
                effective_size=min(one.effective_size for one in found),
            )
        )  # fmt: skip
        return _posteriors(boltzmann, [Region(one.features, one.log_w) for one in found], plan)

    def covered(evaluations: int) -> FloatArray:
        jobs = [
            Mapped(
                plan.declared, plan.asked, plan.seeds[number], walkers[number], maps[number] if maps else None,
                plan.cell, evaluations, plan.seed, ("explore", plan.declared.ends.key, "map", number, evaluations),
            )
            for number in range(count)
        ]  # fmt: skip
        maps[:] = pool.mapped(cover, jobs, f"{label}: {LESS}, {evaluations:,}")
        less.costs.append(
            Cost(
                round(np.mean([one.evaluations for one in maps])), round(np.mean([len(one.archive) for one in maps])),
                growth=float(np.mean([one.growth_at_last_doubling for one in maps])),
            )
        )  # fmt: skip
        found = [one.archive.features.copy() for one in maps]
        return _posteriors(less, [Region(rows, region_log_weights(rows, plan.cell)) for rows in found], plan)

    boltzmann.convergence = _rounds(drawn, plan)
    less.convergence = _rounds(covered, plan)
    return Explored({LESS: less, BOLTZMANN: boltzmann}, maps)


def _rounds(step: Callable[[int], FloatArray], plan: Plan) -> Convergence:
    return run_until(step, plan.evaluations, plan.tolerance, plan.most_evaluations)


def _posteriors(model: Rounds, rows: list[Region], plan: Plan) -> FloatArray:
    """(R, G, K) log posteriors over theta; those over theta and beta are kept."""
    thetas, betas = plan.asked.thetas, plan.asked.betas
    model.rows = rows
    likelihoods = [region_log_likelihood(plan.demonstrations, one.features, one.log_w, thetas, betas) for one in rows]
    found = [
        [posterior_from(values[group].sum(axis=0), thetas, betas) for group in plan.groups] for values in likelihoods
    ]
    model.posteriors.append(np.array([[one.log_probability for one in of_run] for of_run in found]))
    return np.array([[one.log_marginal_theta for one in of_run] for of_run in found])
