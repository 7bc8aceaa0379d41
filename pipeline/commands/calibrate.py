"""`lessbench calibrate`: what as many demonstrations as these could tell, from these alternatives.

It also says whether the inference is calibrated there, by rank histograms (simulation-based calibration).
"""

from __future__ import annotations

import io
import shutil
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import polars as pl

from pipeline.answers.calibration import ENOUGH, LEVEL, Calibration, calibrate
from pipeline.choice import LESS, Boltzmann
from pipeline.choice.models import Model
from pipeline.errors import StageError
from pipeline.formats.files.atomic import folder_written_whole, written_whole
from pipeline.formats.parquet.task_tables import TaskTables
from pipeline.stages.registry import parameters
from pipeline.terminal import say
from pipeline.trajectories.random_streams import child_rng
from pipeline.views.figures.calibration import rank_histograms_figure
from pipeline.views.figures.style import printed, write_figure
from pipeline.vocabulary import TASK_ANCHOR, model_name
from pipeline.workspace.choice_sets import choice_tables, read_choices
from pipeline.workspace.progress import tracked
from pipeline.workspace.project import Project, recorded_run

FOLDER = "calibration"  # in the task's folder of datasets
CAPTION = (
    "Simulation-based calibration of {task}: how often the true weights fall into each part of their posterior, where "
    "a model infers what it chose itself. {repetitions} simulated people for each model, {demonstrations} "
    "demonstrations each. Flat is right. The grey band holds all bars of all panels together with probability 0.995 if "
    "every histogram is flat."
)
ODDS = 10
APART_DEG = 45.0


@dataclass(frozen=True)
class Wanted:
    """What to simulate.

    Attributes:
        demonstrations: in each repetition; None: as many as the task has.
        repetitions: for each model that people may choose by.
    """

    demonstrations: int | None
    repetitions: int


def run(project: Project, name: str, wanted: Wanted) -> None:
    """Simulate people on the task's own alternatives, infer them back, and say how well that went.

    The rank histograms are written into `datasets/<task>/calibration`.

    Raises:
        StageError: each demonstration has alternatives of its own.
        TableError: a table is missing or not what it should be.
    """
    task = project.params.task(name)
    if task.anchor != TASK_ANCHOR:
        raise StageError(
            f"tasks.{name}.anchor is {task.anchor}: each demonstration has alternatives of its own, and people are "
            "simulated on alternatives that all share; set it to task"
        )
    with TaskTables(choice_tables(project, name)) as tables:
        tables.check()
        chosen = read_choices(tables, project, parameters("explore", name))
    count = wanted.demonstrations or len(chosen.people)
    rng = child_rng(project.params.seed, "calibrate", count)
    own = chosen.sets[TASK_ANCHOR]
    models: dict[str, Model] = {LESS.name: LESS(own.bandwidth), Boltzmann.name: Boltzmann()}
    target = project.datasets / name / FOLDER
    with recorded_run(project, "calibrate", name) as record:
        found = calibrate(
            rng, models, own.raw / chosen.scale, count, wanted.repetitions,
            tracked=lambda numbers: tracked(numbers, f"calibrate {name}"),
        )  # fmt: skip
        said = lines(name, found, count, f"who choose from {len(own.raw):,} sampled alternatives")
        ranks = rank_table(found, chosen.features)
        if ranks.height:
            with printed(project.params.figures), folder_written_whole(target) as folder:
                about = {"task": name, "repetitions": wanted.repetitions, "demonstrations": count}
                write_figure(folder, "ranks", rank_histograms_figure(ranks), CAPTION.format(**about))
                text = io.StringIO()
                ranks.with_columns(task=pl.lit(name), demonstrations=pl.lit(count)).write_csv(text)
                with written_whole(folder / "ranks.csv") as stream:
                    stream.write(text.getvalue().encode())
            record.produced = f"ranks.svg and ranks.csv in {project.shown(target)}"
        else:
            shutil.rmtree(target, ignore_errors=True)  # those of an earlier run
            record.produced = "no rank histograms"
    for line in [*said, *rank_lines(ranks, project.shown(target))]:
        say(line)


def rank_table(found: Calibration, features: Sequence[str]) -> pl.DataFrame:
    """A row for each bin of each rank histogram, empty if there were too few repetitions.

    Columns: model; of (a feature's weight, beta or direction); from, to (ends of the bin); count; lower, upper (within
    which it should be); p_value (of the histogram); flat (whether the histogram is).
    """
    rows = [
        (model, of, number / len(one.counts), (number + 1) / len(one.counts), int(count), one.lower, one.upper,
         one.p_value, one.flat)
        for (model, of), one in found.rank_histograms(features).items()
        for number, count in enumerate(one.counts)
    ]  # fmt: skip
    return pl.DataFrame(
        rows,
        {
            "model": pl.String, "of": pl.String, "from": pl.Float64, "to": pl.Float64, "count": pl.Int64,
            "lower": pl.Float64, "upper": pl.Float64, "p_value": pl.Float64,
            "flat": pl.Boolean,
        },
        orient="row",
    )  # fmt: skip


def rank_lines(ranks: pl.DataFrame, folder: str) -> list[str]:
    """What the rank histograms say, in words."""
    if ranks.is_empty():
        return [f"no rank histograms: fewer than {ENOUGH} repetitions are too few to show anything"]
    said = []
    for model in ranks["model"].unique(maintain_order=True):
        mine = ranks.filter(model=model).group_by("of", maintain_order=True)
        each = mine.agg(flat=pl.col("flat").first(), p=pl.col("p_value").first())
        uneven = each.filter(~pl.col("flat"))["of"].to_list()
        which = f"; not {', '.join(uneven)}" if uneven else ""
        said.append(
            f"{model_name(model)} infers its own choices: {each['flat'].sum()} of {each.height} rank histograms of the "
            f"truth are flat (least p {float(each['p'].to_numpy().min()):.2g}){which}"
        )
    verdict = (
        "so nothing speaks against the calibration of the inference here; more repetitions see smaller faults"
        if ranks["flat"].all()
        else "so the inference is NOT calibrated here"
    )
    return [*said, f"{verdict}; see {folder}/ranks.svg"]


def lines(name: str, found: Calibration, demonstrations: int, what: str) -> list[str]:
    """What a calibration says, in words.

    Args:
        name: of the task.
        found: the calibration.
        demonstrations: of each repetition.
        what: people choose from.
    """
    labels = list(dict.fromkeys(chosen_by for chosen_by, _ in found.recoveries))
    repetitions = len(found.recoveries[labels[0], labels[0]].angle)
    counted = f"{demonstrations} demonstration" + ("s" if demonstrations != 1 else "")
    said = [
        f"{name}: {repetitions} simulated people for each model, {what}; {counted} each, weights drawn from the prior"
    ]
    for label, other in zip(labels, reversed(labels), strict=True):
        told, own = found.comparison(label, other), found.recoveries[label, label]
        narrow = float((np.degrees(own.cap) <= APART_DEG).mean())
        said += [
            f"if people choose by {model_name(label)}:",
            f"  {model_name(label)} is favoured in {_percent(told.favoured)} of the repetitions, by {ODDS} to 1 or "
            f"more in {_percent(told.told(ODDS))}; {model_name(other)} is wrongly favoured by {ODDS} to 1 or more in "
            f"{_percent(told.misled(ODDS))}",
            f"  the direction found is {np.degrees(np.median(own.angle)):.0f} degrees from the true one (median); the "
            f"angle that should hold it with probability {LEVEL:g} is {np.degrees(np.median(own.cap)):.0f}, and holds "
            f"it in {_percent(own.coverage())}",
            f"  weights {APART_DEG:.0f} degrees apart can be told from each other in {_percent(narrow)}",
            f"  if {model_name(other)} infers, the angle holds it in "
            f"{_percent(found.recoveries[label, other].coverage())}",
        ]
    verdict = min(found.comparison(label, other).told(ODDS) for label, other in zip(labels, labels[::-1], strict=True))
    can = "would" if verdict >= 0.5 else "would rarely" if verdict < 0.25 else "would sometimes"
    said.append(f"so {counted} {can} tell {' from '.join(map(model_name, labels))}")
    return said


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %"
