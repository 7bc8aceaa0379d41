"""The page on real trips: what is exact, which model predicts them, and how much that depends on the sampler."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import polars as pl

from pipeline.studies.trips.path_models import BOLTZMANN_CORRECTED, MODELS, RECURSIVE_LOGIT
from pipeline.views.report.html import Part, Picture, Points, Report, Section, Table, Text


def trips_report(tables: Mapping[str, pl.DataFrame], pictures: Mapping[str, bytes], made_by: str) -> Report:
    """The page.

    Args:
        tables: trips_exact, trips_estimates, trips_scores and trips_angles, by their names without `trips_`.
        pictures: SVG of scores, samplers and routes.
        made_by: versions and seed.
    """
    scores, angles = tables["scores"], tables["angles"]
    sizes = sorted(scores["set_size"].unique())
    samplers = sorted(scores["sampler"].unique())
    return Report(
        "Real trips: which model predicts the roads that people take",
        made_by,
        [
            Section("In short", [Points([_in_short(scores, sampler, sizes[-1]) for sampler in samplers])]),
            Section("The exact answer", _exact(tables["exact"])),
            Section(
                "Held-out scores",
                [
                    Text(
                        "Each trip is predicted with weights from the other four fifths of the trips. The score is the "
                        "log probability of the path taken among those of its set. Samplers and sizes make other sets, "
                        "so that only numbers of one column can be compared."
                    ),
                    Picture(
                        pictures["scores"],
                        "Lead over corrected Boltzmann, with 95 % intervals over trips and samplings. Above 0 the "
                        "model predicts better.",
                    ),
                    *(_scores(scores.filter(sampler=sampler), sampler, sizes) for sampler in samplers),
                ],
                opens=True,
            ),
            Section(
                "How much the sampler matters",
                [
                    Picture(pictures["samplers"], "Angle between the weights that two samplers lead to."),
                    _angles(angles, sizes),
                    _lost(tables["estimates"], float(tables["exact"]["log_likelihood"][0]), sizes),
                ],
                opens=True,
            ),
            Section(
                "The routes",
                [
                    Picture(
                        pictures["routes"],
                        "Routes of three trips. A link is as wide as the share of the routes that use it; the route "
                        "taken is black. Left: probabilities among all paths. The others choose from the set.",
                    )
                ],
                opens=True,
            ),
            Section(
                "Questions in SQL",
                [
                    Text(
                        "The tables trips_exact, trips_estimates, trips_held_out, trips_scores, trips_angles, "
                        "trips_routes, trips_route_links and trips_map are in the catalog (`lessbench catalog`)."
                    )
                ],
            ),
        ],
    )


def _in_short(scores: pl.DataFrame, sampler: str, size: int) -> str:
    rows = scores.filter(sampler=sampler, set_size=size).sort("difference", descending=True)
    ahead = [_lead(row) for row in rows.iter_rows(named=True) if row["difference_lower"] > 0]
    behind = [_lead(row) for row in rows.iter_rows(named=True) if row["difference_upper"] < 0]
    return (
        f"Sets of {size:,} draws of {sampler}: better than corrected Boltzmann are {'; '.join(ahead) or 'none'}. "
        f"Worse are {'; '.join(behind) or 'none'}. The others cannot be told from it."
    )


def _lead(row: Mapping[str, object]) -> str:
    return f"{MODELS[str(row['model'])]} {row['difference']:+.3f}"


def _exact(exact: pl.DataFrame) -> list[Part]:
    rows = [
        [
            row["feature"].replace("_", " "),
            f"{row['estimate']:.4f}",
            f"{row['standard_error']:.4f}",
            f"{row['published']:.3f}",
            f"{100 * abs(row['estimate'] / row['published'] - 1):.3f} %",
        ]
        for row in exact.iter_rows(named=True)
    ]
    return [
        Text(
            f"Boltzmann over all paths has an exact likelihood: {exact['log_likelihood_published'][0]:.4f} at the "
            f"published weights, {exact['log_likelihood'][0]:.4f} at the estimates."
        ),
        Table(
            "Weights of Boltzmann over all paths.",
            ["feature", "estimate", "standard error", "published", "differ by"],
            rows,
        ),
    ]


def _scores(rows: pl.DataFrame, sampler: str, sizes: Sequence[int]) -> Table:
    table = []
    for model, name in MODELS.items():
        of_model = {row["set_size"]: row for row in rows.filter(model=model).iter_rows(named=True)}
        table.append([name, *(_score(of_model[size], model) for size in sizes)])
    return Table(
        f"Sampler {sampler}, by draws for each trip: nats a trip, and the lead over corrected Boltzmann with its "
        "interval.",
        ["model", *(f"{size:,}" for size in sizes)],
        table,
    )


def _score(row: Mapping[str, float], model: str) -> str:
    if model == BOLTZMANN_CORRECTED:
        return f"{row['log_predictive']:.3f}"
    lead = f"{row['difference']:+.3f} ({row['difference_lower']:+.3f} to {row['difference_upper']:+.3f})"
    return f"{row['log_predictive']:.3f}; {lead}"


def _angles(angles: pl.DataFrame, sizes: Sequence[int]) -> Table:
    rows = []
    pairs = angles.select("sampler", "other_sampler").unique().sort("sampler", "other_sampler").rows()
    for model, name in MODELS.items():
        for one, other in pairs:
            part = angles.filter(model=model, sampler=one, other_sampler=other)
            by_size = {row["set_size"]: row for row in part.iter_rows(named=True)}
            if by_size:
                rows.append([name, f"{one}, {other}", *(_angle(by_size[size]) for size in sizes)])
    return Table(
        "Degrees between the weights from two samplers, by draws for each trip: mean over samplings, and their "
        "standard deviation.",
        ["model", "samplers", *(f"{size:,}" for size in sizes)],
        rows,
    )


def _angle(row: Mapping[str, float | None]) -> str:
    spread = row["spread_deg"]
    return f"{row['angle_deg']:.1f}" + ("" if spread is None else f" ± {spread:.1f}")


def _lost(estimates: pl.DataFrame, exact: float, sizes: Sequence[int]) -> Table:
    rows = []
    known = estimates.drop_nulls("log_likelihood_all_paths")
    lost = known.group_by("model", "sampler", "set_size").agg(pl.col("log_likelihood_all_paths").mean())
    values = {row[:3]: exact - row[3] for row in lost.iter_rows()}
    for model, name in MODELS.items():
        for sampler in sorted(estimates["sampler"].unique()):
            found = [values.get((model, sampler, size)) for size in sizes]
            if model != RECURSIVE_LOGIT and any(value is not None for value in found):
                rows.append([name, sampler, *("infinite" if value is None else f"{value:,.1f}" for value in found)])
    return Table(
        "What Boltzmann over all paths loses, in nats of all trips together, if it takes the weights of another model; "
        "infinite where the sum over all paths is. Models with a coefficient of their own are left out.",
        ["weights of", "sampler", *(f"{size:,}" for size in sizes)],
        rows,
    )
