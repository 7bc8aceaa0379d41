"""Published Python 2 pickles become recordings; whatever else a pickle holds is refused, unexecuted."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
import time
import tracemalloc
import warnings
from pathlib import Path

import numpy as np
import pytest

from pipeline.arrays import FloatArray
from pipeline.errors import ArgumentError, RecordingError
from pipeline.formats.ferl.importer import MAX_BYTES, import_ferl
from pipeline.formats.ferl.python2_pickle import MAX_OPCODES
from pipeline.formats.mcap.joint_states import read_joint_states
from pipeline.formats.mcap.rejection_reasons import REASONS

JOINTS = ["a", "b", "c"]
RNG = np.random.default_rng(8)
RECONSTRUCT = b"cnumpy.core.multiarray\n_reconstruct\n(cnumpy\nndarray\n(I0\ntS'b'\ntR"
DTYPE = b"cnumpy\ndtype\n(S'f8'\nI0\nI1\ntR(I3\nS'<'\nNNNI-1\nI-1\nI0\ntb"


def text(data: bytes) -> bytes:
    return b"S" + repr(data)[1:].encode() + b"\n"


def array(values: FloatArray, fortran: bool = False, shape: tuple[int, ...] | None = None) -> bytes:
    axes = b"".join(b"I%d\n" % n for n in (values.shape if shape is None else shape))
    data = text(values.tobytes("F" if fortran else "C"))
    return RECONSTRUCT + b"(I1\n(" + axes + b"t" + DTYPE + b"I%02d\n" % fortran + data + b"tb"


def listing(*items: bytes) -> bytes:
    return b"(l" + b"".join(item + b"a" for item in items)


def scalar(value: float) -> bytes:
    return b"cnumpy.core.multiarray\nscalar\n(" + DTYPE + text(np.float64(value).tobytes()) + b"tR"


def trajectory(poses: bytes, times: bytes) -> bytes:
    new = b"ccopy_reg\n_reconstructor\n(cutils.trajectory\nTrajectory\nc__builtin__\nobject\nNtR"
    return new + b"(dS'num_waypts'\nI41\nsS'waypts'\n" + poses + b"sS'waypts_time'\n" + times + b"sb"


def imported(folder: Path, content: bytes, joints: list[str] = JOINTS, rate_hz: float = 10.0) -> list[Path]:
    file = folder / "demos.p"
    file.write_bytes(content)
    return import_ferl(file, folder / "out", joints, "/joint_states", rate_hz)


def test_the_published_files_equal_the_open_recordings(shared: Path, tmp_path: Path) -> None:
    original, expected = shared / "real/jaco/original", shared / "real/jaco/recordings"
    joints, topic = [f"j2s7s300_joint_{i}" for i in range(1, 8)], "/j2s7s300_driver/out/joint_state"
    sources = {
        "FERL_demos_tablelaptop_case1": [f"tablelaptop_case1_{i:02d}" for i in range(20)],
        "jl_demo_ID0_task0_1": ["kinesthetic_ID0_task0"],
    }
    for stem, names in sources.items():
        written = import_ferl(original / f"{stem}.p", tmp_path, joints, topic, 10.0)
        assert len(written) == len(names)
        for path, name in zip(written, names, strict=True):
            ours, theirs = read_joint_states(path), read_joint_states(expected / f"{name}.mcap", topic, joints)
            np.testing.assert_array_equal(ours.positions, theirs.positions)
            np.testing.assert_array_equal(ours.time_ns - ours.time_ns[0], theirs.time_ns - theirs.time_ns[0])
            assert (ours.topic, ours.names, ours.clock) == (topic, tuple(joints), "header")
    assert len(list(tmp_path.iterdir())) == 21


def test_a_list_of_demonstrations(tmp_path: Path) -> None:
    poses = [RNG.normal(size=(n, 3)) for n in (5, 2, 9)]
    content = listing(array(poses[0]), array(poses[1], fortran=True), array(poses[2])) + b"."
    with warnings.catch_warnings():  # numpy's old name
        warnings.simplefilter("ignore")
        own = pickle.loads(content, encoding="latin1")
    written = imported(tmp_path, content)
    assert [path.name for path in written] == ["demos_00.mcap", "demos_01.mcap", "demos_02.mcap"]
    for number, (path, expected) in enumerate(zip(written, poses, strict=True)):
        recording = read_joint_states(path)
        np.testing.assert_array_equal(recording.positions, expected)
        np.testing.assert_array_equal(recording.positions, own[number])
        np.testing.assert_array_equal(np.diff(recording.time_ns), 100_000_000)
        assert recording.metadata["demonstration"] == {
            "source": "demos.p", "place": f"{number + 1} of 3",
            "time_base": "nominal 10 Hz; the source has no time stamps",
        }  # fmt: skip
    before = [path.read_bytes() for path in written]
    assert [path.read_bytes() for path in imported(tmp_path, content)] == before


def test_one_demonstration_in_each_of_its_forms(tmp_path: Path) -> None:
    poses = RNG.normal(size=(4, 3))
    times = listing(scalar(2.0), b"F2.25\n", b"I3\n", scalar(7.5))
    forms = {
        "array": array(poses),
        "list of poses": listing(*(array(pose) for pose in poses)),
        "trajectory": trajectory(array(poses), times),
    }
    for form, content in forms.items():
        (path,) = imported(tmp_path, content + b".", rate_hz=4.0)
        recording = read_joint_states(path)
        assert path.name == "demos.mcap"
        np.testing.assert_array_equal(recording.positions, poses)
        time_s = (recording.time_ns - recording.time_ns[0]) / 1e9
        np.testing.assert_allclose(time_s, [0, 0.25, 1, 5.5] if form == "trajectory" else [0, 0.25, 0.5, 0.75])
        assert recording.metadata["demonstration"]["time_base"].startswith(
            "as recorded" if form == "trajectory" else "nominal 4 Hz"
        )


GOOD = array(np.arange(6.0).reshape(2, 3))
BEACON = b"touch beacon"
HOSTILE: dict[str, tuple[bytes, str]] = {
    "os.system": (b"cos\nsystem\n(S'" + BEACON + b"'\ntR.", "unsupported-encoding"),
    "posix.system in a list": (
        listing(GOOD, b"cposix\nsystem\n(S'" + BEACON + b"'\ntR") + b".", "unsupported-encoding"
    ),
    "eval": (b"c__builtin__\neval\n(S'1'\ntR.", "unsupported-encoding"),
    "getattr": (b"c__builtin__\ngetattr\n(S'a'\nS'b'\ntR.", "unsupported-encoding"),
    "a method of a known module": (b"cnumpy\nload\n(S'x'\ntR.", "unsupported-encoding"),
    "a dotted name": (b"cnumpy\nndarray.tofile\n(S'x'\ntR.", "unsupported-encoding"),
    "instance of a class": (b"(S'" + BEACON + b"'\nios\nsystem\n.", "unsupported-encoding"),
    "known names, other arguments": (b"cnumpy\nndarray\n((I999999999\nttR.", "unsupported-encoding"),
    "reconstruct something else": (
        b"cnumpy.core.multiarray\n_reconstruct\n(cnumpy\ndtype\n(I0\ntS'b'\ntR.", "unsupported-encoding"),
    "reconstruct a large array": (
        b"cnumpy.core.multiarray\n_reconstruct\n(cnumpy\nndarray\n(I999999999999\ntS'b'\ntR.", "unsupported-encoding"),
    "object array": (GOOD.replace(b"S'f8'", b"S'O8'") + b".", "unsupported-encoding"),
    "structured dtype": (GOOD.replace(b"S'<'\nNNN", b"S'<'\nN(S'a'\ntN") + b".", "unsupported-encoding"),
    "other byte order": (GOOD.replace(b"S'<'", b"S'>'") + b".", "unsupported-encoding"),
    "state for an array that is none": (DTYPE + b"(I1\ntb.", "unsupported-encoding"),
    "persistent id": (b"P17\n.", "unsupported-encoding"),
    "binary persistent id": (b"S'a'\nQ.", "unsupported-encoding"),
    "protocol 2": (pickle.dumps([1.0], protocol=2), "unsupported-encoding"),
    "protocol 5, out of band": (
        pickle.dumps(pickle.PickleBuffer(b"x" * 9), protocol=5, buffer_callback=lambda _: False),
        "unsupported-encoding"),
    "protocol 4 executing": (b"\x80\x04\x8c\x02os\x8c\x06system\x93\x8c\x0ctouch beacon\x85R.", "unsupported-encoding"),
    "extension registry": (b"\x82\x01.", "unsupported-encoding"),
    "no pickle": (b"\x89MCAP0\r\n" + bytes(100), "unsupported-encoding"),
    "text": (b"hello", "unsupported-encoding"),
    "numbers": (listing(b"I1\n") + b".", "unsupported-encoding"),
    "nothing": (b"N.", "unsupported-encoding"),
    "empty list": (b"(l.", "unsupported-encoding"),
    "one axis and two": (listing(GOOD, array(np.ones(3))) + b".", "unsupported-encoding"),
    "three axes": (array(np.ones((2, 1, 3))) + b".", "unsupported-encoding"),
    "no entries": (array(np.ones((0, 3))) + b".", "unsupported-encoding"),
    "negative axes": (array(np.ones((2, 3)), shape=(-2, -3)) + b".", "unsupported-encoding"),
    "an axis of true": (GOOD.replace(b"I2\nI3\n", b"I01\nI6\n") + b".", "unsupported-encoding"),
    "a list that holds itself": (b"(lp0\ng0\na.", "unsupported-encoding"),
    "deep tuples": (b"(" * 100_000 + b"t" * 100_000 + b".", "unsupported-encoding"),
    "deep lists": (b"(l" * 60_000 + b"a" * 59_999 + b".", "unsupported-encoding"),
    "deep tuple as arguments": (
        b"cnumpy\ndtype\n(" + b"(" * 60_000 + b"t" * 60_000 + b"I0\nI1\ntR.", "unsupported-encoding"),
    "endless marks": (b"(" * (MAX_OPCODES + 1), "too-large"),
    "a list doubled and doubled": (b"(lp0\n" + b"g0\na" * MAX_OPCODES, "too-large"),
    "an array ten thousand times": (
        b"(l" + array(np.ones((500, 3))) + b"p0\na" + b"g0\na" * 10_000 + b".", "too-large"),
    "a wide pose ten thousand times": (
        b"(l" + array(np.ones(10_000)) + b"p0\na" + b"g0\na" * 10_000 + b".", "too-large"),
    "two thousand demonstrations": (b"(l" + GOOD + b"p0\na" + b"g0\na" * 2000 + b".", "too-large"),
    "a large file": (b"(" * (MAX_BYTES + 1), "too-large"),
    "a shape beyond its data": (array(np.ones((2, 3)), shape=(10**9, 10**8)) + b".", "corrupt"),
    "a shape short of its data": (array(np.ones((2, 3)), shape=(1, 3)) + b".", "corrupt"),
    "a whole number of a million digits": (b"I" + b"9" * 1_000_000 + b"\n.", "corrupt"),
    "a number of a million digits": (b"F" + b"9" * 1_000_000 + b"\n.", "corrupt"),
    "a distant memo": (b"Np999999999999999999\ng7\n.", "corrupt"),
    "a broken escape": (b"S'\\xg0'\n.", "corrupt"),
    "an escape of another language": (b"S'\\q'\n.", "corrupt"),
    "a text without quotes": (b"Sabc\n.", "corrupt"),
    "an empty stack": (b"R.", "corrupt"),
    "a mark as a value": (b"(p0\n.", "corrupt"),
    "a tuple without its mark": (b"Nt.", "corrupt"),
    "append to a tuple": (b"(tNa.", "corrupt"),
    "an item of a list": (b"(lS'a'\nNs.", "corrupt"),
    "a key that is a list": (b"(d(lNs.", "corrupt"),
    "two objects": (GOOD + GOOD + b".", "corrupt"),
    "a second pickle": (GOOD + b"." + GOOD + b".", "corrupt"),
    "an array without content": (RECONSTRUCT + b".", "corrupt"),
    "poses of two lengths": (listing(array(np.ones(3)), array(np.ones(4))) + b".", "corrupt"),
    "a trajectory without times": (trajectory(GOOD, b"N") + b".", "corrupt"),
    "a trajectory without poses": (trajectory(b"N", listing(b"I0\n", b"I1\n")) + b".", "corrupt"),
    "fewer times than poses": (trajectory(GOOD, listing(b"I0\n")) + b".", "corrupt"),
    "times of NaN": (trajectory(GOOD, listing(b"I0\n", b"Fnan\n")) + b".", "corrupt"),
    "times beyond any recording": (trajectory(GOOD, listing(b"I0\n", b"F1e300\n")) + b".", "corrupt"),
    "times backwards": (trajectory(GOOD, listing(b"I1\n", b"I0\n")) + b".", "time-not-increasing"),
    "the same time twice": (trajectory(GOOD, listing(b"I1\n", b"I1\n")) + b".", "time-not-increasing"),
    "empty": (b"", "truncated"),
    "no end mark": (GOOD, "truncated"),
    "an open line": (b"S'abc", "truncated"),
    "columns without names": (array(np.ones((2, 4))) + b".", "joints-missing"),
    "one pose": (array(np.ones((1, 3))) + b".", "too-few-messages"),
    "NaN": (array(np.array([[0.0, 1.0, 2.0], [0.0, np.nan, 2.0]])) + b".", "not-finite"),
    "infinity in the second": (listing(GOOD, array(np.full((2, 3), np.inf))) + b".", "not-finite"),
}  # fmt: skip


@pytest.mark.parametrize("case", HOSTILE)
def test_refused_soon_with_a_sentence_and_nothing_done(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, case: str
) -> None:
    content, reason = HOSTILE[case]
    monkeypatch.chdir(tmp_path)
    executed: list[str] = []
    monkeypatch.setattr(os, "system", executed.append)
    file = tmp_path / "demos.p"
    file.write_bytes(content)
    began = time.perf_counter()
    with pytest.raises(RecordingError) as caught:
        import_ferl(file, tmp_path / "out", JOINTS, "/joint_states", 10.0)
    assert time.perf_counter() - began < 1.0
    assert caught.value.reason == reason
    assert reason in REASONS
    assert caught.value.detail.endswith(".")
    assert len(caught.value.detail) < 400
    assert "\n" not in caught.value.detail
    assert executed == []
    assert [path.name for path in tmp_path.iterdir()] == ["demos.p"]


@pytest.mark.parametrize("case", ["an array ten thousand times", "a wide pose ten thousand times", "endless marks"])
def test_memory_stays_in_proportion_to_the_file(tmp_path: Path, case: str) -> None:
    content = HOSTILE[case][0]
    tracemalloc.start()
    with pytest.raises(RecordingError):
        imported(tmp_path, content)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 20_000_000  # repeated, the wide pose would take 800 MB


def test_every_cut_is_refused(tmp_path: Path) -> None:
    whole = listing(GOOD, GOOD) + b"."
    for length in range(len(whole)):
        with pytest.raises(RecordingError):
            imported(tmp_path, whole[:length])
    assert len(imported(tmp_path, whole)) == 2


def test_no_changed_byte_does_harm(tmp_path: Path) -> None:
    """Each result is a recording of the same shape or a refusal; nothing else is raised."""
    whole = trajectory(GOOD, listing(scalar(0.0), scalar(0.5))) + b"."
    for position in RNG.choice(len(whole), 300, replace=False):
        changed = bytearray(whole)
        changed[position] ^= int(RNG.integers(1, 256))
        try:
            (path,) = imported(tmp_path, bytes(changed))
            shape = read_joint_states(path).positions.shape
        except RecordingError:
            continue
        assert shape == (2, 3)


def test_files_that_are_none(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.p")
    for name in ("missing.p", "pipe.p"):
        with pytest.raises(RecordingError) as caught:
            import_ferl(tmp_path / name, tmp_path / "out", JOINTS, "/joint_states", 10.0)
        assert caught.value.reason == "unreadable"


@pytest.mark.parametrize(
    ("joints", "rate_hz", "message"),
    [
        ([], 10.0, "joints must be"),
        (["a", "b", "a"], 10.0, "joints must be one or more different names, got a, b, a"),
        (["a", "", "c"], 10.0, "joints must be"),
        (JOINTS, 0.0, "rate_hz must be between"),
        (JOINTS, float("nan"), "rate_hz must be between"),
    ],
)
def test_arguments(tmp_path: Path, joints: list[str], rate_hz: float, message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        imported(tmp_path, GOOD + b".", joints, rate_hz)
    assert not (tmp_path / "out").exists()


def test_the_folder_is_a_folder(tmp_path: Path) -> None:
    (tmp_path / "out").write_text("a file")
    with pytest.raises(ArgumentError, match="is a file"):
        imported(tmp_path, GOOD + b".")


def test_the_command(tmp_path: Path) -> None:
    (tmp_path / "good.p").write_bytes(GOOD + b".")
    (tmp_path / "bad.p").write_bytes(HOSTILE["os.system"][0])
    words = [sys.executable, "-m", "pipeline", "import", "ferl"]
    done = subprocess.run(
        [*words, "good.p", "out", "--joints", "a, b,c", "--topic", "/arm", "--rate-hz", "20"],
        cwd=tmp_path, capture_output=True, text=True, timeout=60,
    )  # fmt: skip
    assert (done.returncode, done.stdout, done.stderr) == (0, "out/good.mcap\n", "")
    recording = read_joint_states(tmp_path / "out" / "good.mcap")
    assert (recording.topic, recording.names) == ("/arm", ("a", "b", "c"))
    assert np.diff(recording.time_ns).tolist() == [50_000_000]
    bad = subprocess.run([*words, "bad.p", "out", "--joints", "a"], cwd=tmp_path, capture_output=True, text=True)
    assert bad.returncode == 1
    assert bad.stderr.startswith("lessbench: The pickle names os.system; only arrays")
    assert bad.stderr.count("\n") == 1
    assert not (tmp_path / "beacon").exists()


def test_a_folder_of_pickles_becomes_a_folder_for_each_condition(shared: Path, tmp_path: Path) -> None:
    original, expected = shared / "real/jaco/original/twelve", shared / "real/jaco/twelve"
    joints, topic = [f"j2s7s300_joint_{i}" for i in range(1, 8)], "/j2s7s300_driver/out/joint_state"
    written = import_ferl(original, tmp_path, joints, topic, 2.0)
    assert [path.relative_to(tmp_path).as_posix() for path in written] == [
        f"{condition}/ID{number:02}.mcap"
        for condition in ("human1", "human2", "laptop1", "laptop2", "table1")
        for number in range(12)
    ]
    for path in written:
        ours = read_joint_states(path)
        theirs = read_joint_states(expected / path.relative_to(tmp_path), topic, joints)
        np.testing.assert_array_equal(ours.positions, theirs.positions)
        np.testing.assert_array_equal(np.diff(ours.time_ns), np.diff(theirs.time_ns))
        about, stated = ours.metadata["demonstration"], theirs.metadata["demonstration"]
        assert (about["participant"], about["task"]) == (stated["participant"], stated["task"])


def test_names_of_pickles_say_who_shows_what(tmp_path: Path) -> None:
    source, poses = tmp_path / "in", RNG.normal(size=(4, 3))
    source.mkdir()
    for name in ("anna@near.p", "7@near.p", "11@near.p", "7@far.p"):
        (source / name).write_bytes(listing(array(poses)) + b".")
    (source / "notes.txt").write_text("not a pickle")
    written = import_ferl(source, tmp_path / "out", JOINTS, "/joint_states", 10.0, "{participant}@{condition}.p")
    assert [path.relative_to(tmp_path / "out").as_posix() for path in written] == [
        "far/ID07.mcap", "near/ID07.mcap", "near/ID11.mcap", "near/anna.mcap",
    ]  # fmt: skip
    assert read_joint_states(written[-1]).metadata["demonstration"]["participant"] == "anna"


@pytest.mark.parametrize(
    ("files", "names", "said"),
    [
        ({}, "demo_{participant}_{condition}.p", "has no pickles"),
        ({"demo_1.p": True}, "demo_{participant}_{condition}.p", "demo_1.p in .* is not called"),
        ({"demo_1_a.p": True, "demo_01_a.p": True}, "demo_{participant}_{condition}.p", "keep one"),
        ({"demo_1_a.p": True}, "demo_{participant}.p", "it needs"),
        ({"demo_1_a.p": True}, "{participant}{condition}.p", "it needs"),
        ({"demo_1_a.p": True, "demo_2_a.p": False}, "demo_{participant}_{condition}.p", "demo_2_a.p: "),
    ],
)
def test_a_folder_that_is_otherwise_is_refused_whole(
    files: dict[str, bool], names: str, said: str, tmp_path: Path
) -> None:
    source = tmp_path / "in"
    source.mkdir()
    for name, sound in files.items():
        (source / name).write_bytes(listing(array(RNG.normal(size=(4, 3)))) + b"." if sound else b"cos\nsystem\n.")
    with pytest.raises((ArgumentError, RecordingError), match=said):
        import_ferl(source, tmp_path / "out", JOINTS, "/joint_states", 10.0, names)
    assert not (tmp_path / "out").exists()
