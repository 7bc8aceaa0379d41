"""The contents of the report: what was run, the results, and what to be careful about."""

from __future__ import annotations

import json
import platform
from collections.abc import Iterator, Mapping, Sequence
from importlib.metadata import version
from typing import Any

import polars as pl

from pipeline import params
from pipeline.answers.tables import answer_lines
from pipeline.formats.duckdb.questions import CONTENTS, ask
from pipeline.formats.mcap.rejection_reasons import SET_ASIDE
from pipeline.studies.support import beyond, chance_notes, edge_sentence
from pipeline.views.figures.captions import FURTHER_FIGURES, STUDY_FIGURES, TASK_FIGURES
from pipeline.views.findings import findings
from pipeline.views.report.html import (
    Answer,
    Folded,
    Part,
    Picture,
    Points,
    Report,
    Section,
    Table,
    Text,
    Verbatim,
    Words,
)
from pipeline.views.task_summary import theta_labels, theta_meaning
from pipeline.vocabulary import ALL, EXPLORED, INDEPENDENT, SAMPLER_SHIFT, STUDIES, WORKING, model_name
from pipeline.workspace.project import Project

LIBRARIES = ("mujoco", "numpy", "scipy", "finufft", "polars", "duckdb", "matplotlib")
_HASH_DIGITS = 16
FIRST_FIGURES = ("scene", "posterior", "predicted", "ten_posteriors")  # of a task; the others wait behind a click
WORDS = {
    "alternatives": "a trajectory that a person could have chosen instead",
    "features": "a number about a trajectory that people may care about, such as its height over the table",
    "weights": "how much more probable a choice becomes with more of a feature: in nats over the feature's range among "
    "the alternatives; a cost is negative",
    "theta": "the direction of the weights: what people want",
    "beta": "the length of the weights: how decided people are",
    "Boltzmann": "the model in which every alternative counts as one option",
    "LESS": "the model in which an alternative counts by how few others are like it",
    "posterior": "the probability of weights after the demonstrations were seen",
    "KLAggregate": "how much posteriors from different sets of alternatives differ; 0 if they are the same. The "
    "paper's is the sum over all ordered pairs of sets; here it is their mean, which does not grow with their number",
    "held-out": "predicted from the other demonstrations",
    "nat": "the unit of logarithms of probabilities; a difference of 2.3 is a factor of ten",
}
BEST = """select task, demonstration_id, participant, model, set_id, arg_max(theta_id, posterior) as theta_id
    from theta_marginals where shown group by all order by all"""
HYPOTHESES = "select distinct task, theta_id, theta from posteriors order by task, theta_id"
FEATURES = "select task, list(feature order by rowid) as features from scales group by task"
HASHES = "select distinct task, recorded_as as demonstration_id, recording_sha256 from lineage"
SIZES = (
    "select task, min(set_size) as least, max(set_size) as largest, count(distinct (anchor, set_size, set_id)) as sets \
from sampling group by task"
)
EDGE = "from beta_at_edge where shown order by all"
SPLIT = f"""select task, model, set_size, sets, answers from disagreement_between_sets
    where participant = '{ALL}' and answers > 1
      and set_size = (select max(set_size) from disagreement_between_sets where participant = '{ALL}')
    order by all"""
UNEXPLORED = "select distinct task, reason from choice_space where not explored order by all"
UNSETTLED = """select task, model, max(greatest(disagreement, change)) as apart,
        any_value(further_evaluations) as further_evaluations
    from (from convergence qualify round = max(round) over (partition by task, model))
    group by task, model having not bool_and(converged) order by all"""
APART = f"""select task, model, other_model from disagreement_between_models
    where participant = '{ALL}' and shown and theta_id <> other_theta_id order by all"""


def report(project: Project) -> Report:
    """Make the report of a project from its catalog, figures and headline numbers."""
    answers = _Answers(project)
    tasks = [name for name in project.params.tasks if name in answers.words]
    headline = {name: _metrics(project, name) for name in (*tasks, STUDIES)}
    sections = [Section("Answers", told)] if (told := _told(answers, tasks)) else []
    sections += [
        Section("In short", [*_headline(tasks, headline), *_hypotheses(answers)]),
        *(Section(f"Task: {name}", _task(project, answers, name)) for name in tasks),
        Section("What to be careful about", [Points(_warnings(project, answers, tasks))]),
    ]
    if pictures := _pictures(project, STUDIES, STUDY_FIGURES):
        sections.append(Section("Studies", [Folded("figures of the studies", pictures)]))
    sections += [
        Section("Words", [Words(WORDS)], folded=True),
        Section("Made with", _versions(project, answers, tasks), folded=True),
        Section("Parameters", _parameters(project), folded=True),
    ]
    made_by = f"lessbench {version('lessbench')}, MuJoCo {version('mujoco')}, seed {project.params.seed}"
    return Report(f"LESS Workbench: {', '.join(tasks) or 'nothing yet'}", made_by, sections)


class _Answers:
    """Answers from the catalog. Calling it asks a question; what several parts of the report need is asked once.

    Attributes:
        words: for each task with posteriors, its hypotheses in words, by theta_id.
        meaning: for each such task, what the numbers in these words mean.
        best: the most probable theta for each demonstration, all together, and model, on the working set.
    """

    def __init__(self, project: Project) -> None:
        self._catalog = project.catalog
        self._names = set(ask(self._catalog, CONTENTS)["name"])
        self.words: dict[str, tuple[str, ...]] = {}
        self.meaning: dict[str, str] = {}
        self.best = self("theta_marginals", BEST)
        features = dict(self("scales", FEATURES).iter_rows())
        hypotheses = self("posteriors", HYPOTHESES)
        for (task,), rows in () if hypotheses.is_empty() else hypotheses.group_by("task", maintain_order=True):
            thetas = pl.Series(rows["theta"].to_list()).list.to_array(len(features[task])).to_numpy()
            self.words[str(task)] = theta_labels(thetas, features[task])
            self.meaning[str(task)] = theta_meaning(thetas)

    def __call__(self, table: str, question: str) -> pl.DataFrame:
        """The answer; an empty table if the catalog has no such table or view."""
        return ask(self._catalog, question) if table in self._names else pl.DataFrame()


def _told(answers: _Answers, tasks: Sequence[str]) -> list[Part]:
    """The answer of each task, as `lessbench answer` says it."""
    rows = answers("answers", "from answers order by task, place")
    parts: list[Part] = []
    for task in tasks:
        mine = rows.filter(task=task) if rows.width else rows
        if mine.height:
            lines = answer_lines(mine)
            (trust,) = mine.filter(kind="answer")["trust"]
            place = lines.index(trust)
            below = [line.strip() for line in lines]
            parts.append(Answer(lines[0], below[1:place], trust, below[place + 1 :]))
    return parts


def _headline(tasks: Sequence[str], headline: Mapping[str, Mapping[str, Any]]) -> list[Part]:
    header = (
        "task", "model", "what they want", "P(theta)", "beta", "entropy (nat)", "held-out (nat)",
        "KLAggregate per pair, one sampler", "KLAggregate per pair, different samplers",
    )  # fmt: skip
    rows = []
    for task in tasks:
        for model, model_numbers in headline[task].items():
            if model == "recordings":
                continue
            divergence = model_numbers.get("kl_per_pair", {})
            numbers = [model_numbers[name] for name in ("best", "posterior", "beta", "entropy")]
            spread = [divergence.get(regime) for regime in (INDEPENDENT, SAMPLER_SHIFT)]
            rows.append([task, model_name(model), *numbers, model_numbers.get("held_out"), *spread])
    caption = (
        "What all demonstrations of a task together say. P(theta): probability of the most probable weights, summed "
        "over beta. Beta: the most probable one with these weights. Entropy: of the posterior over weights; 0 is "
        "certainty. The held-out score: mean log probability of a demonstration, predicted from the others. "
        "KLAggregate: how far the posteriors of one demonstration from two sets of alternatives are apart (nat; median "
        "over participants, largest sets); lower is more robust."
    )
    return [Table(caption, header, rows)] if rows else [Text("No task has a posterior yet.")]


def _hypotheses(answers: _Answers) -> list[Part]:
    tests = answers("human_choice_tests", "from human_choice_tests")
    worlds = answers("grid_world_hypotheses", "from grid_world_hypotheses")
    if tests.is_empty() or worlds.is_empty():
        return []
    rows = findings(tests, worlds).rows()
    return [
        Table(
            "The paper's hypotheses, and what the studies here say of each.",
            ("hypothesis", "claim", "outcome", "numbers"),
            rows,
        )
    ]


def _warnings(project: Project, answers: _Answers, tasks: Sequence[str]) -> list[str]:
    sentences = [
        f"Task {task}: no posterior yet; run `dvc repro`." for task in project.params.tasks if task not in tasks
    ]
    sentences += _of_recordings(answers)
    salvaged = answers("demonstrations", "from demonstrations where salvaged order by task, source")
    for task, source, lost in _rows(salvaged, "task", "source", "lost"):
        sentences.append(
            f"Task {task}: the recording {source} is cut off, and what was recorded before the cut was used. {lost}"
        )
    simulated = answers(
        "demonstrations",
        "select task, count(*) filter (simulated) as n from demonstrations group by task order by task",
    )
    sentences += [
        f"Task {task}: {n} demonstrations are simulated; nobody moved an arm."
        for task, n in _rows(simulated, "task", "n")
        if n
    ]
    for task, rows in _by_task(answers("support", "from support order by task, demonstration_id, feature")):
        sentences += [f"Task {task}: {sentence}." for sentence in beyond(rows)]
    for task, rows in _by_task(answers("fits", "from fits order by all")):
        sentences += [f"Task {task}: {sentence}." for sentence in chance_notes(rows)]
    for task, model, beta, edge in _rows(answers("posteriors", EDGE), "task", "model", "beta", "edge"):
        sentences.append(f"Task {task}: {edge_sentence(model_name(model), beta, edge)}.")
    for task, reason in _rows(answers("choice_space", UNEXPLORED), "task", "reason"):
        sentences.append(f"Task {task}: the choice space is not explored, so its answers rest on a sample: {reason}.")
    for task, model, apart, further in _rows(
        answers("convergence", UNSETTLED), "task", "model", "apart", "further_evaluations"
    ):
        more = "no number of evaluations can be foreseen" if further is None else f"about {further:,} more would do"
        sentences.append(
            f"Task {task}: under {model_name(model)} independent explorations of the choice space differ, or have "
            f"changed in their last round, by {apart:.2g} nats; {more}, as `lessbench enough {task}` says."
        )
    for task, model, other in _rows(answers("posteriors", APART), "task", "model", "other_model"):
        sentences.append(
            f"Task {task}: {model_name(model)} and {model_name(other)} disagree on what all together want."
        )
    for task, model, size, sets, different in _rows(
        answers("posteriors", SPLIT), "task", "model", "set_size", "sets", "answers"
    ):
        sentences.append(
            f"Task {task}: under {model_name(model)} the answer depends on which alternatives were drawn: {sets} sets "
            f"of {size:,} alternatives give {different} different answers."
        )
    outdated = _rows(answers("outdated", "from outdated"), "file", "input")
    if outdated:
        file, made_from = outdated[0]
        sentences.append(
            f"{len({file for file, _ in outdated})} tables are out of date, {file} among them, which was made from "
            f"another version of {made_from} than is there now; run `dvc repro`."
        )
    return sentences or ["Nothing: every recording was used, and models and sets agree."]


def _of_recordings(answers: _Answers) -> list[str]:
    """What was not used, and what was used although it is odd."""
    said = []
    for task, recordings in _by_task(answers("recordings", "from recordings order by task, source")):
        aside = recordings.filter(pl.col("reason").is_in(sorted(SET_ASIDE)))
        rejected = recordings.filter(~pl.col("used")).height - aside.height
        if rejected:
            total = recordings.height - aside.height
            said.append(f"Task {task}: {rejected} of {total} recordings were rejected; they are listed there.")
        if aside.height:
            said.append(
                f"Task {task}: {aside.height} of the files beside its recordings were set aside, such as "
                f"{aside['source'][0]} ({aside['reason'][0]}); they are listed there."
            )
    for task, people in _by_task(answers("demonstrations", "from demonstrations order by task, source")):
        remarked = people.filter(pl.col("remarks").is_not_null())
        if remarked.height:
            said.append(
                f"Task {task}: {remarked.height} of {people.height} recordings are used with remarks, such as "
                f"{remarked['source'][0]}: {remarked['remarks'][0]}. All are listed there."
            )
        if people["clock"].n_unique() > 1:
            counted = people["clock"].value_counts().sort("clock").rows()
            clocks = ", ".join(f"{clock} of {count}" for clock, count in counted)
            said.append(
                f"Task {task}: the times come from different clocks ({clocks}); set ingest.clock to use one for all."
            )
    return said


def _by_task(answer: pl.DataFrame) -> Iterator[tuple[object, pl.DataFrame]]:
    """The rows of each task; none if the catalog has no such table."""
    if answer.height:
        for (task,), rows in answer.group_by("task", maintain_order=True):
            yield task, rows


def _task(project: Project, answers: _Answers, name: str) -> list[Part]:
    task, settings = project.params.task(name), project.params
    people = answers("demonstrations", "from demonstrations order by source").filter(task=name)
    sizes = answers("sampling", SIZES).filter(task=name).to_dicts()
    drawn = "".join(
        f" {row['sets']:,} sets of {row['least']:,} to {row['largest']:,} alternatives by the sampler "
        f"{settings.sample.sampler}."
        for row in sizes
    )
    about = (
        f"{people.height} demonstrations by {people['participant'].n_unique()} people in {task.scene}.{drawn} "
        f"Features: {', '.join(task.features)}, divided by their {settings.features.scale} (none: as they are). "
        f"Bandwidth: {settings.density.bandwidth}. Weights in words are {answers.meaning[name]}."
    )
    rejected = (
        answers("rejected", "from rejected order by source").filter(task=name).select("source", "reason", "detail")
    )
    figures = {**TASK_FIGURES, **FURTHER_FIGURES}
    first = {figure: figures[figure] for figure in FIRST_FIGURES}
    others = {figure: caption for figure, caption in figures.items() if figure not in first}
    parts: list[Part] = [Text(about), *_pictures(project, name, first)]
    if rejected.height:
        parts.append(Table("Files that were not used, and why.", ("file", "reason", "detail"), rejected.rows()))
    remarked = people.filter(pl.col("remarks").is_not_null())
    if remarked.height:
        caption = "What is odd about recordings that were used, or was decided in reading them."
        parts.append(Table(caption, ("recording", "remarks"), remarked.select("source", "remarks").rows()))
    further = [_people(answers, name, people), *_pictures(project, name, others)]
    return [*parts, Folded("what each demonstration says, densities, and how robust and accurate answers are", further)]


def _people(answers: _Answers, name: str, people: pl.DataFrame) -> Table:
    best = answers.best.filter(task=name)
    models = best["model"].unique(maintain_order=True).to_list()
    answer = {
        (demonstration, participant, model): words
        for demonstration, participant, model, words in _best_words(answers, name, best)
    }
    hashes = dict(_rows(answers("lineage", HASHES).filter(task=name), "demonstration_id", "recording_sha256"))
    rows: list[list[object]] = [
        [
            row["source"],
            row["participant"],
            row["duration_s"],
            str(hashes.get(row["demonstration_id"]) or "")[:_HASH_DIGITS],
        ]
        + [answer.get((row["demonstration_id"], row["participant"], model), "not inferred yet") for model in models]
        for row in people.iter_rows(named=True)
    ]
    rows.append(["all together", "", None, "", *(answer[ALL, ALL, model] for model in models)])
    header = (
        "recording",
        "participant",
        "duration (s)",
        "SHA-256",
        *(f"wants, under {model_name(model)}" for model in models),
    )
    over = dict(_rows(best, "model", "set_id"))
    explored = [model_name(model) for model in models if over[model] == EXPLORED]
    sampled = [model_name(model) for model in models if over[model] != EXPLORED]
    said = [f"{' and '.join(explored)} over the explored choice space"] if explored else []
    said += [f"{' and '.join(sampled)} by the set of alternatives {WORKING!r}"] if sampled else []
    return Table(f"What each says: {', '.join(said)}.", header, rows)


def _best_words(answers: _Answers, name: str, best: pl.DataFrame) -> list[tuple[str, str, str, str]]:
    return [
        (demonstration, participant, model, answers.words[name][theta_id])
        for demonstration, participant, model, theta_id in _rows(
            best, "demonstration_id", "participant", "model", "theta_id"
        )
    ]


def _pictures(project: Project, name: str, captions: Mapping[str, str]) -> list[Part]:
    files = {file.stem: file for file in sorted(project.figures(name).glob("*.svg"))}
    drawn = [figure for figure in captions if figure in files]
    return [Picture(files[figure].read_bytes(), captions[figure]) for figure in drawn]


def _versions(project: Project, answers: _Answers, tasks: Sequence[str]) -> list[Part]:
    programs = [("lessbench", version("lessbench")), ("Python", platform.python_version())]
    programs += [(name, version(name)) for name in LIBRARIES]
    files = answers("files", "from files where table_name = 'posteriors'")
    rows = [
        [row["task"], row["seed"], *(str(row[key] or "")[:_HASH_DIGITS] for key in ("model", "parameters", "sha256"))]
        for row in files.iter_rows(named=True)
        if row["task"] in tasks
    ]
    parts: list[Part] = [
        Text("Equal recordings, parameters and versions give the same tables and figures, byte for byte."),
        Table("Programs.", ("program", "version"), programs),
    ]
    if rows:
        header = ("task", "seed", "compiled scene", "parameters", "posteriors.parquet")
        parts.append(
            Table(
                "What each task's posteriors were made from, and they themselves: the first digits of SHA-256.",
                header,
                rows,
            )
        )
    return parts


def _parameters(project: Project) -> list[Part]:
    files = [params.FILE, *project.own_tasks.values()]
    parts: list[Part] = [Verbatim((project.root / file).read_text(encoding="utf-8")) for file in files]
    if project.overlay is not None:
        parts += [
            Text("Given beside these, and taking their place:"),
            Verbatim(project.overlay.read_text(encoding="utf-8")),
        ]
    return parts


def _metrics(project: Project, name: str) -> dict[str, Any]:
    path = project.metrics(name)
    numbers: dict[str, Any] = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
    return numbers


def _rows(table: pl.DataFrame, *columns: str) -> list[tuple[Any, ...]]:
    return table.select(columns).rows() if table.width else []
