"""Given trajectories pass what recordings and sampled ones pass."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from pipeline.errors import StageError
from pipeline.formats.parquet.tables import read_table
from pipeline.replay.scene import Scene, load_scene
from pipeline.stages import featurize, ingest, sample
from pipeline.workspace.given import read_given
from pipeline.workspace.project import Project
from tests.support.gantry_project import GANTRY
from tests.support.recorded_motions import GOAL, START

T, COUNT = 15, 40


def bows(count: int = COUNT, seed: int = 2) -> np.ndarray:
    """(count, T, 3) trajectories from the scene's start to its goal."""
    s = np.linspace(0, 1, T)[:, None]
    size = np.random.default_rng(seed).normal(scale=0.2, size=(count, 1, 3))
    return np.asarray(START + s * (GOAL - START) + size * np.sin(np.pi * s))


def by_value(paths: np.ndarray) -> np.ndarray:
    """Sorted by a waypoint of their own."""
    return paths[np.lexsort(np.round(paths.reshape(len(paths), -1), 9).T[::-1])]


def saved(path: Path, values: list[Any]) -> Path:
    pl.DataFrame({"waypoints": values}, strict=False).write_parquet(path)
    return path


@pytest.fixture
def scene(tmp_path: Path) -> Scene:
    (tmp_path / "gantry.xml").write_text(GANTRY)
    return load_scene(tmp_path / "gantry.xml", end_effector="tip")


@pytest.fixture
def project(make_project: Callable[[dict[str, Any]], Project], parameters: dict[str, Any]) -> Project:
    parameters["sample"] |= {"sampler": "given", "given": "given.parquet", "sizes": [5, 10], "working_set": 30}
    return make_project(parameters)


def sampled(project: Project, paths: np.ndarray) -> tuple[pl.DataFrame, pl.DataFrame]:
    """The alternatives and how they were drawn."""
    saved(project.root / "given.parquet", list(paths.reshape(len(paths), -1).tolist()))
    ingest.run(project, "sweep")
    sample.run(project, "sweep")
    return tuple(read_table(project.table("sweep", name), name) for name in ("alternatives", "sampling"))  # type: ignore[return-value]


def test_nested_and_flat_lists_are_the_same_trajectories(tmp_path: Path, scene: Scene) -> None:
    paths = bows()
    nested = read_given(saved(tmp_path / "nested.parquet", paths.tolist()), scene, T)
    flat = read_given(saved(tmp_path / "flat.parquet", paths.reshape(COUNT, -1).tolist()), scene, T)
    np.testing.assert_array_equal(nested.waypoints, flat.waypoints)
    np.testing.assert_allclose(nested.waypoints, by_value(paths), atol=1e-15)
    shuffled = np.random.default_rng(0).permutation(paths)
    again = read_given(saved(tmp_path / "shuffled.parquet", shuffled.tolist()), scene, T)
    np.testing.assert_array_equal(again.waypoints, nested.waypoints)
    assert nested.notes == ()


WRONG = {
    "joint after joint": (
        lambda p: p.transpose(0, 2, 1).tolist(), r"row 1 is 3 x 15; it has joint after joint: transpose it"
    ),
    "joint after joint in a row": (
        lambda p: p.transpose(0, 2, 1).reshape(len(p), -1).tolist(),
        "rows are smooth if they are read joint after joint, as 3 x 15",
    ),
    "too few waypoints": (
        lambda p: p[:, 1:].tolist(), r"row 1 is 14 x 3; needed are 15 waypoints of 3 joints \(rail, swing, bend\)"
    ),
    "uneven": (lambda p: [*p[:5].tolist(), p[5, :7].tolist()], "row 6 is 7 x 3"),
    "not finite": (lambda p: np.where(p == p[7, 3, 1], np.nan, p).tolist(), "row 8 has a number that is not finite"),
    "text": (lambda p: ["a"] * len(p), "row 1"),
    "nothing": (lambda p: [], "has no rows"),
    "degrees": (lambda p: np.degrees(p * [0, 0, 1] + [0, 0, 0.3]).tolist(), r"'bend' is at .* look like degrees"),
    "ticks": (lambda p: np.rint(p * [0.1, 4096, 4096]).tolist(), "as encoders count ticks"),
}  # fmt: skip


@pytest.mark.parametrize("kind", WRONG)
def test_what_is_no_trajectory_of_the_arm_is_refused_naming_the_row(tmp_path: Path, scene: Scene, kind: str) -> None:
    change, said = WRONG[kind]
    with pytest.raises(StageError, match=rf"given\.parquet: .*{said}"):
        read_given(saved(tmp_path / "given.parquet", change(bows())), scene, T)


def test_rows_of_endless_zeros_are_refused_before_they_are_decoded(tmp_path: Path, scene: Scene) -> None:
    zeros = pl.Series([np.zeros(72_000)] * 400, dtype=pl.List(pl.Float64))
    pl.DataFrame({"waypoints": zeros}).write_parquet(tmp_path / "given.parquet")
    assert (tmp_path / "given.parquet").stat().st_size < 100_000
    said = r"says that its 400 rows hold 28,800,000 numbers, and rows of 45 are needed, which would be 18,000"
    with pytest.raises(StageError, match=said):
        read_given(tmp_path / "given.parquet", scene, T)


def test_joints_are_unwrapped_and_limited_ones_turned_back(tmp_path: Path, scene: Scene) -> None:
    paths = bows()
    wrapped = paths.copy()
    wrapped[..., 1] = (wrapped[..., 1] - 0.2) % (2 * np.pi)
    wrapped[..., 1] += 0.2
    wrapped[3:6, :, 2] -= 2 * np.pi
    assert np.abs(np.diff(wrapped, axis=1)).max() > 5
    given = read_given(saved(tmp_path / "given.parquet", wrapped.tolist()), scene, T)
    np.testing.assert_allclose(by_value(given.waypoints), by_value(paths), atol=1e-12)
    assert any("3 trajectories have a joint a whole turn from its limits" in note for note in given.notes)


def test_some_beyond_the_limits_or_through_the_surface_are_left_out_and_counted(project: Project) -> None:
    paths = bows()
    paths[:3, 7, 2] = 2.5
    scene = project.root / "gantry.xml"
    scene.write_text(scene.read_text().replace('pos="0 0 -0.5"', 'pos="0 0 -0.25"'))
    paths[3:8, 5:9, 2] = 1.8  # the tip goes below the floor
    alternatives, tallies = sampled(project, paths)
    used = {tuple(np.round(np.ravel(one), 9)) for one in alternatives["waypoints"].to_list()}
    assert used <= {tuple(np.round(one.ravel(), 9)) for one in paths[8:]}
    row = tallies.filter(pl.col("set_id") == "working").row(0, named=True)
    assert row["kept"] == 30
    assert row["proposed"] == 30 + row["outside_limits"] + row["through_surface"]
    assert 0 < row["outside_limits"] <= 3
    assert 0 < row["through_surface"] <= 5


def test_what_starts_or_ends_elsewhere_is_no_alternative(project: Project, capfd: pytest.CaptureFixture[str]) -> None:
    paths = bows()
    paths[:6] = paths[:6, ::-1]
    alternatives, _ = sampled(project, paths)
    starts = np.array(alternatives["waypoints"].to_list())[:, 0]
    np.testing.assert_allclose(starts, np.tile(START, (len(starts), 1)), atol=1e-9)
    assert "6 start or end elsewhere" in capfd.readouterr().err


def test_too_few_that_can_be_used_are_refused_with_the_counts(project: Project) -> None:
    paths = bows()
    paths[:15] = paths[:15, ::-1]
    with pytest.raises(
        StageError, match=r"a set of 30 is wanted, and 25 of the 40 .*15 start or end elsewhere.*working_set"
    ):
        sampled(project, paths)


def test_the_ends_are_those_of_each_demonstration(
    make_project: Callable[[dict[str, Any]], Project], parameters: dict[str, Any]
) -> None:
    parameters["sample"] |= {"sampler": "given", "given": "given.parquet", "sizes": [5], "working_set": 10}
    parameters["tasks"]["sweep"]["anchor"] = "demonstration"
    alternatives, _ = sampled(make_project(parameters), bows())
    assert set(alternatives["anchor"]) == {"demo-0", "demo-1", "demo-2"}


def test_ties_stay_ties(project: Project) -> None:
    """Pairs that are the same trajectory, one of them some turns further on."""
    paths = bows()
    paths[1::2] = paths[::2] + np.array([0, 4 * np.pi, 0])
    alternatives, _ = sampled(project, paths)
    featurize.run(project, "sweep")
    working = pl.col("set_id") == "working"
    features = read_table(project.table("sweep", "features"), "features").filter(working)
    rows = {tuple(np.ravel(one)) for one in alternatives.filter(working)["waypoints"].to_list()}
    assert features.height == 30
    assert features.select("effort", "vase").unique().height == len(rows) < 30


def test_waypoints_keep_all_their_digits(project: Project) -> None:
    paths = bows()
    alternatives, _ = sampled(project, paths)
    known = {tuple(one.ravel()) for one in paths}
    assert all(tuple(np.ravel(one)) in known for one in alternatives["waypoints"].to_list())


@pytest.mark.parametrize("name", ["alts[1].parquet", "a*.parquet", "a?b.parquet", "a{b}.parquet"])
def test_the_file_that_is_named_is_the_file_that_is_read(tmp_path: Path, scene: Scene, name: str) -> None:
    for other in ("alts1.parquet", "ab.parquet", "axb.parquet"):
        saved(tmp_path / other, bows(seed=9).tolist())
    given = read_given(saved(tmp_path / name, bows().tolist()), scene, T)
    np.testing.assert_allclose(given.waypoints, by_value(bows()), atol=1e-15)
