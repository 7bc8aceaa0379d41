"""Stage: what people wanted, how sure that is and whether to trust it, and what they would do next."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence

import numpy as np
import polars as pl

from pipeline.answers.assessment import Answer, Case, assess, held_out_check
from pipeline.answers.checks import end_gap
from pipeline.answers.predictions import (
    Offer,
    beyond_sentences,
    check_rows,
    feature_rows,
    likely_rows,
    log_mass_of_cells,
    motion_rows,
)
from pipeline.answers.tables import (
    ALONE,
    GROUP,
    NEXT,
    PERSON,
    TOGETHER,
    answer_lines,
    answer_rows,
    draw_rows,
    summary_rows,
)
from pipeline.answers.words import preferences
from pipeline.arrays import FloatArray
from pipeline.choice import LESS, Boltzmann
from pipeline.choice.explored import Region
from pipeline.choice.models import Model
from pipeline.choice.prediction import PredictiveCheck, predictive
from pipeline.choice.weights import GroupDraws, WeightDraws, sample_group, sample_weights
from pipeline.errors import ArgumentError
from pipeline.formats.mcap.rejection_reasons import SET_ASIDE
from pipeline.formats.parquet.tables import write_table
from pipeline.formats.parquet.task_tables import TaskTables
from pipeline.params import Task
from pipeline.replay.replay import body_positions
from pipeline.replay.scene import Scene, model_hash, scene_files
from pipeline.stages.registry import parameters, stage
from pipeline.studies.robustness.divergence import true_direction
from pipeline.terminal import say
from pipeline.trajectories.random_streams import child_rng
from pipeline.vocabulary import ALL
from pipeline.workspace.choice_sets import Chosen, choice_tables, read_choices
from pipeline.workspace.project import Project, recorded_run
from pipeline.workspace.provenance import provenance
from pipeline.workspace.scenes import load_task_scene

PEOPLE = ("demonstration_id", "participant")


def run(project: Project, name: str) -> None:
    """Write the tables of the answer of the task `name`."""
    task = project.params.task(name)
    with (
        recorded_run(project, "answer", name) as record,
        TaskTables(choice_tables(project, name, "rejected")) as tables,
    ):
        tables.check()
        scene = load_task_scene(project, task)
        chosen = read_choices(tables, project, parameters("explore", name))
        remarks = _remarks(chosen.people, tables["rejected"].read())
        stated = provenance(
            project, parameters("answer", name), [*tables.values(), *scene_files(scene.path)], model=model_hash(scene)
        )
        rng = child_rng(project.params.seed, "answer")
        positions = _positions(scene, chosen)
        case = case_of(chosen, end_gap_of(scene, chosen, positions), remarks)
        offers = _offers(scene, chosen, positions)
        answer = assess(rng, case)
        found = preferences(answer.group.group, _specs(task, chosen.features))
        rows = answer_rows(name, found, answer.verdict, over=_over(chosen))
        made: dict[str, list[pl.DataFrame]] = {"answers": [rows]}
        for model in (LESS(case.sigma), Boltzmann()):
            known = answer if model.name == LESS.name else None
            for table, part in _of_model(rng, model, case, chosen, offers, known):
                made.setdefault(table, []).append(part)
        for table in stage("answer").makes:
            written = pl.concat(made[table]).with_columns(task=pl.lit(name))
            write_table(project.table(name, table), table, written, stated)
        for line in answer_lines(rows):
            say(line)
        record.notes += beyond_sentences(pl.concat(made["predictive_checks"]))
        record.produced = f"an answer to {rows['trust'][0]}" if rows["trust"][0] == "trust" else rows["trust"][0]


def _specs(task: Task, names: Sequence[str]) -> dict[str, dict[str, object]]:
    """The features in the order of the tables, as params.yaml has them."""
    return {name: dict(task.features[name]) if name in task.features else {} for name in names}


def _positions(scene: Scene, chosen: Chosen) -> dict[str, FloatArray]:
    """By anchor, (N, T, 3) of the end effector along the alternatives."""
    tip = scene.end_effector
    return {key: body_positions(scene, one.waypoints, [tip])[tip] for key, one in chosen.sets.items()}


def _over(chosen: Chosen) -> str | None:
    """What an answer rests on, if that is not the explored choice space."""
    if chosen.explored is not None:
        return None
    count = sum(len(one.ids) for one in chosen.sets.values()) // len(chosen.sets)
    return f"from {count:,} sampled alternatives" + ("" if chosen.shared else " for each demonstration")


Offers = Callable[[Model, str], Offer]
"""What is on offer under a model for those with an anchor."""


def _offers(scene: Scene, chosen: Chosen, positions: dict[str, FloatArray]) -> Offers:
    """The alternatives; or the trajectories that stand for the explored space, which are the same for all."""
    made: dict[tuple[str, str], Offer] = {}  # each sorts and counts neighbours once
    if chosen.explored is None:

        def of_set(model: Model, key: str) -> Offer:
            if (model.name, key) not in made:
                own = chosen.sets[key]
                scaled = own.raw / chosen.scale
                offer = Offer(own.waypoints, own.raw, scaled, positions[key], model.weigh(scaled).log_w)
                made[model.name, key] = offer
            return made[model.name, key]

        return of_set
    space, paths = chosen.explored.space, chosen.explored.waypoints
    cells, tip = Region.mean(space.regions[LESS.name]), scene.end_effector
    places = body_positions(scene, paths, [tip])[tip]
    draws = Region.mean(space.regions[Boltzmann.name])
    weights = {LESS.name: cells.log_w, Boltzmann.name: log_mass_of_cells(draws, cells.features)}
    for label, log_w in weights.items():
        some = np.isfinite(log_w)
        features = cells.features[some]
        made[label, ALL] = Offer(paths[some], features * chosen.scale, features, places[some], log_w[some])
    return lambda model, _: made[model.name, ALL]


def end_gap_of(scene: Scene, chosen: Chosen, positions: dict[str, FloatArray]) -> float | None:
    """How far people's ends are from those of their alternatives; None where the ends are one place."""
    tip = scene.end_effector
    shown = body_positions(scene, chosen.people["waypoints"].to_numpy().astype(np.float64), [tip])[tip]
    keys = list(chosen.sets) * len(shown) if chosen.shared else chosen.people["demonstration_id"].to_list()
    try:
        gaps = [end_gap(one[None], positions[key]) for one, key in zip(shown, keys, strict=False)]
    except ArgumentError:
        return None
    return float(np.median(gaps))


def _remarks(people: pl.DataFrame, rejected: pl.DataFrame) -> int:
    """Recordings that were refused or cut off."""
    refused = rejected.filter(~pl.col("reason").is_in(sorted(SET_ASIDE))).height
    return refused + int(people["salvaged"].sum())


def case_of(chosen: Chosen, gap: float | None = None, remarks: int | None = None) -> Case:
    """What an answer is computed from."""
    stated = [None if text is None else json.loads(text) for text in chosen.people["true_theta"]]
    truths = [true_direction(one, chosen.features, chosen.scale) for one in stated if one is not None]
    known = [truth for truth in truths if truth is not None]
    return Case(
        chosen.of_all({key: one.raw for key, one in chosen.sets.items()}),
        chosen.raw,
        labels(chosen.people["participant"]),
        tuple(chosen.of_all(other) for other in chosen.others),
        end_gap=gap,
        scale=chosen.scale,
        bandwidth=float(np.median([one.bandwidth for one in chosen.sets.values()])),
        truth=np.stack(known) if len(known) == len(stated) else None,
        remarks=remarks,
        space=chosen.explored.space if chosen.explored else None,
        unsettled=chosen.explored.unsettled if chosen.explored else None,
    )


def labels(participants: pl.Series) -> list[str]:
    """A label for each demonstration's person, by the order of their demonstrations: names change no result."""
    numbers = {who: f"{number:06d}" for number, who in enumerate(dict.fromkeys(participants))}
    return [numbers[who] for who in participants]


def _of_model(
    rng: np.random.Generator,
    model: Model,
    case: Case,
    chosen: Chosen,
    offers: Offers,
    known: Answer | None,
) -> Iterator[tuple[str, pl.DataFrame]]:
    """Tables with the rows of one model; of LESS the answer is known already."""
    label = model.name
    together = case.considered(model)
    parts = [together.subset(own) for own in case.groups().values()]
    names = list(dict.fromkeys(chosen.people["participant"]))
    pooled = known.pooled if known else sample_weights(rng, together, count=2048)
    group: GroupDraws = known.group if known else sample_group(rng, parts, count=512)
    following = group.next_person(rng)
    yield "weights", draw_rows(label, names, group, following)
    of: list[tuple[str, str, WeightDraws]] = [
        (GROUP, ALL, group.group),
        (NEXT, ALL, following),
        (TOGETHER, ALL, pooled),
    ]
    of += [(PERSON, who, group.person(index)) for index, who in enumerate(names)]
    of += [(ALONE, who, sample_weights(rng, part, count=512)) for who, part in zip(names, parts, strict=True)]
    yield "weights_summary", summary_rows(label, chosen.features, of, group)
    for kind, who, draws in of:
        if kind == PERSON or (kind == NEXT and chosen.shared):
            row = 0 if kind == NEXT else chosen.people["participant"].to_list().index(who)
            key = next(iter(chosen.sets)) if chosen.shared else chosen.people["demonstration_id"][row]
            offer = offers(model, key)
            p = predictive(offer.scaled, offer.log_w, draws.omega, draws.weight)
            about = {"model": pl.lit(label), "kind": pl.lit(kind), "participant": pl.lit(who)}
            yield "predictions", feature_rows(chosen.features, offer, p).with_columns(**about)
            yield "predicted_motion", motion_rows(offer, p).with_columns(**about)
            yield "likely_paths", likely_rows(offer, p).with_columns(**about)
    people = chosen.people.select(PEOPLE)
    if together.count > 1:
        check = held_out_check(together, pooled)
    else:  # there are no others to predict it from
        people, nothing = people.clear(), np.empty((0, len(chosen.features)))
        check = PredictiveCheck(nothing, nothing)
    yield "predictive_checks", check_rows(people, chosen.features, check, label)
