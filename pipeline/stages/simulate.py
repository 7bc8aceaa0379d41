"""Stage: simulated participants, recorded as a robot's driver would record people."""

from __future__ import annotations

import json

import numpy as np

from pipeline.errors import ParameterError, one_of
from pipeline.formats.files.atomic import folder_written_whole
from pipeline.formats.mcap.writer import METADATA, write_joint_states
from pipeline.replay.planning import Planning
from pipeline.replay.room import Room, task_anchor
from pipeline.trajectories.measured_hand import draw_habit
from pipeline.trajectories.participants import Driver, Hand, demonstrate, draw_participants, driver_messages
from pipeline.trajectories.random_streams import child_rng
from pipeline.workspace.progress import tracked
from pipeline.workspace.project import Project, recorded_run
from pipeline.workspace.scenes import load_task_scene
from pipeline.workspace.trust import register_task_kinds

FIRST_NS = 1_584_950_400_000_000_000  # 2020-03-23 08:00 UTC; each participant comes ten minutes later
SLOT_NS = 600_000_000_000
MEASURED = "measured"  # of simulate.hand


def run(project: Project, name: str) -> None:
    """Write the folder of recordings of the task's simulated participants."""
    task, settings, seed = project.params.task(name), project.params.simulate, project.params.seed
    if name not in settings.weights:
        raise ParameterError(f"simulate.weights has no task {name!r}; it has {one_of(settings.weights)}")
    with recorded_run(project, "simulate", name, (project.datasets / name / "recordings",)) as record:
        register_task_kinds(project, task)
        scene = load_task_scene(project, task)
        room = Room.of(scene, task.surface, task.collisions, task_anchor(scene), str(scene.path))
        planning = Planning.of(room, task.preferences, project.params.ingest.waypoints)
        names = planning.preferences.names
        # what people want makes them, not what the task is called
        wanted = json.dumps(
            {term: [dict(task.preferences[term]), settings.weights[name].get(term, 0.0)] for term in names}
        )
        scales = planning.scales(child_rng(seed, "simulate", wanted, "scales"))
        record.notes += [
            *room.remarks,
            *(
                f"nobody can be planned for {term!r}: it is the same for all deformations"
                for term in planning.unvaried(scales)
            ),
        ]
        theta = np.array([settings.weights[name].get(term, 0.0) for term in names])
        people = draw_participants(
            child_rng(seed, "simulate", wanted), theta, settings.participants,
            spread_rad=settings.spread_rad, skill=settings.skill,
        )  # fmt: skip
        rngs = [child_rng(seed, "simulate", wanted, person.name, "plan") for person in people]
        planned = planning.optimised(rngs, np.stack([person.theta for person in people]), scales)
        driver = Driver(scene.joints, tuple(scene.continuous.tolist()), settings.extra_joints)
        with folder_written_whole(project.datasets / name / "recordings") as folder:
            pairs = list(zip(people, planned, strict=True))
            for place, (person, path) in enumerate(tracked(pairs, f"simulate {name}")):
                rng = child_rng(seed, "simulate", wanted, person.name, "hand")
                habit = draw_habit(rng) if settings.hand == MEASURED else None
                motion = demonstrate(
                    rng, path, person.skill, Hand(), habit,
                    lower=scene.lower, upper=scene.upper, admissible=room.admissible,
                )  # fmt: skip
                log = driver_messages(rng, motion, driver, FIRST_NS + place * SLOT_NS)
                truth = dict(zip(names, (-person.theta / scales).tolist(), strict=True))
                about = {
                    "participant": person.name,
                    "task": name,
                    "simulated": "true",
                    "true_theta": json.dumps(truth),
                    "skill": repr(person.skill),
                    **({} if habit is None else {"length": repr(habit.length), "unevenness": repr(habit.unevenness)}),
                }
                write_joint_states(
                    folder / f"{person.name}.mcap", log.time_ns, log.names, log.positions,
                    topic=settings.topic, metadata={METADATA: about},
                )  # fmt: skip
        record.produced = f"{len(people)} recordings"
