"""From nothing to a posterior with other people's arms: `python -m benchmarks.arms [ARM...] [--robosuite WHEEL]`.

Every arm gets a project of its own with the parameters of this one, recordings of six simulated people, `lessbench
new-task` and the stages up to the posterior, as `dvc repro infer@TASK` runs them. Nothing is edited by hand. The models
of Panda, UR5e and Gen3 come from robosuite's wheel, which pip downloads unless it is named; without it they are
skipped.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
import time
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from pipeline.formats.mcap.joint_states import write_joint_states
from pipeline.replay.scene import Scene, load_scene

ROOT = Path(__file__).resolve().parents[1]
STAGES = ("scene", "ingest", "sample", "featurize", "density", "infer", "explore")
PEOPLE = 6
ROBOTS, GRIPPERS = "robosuite/models/assets/robots", "robosuite/models/assets/grippers"
URDF = """<robot name="bench"><link name="base"/><link name="l1"/>{links}<link name="tool0"/><link name="finger"/>
{joints}<joint name="fixed" type="fixed"><parent link="l5"/><child link="tool0"/><origin xyz="0.25 0 0"/></joint>
<joint name="gripper_finger" type="prismatic"><parent link="tool0"/><child link="finger"/><axis xyz="0 1 0"/>
<limit lower="0" upper="0.04" effort="1" velocity="1"/></joint></robot>"""
LINK = """<link name="l{n}"><collision><origin xyz="0.12 0 0" rpy="0 1.5708 0"/><geometry>
<mesh filename="package://bench_description/meshes/l{n}.stl"/></geometry></collision></link>"""
JOINT = """<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/><origin xyz="{at}"/>
<axis xyz="{axis}"/><limit lower="-2.6" upper="2.6" effort="1" velocity="1"/></joint>"""
PLANAR = """<mujoco><compiler angle="radian"/><worldbody>
<body name="rail" pos="0 0 0.3"><joint name="rail" type="slide" axis="1 0 0" range="-1 1"/>
<geom type="box" size=".1 .1 .05"/>
<body name="upper"><joint name="shoulder" axis="0 0 1" range="-3 3"/>
<geom type="capsule" size=".03" fromto="0 0 0 .4 0 0"/>
<body name="fore" pos=".4 0 0"><joint name="elbow" axis="0 0 1" range="-2.5 2.5"/>
<geom type="capsule" size=".02" fromto="0 0 0 .3 0 0"/><site name="tip" pos=".3 0 0"/></body></body></body>
<body name="drawer" pos="0 1 .3"><joint name="drawer" type="slide" range="0 .3"/>
<geom type="box" size=".1 .1 .1"/></body>
<body name="mug" pos=".5 .5 .3"><freejoint/><geom type="cylinder" size=".04 .06"/></body></worldbody></mujoco>"""


@dataclass(frozen=True)
class Lab:
    """What somebody comes with.

    Attributes:
        file: scene or arm.
        words: for `lessbench new-task`, beside the file and the recordings.
        joints: of the arm, as the file calls them, in order.
        hand: body or site that is kept above the table.
        recorded: what the recordings call a joint.
        others: joints that the recordings have besides.
    """

    file: Path
    words: tuple[str, ...]
    joints: tuple[str, ...]
    hand: str
    recorded: Callable[[str], str] = str
    others: tuple[str, ...] = ()


def panda_with_gripper(folder: Path, models: Path) -> Lab:
    spec = mujoco.MjSpec.from_file(str(models / ROBOTS / "panda/robot.xml"))
    hand = next(body for body in spec.bodies if body.name == "right_hand")
    gripper = mujoco.MjSpec.from_file(str(models / GRIPPERS / "panda_gripper.xml"))
    for part, home in ((spec, "robots/panda"), (gripper, "grippers")):
        for mesh in part.meshes:
            mesh.file = str(models / "robosuite/models/assets" / home / mesh.file)
    hand.add_frame().attach_body(gripper.worldbody.first_body(), "gripper_", "")
    file = folder / "panda.xml"
    file.write_text(spec.to_xml())
    joints = tuple(f"joint{n}" for n in range(1, 8))
    return Lab(
        file, ("--scene", str(file)), joints, "gripper_grip_site", lambda name: f"fr3_{name}",
        ("fr3_finger_joint1", "fr3_finger_joint2"),
    )  # fmt: skip


def ur5e(folder: Path, models: Path) -> Lab:
    file = models / ROBOTS / "ur5e/robot.xml"
    joints = tuple(
        f"{name}_joint" for name in ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
    )
    return Lab(file, around(file), joints, "right_hand", lambda name: f"ur5e/{name}")


def gen3(folder: Path, models: Path) -> Lab:
    file = models / ROBOTS / "kinova3/robot.xml"
    joints = tuple(f"Actuator{n}" for n in range(1, 8))
    return Lab(
        file, around(file), joints, "right_hand", lambda name: name.replace("Actuator", "joint_"), ("finger_joint",)
    )


def urdf(folder: Path, models: Path | None) -> Lab:
    parts = [("j1", "base", "l1", "0 0 0.4", "0 0 1"), ("j2", "l1", "l2", "0 0 0.1", "0 1 0")]
    parts += [
        (f"j{n}", f"l{n - 1}", f"l{n}", "0.25 0 0", axis) for n, axis in ((3, "0 1 0"), (4, "1 0 0"), (5, "0 1 0"))
    ]
    keys = ("name", "parent", "child", "at", "axis")
    joints = "".join(JOINT.format(**dict(zip(keys, one, strict=True))) for one in parts)
    file = folder / "bench_description" / "urdf" / "bench.urdf"
    file.parent.mkdir(parents=True)
    file.write_text(URDF.format(links="".join(LINK.format(n=n) for n in range(2, 6)), joints=joints))
    return Lab(file, around(file), tuple(one[0] for one in parts), "tool0", str, ("gripper_finger",))


def planar(folder: Path, models: Path | None) -> Lab:
    file = folder / "planar.xml"
    file.write_text(PLANAR)
    return Lab(file, ("--scene", str(file)), ("rail", "shoulder", "elbow"), "tip")


def two_arms(folder: Path, models: Path) -> Lab:
    spec = mujoco.MjSpec()
    for prefix, y in (("left_", 0.4), ("right_", -0.4)):
        arm = mujoco.MjSpec.from_file(str(models / ROBOTS / "ur5e/robot.xml"))
        for mesh in arm.meshes:
            mesh.file = str(models / ROBOTS / "ur5e" / mesh.file)
        spec.worldbody.add_frame(pos=[0, y, 0]).attach_body(arm.worldbody.first_body(), prefix, "")
    file = folder / "two.xml"
    file.write_text(spec.to_xml())
    one = ur5e(folder, models).joints
    joints = tuple(f"{side}_{name}" for side in ("left", "right") for name in one)
    return Lab(file, ("--scene", str(file)), joints, "right_right_hand", lambda name: name.replace("_", "/", 1))


LABS = {
    "panda_with_gripper": panda_with_gripper, "ur5e": ur5e, "gen3": gen3, "urdf": urdf, "planar_on_a_slide": planar,
    "two_arms": two_arms,
}  # fmt: skip
OWN = ("urdf", "planar_on_a_slide")  # need no models of others


def around(file: Path) -> tuple[str, ...]:
    """A table and a cup around an arm that comes alone."""
    return ("--arm", str(file), "--table", "--object", "cup:0.4,0.3,0.1")


def ends(scene: Scene, hand: str, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Two configurations half a radian apart in each joint, at which everything is 15 cm above the ground."""
    data = scene.rig.data()
    lower, upper = np.maximum(scene.lower, -2.0), np.minimum(scene.upper, 2.0)
    for _ in range(100_000):
        start = rng.uniform(lower, upper)
        goal = np.clip(start + rng.choice([-0.5, 0.5], len(start)), lower, upper)
        heights = []
        for share in np.linspace(0, 1, 5):
            scene.rig.pose(data, start + share * (goal - start))
            moving = data.xpos[scene.moving_bodies(), 2]
            kind, index = scene.place(hand)
            heights += [
                float(moving.min()) - 0.05,
                float((data.xpos if kind == "body" else data.site_xpos)[index, 2]) - 0.2,
            ]
        if min(heights) > 0:
            return start, goal
    raise RuntimeError("no such configurations were found")


def record(folder: Path, lab: Lab) -> None:
    """Recordings of people who bow to one side on their way, at 50 Hz, with all joints that the driver reports."""
    scene = load_scene(lab.file, joints=lab.joints)
    rng = np.random.default_rng(20200323)
    start, goal = ends(scene, lab.hand, rng)
    folder.mkdir()
    names = [*lab.others, *(lab.recorded(name) for name in lab.joints)]
    s = np.clip(np.linspace(-0.1, 1.1, 180), 0, 1)[:, None]
    side = rng.normal(size=len(start))
    for person in range(PEOPLE):
        bow = 0.2 * side / np.linalg.norm(side) + 0.03 * rng.normal(size=len(start))
        pose = start + (3 * s**2 - 2 * s**3) * (goal - start) + np.sin(np.pi * s) ** 2 * bow
        rows = np.hstack([np.full((len(s), len(lab.others)), 0.02), pose])
        time_ns = 1_700_000_000_000_000_000 + 20_000_000 * np.arange(len(s))
        about = {"demonstration": {"participant": f"p{person}"}}
        write_joint_states(folder / f"p{person}.mcap", time_ns, names, rows, topic="/joint_states", metadata=about)


def measured(name: str, folder: Path, models: Path | None) -> dict[str, object]:
    """What it took from the files to a posterior, s."""
    lab = LABS[name](folder, models)  # type: ignore[arg-type]
    record(folder / "recordings", lab)
    shutil.copy(ROOT / "params.yaml", folder)
    took, said = {}, ""
    for words in (
        ("new-task", "mine", *lab.words, "--recordings", "recordings"),
        *((stage, "mine") for stage in STAGES),
    ):
        begin = time.perf_counter()
        done = subprocess.run([sys.executable, "-m", "pipeline", *words], cwd=folder, capture_output=True, text=True)
        took[words[0]] = round(time.perf_counter() - begin, 1)
        print(f"{name}: lessbench {' '.join(words[:2])}: {took[words[0]]} s", flush=True)
        print(done.stdout + done.stderr, flush=True)
        if done.returncode:
            raise SystemExit(f"{name}: {words[0]} failed")
        said = said or done.stdout
    if not (folder / "datasets/mine/tables/posteriors.parquet").is_file():
        raise SystemExit(f"{name}: there is no posterior")
    return {"arm": name, "joints": len(lab.joints), "seconds": took, "total_s": round(sum(took.values()), 1)}


def robosuite(folder: Path, wheel: Path | None) -> tuple[Path | None, str]:
    """Where the models are, or why they are not here."""
    if wheel is None:
        command = [sys.executable, "-m", "pip", "download", "--no-deps", "--quiet", "robosuite", "-d", str(folder)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=300)
        wheel = next(folder.glob("robosuite*.whl"), None)
        if wheel is None:
            return None, f"pip cannot download robosuite: {done.stderr.strip().splitlines()[-1:] or 'no reason given'}"
    with zipfile.ZipFile(wheel) as archive:
        wanted = [f"{ROBOTS}/{robot}/" for robot in ("panda", "ur5e", "kinova3")] + [f"{GRIPPERS}/"]
        archive.extractall(folder, [one for one in archive.namelist() if one.startswith(tuple(wanted))])
    return folder, ""


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("arms", nargs="*", choices=[[], *LABS], default=[], metavar="ARM", help=", ".join(LABS))
    parser.add_argument("--robosuite", type=Path, help="its wheel, if it is here")
    given = parser.parse_args(arguments)
    results = []
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        arms = given.arms or list(LABS)
        models, reason = (None, "") if set(arms) <= set(OWN) else robosuite(folder, given.robosuite)
        for name in arms:
            if models is None and name not in OWN:
                print(f"{name}: skipped, as {reason}")
                continue
            (folder / name).mkdir()
            results.append(measured(name, folder / name, models))
    print(json.dumps(results, indent=1))


if __name__ == "__main__":
    main()
