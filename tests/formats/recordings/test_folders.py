"""Which files of a folder are one recording, and how what is none is named."""

from __future__ import annotations

from pathlib import Path

import pytest

from pipeline.errors import RecordingError
from pipeline.formats.recordings.folders import LARGEST_INDEX, Bag, bag_of, read_folder, sequences, stem_of

HEAD = "rosbag2_bagfile_information:\n  relative_file_paths:\n"


def folder(path: Path, *names: str, index: str | None = None) -> Path:
    for name in names:
        (path / name).parent.mkdir(parents=True, exist_ok=True)
        (path / name).write_bytes(b"")
    if index is not None:
        (path / "metadata.yaml").write_text(index)
    return path


def test_a_folder_that_is_not_there_is_empty(tmp_path: Path) -> None:
    found = read_folder(tmp_path / "nowhere")
    assert (found.bags, found.unused) == ((), ())


def test_metadata_says_which_files_are_one_recording(tmp_path: Path) -> None:
    path = folder(tmp_path, "tea_1.mcap", "tea_0.mcap", "b.mcap", index=HEAD + "  - tea_0.mcap\n  - tea_1.mcap\n")
    found = read_folder(path)
    assert [(bag.name, [file.name for file in bag.files]) for bag in found.bags] == [
        ("b", ["b.mcap"]), ("tea", ["tea_0.mcap", "tea_1.mcap"])
    ]  # fmt: skip
    assert found.unused == ()
    assert bag_of(path / "tea_1.mcap") == found.bags[1]
    assert bag_of(path / "b.mcap") == found.bags[0]


@pytest.mark.parametrize(
    ("index", "reason"),
    [
        (HEAD + "  - a_0.mcap\n  - a_1.mcap\n", "incomplete-bag"),
        (HEAD + "  - a_0.mcap\n  - ../elsewhere/a_1.mcap\n", "incomplete-bag"),
        ("relative_file_paths: [a_0.mcap]\n", "bad-metadata"),
        (HEAD + "  - [1, 2]\n", "bad-metadata"),
        ("a: [\n", "bad-metadata"),
        ("x: !!python/object/apply:os.system ['true']\n", "bad-metadata"),
        ("a: &a [x]\nb: *a\n", "bad-metadata"),
        ("#" * (LARGEST_INDEX + 1), "bad-metadata"),
    ],
)
def test_metadata_that_cannot_be_used_is_named(tmp_path: Path, index: str, reason: str) -> None:
    path = folder(tmp_path, "a_0.mcap", index=index)
    found = read_folder(path)
    assert [(one.source, one.reason) for one in found.unused] == [("metadata.yaml", reason)]
    assert [bag.name for bag in found.bags] == ["a_0"]
    with pytest.raises(RecordingError):
        bag_of(path / "a_0.mcap")


def test_everything_else_in_the_folder_is_named_with_what_to_do(tmp_path: Path) -> None:
    names = (
        "A.MCAP",
        "b.db3",
        "c.mcap.zstd",
        "d.bag",
        "e.bag.active",
        "notes.txt",
        ".hidden",
        "deep/f.mcap",
        "photos/1.png",
    )
    found = read_folder(folder(tmp_path, *names))
    assert [(bag.name, bag.form) for bag in found.bags] == [
        ("A", "mcap"), ("b", "sqlite"), ("c", "mcap"), ("d", "ros1")
    ]  # fmt: skip
    told = {one.source: (one.reason, one.detail) for one in found.unused}
    assert set(told) == {name.split("/")[0] for name in names} - {bag.source for bag in found.bags}
    aside = {name for name, (reason, _) in told.items() if reason == "not-a-recording"}
    assert aside == {"notes.txt", ".hidden", "photos"}
    for name, command in {
        "e.bag.active": "`rosbag reindex e.bag.active`", "deep": "a folder with 1 MCAP file,",
    }.items():  # fmt: skip
        assert command in told[name][1]


def test_numbered_names_are_looked_at_together_in_the_order_of_their_numbers() -> None:
    bags = [Bag(name, (Path(f"{name}.mcap"),)) for name in ("a_10", "a_2", "a_9", "b", "c_0", "c_1", "ID01", "ID02")]
    assert [[bag.name for bag in one] for one in sequences(bags)] == [
        ["a_2"], ["a_9", "a_10"], ["b"], ["c_0", "c_1"], ["ID01"], ["ID02"]
    ]  # fmt: skip
    listed = [Bag("c", (Path("c_0.mcap"), Path("c_1.mcap")), listed=True), Bag("c_2", (Path("c_2.mcap"),))]
    assert [[bag.name for bag in one] for one in sequences(listed)] == [["c"], ["c_2"]]
    assert stem_of(bags[4:6]) == "c"
    assert stem_of(bags[4:5]) == "c_0"
