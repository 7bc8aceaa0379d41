"""A task skeleton for somebody's own arm and recordings, written into params.yaml beside what is there."""

from __future__ import annotations

import io

from ruamel.yaml import YAML

from pipeline import params
from pipeline.errors import ParameterError
from pipeline.replay.scene import Scene, load_scene
from pipeline.stages.project import Project
from pipeline.stores.whole import written_whole

TABLES = (
    "demonstrations", "rejected", "alternatives", "sampling", "features", "scales", "densities", "posteriors", "held_out",
    "shifted_alternatives", "shifted_sampling", "shifted_features", "robustness", "robustness_posteriors",
    "robustness_sets", "robustness_summary", "robustness_anova", "robustness_post_hoc", "sensitivity",
    "sensitivity_summary", "duplicates", "duplicates_summary",
)  # fmt: skip


def add_task(project: Project, name: str, scene: str, recordings: str, end_effector: str | None) -> str:
    """Add the task `name` to params.yaml, comments kept, and say what to do next.

    Args:
        project: where to add it.
        name: of the task, not used before.
        scene: MJCF file, relative to the project or absolute.
        recordings: folder of MCAP files, relative to the project or absolute.
        end_effector: body or site whose path matters; None for the last body that moves.

    Raises:
        ParameterError: the name is taken or not a name, or the folder holds no recordings.
        SceneError: see `pipeline.replay.load_scene`.
    """
    if name in project.params.tasks:
        raise ParameterError(f"there is a task {name!r} already in {params.FILE}; choose another name")
    folder = project.path(recordings)
    if not any(folder.glob("*.mcap")):
        raise ParameterError(f"--recordings is {recordings}: there is no .mcap file in it; name a folder that has some")
    loaded = load_scene(project.path(scene), end_effector=end_effector)
    yaml = YAML(typ="rt")
    yaml.width = 10_000
    file = project.root / params.FILE
    document = yaml.load(file.read_text(encoding="utf-8"))
    document["tasks"][name] = _skeleton(loaded, scene, recordings)
    if loaded.goal is None:
        document["sample"]["anchor"] = "demonstration"
    text = io.StringIO()
    yaml.dump(document, text)
    params.parse(YAML(typ="safe", pure=True).load(text.getvalue()), str(file))
    with written_whole(file) as stream:
        stream.write(text.getvalue().encode())
    _feed_catalog(project, yaml, name)
    return (
        f"task {name!r} is in {params.FILE}: arm of {len(loaded.joints)} joints ({', '.join(loaded.joints)}), end "
        f"effector {loaded.end_effector}.\nSay there which features matter, then run: dvc repro inspect@{name}"
    )


def _feed_catalog(project: Project, yaml: YAML, name: str) -> None:
    """Let the catalog stage wait for the new task's tables; DVC cannot list them by itself."""
    file = project.root / "dvc.yaml"
    if not file.is_file():
        return
    document = yaml.load(file.read_text(encoding="utf-8"))
    document["stages"]["catalog"]["deps"].extend(f"datasets/{name}/{table}.parquet" for table in TABLES)
    with written_whole(file) as stream:
        yaml.dump(document, stream)


def _skeleton(scene: Scene, file: str, recordings: str) -> dict[str, object]:
    terms = {"efficiency": {"kind": "efficiency"}, "height": {"kind": "height"}}
    return {
        "scene": file,
        "end_effector": scene.end_effector,
        "surface": None,
        "recordings": recordings,
        "features": terms,
        "preferences": {name: dict(spec) for name, spec in terms.items()},
        "thetas": "grid",
    }
