"""What can go wrong with a recording: named corruptions of random strength, and what comes of each.

`python -m tests.support.corruptions` writes the table of outcomes into docs/promises.md.
"""

from __future__ import annotations

import struct
import tempfile
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
from mcap.writer import CompressionType, Writer

from pipeline.params import Ingest
from pipeline.replay.scene import load_scene
from pipeline.stages.ingest import Found, collect
from pipeline.trajectories.random_streams import child_rng
from pipeline.workspace.demonstrations import Intake
from tests.support.gantry_project import GANTRY
from tests.support.joint_bags import ROS1_SCHEMA
from tests.support.recorded_motions import (
    GOAL,
    NAMES,
    START,
    STEP_NS,
    TOPIC,
    Recorded,
    reach,
    save,
    save_messages,
    timed,
)

DRAWS, SEED = 1000, 13
SAME = 1e-9
DOCS = Path(__file__).parents[2] / "docs" / "promises.md"
BEGIN, END = "<!-- table of corruptions -->", "<!-- end of the table of corruptions -->"
Corruption = Callable[[np.random.Generator, Recorded, Path], None]
CORRUPTIONS: dict[str, Corruption] = {}
HINGES = np.array([False, True, True])


def corruption(name: str) -> Callable[[Corruption], Corruption]:
    """Registers a function that writes a corrupt version of a recording into a folder."""

    def register(function: Corruption) -> Corruption:
        CORRUPTIONS[name] = function
        return function

    return register


def poses(name: str) -> Callable[[Callable[[np.random.Generator, np.ndarray], np.ndarray]], None]:
    """Registers a function of the poses (M, 3) alone."""

    def register(change: Callable[[np.random.Generator, np.ndarray], np.ndarray]) -> None:
        @corruption(name)
        def _(rng: np.random.Generator, r: Recorded, folder: Path) -> None:
            save(folder / "a.mcap", r.but(positions=change(rng, r.positions.copy())))

    return register


def clock(name: str) -> Callable[[Callable[[np.random.Generator, np.ndarray], np.ndarray]], None]:
    """Registers a function of the header stamps (M,) alone."""

    def register(change: Callable[[np.random.Generator, np.ndarray], np.ndarray]) -> None:
        @corruption(name)
        def _(rng: np.random.Generator, r: Recorded, folder: Path) -> None:
            save(folder / "a.mcap", r.but(header_ns=change(rng, r.header_ns.copy())))

    return register


def samples(name: str) -> Callable[[Callable[[np.random.Generator, int], np.ndarray]], None]:
    """Registers a function that says which of M samples there are."""

    def register(choose: Callable[[np.random.Generator, int], np.ndarray]) -> None:
        @corruption(name)
        def _(rng: np.random.Generator, r: Recorded, folder: Path) -> None:
            save(folder / "a.mcap", r.rows(choose(rng, len(r.positions))))

    return register


def joint_of(rng: np.random.Generator) -> int:
    return int(rng.integers(3))


def within(rng: np.random.Generator, count: int, low: float = 0.3, high: float = 0.7) -> int:
    """A sample while the arm moves."""
    return int(count * rng.uniform(low, high))


# units, offsets, orders, names


@poses("hinges in degrees")
def _(_rng: np.random.Generator, q: np.ndarray) -> np.ndarray:
    return np.where(HINGES, np.degrees(q), q)


@poses("hinges in encoder ticks")
def _(rng: np.random.Generator, q: np.ndarray) -> np.ndarray:
    return np.where(HINGES, np.rint(rng.choice([4096, 65536]) / (2 * np.pi) * (q + np.pi)), q)


@poses("all joints from -100 to 100")
def _(_rng: np.random.Generator, q: np.ndarray) -> np.ndarray:
    return 100 * (q - q.mean(axis=0)) / np.abs(q - q.mean(axis=0)).max()


@poses("slide in millimetres")
def _(_rng: np.random.Generator, q: np.ndarray) -> np.ndarray:
    return np.where(HINGES, q, 1000 * q)


@poses("one joint by a wrong gear ratio")
def _(rng: np.random.Generator, q: np.ndarray) -> np.ndarray:
    q[:, joint_of(rng)] *= rng.choice([rng.uniform(0.1, 0.4), rng.uniform(1.6, 5)])
    return q


@poses("one joint with the wrong sign")
def _(rng: np.random.Generator, q: np.ndarray) -> np.ndarray:
    q[:, joint_of(rng)] *= -1
    return q


@poses("one joint with an offset")
def _(rng: np.random.Generator, q: np.ndarray) -> np.ndarray:
    q[:, joint_of(rng)] += rng.choice([-1, 1]) * rng.uniform(0.12, 3)
    return q


@poses("two joints exchanged")
def _(rng: np.random.Generator, q: np.ndarray) -> np.ndarray:
    first, second = rng.choice(3, 2, replace=False)
    q[:, [first, second]] = q[:, [second, first]]
    return q


@poses("velocities in place of positions")
def _(_rng: np.random.Generator, q: np.ndarray) -> np.ndarray:
    return np.gradient(q, 0.01, axis=0)


@poses("whole turns of a joint without limits")
def _(rng: np.random.Generator, q: np.ndarray) -> np.ndarray:
    q[:, 1] += 2 * np.pi * rng.integers(-3, 4)
    return q


@poses("a joint without limits within one turn")
def _(rng: np.random.Generator, q: np.ndarray) -> np.ndarray:
    low = rng.uniform(-0.5, 0.8)
    q[:, 1] = low + (q[:, 1] - low) % (2 * np.pi)
    return q


@poses("whole turns of a limited joint")
def _(rng: np.random.Generator, q: np.ndarray) -> np.ndarray:
    q[:, 2] += 2 * np.pi * rng.choice([-1, 1])
    return q


@corruption("joints in another order, each with its name")
def _(rng: np.random.Generator, r: Recorded, folder: Path) -> None:
    order = rng.permutation(3)
    save(folder / "a.mcap", r.but(positions=r.positions[:, order], names=tuple(NAMES[j] for j in order)))


@corruption("further joints")
def _(rng: np.random.Generator, r: Recorded, folder: Path) -> None:
    more = rng.normal(size=(len(r.positions), 2))
    save(folder / "a.mcap", r.but(positions=np.hstack([more, r.positions]), names=("finger", "thumb", *NAMES)))


@corruption("names of another arm")
def _(rng: np.random.Generator, r: Recorded, folder: Path) -> None:
    save(folder / "a.mcap", r.but(names=tuple(f"panda_joint{j + 1}" for j in rng.permutation(7)[:3])))


@corruption("a joint missing")
def _(rng: np.random.Generator, r: Recorded, folder: Path) -> None:
    keep = np.delete(np.arange(3), joint_of(rng))
    save(folder / "a.mcap", r.but(positions=r.positions[:, keep], names=tuple(NAMES[j] for j in keep)))


# samples


@poses("a position that is no number")
def _(rng: np.random.Generator, q: np.ndarray) -> np.ndarray:
    q[within(rng, len(q)), joint_of(rng)] = rng.choice([np.nan, np.inf])
    return q


@poses("one sample elsewhere")
def _(rng: np.random.Generator, q: np.ndarray) -> np.ndarray:
    q[within(rng, len(q)), joint_of(rng)] += rng.choice([-1, 1]) * rng.uniform(0.15, 2)
    return q


@poses("a jump from one sample on")
def _(rng: np.random.Generator, q: np.ndarray) -> np.ndarray:
    q[within(rng, len(q)) :, joint_of(rng)] += rng.choice([-1, 1]) * rng.uniform(0.15, 2)
    return q


@poses("zeros of a second publisher in between")
def _(rng: np.random.Generator, q: np.ndarray) -> np.ndarray:
    q[within(rng, len(q)) :: int(rng.integers(2, 60))] = 0
    return q


@poses("a joint that is stuck from some time on")
def _(rng: np.random.Generator, q: np.ndarray) -> np.ndarray:
    joint, row = joint_of(rng), within(rng, len(q), 0.25, 0.5)
    q[row:, joint] = q[row, joint]
    return q


@poses("noise")
def _(rng: np.random.Generator, q: np.ndarray) -> np.ndarray:
    return np.asarray(q + rng.normal(scale=rng.uniform(0.02, 0.3), size=q.shape))


@samples("no samples for a while")
def _(rng: np.random.Generator, count: int) -> np.ndarray:
    first = within(rng, count, 0.35, 0.5)
    return np.r_[0:first, first + int(rng.integers(3, 100)) : count]


@samples("samples lost here and there")
def _(rng: np.random.Generator, count: int) -> np.ndarray:
    return np.flatnonzero(rng.random(count) > rng.uniform(0.08, 0.5))


@samples("the beginning missing")
def _(rng: np.random.Generator, count: int) -> np.ndarray:
    return np.arange(within(rng, count, 0.35, 0.7), count)


@samples("the end missing")
def _(rng: np.random.Generator, count: int) -> np.ndarray:
    return np.arange(within(rng, count, 0.3, 0.65))


@samples("samples in another order")
def _(rng: np.random.Generator, count: int) -> np.ndarray:
    first, length = within(rng, count, 0.3, 0.6), int(rng.integers(2, 40))
    return np.r_[0:first, np.arange(first, first + length)[::-1], first + length : count]


@samples("samples twice, exactly")
def _(rng: np.random.Generator, count: int) -> np.ndarray:
    return np.sort(np.r_[0:count, rng.integers(count, size=int(rng.integers(1, count)))])


# clocks


@clock("no header stamps")
def _(_rng: np.random.Generator, at: np.ndarray) -> np.ndarray:
    return 0 * at


@clock("header stamps that stand")
def _(rng: np.random.Generator, at: np.ndarray) -> np.ndarray:
    return np.full_like(at, at[int(rng.integers(len(at)))])


@clock("a simulation's clock that begins at 0")
def _(_rng: np.random.Generator, at: np.ndarray) -> np.ndarray:
    return np.asarray(at - at[0])


@clock("header stamps missing here and there")
def _(rng: np.random.Generator, at: np.ndarray) -> np.ndarray:
    at[rng.integers(len(at), size=int(rng.integers(1, 60)))] = 0
    return at


@clock("stamps that repeat")
def _(rng: np.random.Generator, at: np.ndarray) -> np.ndarray:
    for row in rng.choice(np.arange(90, 190), int(rng.integers(1, 20)), replace=False):
        at[row] = at[row - 1]
    return at


@clock("stamps a little late")
def _(rng: np.random.Generator, at: np.ndarray) -> np.ndarray:
    for row in rng.choice(np.arange(90, 190, 3), int(rng.integers(1, 10)), replace=False):
        at[row] = at[row - 1] - int(rng.integers(1, 9_000_000))
    return at


@clock("a clock that is set back")
def _(rng: np.random.Generator, at: np.ndarray) -> np.ndarray:
    at[within(rng, len(at)) :] -= int(10 ** rng.uniform(8, 14))
    return at


@clock("a clock that is set ahead")
def _(rng: np.random.Generator, at: np.ndarray) -> np.ndarray:
    at[within(rng, len(at), 0.35, 0.6) :] += int(10 ** rng.uniform(7.5, 14))
    return at


@clock("a clock that runs slower or faster")
def _(rng: np.random.Generator, at: np.ndarray) -> np.ndarray:
    return np.asarray(at[0] + int(STEP_NS * 10 ** rng.uniform(-1.5, 1.0)) * np.arange(len(at)))


@clock("a clock that changes its pace")
def _(rng: np.random.Generator, at: np.ndarray) -> np.ndarray:
    pace = np.where(np.arange(len(at) - 1) < within(rng, len(at), 0.4, 0.6), 1.0, rng.uniform(1.6, 2.4))
    return np.asarray(at[0] + np.concatenate([[0], np.cumsum(pace * STEP_NS)]).astype(np.int64))


@clock("another date")
def _(rng: np.random.Generator, at: np.ndarray) -> np.ndarray:
    return np.asarray(at + int(rng.integers(-(10**17), 10**17)))


@clock("irregular stamps")
def _(rng: np.random.Generator, at: np.ndarray) -> np.ndarray:
    return np.asarray(at + rng.integers(0, int(rng.uniform(0.55, 0.95) * STEP_NS), size=len(at)))


# files


@corruption("the file cut off")
def _(rng: np.random.Generator, r: Recorded, folder: Path) -> None:
    path = save(folder / "a.mcap", r)
    content = path.read_bytes()
    path.write_bytes(content[: int(len(content) * rng.uniform(0.1, 0.99))])


@corruption("bytes changed")
def _(rng: np.random.Generator, r: Recorded, folder: Path) -> None:
    path = save(folder / "a.mcap", r)
    content = bytearray(path.read_bytes())
    for at in rng.integers(200, len(content) // 2, size=int(rng.integers(1, 20))):
        content[at] ^= int(rng.integers(1, 256))
    path.write_bytes(content)


@corruption("packed otherwise")
def _(rng: np.random.Generator, r: Recorded, folder: Path) -> None:
    save(folder / "a.mcap", r, CompressionType.LZ4 if rng.random() < 0.5 else CompressionType.NONE)


@corruption("another name")
def _(rng: np.random.Generator, r: Recorded, folder: Path) -> None:
    save(folder / f"{''.join(rng.choice(list('abc[]?* é'), 8))}x.mcap", r)


@corruption("an upper-case ending")
def _(_rng: np.random.Generator, r: Recorded, folder: Path) -> None:
    save(folder / "a.MCAP", r)


@corruption("another ending")
def _(rng: np.random.Generator, r: Recorded, folder: Path) -> None:
    save(folder / f"a{rng.choice(['.db3', '.mcap.zstd', '.bag', '.mcap~', '.mcap.txt', ''])}", r)


@corruption("in a folder of its own")
def _(_rng: np.random.Generator, r: Recorded, folder: Path) -> None:
    save(folder / "bag" / "a.mcap", r)


def parts(rng: np.random.Generator, r: Recorded) -> list[Recorded]:
    cuts = np.sort(rng.choice(np.arange(95, 185, 10), int(rng.integers(1, 4)), replace=False))
    edges = [0, *cuts.tolist(), len(r.positions)]
    return [r.rows(slice(first, last)) for first, last in pairwise(edges)]


def save_parts(folder: Path, pieces: list[Recorded], index: bool, without: int = -1) -> None:
    names = [f"a_{number}.mcap" for number in range(len(pieces))]
    for number, (name, piece) in enumerate(zip(names, pieces, strict=True)):
        if number != without:
            save(folder / name, piece)
    if index:
        listed = ", ".join(names)
        (folder / "metadata.yaml").write_text(f"rosbag2_bagfile_information: {{relative_file_paths: [{listed}]}}")


@corruption("split into files, with metadata.yaml")
def _(rng: np.random.Generator, r: Recorded, folder: Path) -> None:
    save_parts(folder, parts(rng, r), index=True)


@corruption("split into files, without metadata.yaml")
def _(rng: np.random.Generator, r: Recorded, folder: Path) -> None:
    save_parts(folder, parts(rng, r), index=False)


@corruption("split into files, one of them lost")
def _(rng: np.random.Generator, r: Recorded, folder: Path) -> None:
    pieces = parts(rng, r)
    save_parts(folder, pieces, index=bool(rng.random() < 0.5), without=int(rng.integers(len(pieces))))


@corruption("copied under another name")
def _(rng: np.random.Generator, r: Recorded, folder: Path) -> None:
    save(folder / "a.mcap", r)
    save(folder / "b.mcap", r, CompressionType.NONE if rng.random() < 0.5 else CompressionType.ZSTD)


@corruption("copied with other times")
def _(rng: np.random.Generator, r: Recorded, folder: Path) -> None:
    save(folder / "a.mcap", r)
    save(folder / "b.mcap", r.later(int(rng.integers(1, 10**15))))


# whose, what, how many


@corruption("several motions in one file")
def _(rng: np.random.Generator, r: Recorded, folder: Path) -> None:
    again = [r.positions]
    for _ in range(int(rng.integers(1, 4))):
        again += [r.positions[::-1] + rng.normal(scale=0.02, size=3), r.positions + rng.normal(scale=0.02, size=3)]
    save(folder / "a.mcap", timed(np.concatenate(again)).but(metadata=r.metadata))


@corruption("there and back")
def _(_rng: np.random.Generator, r: Recorded, folder: Path) -> None:
    save(folder / "a.mcap", timed(np.concatenate([r.positions, r.positions[::-1]])).but(metadata=r.metadata))


@corruption("played backwards")
def _(_rng: np.random.Generator, r: Recorded, folder: Path) -> None:
    save(folder / "a.mcap", r.but(positions=r.positions[::-1]))


@corruption("a rest in the middle")
def _(rng: np.random.Generator, r: Recorded, folder: Path) -> None:
    row = within(rng, len(r.positions), 0.4, 0.6)
    rest = np.repeat(r.positions[row : row + 1], int(rng.integers(130, 900)), axis=0)
    save(
        folder / "a.mcap", timed(np.concatenate([r.positions[:row], rest, r.positions[row:]])).but(metadata=r.metadata)
    )


@corruption("a motion of another task")
def _(rng: np.random.Generator, r: Recorded, folder: Path) -> None:
    s = (r.positions - r.positions[0])[:, 1:2] / (r.positions[-1] - r.positions[0])[1]
    start = START + rng.choice([-1, 1], 3) * rng.uniform([0.25, 0.6, 0.2], [0.6, 1.5, 1.0])
    save(folder / "a.mcap", r.but(positions=start + s * (GOAL - start)))


@corruption("metadata that names another task")
def _(rng: np.random.Generator, r: Recorded, folder: Path) -> None:
    save(folder / "a.mcap", r.but(metadata=r.metadata | {"task": str(rng.choice(["pour", "unknown"]))}))


@corruption("the person's name spelt otherwise in a second recording")
def _(rng: np.random.Generator, r: Recorded, folder: Path) -> None:
    save(folder / "a.mcap", r)
    other = str(rng.choice(["zoë", "ZOË", "Zoe\u0308", " Zoë", "Zoë\u00a0"]))
    save(folder / "b.mcap", reach(0.31).later(10**12).but(metadata={"participant": other}))


@corruption("a topic of desired positions beside the measured ones")
def _(rng: np.random.Generator, r: Recorded, folder: Path) -> None:
    wanted = r.but(positions=r.positions + rng.normal(scale=0.2, size=3), topic=f"{TOPIC}_desired", metadata={})
    if rng.random() < 0.5:
        wanted = wanted.rows(slice(None, None, int(rng.integers(1, 8))))
    save(folder / "a.mcap", r.but(topic=str(rng.choice([TOPIC, "/arm/joint_states"])), also=(wanted,)))


@corruption("joints in messages of their own")
def _(rng: np.random.Generator, r: Recorded, folder: Path) -> None:
    joint, later = joint_of(rng), int(rng.integers(0, 3_000_000))
    rest = np.delete(np.arange(3), joint)
    messages = []
    for row, at in zip(r.positions, r.header_ns.tolist(), strict=True):
        messages.append((tuple(NAMES[j] for j in rest), row[rest], at))
        messages.append(((NAMES[joint],), row[[joint]], at + later))
    save_messages(folder / "a.mcap", messages)


@corruption("messages of ROS 1")
def _(_rng: np.random.Generator, r: Recorded, folder: Path) -> None:
    with (folder / "a.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros1", "test")
        writer.add_metadata("demonstration", dict(r.metadata))
        channel = writer.register_channel(
            TOPIC, "ros1", writer.register_schema("sensor_msgs/JointState", "ros1msg", ROS1_SCHEMA)
        )
        for number, (row, at, log) in enumerate(zip(r.positions, r.header_ns.tolist(), r.log_ns.tolist(), strict=True)):
            names = b"".join(struct.pack("<I", len(name)) + name.encode() for name in NAMES)
            head = struct.pack("<IIII", number, at // 10**9, at % 10**9, 0) + struct.pack("<I", len(NAMES)) + names
            writer.add_message(channel, log, head + struct.pack("<I3d", 3, *row) + bytes(8), log)
        writer.finish()


# what comes of it


@dataclass(frozen=True)
class Outcome:
    """What came of one draw.

    Attributes:
        corruption: its name.
        word: `same`, `said`, the reason of a refusal, or `silent`.
        details: remarks and refusals.
    """

    corruption: str
    word: str
    details: tuple[str, ...]


@cache
def intake() -> Intake:
    """The small project's arm, with a second task `pour` whose recordings are elsewhere."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "gantry.xml"
        path.write_text(GANTRY)
        scene = load_scene(path, end_effector="tip")
    return Intake(
        "sweep", scene, Ingest(waypoints=15, idle_rad=0.01, on_rejected="stop"), True, elsewhere=frozenset({"pour"})
    )


def draw(number: int) -> Outcome:
    """Corrupt one recording, and see."""
    name = list(CORRUPTIONS)[number % len(CORRUPTIONS)]
    rng = child_rng(SEED, "corruption", name, number)
    recorded = reach(float(rng.uniform(0.02, 0.3)), idle=float(rng.uniform(0.15, 0.25))).but(
        metadata={"participant": "Zoë"}
    )
    recorded = recorded.later(int(rng.integers(10**15)))
    with tempfile.TemporaryDirectory() as folder:
        right, wrong = Path(folder) / "right", Path(folder) / "wrong"
        right.mkdir()
        wrong.mkdir()
        save(right / "a.mcap", recorded)
        CORRUPTIONS[name](rng, recorded, wrong)
        expected, found = collect(right, intake()), collect(wrong, intake())
    assert len(expected.rows) == 1, expected.rejected
    assert expected.rows[0]["remarks"] is None, expected.rows[0]["remarks"]
    found.demonstrations() if found.rows else None  # gives people one spelling, and says so
    return Outcome(name, _word(expected, found), _details(found))


def _word(expected: Found, found: Found) -> str:
    if found.missing:
        return next(row["reason"] for row in found.rejected if row["reason"] not in ("copy", "not-a-recording"))
    if _details(found):
        return "said"
    if len(found.rows) == 1 and found.rows[0]["participant"] == "Zoë":
        apart = np.abs(found.rows[0]["waypoints"] - expected.rows[0]["waypoints"]).max()
        return "same" if apart <= SAME else "silent"
    return "silent"


def _details(found: Found) -> tuple[str, ...]:
    said = [f"{row['source']}: {row['remarks']}" for row in found.rows if row["remarks"]]
    return (*said, *(f"{row['source']}: {row['detail']}" for row in found.rejected))


def table(outcomes: list[Outcome]) -> str:
    """What came of each corruption, in Markdown."""
    words: dict[str, Counter[str]] = {name: Counter() for name in CORRUPTIONS}
    for outcome in outcomes:
        words[outcome.corruption][outcome.word] += 1
    lines = ["| corruption | draws | same | used and said | refused |", "|---|---|---|---|---|"]
    for name, counted in words.items():
        refused = ", ".join(f"{word} {n}" for word, n in sorted(counted.items()) if word not in ("same", "said"))
        lines.append(f"| {name} | {counted.total()} | {counted['same'] or ''} | {counted['said'] or ''} | {refused} |")
    return "\n".join(lines)


def documented() -> str:
    """The table as docs/promises.md has it."""
    return DOCS.read_text(encoding="utf-8").split(BEGIN)[1].split(END)[0].strip()


if __name__ == "__main__":
    found_now = table([draw(number) for number in range(DRAWS)])
    before, rest = DOCS.read_text(encoding="utf-8").split(BEGIN)
    DOCS.write_text(f"{before}{BEGIN}\n{found_now}\n{END}{rest.split(END)[1]}", encoding="utf-8")
