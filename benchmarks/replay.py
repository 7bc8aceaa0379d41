"""Times of replay and features per configuration, and of drawing trajectories: `python -m benchmarks.replay`.

One thousand trajectories of the table task have 41 waypoints and three features. The peer is a Python loop over
`mujoco.mj_kinematics` that reads the same position and sums up the same features; to its advantage, its model has no
geoms. "On both cores" means one process per core with half of the trajectories each, for the peer and for ours. The C
loop is compiled with `cc` against the library in MuJoCo's wheel. Unit costs are written to
benchmarks/results/replay.json.
"""

from __future__ import annotations

import multiprocessing
import subprocess
import tempfile
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from mujoco.batch import Batch

from benchmarks.explained import explain
from benchmarks.measuring import Run, measured, record, show, timed
from pipeline.params import load
from pipeline.replay import bind_features, body_positions, clear_of, load_scene
from pipeline.replay.features import FeatureSet
from pipeline.trajectories import measures
from pipeline.trajectories.paths import Anchor
from pipeline.trajectories.samplers import Deformation, Fate, Mixture, Planner, Sampler, ViaPoint, draw_admissible

ROOT = Path(__file__).resolve().parents[1]
TRAJECTORIES, WAYPOINTS, REPEATS = 1000, 41, 20
DRAWN = 5000
C_LOOP = r"""
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <mujoco/mujoco.h>

int main(int argc, char** argv) {
  mjModel* m = mj_loadModel(argv[1], NULL);
  mjData* d = mj_makeData(m);
  int body = atoi(argv[3]), n = atoi(argv[4]);
  double* q = malloc(n * m->nq * sizeof(double));
  double* out = malloc(n * 3 * sizeof(double));
  FILE* in = fopen(argv[2], "rb");
  if (fread(q, sizeof(double), (size_t)n * m->nq, in) != (size_t)n * m->nq) return 1;
  for (int repeat = 0; repeat < 6; repeat++) {
    struct timespec a, b;
    clock_gettime(CLOCK_MONOTONIC, &a);
    for (int i = 0; i < n; i++) {
      memcpy(d->qpos, q + (size_t)i * m->nq, m->nq * sizeof(double));
      mj_kinematics(m, d);
      memcpy(out + 3 * (size_t)i, d->xpos + 3 * body, 3 * sizeof(double));
    }
    clock_gettime(CLOCK_MONOTONIC, &b);
    if (repeat) printf("%.9f\n", (b.tv_sec - a.tv_sec) + 1e-9 * (b.tv_nsec - a.tv_nsec));
  }
  FILE* written = fopen(argv[5], "wb");
  fwrite(out, sizeof(double), (size_t)n * 3, written);
  fclose(written);
  return 0;
}
"""


def table_task() -> tuple[FeatureSet, Anchor]:
    """The features of the task in its scene, and its start and goal."""
    task = load(ROOT / "params.yaml").task("table")
    scene = load_scene(ROOT / task.scene, end_effector=task.end_effector, joints=task.joints)
    return bind_features(scene, task.features), Anchor(scene.start, scene.goal)


def trajectories(features: FeatureSet, anchor: Anchor) -> np.ndarray:
    return Deformation().sample(np.random.default_rng(0), anchor, TRAJECTORIES, WAYPOINTS)


def bodies_alone(path: Path) -> Any:
    """The model without geoms, which neither the peer nor we need for poses."""
    spec = mujoco.MjSpec.from_file(str(path))
    for body in spec.bodies:
        body.explicitinertial, body.mass, body.inertia = True, 1.0, [1.0, 1.0, 1.0]
    for geom in list(spec.geoms):
        spec.delete(geom)
    return spec.compile()


def best(function: Any) -> tuple[float, Any]:
    """Seconds of the fastest of 20 repetitions after one to warm up, and the last result."""
    function()
    runs = [timed(function) for _ in range(REPEATS)]
    return min(took for took, _ in runs), runs[-1][1]


def ours(share: slice) -> tuple[float, np.ndarray]:
    features, anchor = table_task()
    waypoints = trajectories(features, anchor)[share]
    return best(lambda: features.evaluate(waypoints))


def looped(share: slice) -> tuple[float, np.ndarray]:
    """The peer: poses one by one, then the same features from these positions."""
    features, anchor = table_task()
    scene, waypoints = features.scene, trajectories(features, anchor)[share]
    model = bodies_alone(scene.path)
    data, body = mujoco.MjData(model), scene.body_id(scene.end_effector)
    laptop = model.body("laptop").pos[:2]  # its parent is the world, so this is where it always is

    def run() -> np.ndarray:
        positions = np.empty((*waypoints.shape[:2], 3))
        for path, places in zip(waypoints, positions, strict=True):
            for t in range(len(path)):
                data.qpos[:] = path[t]
                mujoco.mj_kinematics(model, data)
                places[t] = data.xpos[body]
        return np.stack(
            [
                measures.squared_steps(waypoints),
                measures.summed_height(positions[..., 2]),
                measures.summed_closeness(positions, laptop, 0.4),
            ],
            axis=1,
        )

    return best(run)


def on_both_cores(function: Any) -> float:
    """Seconds until both halves are done, each in a process of its own."""
    half = TRAJECTORIES // 2
    with multiprocessing.get_context("spawn").Pool(2) as pool:
        return max(took for took, _ in pool.map(function, [slice(0, half), slice(half, None)], chunksize=1))


def posed() -> tuple[float, np.ndarray]:
    """Ours without the features: the positions of the end effector."""
    features, anchor = table_task()
    scene, waypoints = features.scene, trajectories(features, anchor)
    return best(lambda: body_positions(scene, waypoints, [scene.end_effector])[scene.end_effector])


def batched(threads: int) -> tuple[float, np.ndarray]:
    """MuJoCo's batch, which cannot compute kinematics alone."""
    features, anchor = table_task()
    scene = features.scene
    configurations = trajectories(features, anchor).reshape(-1, len(scene.joints))
    batch = Batch(bodies_alone(scene.path), nsim=len(configurations), nthread=threads)
    positions, qpos = batch.bind("xpos"), batch.bind("qpos")

    def run() -> np.ndarray:
        qpos[:, scene.qpos_addresses] = configurations
        batch.forward(stage=int(mujoco.mjtStage.mjSTAGE_POS.value))
        return positions[:, scene.body_id(scene.end_effector)].copy()

    return best(run)


def in_c() -> tuple[float, np.ndarray] | None:
    """Seconds and positions of the C loop on one core; None if it cannot be compiled."""
    features, anchor = table_task()
    scene = features.scene
    configurations = trajectories(features, anchor).reshape(-1, len(scene.joints))
    package = Path(mujoco.__file__).parent
    library = next(iter(sorted(package.glob("libmujoco.so*"))), None)
    with tempfile.TemporaryDirectory() as folder:
        source, program, model = (Path(folder) / name for name in ("loop.c", "loop", "scene.mjb"))
        source.write_text(C_LOOP)
        mujoco.mj_saveModel(bodies_alone(scene.path), str(model), None)
        (Path(folder) / "q").write_bytes(np.ascontiguousarray(configurations).tobytes())
        compiling = ["cc", "-O3", "-o", program, source, f"-I{package / 'include'}", str(library)]
        try:
            subprocess.run([*compiling, f"-Wl,-rpath,{package}"], check=True, capture_output=True)
        except (OSError, subprocess.CalledProcessError):
            return None
        arguments = [Path(folder) / "q", scene.body_id(scene.end_effector), len(configurations), Path(folder) / "out"]
        finished = subprocess.run([program, model, *map(str, arguments)], check=True, capture_output=True, text=True)
        fastest_s = min(map(float, finished.stdout.split()))
        return fastest_s, np.fromfile(Path(folder) / "out").reshape(-1, WAYPOINTS, 3)


def drawn(part: str) -> tuple[float, float]:
    """Seconds that drawing admissible trajectories takes, and the share of draws that was discarded."""
    features, anchor = table_task()
    scene = features.scene
    planner = Planner(trajectories(features, anchor)[:36], Deformation(0.1))
    parts: dict[str, Sampler] = {"deformation": Deformation(), "via-point": ViaPoint(), "planner": planner}
    parts["mixture"] = Mixture(tuple(parts.values()), (1.0, 1.0, 1.0))
    took, draw = best(
        lambda: draw_admissible(
            parts[part], np.random.default_rng(1), anchor, DRAWN, WAYPOINTS,
            lower=scene.lower, upper=scene.upper,
            judge=lambda paths: np.where(clear_of(scene, paths, "table_top"), Fate.KEPT, Fate.THROUGH_SURFACE),
        )
    )  # fmt: skip
    return took, draw.rejection_rate


def main() -> None:
    count = TRAJECTORIES * WAYPOINTS
    our_run, loop = measured(ours, slice(None)), measured(looped, slice(None))
    assert np.allclose(our_run.result, loop.result, rtol=1e-12, atol=1e-12)
    our_both_s, loop_both_s = on_both_cores(ours), on_both_cores(looped)
    poses = measured(posed)
    peers = [
        ("MuJoCo's batch, one thread", measured(batched, 1)),
        ("MuJoCo's batch, both cores", measured(batched, 2)),
    ]
    compiled = in_c()
    if compiled:
        peers.append(("C loop over mj_kinematics, one core", Run(compiled[0], 0, compiled[1])))
    for _, run in peers:
        assert np.abs(run.result.reshape(poses.result.shape) - poses.result).max() < 1e-12

    def per_configuration(total_s: float) -> str:
        return f"{total_s / count * 1e6:.3f} us"

    rows = [
        ("poses and 3 features, one core", "Python loop over mj_kinematics", loop.seconds, our_run.seconds),
        ("poses and 3 features, both cores", "the same, a process on each", loop_both_s, our_both_s),
        *(("poses alone, ours on one core", name, run.seconds, poses.seconds) for name, run in peers),
    ]
    show(
        f"Replay, per configuration, JACO 2 ({count:,} configurations)",
        ("measure", "peer", "its time", "ours", "ratio"),
        [
            (measure, peer, per_configuration(peer_s), per_configuration(our_s), f"{peer_s / our_s:.1f} x")
            for measure, peer, peer_s, our_s in rows
        ],
    )
    if compiled is None:
        print("The C loop could not be compiled: no `cc`, or no headers in MuJoCo's wheel.")

    samplers = ("deformation", "via-point", "planner", "mixture")
    draws = {name: measured(drawn, name) for name in samplers}
    show(
        f"Drawing {DRAWN:,} trajectories that keep the limits and clear the table, one core",
        ("sampler", "per trajectory kept", "draws discarded"),
        [(name, f"{run.seconds / DRAWN * 1e6:.1f} us", f"{run.result:.0%}") for name, run in draws.items()],
    )
    record(
        "replay",
        {
            "replay and 3 features, us per configuration, one core": our_run.seconds / count * 1e6,
            "replay alone, us per configuration, one core": poses.seconds / count * 1e6,
            "replay and 3 features, us per configuration, both cores": our_both_s / count * 1e6,
            "Python loop over mj_kinematics and 3 features, us per configuration, one core": loop.seconds / count * 1e6,
            **(
                {"C loop over mj_kinematics, us per configuration, one core": compiled[0] / count * 1e6}
                if compiled
                else {}
            ),
            **{f"drawing, {name}, us per trajectory": run.seconds / DRAWN * 1e6 for name, run in draws.items()},
        },
    )


if __name__ == "__main__":
    explain(__doc__)
    main()
