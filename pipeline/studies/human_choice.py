"""Section 3 of the paper: which model predicts people's choices after similar options have been added?

In the control trial people choose among dissimilar options, one per group. The shares give the reward of each group:
exp R_g is proportional to its share. In the experimental trial a group may have several options with equal rewards and
features, and each model predicts the shares. Boltzmann treats every option separately; under LESS, the options of a
group divide its weight among them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import polars as pl

from pipeline.arrays import IntArray
from pipeline.choice import LESS, Boltzmann, log_probabilities
from pipeline.errors import TableError, one_of
from pipeline.studies.goodness_of_fit import chi_square_test, wellek_minimum_epsilon

COLUMNS = ("participant", "trial", "choice", "group")
TRIALS = ("control", "experimental")

# Options of one group have the same location, those of different groups are out of the kernel's reach.
_MODELS = (Boltzmann(), LESS(bandwidth=1.0))
_FAR = 1000.0  # distance between groups, in bandwidths: the kernel exp(-10^6) is exactly zero


@dataclass(frozen=True, eq=False)
class HumanChoiceStudy:
    """Tables of the study.

    Attributes:
        control: one row per group: `group`, `count`, `share` in the control trial.
        predictions: `comparison` (`groups`: all groups; `options`: all options; `within`: the options of one group),
            `group`, `option` (null in `groups`), `model`, `count`, `observed` (share), `predicted` (probability).
        tests: one row per model and comparison (`groups` and `options`): `comparison`, `model`, `n`, `chi_square`,
            `degrees_of_freedom`, `p_value`, `minimum_epsilon` (Wellek), `alpha`.
    """

    control: pl.DataFrame
    predictions: pl.DataFrame
    tests: pl.DataFrame


def analyse_choices(
    choices: pl.DataFrame, options: Mapping[str, Sequence[str]] | None = None, alpha: float = 0.05
) -> HumanChoiceStudy:
    """Compare the choices in the experimental trial with those that each model predicts from the control trial.

    Args:
        choices: one row per participant: `participant`, `trial` (`control`, `experimental`), `choice` (any label) and
            `group` (any label). Rows whose `counted`, if there is such a column, is `no` are left out. A column
            `offered` with `option=group` for each option on offer, as `lessbench survey` writes it, says what was.
        options: for each group, the options on offer in the experimental trial. If not given, they are those that were
            in `offered`, or else were chosen at least once.
        alpha: level of Wellek's test.

    Raises:
        TableError: the table is not as described; the message names the row or label.
        ArgumentError: alpha is out of range.
    """
    _check_rows(choices)
    choices = counted(choices)
    control = choices.filter(pl.col("trial") == "control")
    experimental = choices.filter(pl.col("trial") == "experimental")
    shares = _control_shares(control)
    if experimental.height == 0:
        raise TableError("choices has no row of the experimental trial; there is nothing to compare.")
    offered = _offered(experimental, list(shares["group"]), options or _stated(experimental))
    counts = _counts(offered, experimental)
    predictions = pl.concat([_predictions(offered, counts, shares, model) for model in _MODELS])
    tests = [
        _test(predictions.filter((pl.col("comparison") == comparison) & (pl.col("model") == model.name)), alpha)
        for comparison in ("groups", "options")
        for model in _MODELS
    ]
    return HumanChoiceStudy(shares, predictions, pl.concat(tests))


def counted(choices: pl.DataFrame) -> pl.DataFrame:
    """The rows that count: without those of people who failed an attention test."""
    return choices.filter(pl.col("counted") != "no") if "counted" in choices.columns else choices


def compare_with_paper(study: HumanChoiceStudy) -> pl.DataFrame:
    """Compare the numbers that the paper prints with ours, for the paper's 77 choices.

    Returns:
        `quantity`, `comparison`, `model` (null for observations), `printed`, `value` (ours), `agrees` (`value` rounds
        to the printed number) and `note`.

    Raises:
        TableError: the choices are not those of the paper.
    """
    counts = [
        study.control["count"].to_list(),
        study.predictions.filter(_rows_of("options"), model=LESS.name)["count"].to_list(),
    ]
    if counts != [[19, 21], [15, 5, 12, 5]] or study.control["group"].to_list() != ["left", "right"]:
        raise TableError(
            "studies.human_choice.compare_with_paper is true, but these are not the paper's choices; set it to false"
        )
    observed = {row["group"]: row["observed"] for row in study.predictions.filter(_rows_of("groups")).to_dicts()}
    control = {row["group"]: row["share"] for row in study.control.to_dicts()}
    rows: list[tuple[str, str, str | None, str, float, str]] = [
        ("control share of left", "groups", None, "0.475", control["left"], ""),
        ("observed share of left", "groups", None, "0.41", observed["left"], ""),
    ]
    for (comparison, model), printed in _PAPER.items():
        test = study.tests.filter(_rows_of(comparison), model=model).row(0, named=True)
        if comparison == "groups":
            left = study.predictions.filter(_rows_of("groups"), model=model, group="left")["predicted"].item()
            rows.append(("predicted share of left", comparison, model, printed["predicted"], left, ""))
        for quantity in ("chi_square", "p_value", "minimum_epsilon", "degrees_of_freedom"):
            if quantity in printed:
                note = _MISPRINT if (comparison, quantity) == ("options", "degrees_of_freedom") else ""
                rows.append((quantity, comparison, model, printed[quantity], float(test[quantity]), note))
    columns = ("quantity", "comparison", "model", "printed", "value", "note")
    table = pl.DataFrame(rows, schema=columns, orient="row")
    agrees = [
        abs(value - float(printed)) <= 0.5000001 * 10.0 ** -_decimals(printed) for _, _, _, printed, value, _ in rows
    ]
    return table.with_columns(agrees=pl.Series(agrees)).select(*columns[:-1], "agrees", "note")


_MISPRINT = (
    "the paper's 1 degree of freedom is a misprint: four options have 3, and the paper's p values are those of 3"
)
_PAPER: dict[tuple[str, str], dict[str, str]] = {
    ("groups", Boltzmann.name): {
        "predicted": "0.23", "chi_square": "6.27", "degrees_of_freedom": "1", "minimum_epsilon": "0.39",
    },
    ("groups", LESS.name): {
        "predicted": "0.475", "chi_square": "0.72", "degrees_of_freedom": "1", "p_value": "0.4",
        "minimum_epsilon": "0.22",
    },
    ("options", Boltzmann.name): {"chi_square": "9.72", "degrees_of_freedom": "1", "minimum_epsilon": "0.36"},
    ("options", LESS.name): {
        "chi_square": "5.76", "degrees_of_freedom": "1", "p_value": "0.12", "minimum_epsilon": "0.29",
    },
}  # fmt: skip


def _check_rows(choices: pl.DataFrame) -> None:
    for name in COLUMNS:
        if name not in choices.columns:
            raise TableError(
                f"choices lacks the column {name!r}; it has {', '.join(choices.columns)}, "
                f"needed are {', '.join(COLUMNS)}."
            )
        if choices[name].null_count():
            row = int(choices[name].is_null().arg_max() or 0)
            raise TableError(
                f"choices has no {name!r} in row {row + 1}; fill in every cell or leave the participant out."
            )
    for trial in choices["trial"].unique().to_list():
        if trial not in TRIALS:
            raise TableError(
                f"choices names the trial {trial!r}; allowed are {one_of(TRIALS)}. Choices among motions of a task are "
                "read by `lessbench survey weigh`."
            )
    repeated = choices.filter(choices["participant"].is_duplicated())
    if repeated.height:
        raise TableError(
            f"participant {repeated['participant'][0]!r} has more than one row; each takes part in one trial, "
            "with one choice."
        )


def _control_shares(control: pl.DataFrame) -> pl.DataFrame:
    pairs = control.select("group", "choice").unique().sort("group", "choice")
    several = pairs.filter(pairs["group"].is_duplicated())
    if several.height:
        raise TableError(
            f"the group {several['group'][0]!r} has the options {', '.join(map(str, several['choice'][:2]))} in the "
            "control trial; needed is one option per group there."
        )
    if pairs.height < 2:
        raise TableError(f"the control trial has {pairs.height} groups that were chosen; needed are at least two.")
    counts = control.group_by("group").len("count").sort("group").with_columns(pl.col("count").cast(pl.Int64))
    # numpy, because polars divides by a scalar by multiplying with its reciprocal, which rounds differently
    share = counts["count"].to_numpy() / counts["count"].sum()
    return counts.with_columns(share=pl.Series(share))


def _offered(
    experimental: pl.DataFrame, groups: list[object], options: Mapping[str, Sequence[str]] | None
) -> pl.DataFrame:
    """The options on offer in the experimental trial (`group`, `option`), checked and sorted."""
    chosen = experimental.select("group", option="choice").unique().sort("group", "option")
    offered = chosen
    if options is not None:
        pairs = [(group, option) for group, members in options.items() for option in members]
        offered = pl.DataFrame(pairs, schema=chosen.schema, orient="row").sort("group", "option")
        unknown = chosen.join(offered, on=["group", "option"], how="anti")
        if unknown.height:
            group, option = unknown.row(0)
            raise TableError(f"the choice {option!r} of the group {group!r} is not among the options on offer; add it.")
    twice = offered.filter(offered["option"].is_duplicated())
    if twice.height:
        raise TableError(
            f"the option {twice['option'][0]!r} appears more than once, or in two groups; it belongs to one."
        )
    missing = [group for group in groups if group not in offered["group"].to_list()]
    if missing:
        raise TableError(
            f"the group {missing[0]!r} has no option in the experimental trial; if it was offered and nobody chose it, "
            "name it in `options` (studies.human_choice.options in params.yaml)."
        )
    extra = [group for group in offered["group"].to_list() if group not in groups]
    if extra:
        raise TableError(f"nobody chose the group {extra[0]!r} in the control trial, so its reward is unknown.")
    return offered


def _stated(experimental: pl.DataFrame) -> dict[str, list[str]] | None:
    """The options of each group, from the column `offered`; None without it."""
    if "offered" not in experimental.columns or experimental["offered"].null_count():
        return None
    pairs = [pair.partition("=") for row in experimental["offered"].unique().to_list() for pair in str(row).split()]
    options: dict[str, list[str]] = {}
    for option, _, group in sorted(set(pairs)):
        if group:
            options.setdefault(group, []).append(option)
    return options


def _counts(offered: pl.DataFrame, experimental: pl.DataFrame) -> IntArray:
    tallies = experimental.group_by(option="choice").len("count")
    joined = offered.join(tallies, on="option", how="left", maintain_order="left")
    return joined["count"].fill_null(0).cast(pl.Int64).to_numpy()


def _predictions(
    offered: pl.DataFrame, counts: IntArray, shares: pl.DataFrame, model: Boltzmann | LESS
) -> pl.DataFrame:
    option_groups = offered["group"].to_list()
    groups = shares["group"].to_list()
    rewards = np.log([shares["share"][groups.index(group)] for group in option_groups])
    location = _FAR * np.array([[float(option_group == group) for group in groups] for option_group in option_groups])
    p = np.exp(log_probabilities(model, rewards[:, None], [1.0], 1.0, similarity=location))
    options = offered.with_columns(count=pl.Series(counts), predicted=pl.Series(p))
    by_group = options.group_by("group", maintain_order=True).agg(
        pl.lit(None, dtype=offered.schema["option"]).alias("option"), pl.col("count").sum(), pl.col("predicted").sum()
    )
    within = options.filter(pl.len().over("group") > 1).with_columns(
        predicted=pl.col("predicted") / pl.col("predicted").sum().over("group"),
        total=pl.col("count").sum().over("group"),
    )
    total = pl.lit(int(counts.sum()), dtype=pl.Int64).alias("total")
    parts = {"groups": by_group.with_columns(total), "options": options.with_columns(total), "within": within}
    return pl.concat(
        part.select(
            pl.lit(name).alias("comparison"),
            "group",
            "option",
            pl.lit(model.name).alias("model"),
            "count",
            # there are no observed shares within a group that nobody chose
            pl.when(pl.col("total") > 0).then(pl.col("count") / pl.col("total")).alias("observed"),
            "predicted",
        )
        for name, part in parts.items()
    )


def _test(rows: pl.DataFrame, alpha: float) -> pl.DataFrame:
    counts, p = rows["count"].to_numpy(), rows["predicted"].to_numpy()
    fit = chi_square_test(counts, p)
    return pl.DataFrame(
        {
            "comparison": rows["comparison"][0],
            "model": rows["model"][0],
            "n": int(counts.sum()),
            "chi_square": fit.statistic,
            "degrees_of_freedom": fit.degrees_of_freedom,
            "p_value": fit.p_value,
            "minimum_epsilon": wellek_minimum_epsilon(counts, p, alpha),
            "alpha": alpha,
        }
    )


def _rows_of(comparison: str) -> pl.Expr:
    return pl.col("comparison") == comparison


def _decimals(printed: str) -> int:
    return len(printed.partition(".")[2])
