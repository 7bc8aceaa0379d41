"""How probable any trajectory is under each sampler of the box, demonstrations included.

As they stand the samplers draw from thin sets: five half waves, one via point, a few planned paths. A demonstration
lies on none of them, and two of these sets have no common density. So a sampler is given a declared *jitter*:
independent normal noise on the coefficients of the choice space's half waves. The jittered sampler has a density with
respect to those
coefficients everywhere, in closed form but for one integral over the time of the via point:

- deformation: normal, with the variances of the jitter and of the deformation added;
- via-point: for a given time the coefficients lie on a segment per joint; a uniform along it convolved with the jitter;
- planner: the mean over its paths of normals; mixture: the weighted sum of its parts.

What rejection removes changes each by a constant that all trajectories in the space share. A mixture is rejected as a
whole, so that is true of it as well. The densities are those of `jittered` draws; without the jitter they are an
approximation.
"""

from __future__ import annotations

import numpy as np
from scipy.special import log_ndtr, logsumexp

from pipeline.arrays import FloatArray
from pipeline.errors import ArgumentError
from pipeline.trajectories.exploration.choice_space import ChoiceSpace
from pipeline.trajectories.paths import Anchor, natural_bump, require_positive, sine_basis, straight_path
from pipeline.trajectories.samplers import Deformation, Mixture, Planner, Sampler, ViaPoint

JITTER = 0.1  # of a unit of the base measure
_TIMES = 64  # Gauss-Legendre nodes over the time of the via point


def jittered(
    sampler: Sampler, rng: np.random.Generator, space: ChoiceSpace, count: int, jitter: float = JITTER
) -> FloatArray:
    """Raw draws of a sampler as coefficients (count, K, J), with jitter; nothing is rejected."""
    require_positive("jitter", jitter)
    z = space.encode(sampler.sample(rng, space.anchor, count, space.n_waypoints))
    return np.asarray(z + jitter * rng.standard_normal(z.shape))


def log_density(sampler: Sampler, z: FloatArray, space: ChoiceSpace, jitter: float = JITTER) -> FloatArray:
    """Log density (N,) of the jittered sampler at coefficients (N, K, J), with respect to dz.

    Args:
        sampler: deformation, via-point, planner or a mixture of such.
        z: any trajectories as `space.encode` gives them.
        space: whose ends and half waves the sampler draws for.
        jitter: standard deviation of the noise, in units of the base measure.

    Raises:
        ArgumentError: the sampler has no known density.
    """
    require_positive("jitter", jitter)
    if isinstance(sampler, Deformation):
        return _log_normal(z, _variance(sampler, space, jitter))
    if isinstance(sampler, Planner):
        lines = np.stack([straight_path(Anchor(path[0], path[-1]), space.n_waypoints) for path in sampler.paths])
        centres = space.encode(sampler.paths - lines + space.line)
        variance = _variance(sampler.deformation, space, jitter)
        parts = np.stack([_log_normal(z - centre, variance) for centre in centres])
        return np.asarray(logsumexp(parts, axis=0) - np.log(len(centres)))
    if isinstance(sampler, Mixture):
        weights = np.log(np.array(sampler.weights) / sum(sampler.weights))
        parts = np.stack([log_density(part, z, space, jitter) for part in sampler.samplers])
        return np.asarray(logsumexp(parts + weights[:, None], axis=0))
    if isinstance(sampler, ViaPoint):
        return _log_via(sampler, z, space, jitter)
    raise ArgumentError(
        f"sampler {sampler.name!r} has no known density; use deformation, via-point, planner or a mixture of them."
    )


def _variance(sampler: Deformation, space: ChoiceSpace, jitter: float) -> FloatArray:
    """(K, 1) of the coefficients under a jittered deformation."""
    wave = sampler.width_rad * sine_basis(space.n_waypoints, sampler.modes, sampler.decay)
    shared = min(sampler.modes, space.modes)
    variance = np.full((space.modes, 1), jitter**2)
    # Waves of one number have one shape, so the ratio of their heights is the coefficient.
    variance[:shared, 0] += (wave[:shared] ** 2).sum(axis=1) / (space.basis[:shared] ** 2).sum(axis=1)
    return variance


def _log_normal(z: FloatArray, variance: FloatArray) -> FloatArray:
    return np.asarray((-0.5 * z**2 / variance - 0.5 * np.log(2 * np.pi * variance)).sum(axis=(1, 2)))


def _log_via(sampler: ViaPoint, z: FloatArray, space: ChoiceSpace, jitter: float) -> FloatArray:
    """log of the mean over via times of prod_j (1/2r) int_-r^r N(z_j; a c, jitter^2 I) da, c those of the bump."""
    nodes, weights = np.polynomial.legendre.leggauss(_TIMES)
    early, late = sampler.when
    peaks = early + (late - early) * (nodes + 1) / 2
    bumps = natural_bump(np.linspace(0.0, 1.0, space.n_waypoints), peaks[:, None])
    shapes = np.einsum("kt,pt->pk", space.basis / (space.basis**2).sum(axis=1)[:, None], bumps)
    reach = sampler.reach_rad
    terms = np.empty((_TIMES, len(z)))
    for row, shape in enumerate(shapes):
        length = np.sqrt((shape**2).sum())
        along = np.einsum("k,nkj->nj", shape / length, z)
        across = np.maximum((z**2).sum(axis=1) - along**2, 0.0)
        segment = _log_between((-reach * length - along) / jitter, (reach * length - along) / jitter)
        across_log = -0.5 * across / jitter**2 - 0.5 * (space.modes - 1) * np.log(2 * np.pi * jitter**2)
        terms[row] = (segment - np.log(2 * reach * length) + across_log).sum(axis=1)
    return np.asarray(logsumexp(terms + np.log(weights / 2)[:, None], axis=0))


def _log_between(low: FloatArray, high: FloatArray) -> FloatArray:
    """log(Phi(high) - Phi(low)), in whichever tail it is."""
    flip = low > 0
    low, high = np.where(flip, -high, low), np.where(flip, -low, high)
    upper, lower = log_ndtr(high), log_ndtr(low)
    return np.asarray(upper + np.log1p(-np.exp(lower - upper)))
