"""Sets larger than a partition go through the stages part by part, with the results of the whole set in memory."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import polars as pl
import pytest

from pipeline.choice import select_bandwidth
from pipeline.choice.kernel import row_sample
from pipeline.choice.kernel.bandwidth import sampled_bandwidth
from pipeline.choice.scaling import Spread
from pipeline.errors import BandwidthError, StageError
from pipeline.formats.parquet import partitions
from pipeline.formats.parquet.checked.open_table import Piece
from pipeline.formats.parquet.tables import read_table, write_table
from pipeline.stages import density, featurize, infer, ingest, sample
from pipeline.trajectories.random_streams import child_rng
from pipeline.workspace.compute import executor, likelihoods
from pipeline.workspace.compute.streamed_alternatives import StreamedSet
from pipeline.workspace.project import Project
from tests.support.tables import part_rows

MakeProject = Callable[[dict[str, Any]], Project]


@pytest.fixture
def large(parameters: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Parameters of a project whose working set is five parts of 400 rows, features read by two of them at a time."""
    monkeypatch.setattr(partitions, "PARTITIONS", 2)
    for module in (density, likelihoods):
        monkeypatch.setattr(module, "PARTITIONS", 2)
    parameters["compute"]["partition"] = 400
    parameters["sample"] |= {"sizes": [5, 20], "sets": 2, "working_set": 1900}
    parameters["density"]["bandwidth"] = 0.05
    return parameters


def table(project: Project, name: str) -> pl.DataFrame:
    return read_table(project.table("sweep", name), name)


def drawn(project: Project) -> Project:
    for stage in (ingest, sample, featurize):
        stage.run(project, "sweep")
    return project


def computed(project: Project) -> tuple[pl.DataFrame, pl.DataFrame]:
    density.run(project, "sweep")
    infer.run(project, "sweep")
    return table(project, "densities"), table(project, "posteriors")


def test_a_large_set_is_stored_in_parts_with_ids_in_order(make_project: MakeProject, large: dict[str, Any]) -> None:
    project = drawn(make_project(large))
    assert part_rows(project.table("sweep", "alternatives")) == (*[400] * 4, 350)
    rows = table(project, "alternatives")
    assert rows.filter(set_id="working")["alternative_id"].to_list() == [
        f"task/1900/working/{place:06d}" for place in range(1900)
    ]
    assert rows.group_by("set_size", "set_id").len().sort("set_size", "set_id").rows() == [
        (5, "00", 5), (5, "01", 5), (20, "00", 20), (20, "01", 20), (1900, "working", 1900),
    ]  # fmt: skip
    tallies = table(project, "sampling").filter(set_id="working")
    assert tallies["kept"].sum() == 1900
    assert tallies["sampler"].to_list() == ["deformation", "planner", "via-point"]
    features = table(project, "features")
    assert features.filter(kind="alternative")["id"].equals(rows["alternative_id"])


def test_parts_of_a_set_have_streams_of_their_own_and_small_sets_the_one_they_had(
    make_project: MakeProject, large: dict[str, Any]
) -> None:
    project = drawn(make_project(large))
    working = table(project, "alternatives").filter(set_id="working")["waypoints"].to_numpy()
    assert len(np.unique(working[:, 7], axis=0)) == 1900
    small = table(project, "alternatives").filter(set_size=20)
    large["compute"]["partition"] = 50_000
    project = drawn(make_project(large))
    whole = table(project, "alternatives")
    assert whole.filter(set_size=20).equals(small)
    assert not np.array_equal(whole.filter(set_id="working")["waypoints"].to_numpy(), working)
    assert part_rows(project.table("sweep", "alternatives")) == (1950,)


@pytest.mark.parametrize("scale", ["range", "std"])
def test_part_by_part_is_what_the_whole_set_in_memory_gives(
    make_project: MakeProject, large: dict[str, Any], scale: str
) -> None:
    large["features"]["scale"] = scale
    streamed = computed(drawn(make_project(large)))
    large["compute"]["partition"] = 50_000
    whole = computed(make_project(large))
    assert streamed[0].filter(set_id="working")["engine"].unique().to_list() == ["spectral"]
    assert whole[0].filter(set_id="working")["engine"].unique().to_list() == ["exact"]
    for name, one, other, tolerance in (
        ("log_density", streamed[0], whole[0], 1e-6),
        ("log_posterior", streamed[1], whole[1], 1e-4),  # log densities good to 1e-6, beta up to 30
    ):
        np.testing.assert_allclose(one[name], other[name], rtol=0, atol=tolerance, err_msg=name)
    boltzmann = [posteriors.filter(model="boltzmann")["log_posterior"] for posteriors in (streamed[1], whole[1])]
    np.testing.assert_allclose(*boltzmann, rtol=0, atol=1e-9)


def test_a_bandwidth_is_selected_part_by_part(make_project: MakeProject, large: dict[str, Any]) -> None:
    large["density"]["bandwidth"] = "leave-one-out"
    project = drawn(make_project(large))
    density.run(project, "sweep")
    streamed = table(project, "densities").filter(set_id="working").row(0, named=True)
    large["compute"]["partition"] = 50_000
    density.run(make_project(large), "sweep")
    whole = table(project, "densities").filter(set_id="working").row(0, named=True)
    assert whole["rows_scored"] is None
    assert streamed["rows_scored"] == 1900  # so few that all are
    assert streamed["bandwidth_error"] == pytest.approx(0, abs=1e-12)
    assert streamed["bandwidth"] == pytest.approx(whole["bandwidth"], rel=1e-3)
    large["density"]["bandwidth"], large["compute"]["partition"] = "k-fold", 400
    with pytest.raises(StageError, match="'k-fold', which compares all pairs, and the set 'working' has 1,900"):
        density.run(make_project(large), "sweep")


@dataclass(frozen=True, eq=False)
class Rows:
    """Scaled features in memory, where a stage has them in a file."""

    values: np.ndarray

    def read(self, pieces: Sequence[Piece]) -> np.ndarray:
        return np.concatenate([self.values[piece.first : piece.first + piece.count] for piece in pieces])


@pytest.mark.parametrize(("drawn_rows", "errors"), [(50_000, 0.02), (4000, 4.0)])
def test_the_sampled_score_of_parts_is_that_of_the_set(
    make_project: MakeProject, large: dict[str, Any], monkeypatch: pytest.MonkeyPatch, drawn_rows: int, errors: float
) -> None:
    monkeypatch.setattr(row_sample, "_DRAWN", drawn_rows)
    rng = child_rng(3, "clusters")
    values = rng.random((5, 3))[rng.integers(0, 5, 12_000)] + 0.05 * rng.normal(size=(12_000, 3))
    values[7000:7040] = values[:40]  # in other parts
    parts = [[Piece(0, first, min(2500, 12_000 - first))] for first in range(0, 12_000, 2500)]
    spread = Spread.of(values)
    with executor.workers() as pool:
        found = sampled_bandwidth(StreamedSet(pool, Rows(values), parts, spread, 1e9, "clusters"))  # type: ignore[arg-type]
    whole = select_bandwidth(values)
    assert found.rows_scored is not None
    assert found.rows_scored > 1500
    assert found.value_error == pytest.approx(whole.value_error, rel=0.5)
    assert abs(found.value - whole.value) < errors * found.value_error
    assert abs(found.log_likelihood - whole.log_likelihood) < errors * found.log_likelihood_error


def test_rows_that_are_all_the_same_have_no_bandwidth(make_project: MakeProject, large: dict[str, Any]) -> None:
    values = np.ones((600, 2))
    parts = [[Piece(0, 0, 300)], [Piece(0, 300, 300)]]
    with executor.workers() as pool, pytest.raises(BandwidthError, match="one distinct row"):
        StreamedSet(pool, Rows(values), parts, Spread.of(values), 1e9, "the same")  # type: ignore[arg-type]


def test_from_the_same_densities_the_posteriors_agree_to_rounding(
    make_project: MakeProject, large: dict[str, Any]
) -> None:
    large["compute"]["memory_gb"] = 1e-4  # no sketch: every pair is summed
    streamed = computed(drawn(make_project(large)))
    large["compute"]["partition"] = 50_000
    whole = computed(make_project(large))
    assert streamed[0]["log_density"].equals(whole[0]["log_density"])
    np.testing.assert_allclose(streamed[1]["log_posterior"], whole[1]["log_posterior"], rtol=0, atol=1e-9)


def test_rows_that_the_sketch_does_not_resolve_are_summed_exactly(
    make_project: MakeProject, large: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    project = drawn(make_project(large))
    monkeypatch.setattr("pipeline.choice.streaming.RELATIVE_ERROR", 1e-9)
    density.run(project, "sweep")
    streamed = table(project, "densities")
    large["compute"]["partition"] = 50_000
    density.run(make_project(large), "sweep")
    np.testing.assert_allclose(streamed["log_density"], table(project, "densities")["log_density"], rtol=0, atol=1e-7)
    monkeypatch.setattr(density, "LONGEST_S", 1e-12)
    monkeypatch.setattr(density, "sketch_seconds", lambda *_: 0.0)
    large["compute"]["partition"] = 400
    with pytest.raises(StageError, match="too isolated in a set of 1,900"):
        density.run(make_project(large), "sweep")


def test_a_box_too_large_for_one_sketch_is_cut_into_slabs(
    make_project: MakeProject, large: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    density.run(drawn(make_project(large)), "sweep")
    one = table(make_project(large), "densities")
    slabs: list[int] = []
    large["compute"]["memory_gb"] = 2.4e-4
    project = make_project(large)
    monkeypatch.setattr(density, "SLABBED", 0)
    cut_box = density.sketch_slabs
    monkeypatch.setattr(density, "sketch_slabs", lambda *box: slabs.append(len(found := cut_box(*box) or ())) or found)
    density.run(project, "sweep")
    several = table(project, "densities")
    assert slabs[0] > 1
    assert several["engine"].equals(one["engine"])
    np.testing.assert_allclose(several["log_density"], one["log_density"], rtol=0, atol=1e-6)


def test_a_bandwidth_too_narrow_for_a_sketch_takes_the_whole_set_up_to_a_limit(
    make_project: MakeProject, large: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    large["compute"]["memory_gb"] = 1e-4
    project = drawn(make_project(large))
    density.run(project, "sweep")
    streamed = table(project, "densities")
    assert streamed["engine"].unique().to_list() == ["exact"]
    large["compute"]["partition"] = 50_000
    density.run(make_project(large), "sweep")
    assert streamed["log_density"].equals(table(project, "densities")["log_density"])
    monkeypatch.setattr(density, "IN_MEMORY", 1000)
    large["compute"]["partition"] = 400
    with pytest.raises(StageError, match=r"'working' has 1,900 alternatives .* up to 1,000 are possible"):
        density.run(make_project(large), "sweep")


def test_what_would_take_too_long_is_read_at_once_or_else_refused_with_what_to_do(
    make_project: MakeProject, large: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    project = drawn(make_project(large))
    monkeypatch.setattr(density, "LONGEST_S", 1e-9)
    density.run(project, "sweep")
    assert table(project, "densities").filter(set_id="working")["engine"].unique().to_list() == ["exact"]
    monkeypatch.setattr(density, "IN_MEMORY", 1000)
    with pytest.raises(StageError, match=r"'working' of 1,900 alternatives .* hours on \d+ cores; use more workers"):
        density.run(project, "sweep")


def test_a_model_that_needs_the_whole_set_says_so(make_project: MakeProject, large: dict[str, Any]) -> None:
    large["infer"]["models"] = ["boltzmann", "attribute-rule"]
    project = drawn(make_project(large))
    density.run(project, "sweep")
    with pytest.raises(StageError, match=r"attribute-rule, .* 'working' of 1,900 is larger than compute.partition"):
        infer.run(project, "sweep")


def test_densities_in_another_order_are_refused(make_project: MakeProject, large: dict[str, Any]) -> None:
    project = drawn(make_project(large))
    density.run(project, "sweep")
    write_table(project.table("sweep", "densities"), "densities", table(project, "densities").reverse(), {})
    with pytest.raises(StageError, match=r"densities\.parquet: its alternatives are not in the order of features"):
        infer.run(project, "sweep")


@pytest.mark.parametrize("count", [1, 3, 8])
def test_the_number_of_threads_changes_no_byte(
    make_project: MakeProject, large: dict[str, Any], monkeypatch: pytest.MonkeyPatch, count: int
) -> None:
    """Small sets of more than a partition, and a large one."""
    names = ("alternatives", "sampling", "features", "densities", "scales", "posteriors", "held_out")
    large["sample"] |= {"sizes": [70, 90], "sets": 6}

    def written() -> dict[str, bytes]:
        project = drawn(make_project(large))
        computed(project)
        return {name: project.table("sweep", name).read_bytes() for name in names}

    here = written()
    monkeypatch.setattr(executor.os, "cpu_count", lambda: count)
    assert written() == here


def test_results_come_in_the_order_of_the_jobs_and_few_are_under_way(
    make_project: MakeProject, large: dict[str, Any]
) -> None:
    begun: list[int] = []

    def squared(number: int) -> int:
        begun.append(number)
        return number**2

    with executor.workers() as pool:
        results = pool.mapped(squared, range(1000), "squares")
        assert [next(results) for _ in range(3)] == [0, 1, 4]
        assert len(begun) <= 3 + pool.cores() + 1
        results.close()
        with pytest.raises(StageError, match="number 5"):
            list(pool.mapped(_failing, range(1000), "failures"))
    assert len(begun) < 20


@pytest.mark.parametrize(
    ("count", "tree"), [(1, "0"), (2, "(01)"), (3, "((01)2)"), (6, "(((01)(23))(45))"), (7, "(((01)(23))((45)6))")]
)
def test_results_are_merged_as_a_tree_of_neighbours(
    make_project: MakeProject, large: dict[str, Any], count: int, tree: str
) -> None:
    with executor.workers() as pool:
        assert pool.merged(str, range(count), lambda one, other: f"({one}{other})", "numbers") == tree
        with pytest.raises(StageError, match="number 5"):
            pool.merged(_failing, range(1000), max, "failures")
        with pytest.raises(TypeError, match="not supported"):
            pool.merged(lambda number: number if number else None, range(1000), max, "failures")


def test_few_results_wait_to_be_merged(make_project: MakeProject, large: dict[str, Any]) -> None:
    """Of 1000: those under way, and one for each power of two."""
    alive, most = [0], [0]

    class Counted:
        def __init__(self) -> None:
            alive[0] += 1
            most[0] = max(most[0], alive[0])

        def __del__(self) -> None:
            alive[0] -= 1

    with executor.workers() as pool:
        pool.merged(lambda _: Counted(), range(1000), lambda one, other: Counted(), "objects")
        assert most[0] <= pool.cores() + 1 + 10 + 3


def _failing(number: int) -> int:
    if number == 5:
        raise StageError("number 5")
    return number
