"""Tables of demonstrations: what columns mean, units, times and ids, and what is refused."""

from __future__ import annotations

import io
import zipfile
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline.errors import RecordingError
from pipeline.formats.mcap.limits import Limits
from pipeline.formats.recordings.columns import ColumnMap
from pipeline.formats.recordings.folders import read_folder
from pipeline.formats.recordings.readers import inspect, read_recording
from tests.support.recorded_forms import NAMES, START, motion, write_table

ENDINGS = [".csv", ".tsv", ".parquet", ".npz"]
TIMES, POSITIONS = motion()
SECONDS = (TIMES - TIMES[0]) / 1e9


def joints(scale: float = 1.0) -> dict[str, np.ndarray]:
    return {name: POSITIONS[:, place] * scale for place, name in enumerate(NAMES)}


def only(folder: Path, columns: ColumnMap | None = None, **arguments: Any) -> Any:
    """The one recording of a folder."""
    found = read_folder(folder, columns)
    assert not found.unused, found.unused
    (bag,) = found.bags
    return read_recording(bag, joints=arguments.pop("joints", NAMES), columns=columns, **arguments)


def rejected(folder: Path, columns: ColumnMap | None = None, **arguments: Any) -> RecordingError:
    found = read_folder(folder, columns)
    if found.unused:
        (one,) = found.unused
        return RecordingError(one.reason, one.detail)
    with pytest.raises(RecordingError) as caught:
        only(folder, columns, **arguments)
    return caught.value


@pytest.mark.parametrize("ending", ENDINGS)
@pytest.mark.parametrize("time", ["time", "t", "Timestamp", "time_s", "seconds"])
def test_a_table_is_read_by_the_names_of_its_columns(tmp_path: Path, ending: str, time: str) -> None:
    path = write_table(tmp_path / f"tea{ending}", {"note": ["x"] * 60, **joints(), time: SECONDS, "gripper": SECONDS})
    recording = only(tmp_path)
    np.testing.assert_array_equal(recording.time_ns, TIMES - TIMES[0])
    np.testing.assert_array_equal(recording.positions, POSITIONS)
    assert (recording.names, recording.clock, recording.source) == (NAMES, "header", path.name)
    assert (list(recording.hashes), recording.dropped) == ([path], 0)
    (bag,) = read_folder(tmp_path).bags
    assert bag.name == "tea"
    assert inspect(bag).topics[0].joints == (*NAMES, "gripper")


@pytest.mark.parametrize("ending", ENDINGS)
@pytest.mark.parametrize(
    ("name", "values", "unit"),
    [
        ("stamp_ns", TIMES, None), ("time", TIMES, None), ("time_ms", TIMES / 1e6, None), ("time", TIMES // 1000, None),
        ("time", SECONDS * 1000, "ms"), ("clock", TIMES, "ns"), ("time", TIMES / 1e9, None),
    ],
)  # fmt: skip
def test_times_of_every_unit(tmp_path: Path, ending: str, name: str, values: np.ndarray, unit: str | None) -> None:
    write_table(tmp_path / f"tea{ending}", {name: values, **joints()})
    columns = ColumnMap(time=name, time_unit=unit)
    recording = only(tmp_path, columns)
    shift = 0 if recording.time_ns[0] > START // 2 else TIMES[0]
    assert np.abs(recording.time_ns + shift - TIMES).max() <= (0 if values.dtype == np.int64 else 300)
    np.testing.assert_array_equal(recording.positions, POSITIONS)


@pytest.mark.parametrize("ending", [".csv", ".parquet"])
def test_dates_are_times(tmp_path: Path, ending: str) -> None:
    start = datetime(2026, 3, 1, 12)
    dates = [start + timedelta(milliseconds=20 * number) for number in range(60)]
    write_table(tmp_path / f"tea{ending}", {"timestamp": dates, **joints()})
    recording = only(tmp_path)
    np.testing.assert_array_equal(np.diff(recording.time_ns), 20_000_000)
    assert recording.time_ns[0] == int(np.datetime64(start, "ns").astype(np.int64))


def test_a_rate_in_place_of_times_and_times_before_zero(tmp_path: Path) -> None:
    write_table(tmp_path / "tea.csv", joints())
    assert "reading.time, or give its rate in reading.rate_hz" in rejected(tmp_path).detail
    np.testing.assert_array_equal(only(tmp_path, ColumnMap(rate_hz=50.0)).time_ns, TIMES - TIMES[0])
    write_table(tmp_path / "tea.csv", {"t": SECONDS - 0.5, **joints()})
    np.testing.assert_array_equal(only(tmp_path).time_ns, TIMES - TIMES[0])


@pytest.mark.parametrize("ending", ENDINGS)
def test_units_of_positions(tmp_path: Path, ending: str) -> None:
    write_table(tmp_path / f"tea{ending}", {"t": SECONDS, **joints(180 / np.pi)})
    np.testing.assert_allclose(only(tmp_path, ColumnMap(unit="deg")).positions, POSITIONS, atol=1e-12)
    mixed = only(tmp_path, ColumnMap(unit={"swing": "deg", "rail": "mm"})).positions
    np.testing.assert_allclose(mixed[:, 0], POSITIONS[:, 0] * 180 / np.pi / 1000)
    np.testing.assert_allclose(mixed[:, 1], POSITIONS[:, 1])


@pytest.mark.parametrize("ending", ENDINGS)
@pytest.mark.parametrize("ids", [["a", "b"], [3, 12]])
def test_a_column_of_ids_tells_recordings_apart(tmp_path: Path, ending: str, ids: list[Any]) -> None:
    order = np.argsort(np.tile(np.arange(60), 2), kind="stable")  # rows of both by turns
    both = {name: np.concatenate([values, values + 0.1])[order] for name, values in joints().items()}
    table = {"trial": np.repeat(ids, 60)[order], "who": np.repeat(["Ann", "Bo"], 60)[order]}
    write_table(tmp_path / f"all{ending}", {**table, "t": np.tile(SECONDS, 2)[order], **both})
    columns = ColumnMap(id="trial", participant="who")
    found = read_folder(tmp_path, columns).bags
    assert {bag.name for bag in found} == {f"all_{one}" for one in ids}
    for bag in found:
        recording = read_recording(bag, joints=NAMES, columns=columns)
        second = bag.entry == str(ids[1])
        np.testing.assert_array_equal(recording.positions, POSITIONS + 0.1 * second)
        assert recording.metadata["demonstration"] == {"participant": "Bo" if second else "Ann"}
        assert recording.source == f"all{ending}: {bag.entry}"
    assert "reading.id" in rejected(tmp_path, ColumnMap(participant="who")).detail


@pytest.mark.parametrize("ending", [".parquet", ".npz"])
def test_an_array_of_positions(tmp_path: Path, ending: str) -> None:
    values: dict[str, Any] = {"t": SECONDS, "q": POSITIONS if ending == ".npz" else POSITIONS.tolist()}
    write_table(tmp_path / f"tea{ending}", values)
    recording = only(tmp_path, ColumnMap(joints=NAMES))
    np.testing.assert_array_equal(recording.positions, POSITIONS)
    (bag,) = read_folder(tmp_path).bags
    assert inspect(bag).topics[0].joints == ("q_0", "q_1", "q_2")
    assert "names 2" in rejected(tmp_path, ColumnMap(joints=("a", "b"), array="q")).detail
    if ending == ".npz":
        write_table(tmp_path / "tea.npz", values | {"joint_names": np.array(NAMES), "dq": POSITIONS})
        np.testing.assert_array_equal(only(tmp_path, ColumnMap(array="q")).positions, POSITIONS)


def test_csv_of_other_habits_is_read(tmp_path: Path) -> None:
    rows = "\r\n".join(
        f"{t!r}; {q[0]!r};{q[1]!r};{q[2]!r}" for t, q in zip(SECONDS.tolist(), POSITIONS.tolist(), strict=True)
    )
    (tmp_path / "tea.csv").write_bytes(b"\xef\xbb\xbf" + f'"t"; rail;swing;bend\r\n{rows}\r\n'.encode())
    np.testing.assert_array_equal(only(tmp_path).positions, POSITIONS)


@pytest.mark.parametrize("ending", ENDINGS)
def test_mistakes_in_columns_are_one_sentence(tmp_path: Path, ending: str) -> None:
    write_table(tmp_path / f"tea{ending}", {"t": SECONDS, **joints(), "note": ["x"] * 60})
    for columns, said in (
        (ColumnMap(time="when"), "no column 'when', which reading.time"),
        (ColumnMap(id="trial"), "no column 'trial', which reading.id"),
        (ColumnMap(joints=("rail", "note")), "no column of numbers 'note'"),
        (ColumnMap(joints=("rail", "arm")), "no column of numbers 'arm'"),
    ):
        error = rejected(tmp_path, columns)
        assert (error.reason, said in error.detail) == ("not-read", True), error.detail
    error = rejected(tmp_path, joints=["elbow"])
    assert (error.reason, "joint_names" in error.detail) == ("joints-missing", True)


@pytest.mark.parametrize(
    ("text", "reason", "said"),
    [
        ("", "corrupt", "is empty"),
        ("1,2\n3,4\n", "not-read", "begins with numbers"),
        ("t,rail,rail\n0,1,2\n", "corrupt", "'rail' twice"),
        ("t,rail\n0,1\n1,2,3\n", "corrupt", "cannot be read as CSV"),
        ("t,rail\n0,1\n1,x\n", "corrupt", "Row 2 of tea.csv has 'x' in its column 'rail'"),
        ("t,rail\n0,1\n,2\n", "not-finite", "Row 2 of tea.csv has no time"),
        ("t,rail\n0,1\n1,\n", "not-finite", "has rail at nan"),
        ("t,rail\n0,1\n1e300,2\n", "out-of-range", "2262"),
        ("t,rail\n2,1\n1,2\n", "time-not-increasing", "earlier"),
        ("t,rail\n0,1\n", "too-few-messages", "1 pose"),
        ("t,rail\n", "joints-missing", "columns of numbers are none"),
        (",".join(f"c{i}" for i in range(5000)) + "\n", "too-large", "5000 columns"),
    ],
)
def test_csv_that_is_no_motion_is_refused(tmp_path: Path, text: str, reason: str, said: str) -> None:
    (tmp_path / "tea.csv").write_text(text)
    error = rejected(tmp_path, joints=["rail"])
    assert (error.reason, said in error.detail) == (reason, True), (error.reason, error.detail)


def test_text_that_is_none_is_refused(tmp_path: Path) -> None:
    (tmp_path / "tea.csv").write_bytes(b"t,rail\n\xff\xfe,1\n")
    assert rejected(tmp_path).reason == "corrupt"


@pytest.mark.parametrize("ending", ENDINGS)
def test_what_a_table_may_cost_is_bounded(tmp_path: Path, ending: str) -> None:
    write_table(tmp_path / f"tea{ending}", {"t": SECONDS, **joints()})
    assert rejected(tmp_path, limits=Limits(joint_values=100)).reason == "too-large"
    assert rejected(tmp_path, limits=Limits(stored_bytes=10)).reason == "too-large"


# npz


def npz(path: Path, **members: bytes) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in members.items():
            archive.writestr(f"{name}.npy", data)
    return path


def array(values: np.ndarray, **options: Any) -> bytes:
    stream = io.BytesIO()
    np.lib.format.write_array(stream, values, **options)
    return stream.getvalue()


def header(text: str) -> bytes:
    data = text.encode().ljust(118) + b"\n"
    return b"\x93NUMPY\x01\x00" + len(data).to_bytes(2, "little") + data


TIME = array(SECONDS)


@pytest.mark.parametrize(
    ("member", "said"),
    [
        (array(np.array([{}], dtype=object), allow_pickle=True), "Python objects"),
        (header("{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000,), }"), "states 8000000000000 bytes"),
        (header("{'descr': '<f8', 'fortran_order': False, 'shape': (-3,), }"), "states -24 bytes"),
        (header("{'descr': '<f8', 'fortran_order': False, 'shape': (60,), }") + bytes(100), "states 480 bytes"),
        (header("__import__('os').system('true')"), "no array of NumPy"),
        (header("(" * 100), "no array of NumPy"),
        (b"\x93NUMPY\x09\x00", "no array of NumPy"),
        (b"text", "no array of NumPy"),
    ],
)
def test_npz_that_states_what_it_has_not_or_is_a_program_is_refused(tmp_path: Path, member: bytes, said: str) -> None:
    npz(tmp_path / "tea.npz", t=TIME, rail=member)
    error = rejected(tmp_path, joints=["rail"])
    assert (error.reason, said in error.detail) == ("corrupt", True), error.detail


def test_npz_that_inflates_without_end_is_refused(tmp_path: Path) -> None:
    rows = 10**7
    path = npz(tmp_path / "tea.npz", t=TIME, rail=array(np.zeros(rows)))
    assert path.stat().st_size < 1 << 17
    assert rejected(tmp_path, joints=["rail"]).reason == "too-large"


def test_damaged_archives_are_one_sentence(tmp_path: Path) -> None:
    path = write_table(tmp_path / "tea.npz", {"t": SECONDS, **joints()})
    content, rng = path.read_bytes(), np.random.default_rng(0)
    reasons = set()
    for _ in range(200):
        data = bytearray(content)
        for at in rng.integers(len(data), size=3):
            data[at] = rng.integers(256)
        path.write_bytes(data)
        try:
            found = read_folder(tmp_path)
            reasons |= {one.reason for one in found.unused}
            for bag in found.bags:
                read_recording(bag, joints=NAMES)
        except RecordingError as error:
            reasons.add(error.reason)
    assert "corrupt" in reasons


# Parquet


def test_damaged_parquet_is_one_sentence(tmp_path: Path) -> None:
    path = write_table(tmp_path / "tea.parquet", {"t": SECONDS, **joints()})
    content, rng, said = path.read_bytes(), np.random.default_rng(0), []
    for _ in range(8):
        data = bytearray(content)
        for at in rng.integers(len(data) - 800, len(data), 3):
            data[at] = rng.integers(256)
        path.write_bytes(data)
        found = read_folder(tmp_path)
        for bag in found.bags:
            try:
                read_recording(bag, joints=NAMES)
            except RecordingError as error:
                said.append(error.detail)
    assert all(said)
    path.write_bytes(b"PAR1" + bytes(100))
    assert rejected(tmp_path).reason == "corrupt"


def test_uneven_lists_of_parquet_are_refused(tmp_path: Path) -> None:
    rows = POSITIONS.tolist()
    rows[5] = rows[5] + [1.0]
    rows[6] = rows[6][:2]
    write_table(tmp_path / "tea.parquet", {"t": SECONDS, "q": rows})
    error = rejected(tmp_path, ColumnMap(joints=NAMES))
    assert (error.reason, "not of one length" in error.detail) == ("corrupt", True)


def test_a_long_text_that_stands_for_many_rows_is_refused(tmp_path: Path) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    rows = 200_000
    ids = pa.DictionaryArray.from_arrays(pa.array(np.zeros(rows, np.int32)), pa.array(["x" * 100_000]))
    plain = {name: np.zeros(rows) for name in ("t", *NAMES)}
    path = tmp_path / "tea.parquet"
    pq.write_table(
        pa.table({"id": ids.cast(pa.dictionary(pa.int32(), pa.string())), **plain}), path, store_schema=False
    )
    assert path.stat().st_size < 1 << 20
    error = rejected(tmp_path, ColumnMap(id="id"))
    assert (error.reason, "texts of more than" in error.detail) == ("corrupt", True)


def test_of_a_wide_table_no_more_rows_are_read_than_may_be_held(tmp_path: Path) -> None:
    names = [f"j{number}" for number in range(3000)]
    line = ",".join(["0"] * 3001)
    (tmp_path / "tea.csv").write_text("\n".join(["t," + ",".join(names), *[line] * 20]))
    found = read_folder(tmp_path)
    with pytest.raises(RecordingError, match="more than 30000 joint positions"):
        read_recording(found.bags[0], limits=Limits(joint_values=30_000))


def test_of_a_table_only_what_is_wanted_is_read(tmp_path: Path) -> None:
    many = {f"j{number}": SECONDS for number in range(300)}
    write_table(tmp_path / "tea.csv", {"t": SECONDS, **many, **joints()})
    assert only(tmp_path, limits=Limits(joint_values=4 * 60)).names == NAMES
