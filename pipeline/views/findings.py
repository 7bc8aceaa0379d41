"""The outcomes of the paper's hypotheses H1 to H5, in words with their numbers."""

from __future__ import annotations

import polars as pl

from pipeline.vocabulary import BOLTZMANN, LESS, LESS_HIDDEN, LESS_HIDDEN_OWN_BANDWIDTH, model_name

ALPHA = 0.05
_HIDDEN = {
    LESS_HIDDEN: "people who choose by LESS and also see mean x and mean y (robot's bandwidth)",
    LESS_HIDDEN_OWN_BANDWIDTH: "people who choose by LESS and also see mean x and mean y (bandwidth of their own)",
}


def findings(tests: pl.DataFrame, hypotheses: pl.DataFrame) -> pl.DataFrame:
    """The outcome of every hypothesis, one row per variant of it.

    Args:
        tests: the table `human_choice_tests`.
        hypotheses: the table `grid_world_hypotheses`.

    Returns:
        `hypothesis`, `claim`, `outcome` (`supported`, `not supported`, or a comparison for H2) and `numbers`.
    """
    rows = [*_human_choice(tests), *(_grid_world(row) for row in hypotheses.iter_rows(named=True))]
    return pl.DataFrame(rows, schema=["hypothesis", "claim", "outcome", "numbers"], orient="row")


def _human_choice(tests: pl.DataFrame) -> list[tuple[str, str, str, str]]:
    boltzmann, less = (tests.filter(comparison="groups", model=model).row(0, named=True) for model in (BOLTZMANN, LESS))
    differs = boltzmann["p_value"] < ALPHA
    tighter = less["minimum_epsilon"] < boltzmann["minimum_epsilon"]
    fits = less["p_value"] >= ALPHA
    if fits and tighter:
        equivalent = "no difference found; the tighter bound"
    else:
        equivalent = "no difference found; the looser bound" if fits else "they differ"
    return [
        ("H1", "observed shares differ from Boltzmann's", "supported" if differs else "not supported", _fit(boltzmann)),
        ("H2", "observed shares are equivalent to those of LESS", equivalent, _fit(less)),
    ]


def _fit(test: dict[str, float]) -> str:
    return (
        f"chi-square({test['degrees_of_freedom']}) = {test['chi_square']:.2f}, {_p(test['p_value'])}; "
        f"minimum epsilon {test['minimum_epsilon']:.2f}"
    )


def _grid_world(row: dict[str, object]) -> tuple[str, str, str, str]:
    expected, other = model_name(str(row["expected"])), model_name(str(row["other"]))
    sampling = str(row["sampling_model"])
    people = _HIDDEN.get(sampling) or f"people who choose by {model_name(sampling)}"
    numbers = (
        f"TruePosterior {row['posterior_expected']:.2f} against {row['posterior_other']:.2f}, "
        f"{_p(row['posterior_p_value'])}; "
        f"TrueMatch {row['match_expected']:.2f} against {row['match_other']:.2f}, {_p(row['match_p_value'])}"
    )
    claim = f"{people}: inference by {expected} is better than by {other}"
    return str(row["hypothesis"]), claim, "supported" if row["supported"] else "not supported", numbers


def _p(value: object) -> str:
    if value is None:
        return "p undefined"
    return "p < 0.001" if float(str(value)) < 0.001 else f"p = {value:.3f}"
