"""Every stage, declared once: the parameters it uses, what it reads and what it makes.

`python -m pipeline.stages.dvc_yaml` writes dvc.yaml from these declarations. Each table records the parameters declared
for its stage. The commands `run`, `study`, `verify` and `catalog`, completion on the command line, docs/tables.md and
ARCHITECTURE.md follow them too.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from importlib import import_module

from pipeline.vocabulary import STUDIES
from pipeline.workspace.project import TABLES, Project


class Scope(Enum):
    """What one run of a stage is for."""

    TASK = "each task"
    SIMULATED = "each task with simulated participants"
    STUDIES = "the studies"
    PROJECT = "the whole project"


@dataclass(frozen=True)
class Stage:
    """A stage of dvc.yaml.

    In parameters and paths `{task}` stands for the name of the task. Paths begin at the project's folder.

    Attributes:
        name: in dvc.yaml.
        scope: what one run is for.
        command: of `lessbench`; the task's name follows where the scope is one task.
        module: its function `run` runs the stage.
        parameters: dotted paths in params.yaml.
        named: those of them that name a file or folder which the stage reads.
        reads: tables of the same task, or of the studies.
        inputs: other files and folders that it reads.
        makes: tables, in the order in which they are documented.
        outputs: other files and folders that it writes.
        metrics: files of headline numbers that it writes, for `dvc metrics`.
        features: whether it evaluates features, so that the feature files of the tasks are part of its code.
    """

    name: str
    scope: Scope
    command: str
    module: str
    parameters: tuple[str, ...] = ()
    named: tuple[str, ...] = ()
    reads: tuple[str, ...] = ()
    inputs: tuple[str, ...] = ()
    makes: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()
    metrics: tuple[str, ...] = ()
    features: bool = False

    @property
    def per_task(self) -> bool:
        """Whether it is run for one task at a time."""
        return self.scope in (Scope.TASK, Scope.SIMULATED)

    def run(self, project: Project, task: str | None = None) -> None:
        """Run it here and now; `task` for a stage that is run per task."""
        import_module(self.module).run(project, *([task] if self.per_task else []))


SCENE = "datasets/{task}/scene.json"
STAGES = (
    Stage(
        "scene", Scope.TASK, "scene", "pipeline.stages.scene",
        parameters=(
            "tasks.{task}.scene", "tasks.{task}.end_effector", "tasks.{task}.joints", "tasks.{task}.joint_names",
        ),
        named=("tasks.{task}.scene",),
        inputs=("datasets/robots", "datasets/scenes/parts"),
        outputs=(SCENE,),
    ),
    Stage(
        "simulate", Scope.SIMULATED, "simulate", "pipeline.stages.simulate",
        parameters=(
            "seed", "tasks.{task}.end_effector", "tasks.{task}.surface", "tasks.{task}.collisions",
            "tasks.{task}.preferences",
            "simulate.participants", "simulate.spread_rad", "simulate.skill", "simulate.hand", "simulate.topic",
            "simulate.extra_joints", "simulate.weights.{task}", "ingest.waypoints",
        ),
        inputs=(SCENE,),
        outputs=("datasets/{task}/recordings",),
        features=True,
    ),
    Stage(
        "ingest", Scope.TASK, "ingest", "pipeline.stages.ingest",
        parameters=(
            "tasks.{task}.recordings", "tasks.{task}.reading", "tasks.{task}.end_effector", "tasks.{task}.surface",
            "tasks.{task}.anchor", "ingest",
        ),
        named=("tasks.{task}.recordings",),
        inputs=(SCENE,),
        makes=("demonstrations", "rejected"),
    ),
    Stage(
        "sample", Scope.TASK, "sample", "pipeline.stages.sample",
        parameters=(
            "seed", "tasks.{task}.end_effector", "tasks.{task}.surface", "tasks.{task}.collisions",
            "tasks.{task}.anchor", "tasks.{task}.preferences",
            "ingest.waypoints", "ingest.far_ends", "ingest.far_rad", "ingest.far_m", "sample", "compute.partition",
        ),
        named=("sample.given",),
        reads=("demonstrations",),
        inputs=(SCENE,),
        makes=("alternatives", "sampling"),
        features=True,
    ),
    Stage(
        "featurize", Scope.TASK, "featurize", "pipeline.stages.featurize",
        parameters=("tasks.{task}.end_effector", "tasks.{task}.features"),
        reads=("demonstrations", "alternatives"),
        inputs=(SCENE,),
        makes=("features", "feature_units"),
        features=True,
    ),
    Stage(
        "density", Scope.TASK, "density", "pipeline.stages.density",
        parameters=("features.scale", "density", "compute.partition", "compute.memory_gb"),
        reads=("features", "feature_units"),
        makes=("scales", "densities"),
    ),
    Stage(
        "infer", Scope.TASK, "infer", "pipeline.stages.infer",
        parameters=("tasks.{task}.thetas", "infer", "compute.partition"),
        reads=("demonstrations", "features", "scales", "densities"),
        makes=("posteriors", "held_out", "support", "fits"),
    ),
    Stage(
        "explore", Scope.TASK, "explore", "pipeline.stages.explore",
        parameters=(
            "seed", "tasks.{task}.end_effector", "tasks.{task}.surface", "tasks.{task}.collisions",
            "tasks.{task}.anchor", "tasks.{task}.features", "tasks.{task}.thetas",
            "ingest.waypoints", "infer.theta_values", "infer.betas", "explore",
        ),
        reads=("demonstrations", "alternatives", "scales"),
        inputs=(SCENE,),
        makes=("choice_space", "convergence", "explored", "explored_posteriors"),
        features=True,
    ),
    Stage(
        "shift", Scope.TASK, "shift", "pipeline.stages.shift",
        parameters=(
            "seed", "tasks.{task}.end_effector", "tasks.{task}.surface", "tasks.{task}.collisions",
            "tasks.{task}.anchor", "tasks.{task}.preferences",
            "ingest.waypoints", "sample.sizes", "sample.deformation.modes", "sample.planner.width_rad",
            "robustness.samplers",
        ),
        reads=("demonstrations",),
        inputs=(SCENE,),
        makes=("shifted_alternatives", "shifted_sampling"),
        features=True,
    ),
    Stage(
        "robustness", Scope.TASK, "study robustness", "pipeline.stages.robustness",
        parameters=(
            "seed", "tasks.{task}.end_effector", "tasks.{task}.anchor", "tasks.{task}.features", "tasks.{task}.thetas",
            "density",
            "infer.theta_values", "infer.betas", "robustness.duplicates", "robustness.bandwidth_factors",
        ),
        reads=("demonstrations", "features", "scales", "shifted_alternatives"),
        inputs=(SCENE,),
        makes=(
            "shifted_features", "robustness", "robustness_posteriors", "robustness_sets", "robustness_summary",
            "robustness_anova", "robustness_post_hoc", "sensitivity", "sensitivity_summary", "duplicates",
            "duplicates_summary",
        ),
        features=True,
    ),
    Stage(
        "answer", Scope.TASK, "conclude", "pipeline.stages.answer",
        parameters=("seed", "tasks.{task}.end_effector", "tasks.{task}.features"),
        reads=(
            "demonstrations", "rejected", "alternatives", "features", "scales", "densities", "explored",
            "choice_space", "convergence", "shifted_features",
        ),
        inputs=(SCENE,),
        makes=(
            "weights", "weights_summary", "answers", "predictions", "predicted_motion", "likely_paths",
            "predictive_checks",
        ),
    ),
    Stage(
        "figures", Scope.TASK, "figures", "pipeline.stages.figures",
        parameters=("tasks.{task}.end_effector", "figures"),
        inputs=(SCENE,),
        reads=(
            "demonstrations", "rejected", "alternatives", "features", "scales", "densities", "posteriors", "held_out",
            "robustness", "robustness_summary", "robustness_sets", "robustness_posteriors", "sensitivity",
            "sensitivity_summary", "duplicates_summary", "fits", "explored", "explored_posteriors", "shifted_features",
            "predictions",
        ),
        outputs=("datasets/{task}/figures",),
        metrics=("datasets/{task}/metrics.json",),
    ),
    Stage(
        "inspect", Scope.TASK, "inspect", "pipeline.stages.inspect",
        parameters=(
            "seed", "tasks.{task}.end_effector", "tasks.{task}.recordings", "tasks.{task}.features", "sample.sampler",
            "density.bandwidth",
        ),
        reads=(
            "demonstrations", "alternatives", "features", "scales", "densities", "posteriors", "robustness_summary",
            "fits", "weights_summary", "explored_posteriors", "answers", "predicted_motion", "likely_paths",
        ),
        inputs=(SCENE,),
        outputs=("datasets/{task}/inspect.rrd",),
        features=True,
    ),
    Stage(
        "human-choice", Scope.STUDIES, "study human-choice", "pipeline.stages.human_choice",
        parameters=("studies.human_choice",),
        named=("studies.human_choice.choices",),
        makes=("human_choice_control", "human_choice_paper", "human_choice_predictions", "human_choice_tests"),
    ),
    Stage(
        "grid-world", Scope.STUDIES, "study grid-world", "pipeline.stages.grid_world",
        parameters=("seed", "studies.grid_world"),
        makes=(
            "grid_world", "grid_world_anova", "grid_world_bandwidths", "grid_world_density_1d", "grid_world_density_2d",
            "grid_world_hypotheses", "grid_world_logistic", "grid_world_paths", "grid_world_post_hoc",
            "grid_world_posteriors", "grid_world_summary",
        ),
    ),
    Stage(
        "study-figures", Scope.STUDIES, "figures studies", "pipeline.stages.figures_studies",
        parameters=("studies.grid_world.objects", "studies.grid_world.size", "figures"),
        reads=(
            "grid_world_density_1d", "grid_world_density_2d", "grid_world_paths", "grid_world_posteriors",
            "grid_world_summary", "human_choice_predictions", "human_choice_tests",
        ),
        outputs=("datasets/studies/figures",),
        metrics=("datasets/studies/metrics.json",),
    ),
    Stage(
        "study-inspect", Scope.STUDIES, "inspect studies", "pipeline.stages.inspect_studies",
        parameters=("studies.grid_world",),
        reads=(
            "grid_world_bandwidths", "grid_world_density_1d", "grid_world_density_2d", "grid_world_hypotheses",
            "grid_world_paths", "grid_world_posteriors", "grid_world_summary", "human_choice_predictions",
            "human_choice_tests",
        ),
        outputs=("datasets/studies/inspect.rrd",),
    ),
    Stage(
        "catalog", Scope.PROJECT, "catalog", "pipeline.stages.catalog",
        inputs=("schemas", TABLES, TABLES.format(task=STUDIES)),
        outputs=("datasets/catalog.duckdb",),
    ),
    Stage(
        "report", Scope.PROJECT, "report", "pipeline.stages.report",
        inputs=(
            "params.yaml", "datasets/catalog.duckdb", "datasets/{task}/figures", "datasets/{task}/metrics.json",
            "datasets/studies/figures", "datasets/studies/metrics.json",
        ),
        outputs=("datasets/report.html",),
    ),
)  # fmt: skip
BY_COMMAND = (
    Stage(
        "redraws", Scope.TASK, "study redraws", "pipeline.stages.redraws",
        parameters=(
            "seed", "tasks.{task}.end_effector", "tasks.{task}.surface", "tasks.{task}.collisions",
            "tasks.{task}.anchor", "tasks.{task}.features", "tasks.{task}.preferences", "tasks.{task}.thetas",
            "ingest.waypoints", "sample.sizes", "sample.sets", "sample.deformation.modes", "sample.planner.width_rad",
            "density.bandwidth", "infer.theta_values", "infer.betas", "robustness.redraws",
        ),
        reads=("demonstrations", "features", "scales", "choice_space", "explored"),
        inputs=(SCENE,),
        makes=(
            "redraws", "redraws_anova", "redraws_post_hoc", "redraws_leads", "redraws_held_out",
            "redraws_held_out_leads", "redraws_positions",
        ),
        features=True,
    ),
    Stage(
        "regimes", Scope.TASK, "study regimes", "pipeline.stages.regimes",
        parameters=(
            "seed", "tasks.{task}.end_effector", "tasks.{task}.surface", "tasks.{task}.collisions",
            "tasks.{task}.anchor", "tasks.{task}.features", "tasks.{task}.thetas", "ingest.waypoints",
            "density.bandwidth", "infer.theta_values", "infer.betas", "explore", "robustness.regimes",
        ),
        reads=("demonstrations", "features", "scales", "shifted_alternatives", "shifted_features", "robustness"),
        inputs=(SCENE,),
        makes=("regimes", "regimes_summary", "regimes_calibration", "regimes_held_out"),
        features=True,
    ),
    Stage(
        "section-5", Scope.PROJECT, "study section-5", "pipeline.stages.section_5",
        parameters=("figures",),
        inputs=("datasets/{task}/tables",),
        outputs=("datasets/section_5.html", "datasets/studies/section_5_figures"),
    ),
    Stage(
        "import-trips", Scope.STUDIES, "import trips", "pipeline.commands.import_trips",
        makes=("trips_network", "trips_observed"),
    ),
    Stage(
        "trips", Scope.STUDIES, "study trips", "pipeline.stages.trips",
        parameters=("seed", "figures"),
        reads=("trips_network", "trips_observed"),
        makes=(
            "trips_exact", "trips_estimates", "trips_held_out", "trips_scores", "trips_angles", "trips_routes",
            "trips_route_links", "trips_map",
        ),
        outputs=("datasets/studies/trips_figures", "datasets/trips.html"),
    ),
)  # fmt: skip
"""What DVC does not run, because the project does not have the data. The catalog takes the tables that are there."""
# parameters that may be left out; DVC cannot wait for what is not there, and then waits for the whole task instead
OPTIONAL_SECTIONS = ("explore", "figures")  # of params.yaml; a stage waits for one only if it is there
OPTIONAL = ("tasks.{task}.joints", "tasks.{task}.joint_names", "tasks.{task}.reading")
# parameters that a stage may read without declaring them, with the reason why that changes no result
UNDECLARED = {
    "tasks.{task}.scene": "the stage `scene` alone follows it; the others depend on scene.json, which changes with it",
    "tasks.{task}.joints": "likewise, as scene.json lists the joints",
    "tasks.{task}.joint_names": "likewise, as scene.json has the names",
    "tasks.{task}.scene_files": "the stage `scene` depends on the files themselves; most tasks need not name any",
    "tasks.{task}.feature_files": "stages depend on the files themselves; older parameters do not name any",
}


def stage(name: str) -> Stage:
    """The stage `name`.

    Raises:
        KeyError: there is none.
    """
    return {one.name: one for one in (*STAGES, *BY_COMMAND)}[name]


def parameters(name: str, task: str = "") -> tuple[str, ...]:
    """The parameters of the stage `name`, for `task` if it is run per task."""
    return tuple(path.format(task=task) for path in stage(name).parameters)


def table_makers(task: str) -> dict[str, Stage]:
    """Which stage makes each table of a task, or of `studies`, in the order in which they are made."""
    return {table: one for one in (*STAGES, *BY_COMMAND) if one.per_task != (task == STUDIES) for table in one.makes}
