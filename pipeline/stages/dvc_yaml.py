"""dvc.yaml, written from the registry of stages and from what their modules import.

`python -m pipeline.stages.dvc_yaml` writes the file of the project that it is run in. Run it after a change of the
registry, of a stage's imports or of the tasks in params.yaml, and when `sample.given`, `feature_files` or
`scene_files` name a file or no longer do.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from pathlib import Path
from types import MappingProxyType

from pipeline.formats.files.atomic import written_whole
from pipeline.params import FILE as FILE_OF_PARAMETERS
from pipeline.params import Params, value_at
from pipeline.stages.registry import OPTIONAL, OPTIONAL_SECTIONS, STAGES, Scope, Stage
from pipeline.views.figures.captions import STUDY_FIGURES, TASK_FIGURES
from pipeline.vocabulary import STUDIES
from pipeline.workspace.project import TABLES, find_project, table_path

FILE = "dvc.yaml"
WIDTH = 120
ROOT = Path(__file__).resolve().parents[2]
FOREACH = {Scope.TASK: "${tasks}", Scope.SIMULATED: "${simulate.weights}"}
# modules that find files, check parameters, report and declare: a change of them, or of what they alone import, changes
# no result
NEUTRAL = {
    "pipeline/arrays.py",
    "pipeline/errors.py",
    "pipeline/formats/files/atomic.py",
    "pipeline/formats/files/links.py",
    "pipeline/formats/files/lock.py",
    "pipeline/formats/files/parent_process.py",
    "pipeline/params/paths.py",
    "pipeline/params/reading.py",
    "pipeline/params/sections.py",
    "pipeline/params/sizes.py",
    "pipeline/plug_ins.py",
    "pipeline/stages/registry.py",
    "pipeline/terminal.py",
    "pipeline/workspace/outputs.py",
    "pipeline/yaml_text.py",
    "pipeline/workspace/compute/dask_executor.py",
    "pipeline/workspace/progress.py",
    "pipeline/workspace/project.py",
    "pipeline/workspace/trust.py",
}
MOST = 0.3  # share of the files in a folder, from which on a stage waits for the whole folder
MANY = 4  # tables of a stage, from which on it waits for the folder of all schemas
KEPT = "*kept"  # an output that a failing stage leaves as it was
HEAD = """\
# Written by `python -m pipeline.stages.dvc_yaml` from pipeline/stages/registry.py: change that, then run this.
# A stage re-runs when something that it lists has changed. One that fails leaves its outputs as they were.
"""
_PLAIN = re.compile(r"[\w./-]+")  # what YAML takes as it stands
NO_FILES: Mapping[str, str] = MappingProxyType({})


def main() -> None:
    """Write dvc.yaml of the project around the working directory."""
    project = find_project(Path.cwd())
    with written_whole(project.root / FILE) as stream:
        stream.write(dvc_yaml(project.params, project.own_tasks).encode())


def dvc_yaml(params: Params, own: Mapping[str, str] = NO_FILES) -> str:
    """The text of dvc.yaml for a project with these parameters.

    Args:
        params: of the project.
        own: files of single tasks, by the name of the task (see `pipeline.params.own_tasks`).
    """
    stages = [_stage(stage, params, own) for stage in STAGES if stage.scope is not Scope.PROJECT]
    stages[0] = stages[0].replace(KEPT, "&kept {persist: true}", 1)
    return HEAD + _variables(params, own) + "stages:\n" + "".join([*stages, *of_all_tasks(params, own)])


def of_all_tasks(params: Params, own: Mapping[str, str] = NO_FILES) -> list[str]:
    """The parts of the text that name every task: the stages of the whole project, and what `dvc plots show` shows."""
    figures = dict.fromkeys(params.tasks, TASK_FIGURES) | {STUDIES: STUDY_FIGURES}
    plots = [f"datasets/{place}/figures/{name}.svg" for place, names in figures.items() for name in names]
    stages = [_stage(stage, params, own) for stage in STAGES if stage.scope is Scope.PROJECT]
    return [*stages, _listed("", "plots", plots)]


def code_of(module: str) -> list[str]:
    """The files of code that can change what a module does, a folder standing for all that is in it.

    They are the module and what it imports, anywhere in it, and so on; without `NEUTRAL`, and without the files
    `__init__.py`, which compute nothing. A folder of which they are three tenths or more stands for it.
    """
    found: set[str] = set()
    waiting = {f"{module.replace('.', '/')}.py"}
    while waiting:
        file = waiting.pop()
        found.add(file)
        waiting |= _imported(file) - found - NEUTRAL
    gathered = {Path(file).parent for file in found if file.endswith("/__init__.py") and _imported(file)}
    files = found.union(*(_files_in(folder) for folder in gathered)) - NEUTRAL
    return sorted(_folders_for_files({file for file in files if not file.endswith("/__init__.py")}))


def _variables(params: Params, own: Mapping[str, str]) -> str:
    """What DVC reads beside params.yaml, and in which file each task stands; nothing if all stand in params.yaml."""
    if not own:
        return ""
    places = [f"    {name}: {{in: {own.get(name, FILE_OF_PARAMETERS)}}}\n" for name in params.tasks]
    return "vars:\n" + "".join(f"- {file}\n" for file in own.values()) + "- tasks:\n" + "".join(places)


def _stage(stage: Stage, params: Params, own: Mapping[str, str]) -> str:
    foreach = FOREACH.get(stage.scope)
    indent, key = ("    ", STUDIES) if foreach is None else ("      ", "${key}")
    tables = [table_path(key, table) for table in stage.reads]
    if stage.reads and not stage.makes:  # what draws many tables waits for all, in their folder
        tables = [TABLES.format(task=key)]
    places = params.tasks if stage.scope is Scope.PROJECT else [key]
    inputs = dict.fromkeys(path.format(task=place) for path in stage.inputs for place in places)
    if FILE_OF_PARAMETERS in inputs:
        inputs |= dict.fromkeys(own.values())
    schemas = [f"schemas/{table}.toml" for table in stage.makes] if len(stage.makes) < MANY else ["schemas"]
    made = [*(table_path(key, table) for table in stage.makes), *_for(stage.outputs, key)]
    return "".join(
        [
            f"  {stage.name}:\n" + (f"    foreach: {foreach}\n    do:\n" if foreach else ""),
            f"{indent}cmd: lessbench {stage.command}{f' {key}' if foreach else ''}\n",
            _listed(indent, "params", _in_files(stage, _for(watched(stage.parameters, params), key), own)),
            _listed(
                indent,
                "deps",
                [
                    *_named(stage, params),
                    *_files_of_tasks(stage, params),
                    *inputs,
                    *tables,
                    *schemas,
                    *code_of(stage.module),
                ],
            ),
            _listed(indent, "outs", made, KEPT),
            _listed(indent, "metrics", _for(stage.metrics, key), KEPT),
        ]
    )


def watched(paths: Sequence[str], params: Params) -> list[str]:
    """The parameters that DVC waits for: those of a stage that are there.

    If a task leaves some out, it is the task that holds them.
    """
    paths = [path for path in paths if path not in OPTIONAL_SECTIONS or path in params.model_fields_set]
    optional = [path for path in paths if path in OPTIONAL]
    if all(path.rpartition(".")[2] in task.model_fields_set for path in optional for task in params.tasks.values()):
        return list(paths)
    whole = {path.rpartition(".")[0] for path in optional}
    inside = {path for path in paths for folder in whole if path.startswith(f"{folder}.")}
    return [*whole, *(path for path in paths if path not in inside)]


def states_all(params: Params) -> bool:
    """Whether no task leaves out what it may, so that DVC can wait for each parameter by itself."""
    return all(set(watched(one.parameters, params)) | set(OPTIONAL_SECTIONS) >= set(one.parameters) for one in STAGES)


def _in_files(stage: Stage, paths: Sequence[str], own: Mapping[str, str]) -> list[str]:
    """The parameters, those of a task in the file in which it stands."""
    mine = [path for path in paths if path.startswith("tasks.")]
    if not own or not mine or stage.scope is not Scope.TASK:
        return list(paths)
    listed = ", ".join(f"'{path}'" for path in mine)
    return [*(path for path in paths if path not in mine), f"{{'${{item.in}}': [{listed}]}}"]


def _for(texts: Iterable[str], key: str) -> list[str]:
    return [text.format(task=key) for text in texts]


def _named(stage: Stage, params: Params) -> list[str]:
    """Files and folders that parameters name, where DVC reads their names; it cannot read that there is none."""
    own = [f"item.{path.rpartition('.')[2]}" for path in stage.named if path.startswith("tasks.")]
    others = [path for path in stage.named if not path.startswith("tasks.") and value_at(params, path) is not None]
    return [f"${{{path}}}" for path in (*own, *others)]


def _files_of_tasks(stage: Stage, params: Params) -> list[str]:
    """Those of every task, since a stage is written once for all tasks; a task without any names none to DVC."""
    tasks = params.tasks.values()
    files = [file for task in tasks if stage.features for file in task.feature_files]
    if "tasks.{task}.scene" in stage.named:
        files += [file for task in tasks for file in task.scene_files]
    return list(dict.fromkeys(files))


def _listed(indent: str, name: str, items: Sequence[str], setting: str = "") -> str:
    """A YAML list in lines of `WIDTH`."""
    lines = [f"{indent}{name}: ["]
    for item in items:
        text = item if item.startswith("{") or _PLAIN.fullmatch(item) else "'" + item.replace("'", "''") + "'"
        text = f"{text}: {setting}, " if setting else f"{text}, "
        if len(lines[-1]) + len(text) > WIDTH + 1:  # but for the last space
            lines.append(f"{indent}  ")
        lines[-1] += text
    return "\n".join(line.rstrip() for line in lines).removesuffix(",") + "]\n" if items else ""


@cache
def _imported(file: str) -> frozenset[str]:
    """The project's files that a file imports, anywhere in it."""
    found = set()
    for node in ast.walk(ast.parse((ROOT / file).read_text(encoding="utf-8"))):
        names: list[str] = []
        if isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            names = [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
        elif isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        for name in names:
            path = name.replace(".", "/")
            found |= {file for file in (f"{path}.py", f"{path}/__init__.py") if _is_code(file)}
    return frozenset(found)


def _is_code(file: str) -> bool:
    return file.startswith("pipeline/") and (ROOT / file).is_file()


def _files_in(folder: Path) -> set[str]:
    files = (ROOT / folder).rglob("*.py")
    return {file.relative_to(ROOT).as_posix() for file in files if file.name != "__init__.py"}


def _folders_for_files(files: set[str]) -> set[str]:
    """The files, with the outermost folders in place of most of the files in them."""
    found = set(files)
    folders = {folder for file in files for folder in Path(file).parents if len(folder.parts) > 1}
    for folder in sorted(folders, key=lambda path: len(path.parts)):
        inside = _files_in(folder)
        if 1 < len(inside) <= len(inside & found) / MOST and not inside & NEUTRAL:
            found = (found - inside) | {folder.as_posix()}
    return found


if __name__ == "__main__":
    main()
