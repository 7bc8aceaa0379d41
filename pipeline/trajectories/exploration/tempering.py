"""Draws from the base measure of a choice space, tilted little by little towards what each theta wants.

Boltzmann over the base measure mu needs Z(omega) = E_mu[exp(omega . phi)] for omega = beta theta. Along each theta a
population of walkers goes from omega = 0, where it is drawn exactly, to the largest beta. Each step reweights and
resamples the walkers (a sequential Monte Carlo sampler; Del Moral, Doucet and Jasra 2006), with the step in beta chosen
so that the effective sample size stays at a declared share, and then moves them by preconditioned Crank-Nicolson steps
(Cotter, Roberts, Stuart and White 2013, equation 4.8) about the walkers' mean m,
    z' = m + sqrt(1 - s^2) (z - m) + s xi,  xi ~ N(0, I),
which leave N(m, I) as it is; a step inside the space is accepted with min(1, exp(omega . (phi' - phi) - m . (z' - z))).
The draws of all steps of all thetas are pooled by `pipeline.choice.reweighting`, which is far more exact than the
product of the steps' own ratios. Moves about a Gaussian whose *covariance* is fitted to the walkers were tried and
rejected: they accept more, and are wrong at equal cost (docs/choice_space.md has the figures).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pipeline.arrays import FloatArray
from pipeline.errors import ArgumentError
from pipeline.trajectories.exploration.choice_space import ChoiceSpace

_RECORD_EVERY = 4  # sweeps; draws in between are nearly the same
_STEPS = (0.02, 1.0)  # least and greatest s
_HALVINGS = 40  # of the interval in which the next beta is sought


@dataclass(frozen=True)
class Tempering:
    """How hard to sample. The defaults look at about a million trajectories for 19 thetas up to beta = 100.

    Attributes:
        walkers: per theta.
        sweeps: moves of every walker after each step in beta; those of the second half are recorded.
        effective_share: of the walkers, that a step in beta leaves.
        acceptance: share of accepted moves that the step size is steered to.
    """

    walkers: int = 100
    sweeps: int = 100
    effective_share: float = 0.5
    acceptance: float = 0.3

    def __post_init__(self) -> None:
        if self.walkers < 2 or self.sweeps < 2 or not (0 < self.effective_share < 1 and 0 < self.acceptance < 1):
            raise ArgumentError(
                f"walkers is {self.walkers}, sweeps {self.sweeps}, effective_share {self.effective_share}, acceptance "
                f"{self.acceptance}; allowed are >= 2, >= 2 and twice a share between 0 and 1."
            )


@dataclass(frozen=True, eq=False)
class TiltedDraws:
    """Draws from mu(z) exp(omega . phi(z)) for S tilts omega, the first of which is zero.

    Attributes:
        omegas: (S, F).
        features: (M, F) of the draws, tilt by tilt.
        counts: (S,) how many each tilt has.
        log_normalisers: (S,) first estimates of log Z(omega), the product of the steps' ratios.
        walkers: (R N, K, J) where the walkers ended, at the largest beta of each theta: seeds for a map.
        evaluations: trajectories looked at.
    """

    omegas: FloatArray
    features: FloatArray
    counts: FloatArray
    log_normalisers: FloatArray
    walkers: FloatArray
    evaluations: int

    def merged(self, *others: TiltedDraws) -> TiltedDraws:
        """Several independent populations as one."""
        parts = (self, *others)
        names = ("omegas", "features", "counts", "log_normalisers", "walkers")
        joined = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
        return TiltedDraws(**joined, evaluations=sum(part.evaluations for part in parts))


def temper(
    space: ChoiceSpace,
    thetas: FloatArray,
    largest_beta: float,
    rng: np.random.Generator,
    tempering: Tempering = Tempering(),
    *,
    progress: Callable[[int, float], None] | None = None,
) -> TiltedDraws:
    """Sample the base measure under every tilt from none to the largest beta along each theta.

    Args:
        space: with the base measure.
        thetas: (R, F) directions on scaled features.
        largest_beta: to which the walkers go.
        rng: the stream of this population; equal streams and arguments give equal draws.
        tempering: how hard to sample.
        progress: called with (evaluations so far, least beta reached) after each step.

    Raises:
        ArgumentError: the base measure has hardly a member in the space.
    """
    rays, walkers = len(thetas), tempering.walkers
    z, features = space.draw_base(rng, rays * walkers)
    z, features = z.reshape(rays, walkers, *z.shape[1:]), features.reshape(rays, walkers, -1)
    betas, log_z, sizes = np.zeros(rays), np.zeros(rays), np.full(rays, 0.5)
    omegas, draws, estimates = (
        [np.zeros((1, thetas.shape[1]))],
        [features.reshape(1, rays * walkers, -1).copy()],
        [np.zeros(1)],
    )
    evaluations = rays * walkers
    while (going := np.flatnonzero(betas < largest_beta)).size:
        rewards = np.einsum("rf,rnf->rn", thetas[going], features[going])
        step = _next_step(rewards, largest_beta - betas[going], tempering.effective_share)
        betas[going] = np.where(step >= largest_beta - betas[going], largest_beta, betas[going] + step)
        picked, ratio = _resampled(rng, step[:, None] * rewards)
        log_z[going] += ratio
        omega = betas[going, None] * thetas[going]
        rows = np.arange(len(going))[:, None]
        moved = _Walkers(space, omega, z[going][rows, picked], features[going][rows, picked], sizes[going])
        recorded = []
        for sweep in range(tempering.sweeps):
            moved.sweep(rng, tempering.acceptance)
            if sweep >= tempering.sweeps // 2 and (tempering.sweeps - 1 - sweep) % _RECORD_EVERY == 0:
                recorded.append(moved.features.copy())
        z[going], features[going], sizes[going] = moved.z, moved.features, moved.sizes
        evaluations += tempering.sweeps * len(going) * walkers
        omegas.append(omega)
        draws.append(np.concatenate(recorded, axis=1))
        estimates.append(log_z[going].copy())
        if progress is not None:
            progress(evaluations, float(betas.min()))
    return TiltedDraws(
        omegas=np.concatenate(omegas),
        features=np.concatenate([part.reshape(-1, part.shape[2]) for part in draws]),
        counts=np.concatenate([np.full(len(part), part.shape[1]) for part in draws]),
        log_normalisers=np.concatenate(estimates),
        walkers=z.reshape(-1, *z.shape[2:]),
        evaluations=evaluations,
    )


class _Walkers:
    """R populations of N walkers, each at its own tilt."""

    def __init__(
        self, space: ChoiceSpace, omega: FloatArray, z: FloatArray, features: FloatArray, sizes: FloatArray
    ) -> None:
        self.space, self.omega, self.z, self.features, self.sizes = space, omega, z, features, sizes
        self._centre = z.mean(axis=1, keepdims=True)
        self._log_ratio = self._relative()

    def sweep(self, rng: np.random.Generator, acceptance: float) -> None:
        """One preconditioned Crank-Nicolson move of every walker; the step size follows the share accepted."""
        size = self.sizes[:, None, None, None]
        kept = self._centre + np.sqrt(1 - size**2) * (self.z - self._centre)
        proposed = kept + size * rng.standard_normal(self.z.shape)
        shift = self._shift(proposed).ravel()
        enough = np.log1p(-rng.random(self._log_ratio.shape)).ravel() + self._log_ratio.ravel() + shift
        count = self.z.shape[1]
        features, accepted = self.space.evaluate_wanted(
            proposed.reshape(-1, *proposed.shape[2:]),
            lambda phi, rows: np.asarray((self.omega[rows // count] * phi).sum(axis=1) > enough[rows]),
        )
        accepted, features = accepted.reshape(self._log_ratio.shape), features.reshape(self.features.shape)
        self.z[accepted], self.features[accepted] = proposed[accepted], features[accepted]
        self._log_ratio = self._relative()
        self.sizes = np.clip(self.sizes * np.exp(0.5 * (accepted.mean(axis=1) - acceptance)), *_STEPS)

    def _relative(self) -> FloatArray:
        """(R, N) log of the tilted measure relative to the Gaussian N(centre, I) that the moves leave as it is."""
        return np.asarray(np.einsum("rf,rnf->rn", self.omega, self.features) - self._shift(self.z))

    def _shift(self, z: FloatArray) -> FloatArray:
        return np.asarray(np.einsum("rkj,rnkj->rn", self._centre[:, 0], z))


def _next_step(rewards: FloatArray, room: FloatArray, share: float) -> FloatArray:
    """(R,) the largest step in beta, at most `room`, that keeps Kish's effective size at a share of the walkers."""

    def effective(step: FloatArray) -> FloatArray:
        log_w = step[:, None] * rewards
        w = np.exp(log_w - log_w.max(axis=1, keepdims=True))
        return np.asarray(w.sum(axis=1) ** 2 / (w**2).sum(axis=1) / rewards.shape[1])

    low, high = np.zeros_like(room), room.copy()
    whole = effective(room) >= share
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        good = effective(middle) >= share
        low, high = np.where(good, middle, low), np.where(good, high, middle)
    return np.where(whole, room, low)


def _resampled(rng: np.random.Generator, log_w: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Systematic resampling: rows picked (R, N), and log of the mean weight (R,)."""
    peak = log_w.max(axis=1, keepdims=True)
    total = np.cumsum(np.exp(log_w - peak), axis=1)
    count = log_w.shape[1]
    marks = (np.arange(count) + rng.random((len(log_w), 1))) / count * total[:, -1:]
    picked = np.stack([np.searchsorted(row, mark, side="right") for row, mark in zip(total, marks, strict=True)])
    return np.minimum(picked, count - 1), np.log(total[:, -1] / count) + peak[:, 0]
