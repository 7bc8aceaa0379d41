"""Which sampler for continuous weights: `python -m benchmarks.weights` (emcee takes part where it is installed).

The rule, stated before measuring: most effective draws of the worst weight per second, among samplers that agree with
each other within their errors; one that brings a dependency must be twice as fast as the best that brings none.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from importlib.util import find_spec

import numpy as np

from benchmarks.explained import explain
from benchmarks.measuring import show, timed
from pipeline.choice import LESS, Boltzmann
from pipeline.choice.weights import Choices, GroupPrior, WeightPrior, sample_group, sample_weights

PRIOR = WeightPrior()
Sampled = tuple[np.ndarray, np.ndarray]  # posterior mean (F,), effective draws (F,)


def problem(model: Boltzmann | LESS, alternatives: int, demonstrations: int, rim: bool) -> Choices:
    """Demonstrations in a cloud of three features, or beyond one of its sides."""
    rng = np.random.default_rng(3)
    rows = rng.random((alternatives, 3)) ** 1.5
    chosen = rng.random((demonstrations, 3)) * [0.4, 0.7, 1.0]
    if rim:
        chosen[:, 0] = -0.05
    return Choices.outside(model, chosen, rows)


def importance(choices: Choices) -> Sampled:
    draws = sample_weights(np.random.default_rng(0), choices)
    return draws.mean, np.full(3, draws.effective)


def elliptical_slice(choices: Choices, steps: int = 5000) -> Sampled:
    """Given a scale the prior is Gaussian; given the weights the scale is drawn from its conditional."""
    rng, tau = np.random.default_rng(0), 1.0
    omega, chain = np.zeros(3), np.empty((steps, 3))
    value = choices.total(omega[None])[0]
    for step in range(steps):
        other, level = tau * rng.standard_normal(3), value + math.log(rng.random())
        angle = rng.random() * 2 * math.pi
        low, high = angle - 2 * math.pi, angle
        while True:
            proposed = omega * math.cos(angle) + other * math.sin(angle)
            value = choices.total(proposed[None])[0]
            if value > level:
                break
            low, high = (angle, high) if angle < 0 else (low, angle)
            angle = rng.uniform(low, high)
        omega = chain[step] = proposed
        log_p = PRIOR.log_components(omega[None])[0]
        p = np.exp(log_p - log_p.max())
        tau = float(rng.choice(PRIOR.scales, p=p / p.sum()))
    return chain[500:].mean(axis=0), (steps - 500) / _autocorrelation_time(chain[500:, None])


def ensemble(choices: Choices, steps: int = 2000, walkers: int = 24) -> Sampled:
    import emcee

    def log_density(omega: np.ndarray) -> np.ndarray:
        return choices.total(omega) + PRIOR.log_density(omega)

    np.random.seed(0)  # noqa: NPY002  emcee draws from the global stream
    sampler = emcee.EnsembleSampler(walkers, 3, log_density, vectorize=True)
    sampler.run_mcmc(np.random.default_rng(0).normal(size=(walkers, 3)), steps)
    chain = sampler.get_chain(discard=200)
    return chain.mean(axis=(0, 1)), len(chain) * walkers / _autocorrelation_time(chain)


def _autocorrelation_time(chain: np.ndarray) -> np.ndarray:
    """(F,) of a chain (T, W, F): Sokal's window of five times."""
    centred = chain - chain.mean(axis=(0, 1))
    spectrum = np.abs(np.fft.rfft(centred, 2 * len(chain), axis=0)) ** 2
    correlation = np.fft.irfft(spectrum, axis=0)[: len(chain)].mean(axis=1)
    times = 2 * np.cumsum(correlation / correlation[0], axis=0) - 1
    inside = np.arange(len(chain))[:, None] >= 5 * times
    window = np.where(inside.any(axis=0), inside.argmax(axis=0), len(chain) - 1)
    return np.maximum(times[window, np.arange(3)], 1.0)


def main() -> None:
    samplers: dict[str, Callable[[Choices], Sampled]] = {"importance": importance, "elliptical slice": elliptical_slice}
    if find_spec("emcee"):
        samplers["emcee"] = ensemble
    rows = []
    for model in (Boltzmann(), LESS(0.1)):
        for name, arguments in {
            "12 of 1000": (1000, 12, False),
            "1 of 1000": (1000, 1, False),
            "rim, 12 of 1000": (1000, 12, True),
            "rim, 1 of 100": (100, 1, True),
        }.items():
            choices = problem(model, *arguments)
            for label, sampler in samplers.items():
                sampler(choices) if label == "importance" else None  # what is cached is not timed
                took, (mean, effective) = timed(sampler, choices)
                rate = effective.min() / took
                rows.append(
                    (
                        model.name,
                        name,
                        label,
                        f"{took:.2f} s",
                        f"{effective.min():,.0f}",
                        f"{rate:,.0f}",
                        str(mean.round(2)),
                    )
                )
    columns = ("model", "demonstrations", "sampler", "time", "effective", "per second", "mean of the weights")
    show("Samplers of continuous weights", columns, rows)
    show(
        "A group of people", ("people", "demonstrations each", "time", "effective of 1,024", "Pareto k"), list(groups())
    )


def groups():
    rng = np.random.default_rng(5)
    rows = rng.random((1000, 3))
    for people, each in ((12, 1), (12, 5), (50, 1)):
        _, _, omega = GroupPrior(WeightPrior((5.0,)), (3.0,)).draw(rng, people, 3)
        utilities = omega @ rows.T
        p = np.exp(utilities - utilities.max(axis=1, keepdims=True))
        chosen = [rng.choice(1000, each, p=q / q.sum()) for q in p]
        choices = [Choices.outside(LESS(0.1), rows[c] + 0.01 * rng.normal(size=(each, 3)), rows) for c in chosen]
        took, draws = timed(sample_group, np.random.default_rng(0), choices)
        yield str(people), str(each), f"{took:.2f} s", f"{draws.group.effective:.0f}", f"{draws.group.pareto_k:.2f}"


if __name__ == "__main__":
    explain(__doc__)
    main()
