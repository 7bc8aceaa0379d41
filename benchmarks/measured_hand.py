"""The reference quantiles of `pipeline/trajectories/measured_hand.py`, from recordings of people on an arm.

python -m benchmarks.measured_hand FOLDER_OR_FILE... --topic /j2s7s300_driver/out/joint_state --joints a,b,c
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from pipeline.arrays import FloatArray
from pipeline.formats.mcap.joint_states import read_joint_states
from pipeline.terminal import say
from pipeline.trajectories.measured_hand import LEVELS, measure

WAYPOINTS = 41
IDLE_RAD = 0.01  # as ingest.idle_rad


def waypoints_of(path: Path, topic: str, joints: list[str]) -> FloatArray:
    """(WAYPOINTS, J), uniform in time between the ends of the motion, joints unwrapped."""
    recording = read_joint_states(path, topic, joints)
    positions, time_s = np.unwrap(recording.positions, axis=0), (recording.time_ns - recording.time_ns[0]) / 1e9
    away = np.abs(positions - positions[0]).max(axis=1) > IDLE_RAD
    before = np.abs(positions - positions[-1]).max(axis=1) > IDLE_RAD
    first, last = max(int(away.argmax()) - 1, 0), len(positions) - max(int(before[::-1].argmax()) - 1, 0)
    times = np.linspace(time_s[first], time_s[last - 1], WAYPOINTS)
    return np.stack([np.interp(times, time_s[first:last], joint) for joint in positions[first:last].T], axis=1)


def reference(paths: list[Path], topic: str, joints: list[str]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Quantiles of LENGTH and UNEVENNESS at LEVELS, and the mean SHARES."""
    measured = [measure(waypoints_of(path, topic, joints)) for path in paths]
    length = np.quantile([habit.length for habit, _ in measured], LEVELS)
    unevenness = np.quantile([habit.unevenness for habit, _ in measured], LEVELS)
    return length, unevenness, np.mean([shares for _, shares in measured], axis=0)


def main() -> None:
    """Print the three constants."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sources", nargs="+", type=Path, help="recordings, or folders of them")
    parser.add_argument("--topic", required=True)
    parser.add_argument("--joints", required=True, help="names, separated by commas")
    given = parser.parse_args()
    paths = sorted(p for source in given.sources for p in ([source] if source.is_file() else source.rglob("*.mcap")))
    for name, values in zip(
        ("LENGTH", "UNEVENNESS", "SHARES"), reference(paths, given.topic, given.joints.split(",")), strict=True
    ):
        say(f"{name} = ({', '.join(f'{value:.4g}' for value in values)})")


if __name__ == "__main__":
    main()
