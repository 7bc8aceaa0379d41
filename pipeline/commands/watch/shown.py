"""The recording of what is watched: how it begins, and what of a demonstration it shows."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.commands.serve import announce
from pipeline.commands.watch.belief import Belief, believed
from pipeline.replay.along import along
from pipeline.replay.geometry import body_poses, extract_geometry
from pipeline.replay.replay import body_positions
from pipeline.stages.inspect import replay_of
from pipeline.views.rerun.live_recording import Arrival, Beginning, Watched, watched
from pipeline.views.rerun.records import Replay
from pipeline.views.rerun.server import require_listening, server
from pipeline.views.task_summary import theta_labels, theta_meaning
from pipeline.views.task_view import map_on_axes

if TYPE_CHECKING:
    from pipeline.views.rerun.server import Address

_POSES = 100  # configurations of alternatives that show which bodies move


@contextmanager
def shown(partial: Path, belief: Belief, address: Address | None) -> Iterator[Watched]:
    """The recording of what is watched, saved in the folder and served at the address."""
    with ExitStack() as stack:
        sinks = [] if address is None else [server(address)]
        recording = stack.enter_context(watched(partial / "inspect.rrd", _beginning(belief), *sinks))
        if address is not None:
            require_listening(address)
            announce(address, f"what is watched for {belief.setting.name}", stay=True)
        yield recording


def arrival(row: dict[str, Any], belief: Belief) -> Arrival:
    """A demonstration that the belief has taken in, from its row of demonstrations.parquet."""
    setting, path = belief.setting, row["waypoints"][None]
    tip = setting.scene.end_effector
    return Arrival(
        name=row["demonstration_id"],
        replay=replay_of(setting.scene, path, np.array([row["duration_s"]])),
        path=body_positions(setting.scene, path, [tip])[tip][0],
        waypoints=row["waypoints"],
        along=along(setting.feature_set, path)[0],
        raw=belief.raw[row["demonstration_id"]],
        on_map=belief.on_map(),
        belief=believed(belief),
    )


def _beginning(belief: Belief) -> Beginning:
    """What is shown before any demonstration."""
    setting = belief.setting
    pair = setting.pair
    sigma = setting.bandwidth * setting.scale
    configurations = setting.waypoints.reshape(-1, setting.waypoints.shape[-1])[: _POSES * 10 : 10]
    positions, quaternions = body_poses(setting.scene, configurations)
    samples = np.arange(len(configurations))
    poses = Replay(
        extract_geometry(setting.scene.model), positions, quaternions, samples.astype(np.float64), 0 * samples
    )
    return Beginning(
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
        prior=believed(belief),
    )
