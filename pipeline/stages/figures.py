"""Stage: the figures of a task, and its headline numbers, from its tables and its scene."""

from __future__ import annotations

import numpy as np
import polars as pl

from pipeline.arrays import FloatArray
from pipeline.formats.mcap.rejection_reasons import SET_ASIDE
from pipeline.formats.parquet.checked.open_table import OpenTable
from pipeline.formats.parquet.tables import read_table
from pipeline.formats.parquet.task_tables import TaskTables
from pipeline.replay.picture import named_things, take_picture
from pipeline.replay.replay import body_positions
from pipeline.replay.scene import Scene
from pipeline.studies.robustness.samplings import COMPARED
from pipeline.views.figures.folder import write_figures
from pipeline.views.figures.held_out import held_out_figure
from pipeline.views.figures.predicted import predicted_figure
from pipeline.views.figures.robustness import (
    accuracy_figure,
    duplicates_figure,
    importance_figure,
    kl_figure,
    sensitivity_figure,
    two_posteriors_figure,
)
from pipeline.views.figures.scene import HEIGHT, WIDTH, scene_figure
from pipeline.views.figures.style import Figure, printed
from pipeline.views.figures.task import (
    before_after_figure,
    densities_figure,
    map_figure,
    posterior_figure,
    regions_figure,
)
from pipeline.views.headline import task_headline
from pipeline.views.intervals import compare_models, differences
from pipeline.views.robustness import POINT, SETTING, Example, accuracy, changed_answers, example, middle_size, per_pair
from pipeline.views.task_view import INPUTS, TaskView, task_view
from pipeline.vocabulary import ALL, BOLTZMANN, KNOWN_DENSITY, LESS, SAMPLER_SHIFT, WORKING
from pipeline.workspace.project import Project, recorded_run
from pipeline.workspace.scenes import load_task_scene

BOTH = (BOLTZMANN, LESS)
EXPLORED_TABLES = ("explored", "shifted_features")
ROBUSTNESS = (
    "robustness", "robustness_summary", "robustness_sets", "robustness_posteriors", "sensitivity",
    "sensitivity_summary",
    "duplicates_summary",
)  # fmt: skip


def run(project: Project, name: str) -> None:
    """Write the figures and metrics.json of the task `name`."""
    task = project.params.task(name)
    with (
        recorded_run(project, "figures", name, (project.figures(name), project.metrics(name))) as record,
        printed(project.params.figures),
        TaskTables(project.tables(name, INPUTS)) as inputs,
        TaskTables(project.tables(name, ("held_out", "rejected", *ROBUSTNESS))) as results,
    ):
        view = task_view(inputs, project.table(name, "explored_posteriors"))
        final = {model: steps[-1].marginal_theta for model, steps in view.beliefs.items()}
        figures = {
            "scene": _scene(load_task_scene(project, task), view.demonstrations["waypoints"].to_numpy()),
            "densities": densities_figure(view.curves),
            "density_map": map_figure(view.map),
            "posterior": posterior_figure(final, view.labels, view.meaning, view.over, view.nearest_truth),
        }
        held_out = results["held_out"].read(where=pl.col("set_id") == WORKING)
        if held_out.height:
            figures["held_out"] = held_out_figure(held_out, compare_models(held_out), differences(held_out))
        predictions = project.table(name, "predictions")
        if predictions.exists():
            following = read_table(predictions, "predictions").filter(kind="next")
            if following.height:
                figures["predicted"] = predicted_figure(following, view.axes, view.demonstration_phi)
        summary = pairs = None
        if project.table(name, ROBUSTNESS[0]).exists():
            figures |= _robustness(results, view)
            summary = results["robustness_summary"].read()
            pairs = per_pair(summary, results["robustness"].read(), POINT)
            figures |= _explored(project, name, view, results["robustness_posteriors"])
        else:
            record.notes.append(f"no robustness study yet, so none of its figures: lessbench study robustness {name}")
        rejected = results["rejected"].read(where=~pl.col("reason").is_in(sorted(SET_ASIDE))).height
        recordings = view.demonstrations.height, rejected
        beliefs = {model: steps[-1] for model, steps in view.beliefs.items()}
        numbers = task_headline(beliefs, view.labels, held_out, summary, recordings, view.fits, view.resting_on, pairs)
        write_figures(project, name, figures, numbers)
        record.produced = f"{len(figures)} figures"


def _scene(scene: Scene, waypoints: FloatArray) -> Figure:
    """The arm where motions start, by the scene's keyframe or as the first demonstration (n, T, J) does."""
    paths = body_positions(scene, waypoints, [scene.end_effector])[scene.end_effector]
    start = waypoints[0, 0] if scene.start is None else scene.start
    return scene_figure(take_picture(scene, start, paths.reshape(-1, 3), WIDTH, HEIGHT), paths, named_things(scene))


def _robustness(tables: TaskTables, view: TaskView) -> dict[str, Figure]:
    robustness = tables["robustness"].read()
    of_all = tables["robustness_posteriors"].read(where=pl.col("demonstration_id") == ALL)
    truth = accuracy(robustness, of_all, None if view.truth is None else view.truth.mean)
    shown = _example(tables["robustness_posteriors"])
    sensitivity = tables["sensitivity"].read()
    size = middle_size(sensitivity)
    summary = per_pair(tables["robustness_summary"].read(), robustness, POINT)
    sets = tables["robustness_sets"].read()
    varied = tables["sensitivity_summary"].read(where=pl.col("set_size") == size)
    figures = {
        "robustness": kl_figure(summary),
        "two_posteriors": two_posteriors_figure(shown.posteriors, shown.set_ids, view.labels, view.meaning),
        "duplicates": duplicates_figure(tables["duplicates_summary"].read()),
        "sensitivity": sensitivity_figure(
            per_pair(varied, sensitivity, SETTING), changed_answers(sensitivity.filter(set_size=size))
        ),
    }
    if KNOWN_DENSITY in summary["regime"]:
        alike = pl.col("model").is_in(COMPARED)
        figures["importance"] = importance_figure(summary.filter(alike), truth.filter(alike), sets)
    if truth.height:
        figures["accuracy"] = accuracy_figure(truth, len(view.labels))
    return figures


def _explored(project: Project, name: str, view: TaskView, posteriors: OpenTable) -> dict[str, Figure]:
    """What ten samplers reach and say, beside the explored choice space; nothing if that is not explored."""
    paths = [project.table(name, table) for table in EXPLORED_TABLES]
    if not all(path.exists() for path in paths):
        return {}
    regions, drawn = (OpenTable(path, table) for path, table in zip(paths, EXPLORED_TABLES, strict=True))
    with regions, drawn:
        region = regions.read(["exploration", "model", "features"], where=pl.col("model") == LESS)
        if region.is_empty() or not set(BOTH) <= set(view.explorations):
            return {}
        pair = [view.features[f] for f in (view.by_weight[0], view.by_weight[min(1, len(view.features) - 1)])]
        places = [view.features.index(feature) for feature in pair]
        largest = pl.col("set_size") == pl.col("set_size").max()
        sets = drawn.read(["set_id", "set_size", *view.features]).filter(largest)
        first = region.filter(exploration=region["exploration"][0])["features"].to_numpy()
        one = view.demonstrations["demonstration_id"][0]
        shifted = (pl.col("regime") == SAMPLER_SHIFT) & (pl.col("demonstration_id") == one)
        sampled = posteriors.read(where=shifted & pl.col("model").is_in(BOTH)).filter(largest)
    shown = {
        str(key): view.shown(rows.select(view.features).to_numpy())[:, places]
        for (key,), rows in sets.group_by("set_id", maintain_order=True)
    }
    return {
        "regions": regions_figure(
            shown,
            view.shown(first * view.scale)[:, places],
            view.shown(view.demonstration_phi)[:, places],
            (view.axes[places[0]].label, view.axes[places[1]].label),
        ),
        "ten_posteriors": before_after_figure(
            _marginals(sampled), {model: view.explorations[model] for model in BOTH}, view.labels, view.meaning
        ),
    }


def _marginals(rows: pl.DataFrame) -> dict[str, FloatArray]:
    """By model, the posterior over theta, a row for each set."""
    found = {}
    for model in BOTH:
        sets = rows.filter(model=model).sort("theta_id").partition_by("set_id", maintain_order=True)
        found[model] = np.stack([one["posterior"].to_numpy() for one in sets])
    return found


def _example(posteriors: OpenTable) -> Example:
    """The example of a table that may be large: only the rows that it shows are read in full."""
    size = middle_size(posteriors.read(["set_size"]))
    first = posteriors.part(0, ["demonstration_id"]).filter(pl.col("demonstration_id") != ALL).item(0, 0)
    return example(posteriors.read(where=(pl.col("set_size") == size) & (pl.col("demonstration_id") == first)))
