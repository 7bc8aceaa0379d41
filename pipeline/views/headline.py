"""The headline numbers of a task, and of the studies: those by which two settings are compared."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from pipeline.choice import entropy
from pipeline.vocabulary import ALL, INDEPENDENT, SAMPLER_SHIFT, SINGLE

if TYPE_CHECKING:
    from pipeline.choice import Posterior

Numbers = dict[str, "float | str | Numbers"]
_DIGITS = 6
KL_REGIMES = (INDEPENDENT, SAMPLER_SHIFT)


def task_headline(
    beliefs: Mapping[str, Posterior],
    labels: Sequence[str],
    held_out: pl.DataFrame,
    summary: pl.DataFrame | None,
    recordings: tuple[int, int],
    fits: pl.DataFrame,
    resting_on: Sequence[str] = (),
    pairs: pl.DataFrame | None = None,
) -> Numbers:
    """The headline numbers of a task, from all of its demonstrations together.

    Args:
        beliefs: for each model, the posterior given all demonstrations.
        labels: (K,) the hypotheses in words.
        held_out: rows of the table `held_out` for the same set; there may be none.
        summary: the table `robustness_summary`, or None if the study was not run.
        recordings: number of recordings that were used, and that were rejected.
        fits: the table `fits`.
        resting_on: what the posterior of each model rests on.
        pairs: the `summary` per pair of sets, see `pipeline.views.robustness.per_pair`.

    Returns:
        `recordings`: `used`, `rejected`. For each model: `best`, the most probable theta in words, or that none is
        better than chance; `over`, what the posterior rests on; `gain`, of the best log likelihood over that of theta =
        0 (nats); its `posterior`, summed over beta; the `beta` that is most probable with it; the `entropy` of the
        posterior over theta (nats); `held_out`, the mean log predictive probability of a demonstration given the others
        (nats); and `kl_aggregate`, for each regime the median over single demonstrations with the largest sets (nats),
        of which `kl_per_pair` is the mean of a pair of sets.
    """
    numbers: Numbers = {"recordings": dict(zip(("used", "rejected"), recordings, strict=True))}
    over = dict(zip(beliefs, resting_on, strict=False))
    for model, belief in beliefs.items():
        best = belief.map_index
        together = fits.filter(model=model, demonstration_id=ALL, participant=ALL).row(0, named=True)
        model_numbers: Numbers = {
            "best": in_words(labels[best], together["better"]),
            **({"over": over[model]} if model in over else {}),
            "gain": _short(together["log_likelihood"] - together["log_chance"]),
            "posterior": _short(belief.marginal_theta[best]),
            "beta": _short(belief.betas[int(np.argmax(belief.log_probability[best]))]),
            "entropy": _short(entropy(belief.marginal_theta)),
        }
        scores = held_out.filter(model=model)["log_predictive"].to_numpy()
        if scores.size:
            model_numbers["held_out"] = _short(scores.mean())
        if summary is not None:
            model_numbers["kl_aggregate"] = _divergences(summary.filter(model=model, demonstrations=SINGLE))
        if pairs is not None:
            model_numbers["kl_per_pair"] = _divergences(pairs.filter(model=model, demonstrations=SINGLE))
        numbers[model] = model_numbers
    return numbers


def in_words(label: str, better: bool) -> str:
    """The most probable theta, or that it explains people no better than chance."""
    return label if better else f"nothing found: no better than chance (likeliest: {label})"


def studies_headline(tests: pl.DataFrame, grid_summary: pl.DataFrame) -> Numbers:
    """The headline numbers of the studies of human choice and of the grid world.

    Args:
        tests: the table `human_choice_tests`.
        grid_summary: the table `grid_world_summary`.

    Returns:
        `human_choice`: `p_value` and `minimum_epsilon` for each comparison and model. `grid_world`: TruePosterior for
        each model of people and of the robot, averaged over all thetas.
    """
    choices: dict[str, Numbers] = {}
    for row in tests.iter_rows(named=True):
        model_numbers: Numbers = {name: _short(row[name]) for name in ("p_value", "minimum_epsilon")}
        choices.setdefault(row["comparison"], {})[row["model"]] = model_numbers
    world: dict[str, Numbers] = {}
    for row in grid_summary.filter(pl.col("theta_id").is_null()).iter_rows(named=True):
        world.setdefault(f"people-{row['sampling_model']}", {})[row["inference_model"]] = _short(row["true_posterior"])
    return {"human_choice": dict(choices), "grid_world": dict(world)}


def _divergences(summary: pl.DataFrame) -> Numbers:
    largest = summary.filter(pl.col("set_size") == pl.col("set_size").max().over("regime"))
    by_regime = {regime: largest.filter(regime=regime)["value"].to_list() for regime in KL_REGIMES}
    return {regime: _short(values[0]) for regime, values in by_regime.items() if values}


def _short(value: float) -> float | str:
    """The number rounded to six digits; an infinite one as a word, because JSON has no infinite numbers."""
    return float(f"{value:.{_DIGITS}g}") if np.isfinite(value) else str(value)
