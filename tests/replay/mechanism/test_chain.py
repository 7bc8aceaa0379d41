from dataclasses import replace

import mujoco
import numpy as np
import pytest

from pipeline.errors import SceneError
from pipeline.replay import load_scene
from pipeline.replay import replay as replayed


def random_scene(tmp_path, seed):
    """A tree of twelve bodies with up to two joints each: any axis, anchor, reference and pose, some not replayed."""
    rng = np.random.default_rng(seed)

    def vector(values):
        return " ".join(f"{value:.6f}" for value in values)

    children = {index: [] for index in range(13)}
    for index in range(1, 13):
        children[int(rng.integers(0, index))].append(index)
    names = []

    def body(index):
        joints = ""
        for number in range(int(rng.integers(0, 3))):
            names.append(f"j{index}_{number}")
            kind = "slide" if rng.random() < 0.3 else "hinge"
            joints += (
                f'<joint name="{names[-1]}" type="{kind}" axis="{vector(rng.normal(size=3))}" '
                f'pos="{vector(rng.normal(size=3))}" ref="{rng.normal():.6f}"/>'
            )
        inside = "".join(body(child) for child in children[index])
        pose = f'pos="{vector(rng.normal(size=3))}" quat="{vector(rng.normal(size=4))}"'
        site = f'<site name="s{index}" pos="{vector(rng.normal(size=3))}" quat="{vector(rng.normal(size=4))}"/>'
        return f'<body name="b{index}" {pose}>{joints}<geom size="0.1"/>{site}{inside}</body>'

    trees = "".join(body(child) for child in children[0])
    path = tmp_path / f"random{seed}.xml"
    loose = '<body name="loose" pos="1 2 3"><freejoint/><geom size="0.1"/></body>'
    path.write_text(
        f'<mujoco><compiler angle="radian"/><worldbody>{trees}{loose}'
        '<body name="ball"><joint type="ball"/><geom size="0.1"/></body></worldbody></mujoco>'
    )
    chosen = [str(name) for name in rng.permutation(names)[: max(1, len(names) - 2)]]
    return load_scene(path, joints=chosen)


@pytest.mark.parametrize("seed", range(12))
def test_every_body_and_site_is_where_mujoco_has_it(tmp_path, seed):
    scene = random_scene(tmp_path, seed)
    waypoints = np.random.default_rng(seed).uniform(-7, 7, (6, 5, len(scene.joints)))
    (motion,) = replayed(scene, waypoints)
    data = mujoco.MjData(scene.model)
    for n, t in np.ndindex(6, 5):
        data.qpos[:] = scene.home
        data.qpos[scene.qpos_addresses] = waypoints[n, t]
        mujoco.mj_kinematics(scene.model, data)
        for name in [f"b{index}" for index in range(1, 13)] + ["loose", "ball"]:
            assert np.abs(motion.position(name)[n, t] - data.body(name).xpos).max() < 1e-12
            assert np.abs(motion.rotation(name)[n, t] - data.body(name).xmat.reshape(3, 3)).max() < 1e-12
        for index in range(1, 13):
            assert np.abs(motion.position(f"s{index}")[n, t] - data.site(f"s{index}").xpos).max() < 1e-12


@pytest.mark.parametrize("task", ["table", "laptop", "human"])
def test_the_arm_of_the_project(task):
    scene = load_scene(f"datasets/scenes/{task}.xml", end_effector="j2s7s300_link_7")
    waypoints = np.random.default_rng(2).uniform(-4, 4, (20, 41, 7))
    (motion,) = replayed(scene, waypoints)
    data = mujoco.MjData(scene.model)
    names = [scene.model.body(index).name for index in range(scene.model.nbody)]
    got = np.stack([motion.position(name) for name in names], axis=2)
    for n, t in np.ndindex(20, 41):
        data.qpos[scene.qpos_addresses] = waypoints[n, t]
        mujoco.mj_kinematics(scene.model, data)
        assert np.abs(got[n, t] - data.xpos).max() < 1e-14


def test_results_cannot_be_written_to(gantry):
    (motion,) = replayed(gantry, np.zeros((2, 3, 3)))
    for values in (motion.position("hook"), motion.position("bin"), motion.end_effector):
        with pytest.raises(ValueError, match="read-only"):
            values[0, 0, 0] = 1.0


def test_a_chain_that_differs_from_mujoco_is_refused(gantry):
    gantry.chain.require_agreement()
    first, *others = gantry.chain.joints
    moved = first.placement + 1e-6 * np.eye(3, 4, 3)
    wrong = replace(gantry.chain, joints=(replace(first, placement=moved), *others))
    with pytest.raises(SceneError, match=r"body '\w+' differs by up to 1e-06 from where MuJoCo has it"):
        wrong.require_agreement()
