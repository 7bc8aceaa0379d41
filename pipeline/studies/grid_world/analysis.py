"""Statistics of the grid world: is inference better when it uses the model by which people choose?"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import polars as pl

from pipeline.studies.grid_world.trials import HIDDEN_MODELS, SAMPLING_MODELS
from pipeline.studies.statistics import repeated_logistic, repeated_measures_anova, tukey_hsd
from pipeline.vocabulary import BOLTZMANN, LESS

# The experiment of section 4.1. Those of section 4.3 have the name of their sampling model.
FACTORIAL = "sampling x inference"
ALPHA = 0.05


@dataclass(frozen=True, eq=False)
class GridWorldAnalysis:
    """Tables of the analysis. A subject is one theta with one seed.

    Attributes:
        summary: one row per sampling model, inference model and theta: `sets`, `true_posterior` (mean),
            `standard_error`, `true_match` (share); `theta_id` is null in the rows over all thetas.
        anova: `experiment` and the columns of `repeated_measures_anova`, for TruePosterior.
        post_hoc: the columns of `tukey_hsd`, for TruePosterior, over the four cells of the factorial experiment.
        logistic: `experiment` and the columns of `repeated_logistic`, for TrueMatch; the term `inference_model`
            compares LESS with Boltzmann.
        hypotheses: one row per hypothesis and sampling model: `hypothesis`, `sampling_model`, `expected` and `other`
            (the inference models), `posterior_expected`, `posterior_other`, `posterior_p_value`, `match_expected`,
            `match_other`, `match_odds_ratio` (expected over other), `match_p_value`, `supported` (the expected model is
            better in both measures, each at the 0.05 level); and with theta as a random unit, as its sets are no more
            than repetitions: `thetas`, `thetas_ahead` (those for which the expected model has the higher mean
            posterior), `theta_lead_least` and `theta_lead_most` (of these means), `theta_lead_low` and
            `theta_lead_high` (95 % interval of their mean over thetas) and `theta_p_value` (paired t test).
    """

    summary: pl.DataFrame
    anova: pl.DataFrame
    post_hoc: pl.DataFrame
    logistic: pl.DataFrame
    hypotheses: pl.DataFrame


def analyse(trials: pl.DataFrame) -> GridWorldAnalysis:
    """Analyse the table of `run_trials`."""
    # the paper compares two models of inference; the other models are in the summary alone
    compared = trials.filter(pl.col("inference_model").is_in(SAMPLING_MODELS)).with_columns(
        subject=pl.format("{}/{}", "theta_id", "seed")
    )
    factorial = compared.filter(pl.col("sampling_model").is_in(SAMPLING_MODELS))
    design = ["sampling_model", "inference_model"]
    anova = [_named(FACTORIAL, repeated_measures_anova(factorial, "true_posterior", design, "subject"))]
    logistic = [_named(FACTORIAL, repeated_logistic(factorial, "true_match", design, "subject"))]
    for model in (*SAMPLING_MODELS, *HIDDEN_MODELS):
        sets = compared.filter(pl.col("sampling_model") == model)
        logistic.append(_named(model, repeated_logistic(sets, "true_match", ["inference_model"], "subject")))
        if model in HIDDEN_MODELS:
            one_way = repeated_measures_anova(sets, "true_posterior", ["inference_model"], "subject")
            anova.append(_named(model, one_way))
    tables = _Tables(
        _summary(trials),
        pl.concat(anova),
        tukey_hsd(factorial, "true_posterior", design, "subject"),
        pl.concat(logistic),
    )
    hypotheses = [
        _hypothesis("H3", LESS, tables, expected=LESS),
        _hypothesis("H4", BOLTZMANN, tables, expected=BOLTZMANN),
        *(_hypothesis("H5", model, tables, expected=LESS) for model in HIDDEN_MODELS),
    ]
    return GridWorldAnalysis(*tables, pl.DataFrame(hypotheses, infer_schema_length=None))


class _Tables(NamedTuple):
    summary: pl.DataFrame
    anova: pl.DataFrame
    post_hoc: pl.DataFrame
    logistic: pl.DataFrame


def _hypothesis(name: str, sampling_model: str, tables: _Tables, expected: str) -> dict[str, object]:
    from scipy.stats import ttest_1samp

    other = BOLTZMANN if expected == LESS else LESS
    overall = tables.summary.filter((pl.col("sampling_model") == sampling_model) & pl.col("theta_id").is_null())
    posterior, match = (
        dict(overall.select("inference_model", column).iter_rows()) for column in ("true_posterior", "true_match")
    )
    if sampling_model in HIDDEN_MODELS:
        p_value = tables.anova.filter(pl.col("experiment") == sampling_model)["p_value"].item()
    else:
        pair = (pl.col("sampling_model_a") == sampling_model) & (pl.col("sampling_model_b") == sampling_model)
        p_value = tables.post_hoc.filter(pair)["p_value"].item()
    logit = tables.logistic.filter(pl.col("experiment") == sampling_model).row(0, named=True)
    odds_ratio = logit["odds_ratio"]  # LESS over Boltzmann
    if odds_ratio is not None and expected == BOLTZMANN:
        odds_ratio = 1.0 / odds_ratio
    ahead = posterior[expected] > posterior[other] and match[expected] > match[other]
    by_theta = tables.summary.filter((pl.col("sampling_model") == sampling_model) & pl.col("theta_id").is_not_null())
    means = {
        model: by_theta.filter(inference_model=model).sort("theta_id")["true_posterior"].to_numpy()
        for model in (expected, other)
    }
    leads = means[expected] - means[other]
    test = ttest_1samp(leads, 0.0)
    low, high = test.confidence_interval(0.95)
    return {
        "hypothesis": name,
        "sampling_model": sampling_model,
        "expected": expected,
        "other": other,
        "posterior_expected": posterior[expected],
        "posterior_other": posterior[other],
        "posterior_p_value": p_value,
        "match_expected": match[expected],
        "match_other": match[other],
        "match_odds_ratio": odds_ratio,
        "match_p_value": logit["p_value"],
        "supported": ahead and p_value < ALPHA and logit["p_value"] is not None and logit["p_value"] < ALPHA,
        "thetas": len(leads),
        "thetas_ahead": int((leads > 0).sum()),
        "theta_lead_least": float(leads.min()),
        "theta_lead_most": float(leads.max()),
        "theta_lead_low": float(low),
        "theta_lead_high": float(high),
        "theta_p_value": float(test.pvalue),
    }


def _summary(trials: pl.DataFrame) -> pl.DataFrame:
    measures = (
        pl.len().cast(pl.Int64).alias("sets"),
        pl.col("true_posterior").mean(),
        (pl.col("true_posterior").std() / pl.len().sqrt()).alias("standard_error"),
        pl.col("true_match").mean(),
    )
    models = ["sampling_model", "inference_model"]
    per_theta = trials.group_by(*models, "theta_id", maintain_order=True).agg(measures)
    overall = trials.group_by(*models, maintain_order=True).agg(
        pl.lit(None, dtype=pl.Int64).alias("theta_id"), *measures
    )
    return pl.concat([overall, per_theta])


def _named(experiment: str, table: pl.DataFrame) -> pl.DataFrame:
    return table.select(pl.lit(experiment).alias("experiment"), pl.all())
