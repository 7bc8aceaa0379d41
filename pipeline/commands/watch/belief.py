"""What the demonstrations so far say: in numbers, in words and as data."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import polars as pl

from pipeline.arrays import FloatArray
from pipeline.choice import Posterior, entropy, log_likelihood, posterior_from
from pipeline.choice.models import choice_model
from pipeline.choice.weights import Choices, sample_weights, weighted_quantiles
from pipeline.commands.watch.setting import Setting
from pipeline.errors import WorkbenchError
from pipeline.trajectories.random_streams import child_rng
from pipeline.views.rerun.live_recording import Believed
from pipeline.views.rerun.records import Weights
from pipeline.views.task_summary import theta_labels
from pipeline.views.task_view import EXPLORED, mean_posterior, over_what
from pipeline.views.truth import Truth, known_truth
from pipeline.vocabulary import BOLTZMANN, LESS, model_name

DRAWS = 1024  # of the weights, after each demonstration


@dataclass
class Belief:
    """What the demonstrations so far say; in the order of their names, as `dvc repro` has them.

    Attributes:
        setting: of the task.
        models: labels of the models.
        rows: by demonstration, its row of demonstrations.parquet.
        raw: by demonstration, (F,) raw values of its features.
        log_likelihoods: by demonstration and model, (K, B).
    """

    setting: Setting
    models: tuple[str, ...]
    rows: dict[str, dict[str, Any]] = field(default_factory=dict)
    raw: dict[str, FloatArray] = field(default_factory=dict)
    log_likelihoods: dict[str, dict[str, FloatArray]] = field(default_factory=dict)

    def take(self, row: dict[str, Any]) -> None:
        """Take a demonstration in, in place of what had its name before."""
        setting, key = self.setting, row["demonstration_id"]
        raw = setting.feature_set.evaluate(row["waypoints"][None])
        phi, alternatives = raw / setting.scale, setting.raw / setting.scale
        self.log_likelihoods[key] = {
            label: log_likelihood(
                choice_model(label, setting.bandwidth), phi, alternatives, setting.thetas, setting.betas
            )[0]
            for label in self.models
        }
        self.rows[key], self.raw[key] = row, raw[0]

    def drop(self, key: str) -> None:
        """Forget a demonstration."""
        for kept in (self.rows, self.raw, self.log_likelihoods):
            kept.pop(key, None)

    def values(self, model: str) -> FloatArray:
        """(n, K, B) log likelihoods."""
        shape = (0, len(self.setting.thetas), len(self.setting.betas))
        return np.array([self.log_likelihoods[key][model] for key in sorted(self.rows)]).reshape(-1, *shape[1:])

    def posteriors(self) -> dict[str, Posterior]:
        """By model, over all demonstrations together: over the explored choice space, or the sampled alternatives."""
        setting = self.setting
        return {
            model: mean_posterior(setting.space.posteriors(model, self.phi))
            if model in setting.space.normalisers
            else posterior_from(self.values(model).sum(axis=0), setting.thetas, setting.betas)
            for model in self.models
        }

    def weights(self) -> Weights | None:
        """The weights of all demonstrations together, as if they were one person's; None if there are none to infer.

        The hierarchy over people, which the answer has, takes too long after each recording: ten seconds a model.

        Raises:
            WorkbenchError: they cannot be inferred.
        """
        setting, asked = self.setting, [model for model in self.models if model in (LESS, BOLTZMANN)]
        if not self.rows or not asked:
            return None
        tables = []
        for model in asked:
            if model in setting.space.regions:
                choices = Choices.over(setting.space.regions[model], self.phi)
            else:
                rows = setting.raw / setting.scale
                choices = Choices.outside(choice_model(model, setting.bandwidth), self.phi, rows)
            draws = sample_weights(child_rng(setting.seed, "watch", "weights", model), choices, count=DRAWS)
            low, median, high = weighted_quantiles(draws.directions, draws.weight, (0.05, 0.5, 0.95))
            tables.append(
                pl.DataFrame({"feature": setting.features, "low": low, "median": median, "high": high}).with_columns(
                    model=pl.lit(model)
                )
            )
        truth = self.truth()
        return Weights(setting.features, pl.concat(tables), None if truth is None else truth.mean)

    def truth(self) -> Truth | None:
        """What the people so far truly want, if their recordings say it."""
        setting = self.setting
        stated = [self.rows[key]["true_theta"] for key in sorted(self.rows)]
        return known_truth(stated, setting.features, setting.scale, setting.thetas)

    @property
    def phi(self) -> FloatArray:
        """(n, F) scaled features."""
        raw = np.array([self.raw[key] for key in sorted(self.rows)]).reshape(-1, len(self.setting.features))
        return np.asarray(raw / self.setting.scale)

    @property
    def over(self) -> str:
        """What these posteriors are over, in words; nothing if it is the sampled alternatives."""
        explored, sampled = self.setting.space.normalisers, f"set of {len(self.setting.raw):,}"
        said = over_what(self.models, [EXPLORED if model in explored else sampled for model in self.models])
        return f", posteriors {said}" if explored else ""

    def on_map(self) -> FloatArray:
        """(n, 2) values of the map's two features, as they stand on its axes."""
        raw = np.array([self.raw[key] for key in sorted(self.rows)]).reshape(-1, len(self.setting.features))
        return np.stack([self.setting.axes[f].shown(raw[:, f]) for f in self.setting.pair], axis=1)


def as_data(belief: Belief) -> dict[str, dict[str, object]]:
    """By model, the most probable weights, their probability, and how many thetas are still plausible."""
    return {
        model: {
            "theta": dict(zip(belief.setting.features, posterior.map_theta.tolist(), strict=True)),
            "probability": float(posterior.marginal_theta[posterior.map_index]),
            "plausible": float(np.exp(entropy(posterior.marginal_theta))),
        }
        for model, posterior in belief.posteriors().items()
    }


def in_words(belief: Belief) -> list[str]:
    """Per model, what is most probable and how sure that is."""
    names, thetas = belief.setting.features, belief.setting.thetas
    labels, found = theta_labels(thetas, names), []
    for model, posterior in belief.posteriors().items():
        best, left = posterior.map_index, np.exp(entropy(posterior.marginal_theta))
        found.append(
            f"{model_name(model)} {labels[best]} (P {posterior.marginal_theta[best]:.3f}, {left:.1f} of "
            f"{len(thetas)} thetas still plausible)"
        )
    return found


def believed(belief: Belief) -> Believed:
    """By model, the posterior over theta, the text beside it, and the truth if it is known."""
    posteriors = {model: posterior.marginal_theta for model, posterior in belief.posteriors().items()}
    lines = [
        f"# {belief.setting.name}",
        "",
        f"**{len(belief.rows)} demonstration{'s' * (len(belief.rows) != 1)}** so far, {len(belief.setting.raw):,} "
        f"alternatives{belief.over}.",
        "",
        *(f"- {line}" for line in in_words(belief)),
        "",
        f"Recordings: {', '.join(sorted(belief.rows)) or 'none yet'}.",
        "",
        "These posteriors come without a verdict, as checks need `dvc repro`. That of the task's own demonstrations:"
        if belief.setting.answer
        else "These posteriors come without a verdict: run `dvc repro`, then ask `lessbench answer` for one.",
        "",
        *belief.setting.answer,
    ]
    try:
        weights = belief.weights()
    except WorkbenchError as error:
        weights = None
        lines.append(f"\nNo weights are shown: {error}")
    truth = belief.truth()
    return Believed(posteriors, "\n".join(lines), None if truth is None else truth.nearest, weights)
