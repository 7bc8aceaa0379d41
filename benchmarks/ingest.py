"""Reading 100,000 JointState messages against mcap-ros2-support's decoder: `python -m benchmarks.ingest`.

The bag is of a seven-joint arm, in zstd chunks. Both readers check the CRCs; ours also enforces size limits and checks
the poses. Their times, names and positions are compared.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from benchmarks.explained import explain
from benchmarks.measuring import measured, record, show, timed
from pipeline.formats.mcap.joint_states import read_joint_states, write_joint_states

MESSAGES = 100_000
NAMES = tuple(f"j2s7s300_joint_{i}" for i in range(1, 8))
Read = tuple[np.ndarray, tuple[str, ...], np.ndarray]


def write(path: Path) -> None:
    rng = np.random.default_rng(0)
    time_ns = 1_700_000_000_000_000_000 + np.cumsum(rng.integers(9_000_000, 11_000_000, MESSAGES))
    positions = np.cumsum(rng.normal(scale=0.01, size=(MESSAGES, len(NAMES))), axis=0)
    write_joint_states(path, time_ns, NAMES, positions, topic="/joint_states", metadata={})


def ours(path: Path) -> tuple[float, Read]:
    took, recording = timed(read_joint_states, path)
    return took, (recording.time_ns, recording.names, recording.positions)


def official(path: Path) -> tuple[float, Read]:
    def read() -> Read:
        stamps, names, positions = [], set(), []
        with path.open("rb") as stream:
            reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
            for _, _, _, message in reader.iter_decoded_messages():
                stamps.append(message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec)
                names.add(tuple(message.name))
                positions.append(message.position)
        (joint_names,) = names
        return np.array(stamps), joint_names, np.array(positions)

    return timed(read)


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "demonstration.mcap"
        write(path)
        our_run, peer_run = measured(ours, path, times=5), measured(official, path, times=3)
        size = path.stat().st_size
    assert our_run.result[1] == peer_run.result[1]
    assert (our_run.result[0] == peer_run.result[0]).all()
    assert (our_run.result[2] == peer_run.result[2]).all()
    show(
        f"Reading {MESSAGES:,} JointState messages of {len(NAMES)} joints, {size / 1e6:.0f} MB, CRCs checked, same "
        "values",
        ("reader", "time", "messages a second", "peak memory"),
        [
            (name, f"{run.seconds:.2f} s", f"{MESSAGES / run.seconds:,.0f}", f"{run.memory / 1e6:,.0f} MB")
            for name, run in (("mcap-ros2-support", peer_run), ("ours", our_run))
        ]
        + [("ratio", f"{peer_run.seconds / our_run.seconds:.1f} x", "", "")],
    )
    record("replay", {"ingest, us per message": our_run.seconds / MESSAGES * 1e6})


if __name__ == "__main__":
    explain(__doc__)
    main()
