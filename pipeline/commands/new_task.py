"""A task for somebody's own arm and recordings, proposed from both and written into params.yaml."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from pipeline import params
from pipeline.commands.proposed_features import Terms, proposed_features
from pipeline.commands.task_checks import chosen_anchor
from pipeline.commands.task_files import DvcFile
from pipeline.errors import ParameterError, few_of, one_of
from pipeline.formats.files.atomic import written_whole
from pipeline.replay.arm_proposal import UnknownArm, hand_of_scene, joints_elsewhere
from pipeline.replay.scene import Scene, load_scene
from pipeline.stages.dvc_yaml import FILE as DVC_YAML
from pipeline.stages.registry import stage
from pipeline.stages.scene import unwatched_files
from pipeline.vocabulary import RESERVED_FOLDERS
from pipeline.workspace.demonstrations import column_map
from pipeline.workspace.joint_names import matched_names, renamed
from pipeline.workspace.params_edits import entry_text, with_entry
from pipeline.workspace.project import Project
from pipeline.workspace.recorded_joints import RecordedJoints, recorded_joints
from pipeline.yaml_text import plain_yaml

COMMENTS = {
    "scene": "MJCF or URDF",
    "scene_files": "what it depends on, so that DVC notices a change",
    "end_effector": "body or site whose path matters",
    "joints": "the arm's; everything else stays where it is",
    "joint_names": "name in the recordings: name in the scene",
    "surface": "site that sampled paths stay above; null: none",
    "collisions": "true: paths may touch nothing, by MuJoCo's contacts",
    "reading": "what tables, datasets and file names mean",
    "anchor": "alternatives go from start to goal; or demonstration: as each does",
    "features": "what may matter to the person",
    "preferences": "what the planner sampler plans for",
    "thetas": "or a list of weight vectors, one number per feature",
}


@dataclass(frozen=True)
class Wishes:
    """What is said of a task beforehand; None and nothing where it is to be proposed.

    Attributes:
        name: of the task, not used before.
        scene: MJCF or URDF file.
        recordings: folder.
        end_effector: body or site whose path matters.
        joints: names of the arm's joints in the scene, in order.
        joint_names: name in the recordings: name in the scene.
        objects: bodies, nearness to which may matter.
        reading: what the recordings do not say themselves, as it stands in the task.
        own_file: whether it is to stand in `tasks/NAME.yaml` and not in params.yaml.
    """

    name: str
    scene: Path
    recordings: Path
    end_effector: str | None = None
    joints: tuple[str, ...] = ()
    joint_names: Mapping[str, str] = field(default_factory=dict)
    objects: tuple[str, ...] = ()
    reading: Mapping[str, Any] = field(default_factory=dict)
    own_file: bool = False

    @property
    def said(self) -> params.Reading | None:
        """The wished `reading`, checked.

        Raises:
            ParameterError: it is not what it may be.
        """
        if not self.reading:
            return None
        try:
            return params.Reading.model_validate(self.reading)
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            place = ".".join(str(part) for part in first["loc"][:1])
            raise ParameterError(
                f"--reading {place or 'as a whole'}: {first['msg'].removeprefix('Value error, ')}; it takes "
                f"{one_of(params.Reading.model_fields)}"
            ) from None

    @property
    def file(self) -> str:
        """Where it is to stand."""
        return f"{params.OWN_TASKS}/{self.name}.yaml" if self.own_file else params.FILE


def add_task(project: Project, wishes: Wishes) -> list[str]:
    """Add a task to params.yaml, all else left as it is, and say what was chosen and what to do next.

    Returns:
        lines: what was chosen, what is odd, what to do next.

    Raises:
        ParameterError: the name is taken or not a name, the folder holds no recordings that can be used, or these and
            the scene share no joint.
        SceneError: see `pipeline.replay.load_scene`.
    """
    require_new(project, wishes.name)
    scene, names, said = chosen_arm(wishes)
    surface = scene.box_sites()[0] if len(scene.box_sites()) == 1 else None
    choice = chosen_anchor(project, wishes.name, scene, surface, wishes.recordings, names, wishes.said)
    terms, features = proposed_features(scene, wishes.objects, choice.demonstrations)
    entry = _skeleton(project, wishes, scene, surface, names, choice.anchor, terms)
    parts = unwatched_files(project, scene.path)
    entry = {"scene": entry["scene"], **({"scene_files": parts} if parts else {}), **entry}
    dvc = DvcFile(project)
    _write(project, wishes, entry)
    remedy = dvc.follow()
    return [
        f"task {wishes.name!r} is in {wishes.file}.",
        *said,
        f"End effector: {scene.end_effector}"
        + ("." if wishes.end_effector else ", the hand of these joints; name another with --end-effector."),
        *_of_other_hands(scene),
        _of_surface(scene, surface),
        *choice.lines,
        *features,
        *(f"Of the scene: {remark}." for remark in scene.remarks),
        *_of_files(parts),
        f"Say in {wishes.file} which features matter, then run: {_next_command(project, wishes.name)}",
        *([] if remedy is None else [remedy]),
    ]


def require_new(project: Project, name: str) -> None:
    """Raise a ParameterError if a task cannot have this name."""
    if name in project.params.tasks:
        raise ParameterError(
            f"there is a task {name!r} already in {project.own_tasks.get(name, params.FILE)}; choose another name"
        )
    if name in RESERVED_FOLDERS:
        raise ParameterError(f"a task cannot be called {name!r}, since datasets/{name} is taken; choose another name")


def _write(project: Project, wishes: Wishes, entry: Mapping[str, Any]) -> None:
    """Add an entry to the tasks.

    Raises:
        ParameterError: the result would not be what parameters may be; all files are then as they were.
    """
    file = project.root / params.FILE
    text = with_entry(file.read_text(encoding="utf-8"), "tasks", wishes.name, entry, COMMENTS)
    params.parse(plain_yaml(text), str(file))
    if wishes.own_file:
        file = project.root / wishes.file
        text = f"tasks:\n{entry_text(wishes.name, entry, COMMENTS)}"
    with written_whole(file) as stream:
        stream.write(text.encode())


def _recorded(wishes: Wishes) -> RecordedJoints:
    recorded = recorded_joints(wishes.recordings, column_map(wishes.said))
    if not recorded.recordings:
        raise ParameterError(
            f"--recordings is {wishes.recordings}: no recording in it has joint states; `lessbench check` says what a "
            "file holds"
        )
    return recorded


def chosen_arm(wishes: Wishes) -> tuple[Scene, dict[str, str], list[str]]:
    """The scene with the joints that are the arm's, `joint_names`, and what was chosen.

    Raises:
        ParameterError, SceneError: see `add_task`.
    """
    recorded = _recorded(wishes)
    unknown = UnknownArm(wishes.scene)
    names = dict(wishes.joint_names) or renamed(matched_names(recorded.shared, unknown.joints))
    theirs = {ours: name for name, ours in names.items()}
    heard = [joint for joint in unknown.joints if theirs.get(joint, joint) in recorded.shared]
    if not heard:
        raise ParameterError(
            f"{wishes.scene} has the joints {one_of(unknown.joints) or '(none)'} and the recordings share "
            f"{one_of(recorded.shared) or '(none)'}; no name is the same, nor the same but for a prefix: say which is "
            "which with --joint-name RECORDED=SCENE, once for each joint"
        )
    if wishes.joints:
        joints, left = wishes.joints, {}
        missing = [joint for joint in joints if joint in unknown.joints and joint not in heard]
        if missing:
            raise ParameterError(f"no recording has joint {missing[0]!r}; all of them have {one_of(heard)}")
    else:
        arm = unknown.arm(heard)
        joints, left = arm.joints, arm.left_out
    scene = load_scene(wishes.scene, end_effector=wishes.end_effector, joints=joints)
    if wishes.end_effector is None:
        scene = load_scene(wishes.scene, end_effector=hand_of_scene(scene), joints=joints)
    names = {name: ours for name, ours in names.items() if ours in joints}
    return scene, names, _said_of_joints(scene, names, left, unknown.free_bodies, recorded)


def _said_of_joints(
    scene: Scene, names: Mapping[str, str], left: Mapping[str, str], free: list[str], recorded: RecordedJoints
) -> list[str]:
    reasons = dict.fromkeys(left.values())
    out = [f"{few_of([name for name in left if left[name] == reason], 8)} ({reason})" for reason in reasons]
    out += [f"{few_of(free)} (moves freely, not by joints)"] if free else []
    odd = [name for name in recorded.some if name in scene.joints or name in names]
    return [
        f"Joints of the arm: {', '.join(scene.joints)}, which {_all(recorded.recordings)}.",
        *([f"Left out, and kept at home: {'; '.join(out)}. Name others with --joint."] if out else []),
        *(
            [f"The recordings call them otherwise: {few_of([f'{one}: {ours}' for one, ours in names.items()])}."]
            if names
            else []
        ),
        *([f"Only some recordings have {few_of(odd)}."] if odd else []),
    ]


def _of_files(parts: list[str]) -> list[str]:
    """What is said of the files that the scene depends on."""
    return (
        [
            f"Files of the scene, whose changes DVC notices: {few_of(parts)} (scene_files), and what lies in "
            f"{' or '.join(stage('scene').inputs)}."
        ]
        if parts
        else []
    )


def _of_other_hands(scene: Scene) -> list[str]:
    others = joints_elsewhere(scene)
    return (
        [
            f"{few_of(others)} do not move it, as they are another arm's; a feature looks at the hand of "
            "that arm if it says so with `of`."
        ]
        if others
        else []
    )


def _of_surface(scene: Scene, surface: str | None) -> str:
    if surface is not None:
        return f"Surface: {surface}, the scene's one box site, which paths stay above; null in the task for none."
    boxes = scene.box_sites()
    return (
        f"Surface: none, as the scene has {len(boxes)} box sites, {one_of(boxes)}; name one in the task."
        if boxes
        else "Surface: none, as the scene has no site of type box; paths may go anywhere that the joints reach."
    )


def _skeleton(
    project: Project,
    wishes: Wishes,
    scene: Scene,
    surface: str | None,
    names: Mapping[str, str],
    anchor: str,
    terms: Terms,
) -> dict[str, Any]:
    return {
        "scene": project.named(wishes.scene),
        "end_effector": scene.end_effector,
        "joints": list(scene.joints),
        "joint_names": dict(names) or None,
        "surface": surface,
        "collisions": False,
        "recordings": project.named(wishes.recordings),
        "reading": dict(wishes.reading) or None,
        "anchor": anchor,
        "features": terms,
        "preferences": terms,
        "thetas": "grid",
    }


def _all(recordings: int) -> str:
    return "the recording has" if recordings == 1 else f"all {recordings} recordings have"


def _next_command(project: Project, name: str) -> str:
    if (project.root / DVC_YAML).is_file():
        return f"dvc repro infer@{name} for the posterior, or dvc repro inspect@{name} to look at it, too"
    return f"lessbench run {name}"
