"""`lessbench watch`: the posterior as people demonstrate, recording by recording, before any stage is run again.

The alternatives, their scales and their bandwidth are those of the task's tables, and so is the explored choice space;
the demonstrations are those of the folder and nothing else. The answer is that of `dvc repro` on the same recordings
with these alternatives and this choice space, whose bound on effort the recordings may move.
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import polars as pl

from pipeline.answers.tables import answer_markdown
from pipeline.arrays import FloatArray
from pipeline.choice import Posterior, entropy, log_likelihood, posterior_from
from pipeline.choice.models import choice_model
from pipeline.commands.serve import Live, announce, claimed, interrupted
from pipeline.errors import RecordingError, StageError, WorkbenchError
from pipeline.formats.files.atomic import folder_written_whole
from pipeline.formats.mcap.folder_watcher import Arrivals, News
from pipeline.formats.parquet.checked.open_table import OpenTable
from pipeline.formats.parquet.partitions import gathered
from pipeline.formats.parquet.tables import read_table, table_writer, write_table
from pipeline.formats.parquet.task_tables import TaskTables
from pipeline.formats.recordings.folders import Bag
from pipeline.params import Task
from pipeline.replay.along import along
from pipeline.replay.features import FeatureSet, bind_features
from pipeline.replay.geometry import body_poses, extract_geometry
from pipeline.replay.replay import body_positions
from pipeline.replay.scene import Scene, scene_files
from pipeline.stages.ingest import NULLABLE, REJECTED, SAME
from pipeline.stages.inspect import PATHS
from pipeline.stages.registry import parameters
from pipeline.studies.exploration import explored_posterior_rows
from pipeline.studies.posteriors import PART_ROWS, Group, groups_of, hypotheses, posterior_parts
from pipeline.terminal import plain, say
from pipeline.trajectories.random_streams import child_rng
from pipeline.views.feature_axis import FeatureAxis
from pipeline.views.rerun.live_recording import Arrival, Beginning, Believed, Watched, watched
from pipeline.views.rerun.records import AlternativeSet, Replay
from pipeline.views.rerun.server import require_listening, server
from pipeline.views.task_summary import replay_samples, theta_labels, theta_meaning
from pipeline.views.task_view import (
    ALTERNATIVE,
    EXPLORED,
    axes_of,
    map_on_axes,
    mean_posterior,
    over_what,
    read_waypoints,
)
from pipeline.views.truth import known_truth
from pipeline.vocabulary import TASK_ANCHOR, WORKING, model_name
from pipeline.workspace.demonstrations import LONGEST_NAME, NAMED_BY, Intake, demonstration
from pipeline.workspace.explored_space import ExploredSpace
from pipeline.workspace.project import Project, recorded_run
from pipeline.workspace.provenance import provenance
from pipeline.workspace.trust import register_task_kinds

if TYPE_CHECKING:
    from pipeline.views.rerun.server import Address
FOLDER = "watch"  # in the task's folder of datasets: what is kept when watching ends
TABLES = ("alternatives", "features", "scales", "densities")
LOOK_S = 0.5
_json_lines: ContextVar[bool] = ContextVar("json_lines", default=False)
POSES = 100  # configurations of alternatives that show which bodies move


@dataclass(frozen=True)
class Until:
    """When watching ends, besides Ctrl-C and SIGTERM.

    Attributes:
        demonstrations: once so many are in use.
        idle_s: once nothing has come for so long.
    """

    demonstrations: int | None = None
    idle_s: float | None = None


@dataclass(frozen=True, eq=False)
class Setting:
    """What a task's tables say before any demonstration.

    Attributes:
        name, task, scene: the task.
        intake: what its recordings are judged by.
        features: names of the features.
        axes: how they stand on an axis.
        scale: (F,) what raw values are divided by.
        raw: (N, F) raw values of the working set.
        bandwidth: of LESS on it.
        waypoints: (A, T, J) of the alternatives that are drawn.
        drawn: their paths.
        feature_set: what evaluates the features.
        thetas, betas: the hypotheses.
        space: the explored choice space.
        answer: what `lessbench answer` says of the task's own demonstrations, in Markdown; empty if there is none yet.
        sources: the tables, which are closed.
    """

    name: str
    task: Task
    scene: Scene
    intake: Intake
    features: tuple[str, ...]
    axes: tuple[FeatureAxis, ...]
    scale: FloatArray
    raw: FloatArray
    bandwidth: float
    waypoints: FloatArray
    drawn: AlternativeSet
    feature_set: FeatureSet
    thetas: FloatArray
    betas: FloatArray
    space: ExploredSpace
    answer: tuple[str, ...]
    sources: tuple[OpenTable, ...]


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
        pair = _pair(self.setting)
        return np.stack([self.setting.axes[f].shown(raw[:, f]) for f in pair], axis=1)


def run(
    project: Project, folder: Path | None, name: str | None, until: Until, live: Live | None, as_json: bool = False
) -> None:
    """Watch a folder until told to end, then keep what was found in `datasets/<task>/watch`.

    With `as_json` each line that is printed is a JSON object, for programs.

    Raises:
        StageError: it is not clear which task is meant, or its tables cannot be used.
        TableError: a table is missing or not what it should be.
    """
    _json_lines.set(as_json)
    name, folder = which_task(project, folder, name)
    address = None if live is None else claimed(live)
    with recorded_run(project, "watch", name) as record:
        setting = read_setting(project, name)
        belief = Belief(setting, project.params.infer.models)
        arrivals = Arrivals(folder)
        rejected: dict[str, dict[str, str]] = {}
        target = project.datasets / name / FOLDER
        try:
            with folder_written_whole(target) as partial:
                with _shown(partial, setting, belief, address) as shown:
                    _tell(
                        "watching",
                        f"watching {folder}{'' if folder.is_dir() else ' (not there yet)'} for {name}: "
                        f"{len(setting.raw):,} alternatives{belief.over}, {len(setting.thetas)} thetas x "
                        f"{len(setting.betas)} betas; Ctrl-C ends",
                    )
                    for path in _files(arrivals, belief, until, shown):
                        _take(path, project, belief, rejected, shown)
                if not belief.rows:
                    raise _NothingToKeep
                _write(partial, project, belief, rejected, folder)
        except _NothingToKeep:
            _tell("end", "no demonstration came, so nothing was kept")
            record.produced = "nothing: no demonstration came"
            return
        record.produced = ", ".join(_counts(belief, rejected, arrivals))
        _tell("end", f"{record.produced}; kept in {project.shown(target)}", kept=project.shown(target))
        _tell(
            "note",
            f"these posteriors come without a verdict; `lessbench answer {name}` has the verdict on the task's own "
            "demonstrations",
        )


class _NothingToKeep(Exception):
    """Leaves what an earlier run kept where it is."""


def which_task(project: Project, folder: Path | None, name: str | None) -> tuple[str, Path]:
    """The task and the folder, each of which may say the other.

    Raises:
        StageError: neither does.
    """
    tasks = project.params.tasks
    if name is not None:
        return name, folder or project.path(project.params.task(name).recordings)
    own = {key: project.path(task.recordings).resolve() for key, task in tasks.items()}
    mine = [key for key, path in own.items() if folder is not None and path == folder.resolve()]
    if len(mine) == 1 or len(tasks) == 1:
        found = mine[0] if mine else next(iter(tasks))
        return found, folder or own[found]
    said = "no folder was given" if folder is None else f"{folder} is not the folder of recordings of exactly one task"
    raise StageError(f"{said}; say which task is meant with --task: {', '.join(tasks)}")


def read_setting(project: Project, name: str) -> Setting:
    """What the tables of a task say.

    Raises:
        StageError: its alternatives belong to single demonstrations.
        TableError: a table is missing or not what it should be.
    """
    task = project.params.task(name)
    if task.anchor != TASK_ANCHOR:
        raise StageError(
            f"tasks.{name}.anchor is {task.anchor!r}: each demonstration needs alternatives of its own, which new ones "
            "do not have yet; set it to task, or run `dvc repro` after each recording"
        )
    with TaskTables(project.tables(name, TABLES)) as tables:
        sources = tuple(tables.values())
        scales = tables["scales"].read()
        names = tuple(scales["feature"])
        if set(names) != set(task.features):
            raise StageError(f"{tables['scales'].path}: has features other than tasks.{name}.features; run `dvc repro`")
        working = pl.col("set_id") == WORKING
        features = tables["features"].read(["set_id", *names], where=working)
        densities = tables["densities"].read(["alternative_id", "bandwidth", "log_density"], where=working)
        alternatives = tables["alternatives"].read(ALTERNATIVE, where=working)
        both = alternatives.join(densities, on="alternative_id", how="inner", maintain_order="left")
        if not features.height == alternatives.height == both.height > 0:
            raise StageError(
                f"{tables['densities'].path}: does not have the alternatives of alternatives.parquet; run `dvc repro`"
            )
        some = _some(project, both)
        waypoints = read_waypoints(tables["alternatives"], some["alternative_id"])
    thetas = hypotheses(task, project.params.infer, names, tuple(scales["direction"]))
    betas = np.array(project.params.infer.betas)
    register_task_kinds(project, task)
    intake = Intake.of(project, name)
    scene = intake.scene
    paths = body_positions(scene, waypoints, [scene.end_effector])[scene.end_effector]
    log_weights = -some["log_density"].to_numpy()
    return Setting(
        name=name,
        task=task,
        scene=scene,
        intake=intake,
        features=names,
        axes=axes_of(scales, waypoints.shape[1]),
        scale=scales["scale"].to_numpy(),
        raw=np.ascontiguousarray(features.select(names).to_numpy()),
        bandwidth=float(both["bandwidth"][0]),
        waypoints=waypoints,
        drawn=AlternativeSet((WORKING,), tuple(some["sampler"]), paths, log_weights, shown=True),
        feature_set=bind_features(scene, {feature: task.features[feature] for feature in names}),
        thetas=thetas,
        betas=betas,
        space=ExploredSpace.of(project.table(name, "explored"), thetas, betas),
        answer=_answer(project, name),
        sources=sources,
    )


def _answer(project: Project, name: str) -> tuple[str, ...]:
    path = project.table(name, "answers")
    return tuple(answer_markdown(read_table(path, "answers"))) if path.exists() else ()


def _some(project: Project, alternatives: pl.DataFrame) -> pl.DataFrame:
    """As many as are to be drawn, the same every time."""
    if alternatives.height <= PATHS:
        return alternatives
    rng = child_rng(project.params.seed, "watch")
    return alternatives[np.sort(rng.choice(alternatives.height, PATHS, replace=False))]


def _files(arrivals: Arrivals, belief: Belief, until: Until, shown: Watched) -> Iterator[Path]:
    """The recordings to take, one by one, until it is time to end."""
    last = time.monotonic()
    with interrupted() as stop:
        while True:
            news = arrivals.look()
            if news.whole or news.gone:
                last = time.monotonic()
            _forget(news, belief, shown)
            for path in news.whole:
                yield path
                if stop.is_set() or _enough(belief, until):
                    return
            for path in news.waiting:
                waits = f"{path.name}: not read yet, as it is not closed; its recorder may still be writing"
                _tell("waits", waits, file=path.name)
            if until.idle_s is not None and time.monotonic() - last >= until.idle_s:
                return
            if stop.wait(LOOK_S):
                return


def _enough(belief: Belief, until: Until) -> bool:
    return until.demonstrations is not None and len(belief.rows) >= until.demonstrations


def _take(path: Path, project: Project, belief: Belief, rejected: dict[str, dict[str, str]], shown: Watched) -> None:
    known = path.stem in belief.rows
    try:
        row = demonstration(Bag(path.stem, (path,)), belief.setting.intake)
        row.pop(NAMED_BY)
        _refuse_copy(row, belief)
        belief.take(row)
    except WorkbenchError as error:
        reason, detail = (
            (error.reason, error.detail) if isinstance(error, RecordingError) else ("no-likelihood", str(error))
        )
        name = plain(path.name, LONGEST_NAME + 60)
        rejected[path.name] = {"source": name, "reason": reason, "detail": detail}
        _tell("rejected", f"{name}: not used ({reason}): {detail.rstrip('.')}", file=name, reason=reason, detail=detail)
        if known:
            belief.drop(path.stem)
            shown.remove(path.stem, belief.on_map(), _believed(belief))
        return
    rejected.pop(path.name, None)
    setting = belief.setting
    shown.show(
        Arrival(
            row["demonstration_id"],
            _replay(setting.scene, row["waypoints"], row["duration_s"]),
            body_positions(setting.scene, row["waypoints"][None], [setting.scene.end_effector])[
                setting.scene.end_effector
            ][0],
            row["waypoints"],
            along(setting.feature_set, row["waypoints"][None])[0],
            belief.raw[row["demonstration_id"]],
            belief.on_map(),
            _believed(belief),
        )
    )
    line = f"{len(belief.rows):>3} {path.name}{' again' if known else ''}: {'; '.join(_lines(belief))}"
    _tell("taken", line, file=path.name, demonstrations=len(belief.rows), models=_as_data(belief))


def _refuse_copy(row: dict[str, Any], belief: Belief) -> None:
    for key, other in belief.rows.items():
        at_once = (row["start_time_ns"], row["duration_s"]) == (other["start_time_ns"], other["duration_s"])
        if key != row["demonstration_id"] and at_once and np.abs(row["waypoints"] - other["waypoints"]).max() <= SAME:
            detail = f"It holds the same recording as {other['source']}, which is used; one is one demonstration."
            raise RecordingError("copy", detail)


def _forget(news: News, belief: Belief, shown: Watched) -> None:
    for path in news.gone:
        if path.stem in belief.rows:
            belief.drop(path.stem)
            shown.remove(path.stem, belief.on_map(), _believed(belief))
            line = f"{len(belief.rows):>3} {path.name} is gone: {'; '.join(_lines(belief))}"
            _tell("gone", line, file=path.name, demonstrations=len(belief.rows), models=_as_data(belief))


def _tell(event: str, line: str, **more: object) -> None:
    """Say a line, or for programs what happened, as a JSON object on one line."""
    say(json.dumps({"event": event, "said": line, **more}) if _json_lines.get() else line)


def _as_data(belief: Belief) -> dict[str, dict[str, object]]:
    """By model, the most probable weights, their probability, and how many thetas are still plausible."""
    return {
        model: {
            "theta": dict(zip(belief.setting.features, posterior.map_theta.tolist(), strict=True)),
            "probability": float(posterior.marginal_theta[posterior.map_index]),
            "plausible": float(np.exp(entropy(posterior.marginal_theta))),
        }
        for model, posterior in belief.posteriors().items()
    }


def _lines(belief: Belief) -> list[str]:
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


def _believed(belief: Belief) -> Believed:
    """By model, the posterior over theta, the text beside it, and the truth if it is known."""
    posteriors = {model: posterior.marginal_theta for model, posterior in belief.posteriors().items()}
    lines = [
        f"# {belief.setting.name}",
        "",
        f"**{len(belief.rows)} demonstration{'s' * (len(belief.rows) != 1)}** so far, {len(belief.setting.raw):,} "
        f"alternatives{belief.over}.",
        "",
        *(f"- {line}" for line in _lines(belief)),
        "",
        f"Recordings: {', '.join(sorted(belief.rows)) or 'none yet'}.",
        "",
        "These posteriors come without a verdict, as checks need `dvc repro`. That of the task's own demonstrations:"
        if belief.setting.answer
        else "These posteriors come without a verdict: run `dvc repro`, then ask `lessbench answer` for one.",
        "",
        *belief.setting.answer,
    ]
    setting = belief.setting
    stated = [row["true_theta"] for row in belief.rows.values()]
    truth = known_truth(stated, setting.features, setting.scale, setting.thetas)
    return Believed(posteriors, "\n".join(lines), None if truth is None else truth.nearest)


@contextmanager
def _shown(partial: Path, setting: Setting, belief: Belief, address: Address | None) -> Iterator[Watched]:
    """The recording of what is watched, saved in the folder and served at the address."""
    pair = _pair(setting)
    sigma = setting.bandwidth * setting.scale
    configurations = setting.waypoints.reshape(-1, setting.waypoints.shape[-1])[: POSES * 10 : 10]
    positions, quaternions = body_poses(setting.scene, configurations)
    samples = np.arange(len(configurations))
    poses = Replay(
        extract_geometry(setting.scene.model), positions, quaternions, samples.astype(np.float64), 0 * samples
    )
    beginning = Beginning(
        task=setting.name,
        poses=poses,
        alternatives=setting.drawn,
        map=map_on_axes(
            (setting.axes[pair[0]], setting.axes[pair[1]]), setting.raw[:, pair], np.empty((0, 2)), sigma[pair]
        ),
        theta_labels=theta_labels(setting.thetas, setting.features),
        theta_meaning=theta_meaning(setting.thetas),
        joints=setting.scene.joints,
        joint_units=setting.scene.joint_units,
        axes=setting.axes,
        prior=_believed(belief),
    )
    with ExitStack() as stack:
        sinks = [] if address is None else [server(address)]
        shown = stack.enter_context(watched(partial / "inspect.rrd", beginning, *sinks))
        if address is not None:
            require_listening(address)
            announce(address, f"what is watched for {setting.name}", stay=True)
        yield shown


def _write(partial: Path, project: Project, belief: Belief, rejected: dict[str, dict[str, str]], folder: Path) -> None:
    """Tables as those of the stages, of the working set and of the explored choice space."""
    setting = belief.setting
    rows = [belief.rows[key] for key in sorted(belief.rows)]
    table = pl.DataFrame(rows, schema_overrides=NULLABLE).with_columns(
        waypoints=pl.Series(np.stack([row["waypoints"] for row in rows]))
    )
    people = table.select("demonstration_id", "participant")
    files = [folder / row["source"] for row in rows if (folder / row["source"]).is_file()]
    used = [*files, *scene_files(setting.scene.path)]
    stated = provenance(project, parameters("ingest", setting.name), used)
    write_table(partial / "demonstrations.parquet", "demonstrations", table, stated)
    write_table(partial / "rejected.parquet", "rejected", pl.DataFrame(list(rejected.values()), REJECTED), stated)
    stated = provenance(project, parameters("infer", setting.name), [*files, *setting.sources])
    with (
        table_writer(partial / "posteriors.parquet", "posteriors", stated) as writer,
        gathered(writer, PART_ROWS) as posteriors,
    ):
        groups = groups_of(people)
        for model in belief.models:
            about = {"task": setting.name, "model": model, "set_size": len(setting.raw), "set_id": WORKING}
            for part in posterior_parts(groups, belief.values(model), setting.thetas, setting.betas, about):
                posteriors.add(part)
    if setting.space.normalisers:
        stated = provenance(project, parameters("explore", setting.name), [*files, *setting.sources])
        write_table(partial / "explored_posteriors.parquet", "explored_posteriors", _explored(belief, groups), stated)


def _explored(belief: Belief, groups: Sequence[Group]) -> pl.DataFrame:
    """Rows of the table explored_posteriors."""
    setting, phi = belief.setting, belief.phi
    tables: list[pl.DataFrame] = []
    for model in (one for one in belief.models if one in setting.space.normalisers):
        by_group = [setting.space.posteriors(model, phi[rows]) for _, _, rows in groups]
        values = np.array([[one.log_probability for one in of_run] for of_run in zip(*by_group, strict=True)])
        about = {"task": setting.name, "model": model}
        tables += explored_posterior_rows(groups, values, setting.thetas, setting.betas, about)
    return pl.concat(tables)


def _counts(belief: Belief, rejected: dict[str, dict[str, str]], arrivals: Arrivals) -> list[str]:
    unfinished = [path for path in arrivals.open if path.name not in rejected and path.stem not in belief.rows]
    return [
        f"{len(belief.rows)} demonstration{'s' * (len(belief.rows) != 1)}",
        *([f"{len(rejected)} not used"] if rejected else []),
        *([f"{len(unfinished)} never closed ({', '.join(path.name for path in unfinished)})"] if unfinished else []),
    ]


def _replay(scene: Scene, waypoints: FloatArray, duration_s: float) -> Replay:
    configurations, time_s, which = replay_samples(waypoints[None], np.array([duration_s]))
    positions, quaternions = body_poses(scene, configurations)
    return Replay(extract_geometry(scene.model), positions, quaternions, time_s, which)


def _pair(setting: Setting) -> list[int]:
    return [0, min(1, len(setting.features) - 1)]
