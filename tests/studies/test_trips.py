"""The study of trips on a small network, and its exact likelihood on the published one."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from scipy import sparse
from scipy.special import stdtrit

from pipeline.errors import StageError
from pipeline.formats.trips.importer import read_trips
from pipeline.stages import trips
from pipeline.studies.trips.choices import draw_all, drawers
from pipeline.studies.trips.drawn_paths import SAMPLERS, PathSet, Way, draw
from pipeline.studies.trips.path_models import (
    BOLTZMANN_CORRECTED,
    BY_SET,
    EXPANDED_PATH_SIZE,
    LESS,
    LESS_LINKS,
    PATH_SIZE,
    Kernels,
    log_weights,
    own_feature,
)
from pipeline.studies.trips.roads import Roads
from pipeline.studies.trips.study import PUBLISHED, START, folds_of, run_trips, summed_up
from pipeline.studies.trips.town_map import town_map
from pipeline.workspace.project import Project
from tests.support.small_roads import write_small_roads

# Two paths that share a link, and one apart from them.
LINKS = sparse.csr_array(np.array([[1.0, 1, 0, 0], [1, 0, 1, 0], [0, 0, 0, 1]]))
STEPS = np.zeros((3, 1), dtype=np.intp)
PATHS = PathSet(STEPS, np.array([[0.0], [0.0], [9.0]]), LINKS, np.log([0.2, 0.1, 0.01]), np.array([3, 1, 1]), 0)
KERNELS = Kernels(np.array([1.0]), 0.1)


@pytest.fixture(scope="module")
def roads(tmp_path_factory: pytest.TempPathFactory) -> Roads:
    read = read_trips(write_small_roads(tmp_path_factory.mktemp("roads")))
    return Roads.of(read.network.reverse(), read.observed.reverse())


def test_weights_of_models_are_those_worked_out_by_hand() -> None:
    pool = np.array([[0.0], [0.0], [0.0], [0.0], [9.0]])
    np.testing.assert_allclose(log_weights(LESS, PATHS, pool, KERNELS), [-np.log(2), -np.log(2), 0])
    np.testing.assert_allclose(log_weights("less-pooled", PATHS, pool, KERNELS), [-np.log(4), -np.log(4), 0])
    corrected = log_weights(BOLTZMANN_CORRECTED, PATHS, pool, KERNELS)
    np.testing.assert_allclose(corrected, np.log([15, 10, 100]))
    shared, apart = np.exp(-1 / (2 * 0.25)), np.exp(-2 / (2 * 0.25))  # squared distances 2 - 2 * 1/2 and 2
    sums = [1 + shared + apart, 1 + shared + apart, 1 + 2 * apart]
    np.testing.assert_allclose(log_weights(LESS_LINKS, PATHS, pool, KERNELS), -np.log(sums))


@pytest.mark.parametrize(("count", "links"), [(1, 3), (257, 40), (1001, 90)])
def test_the_density_over_shared_links_is_the_sum_over_all_pairs(count: int, links: int) -> None:
    rng = np.random.default_rng(count)
    used = rng.integers(0, 3, (count, links)).astype(float)
    used[:, 0] = 1
    paths = PathSet(
        np.zeros((count, 1), dtype=np.intp), np.zeros((count, 1)), sparse.csr_array(used), np.zeros(count),
        np.ones(count, dtype=np.int64), 0,
    )  # fmt: skip
    rows = used / np.linalg.norm(used, axis=1, keepdims=True)
    expected = [np.log(np.exp(-((rows - row) ** 2).sum(axis=1) / (2 * 0.5**2)).sum()) for row in rows[:20]]
    found = -log_weights(LESS_LINKS, paths, paths.features, KERNELS)
    np.testing.assert_allclose(found[:20], expected, atol=1e-12)
    last = np.log(np.exp(-((rows - rows[-1]) ** 2).sum(axis=1) / (2 * 0.5**2)).sum())
    assert found[-1] == pytest.approx(last, abs=1e-12)


def test_path_sizes_are_those_worked_out_by_hand() -> None:
    np.testing.assert_allclose(own_feature(PATH_SIZE, PATHS), np.log([0.75, 0.75, 1]))
    # of the four draws, the second path is expected 0.4 times and counts 2.5; the third counts 25; the first is taken
    expanded = [(1 / 3.5 + 1) / 2, (1 / 3.5 + 1 / 2.5) / 2, 1 / 25]
    np.testing.assert_allclose(own_feature(EXPANDED_PATH_SIZE, PATHS), np.log(expanded))


def test_a_set_has_distinct_paths_with_the_one_taken_first(roads: Roads) -> None:
    way = Way.of(roads, SAMPLERS["wide"], int(roads.destinations[0]))
    paths = draw(roads, 0, way, 200, 1, ("here",)).first(200)
    assert paths.drawn.sum() == 201
    np.testing.assert_allclose(paths.features[0], roads.features[roads.paths[0]].sum(axis=0))
    assert len(np.unique(paths.log_q.round(12))) > 2
    shares = paths.drawn[1:] / 200
    np.testing.assert_allclose(shares, np.exp(paths.log_q[1:]), atol=0.12)
    again = draw(roads, 0, way, 200, 1, ("here",))
    np.testing.assert_array_equal(paths.features, again.first(200).features)
    few = again.first(20)
    assert few.drawn.sum() == 21
    np.testing.assert_array_equal(few.features, paths.features[: len(few.features)])


def test_corrected_boltzmann_comes_to_the_exact_estimate_where_all_paths_are_drawn(roads: Roads) -> None:
    exact = roads.recursive_logit().estimate([-2.0, -1.0, -1.0, -4.0])
    with ThreadPoolExecutor(1) as pool:
        drawn = draw_all(roads, [1500], 0, 1, pool).drawn[1500]["wide"]
    weights = drawn.sets(BOLTZMANN_CORRECTED).estimate(drawn.log_weights(BOLTZMANN_CORRECTED))
    value = roads.recursive_logit().log_likelihoods(weights).sum()
    assert exact.log_likelihood - value < 0.05


def test_processes_draw_the_same_as_one_thread(roads: Roads) -> None:
    with drawers(10_000) as processes, drawers(1) as thread:
        assert type(processes) is not type(thread)
        many, one = (draw_all(roads, [20, 5], 1, 7, pool) for pool in (processes, thread))
    assert many.kernels.keys() == one.kernels.keys()
    for size in (20, 5):
        np.testing.assert_array_equal(many.kernels[size].scale, one.kernels[size].scale)
        for sampler in SAMPLERS:
            a, b = many.drawn[size][sampler], one.drawn[size][sampler]
            np.testing.assert_array_equal(a.features, b.features)
            np.testing.assert_array_equal(a.nests, b.nests)
            for model in a.log_w:
                np.testing.assert_array_equal(a.log_w[model], b.log_w[model])


def test_the_study_has_a_row_for_everything_and_is_the_same_again(roads: Roads) -> None:
    study = run_trips(roads, 3, {8: 2})
    count = len(BY_SET) * len(SAMPLERS) * 2
    assert study.estimates.height == count
    assert study.held_out.height == (count + len(SAMPLERS) * 2) * 40
    assert study.scores.height == (len(BY_SET) + 1) * len(SAMPLERS)
    assert study.held_out["log_predictive"].max() <= 0
    again = run_trips(roads, 3, {8: 2})
    assert study.scores.equals(again.scores)
    assert study.estimates.equals(again.estimates)


def test_each_trip_is_held_out_once() -> None:
    np.testing.assert_array_equal(np.sum(folds_of(23, 4), axis=0), np.ones(23))


def test_intervals_take_both_errors() -> None:
    rows = [("boltzmann-corrected", "wide", 5, s, t, -1.0 - s - t) for s in (0, 1) for t in (0, 2)]
    columns = ["model", "sampler", "set_size", "sampling", "trip", "log_predictive"]
    row = summed_up(pl.DataFrame(rows, schema=columns, orient="row")).row(0, named=True)
    assert row["log_predictive"] == -2.5
    assert row["log_predictive_error_trips"] == pytest.approx(1.0)  # trips have -1.5 and -3.5
    assert row["log_predictive_error_samplings"] == pytest.approx(0.5)  # samplings have -2 and -3
    # mean squares of 1 over samplings and 4 over trips, 5 together on 25 / 17 degrees of freedom, for 4 values
    assert row["log_predictive_upper"] == pytest.approx(-2.5 + stdtrit(25 / 17, 0.975) * np.sqrt(1.25))
    assert row["difference"] == 0


def test_without_trips_the_study_says_how_to_import_some(tmp_path: Path) -> None:
    with pytest.raises(StageError, match="lessbench import trips FOLDER"):
        trips.run(Project(tmp_path))


def test_the_exact_likelihood_of_the_published_weights(shared: Path) -> None:
    read = read_trips(shared / "real" / "borlange")
    logit = Roads.of(read.network, read.observed).recursive_logit()
    value, gradient = logit.gradient(PUBLISHED, np.ones(1832))
    assert value == pytest.approx(-6302.93, rel=1e-6)
    assert np.abs(gradient).max() < 5
    np.testing.assert_allclose(logit.estimate(START).weights, PUBLISHED, rtol=0.01)


def test_the_map_of_a_square_is_a_square() -> None:
    """Four links of one minute round a block, with a turn to the left by a right angle after each."""
    rows = [(number, number % 4 + 1, 1.0, 1, -np.pi / 2) for number in range(1, 5)]
    columns = ["from_link", "to_link", "travel_time", "link", "turn_angle"]
    town = town_map(pl.DataFrame(rows, schema=columns, orient="row"))
    ends = town.select("end_x", "end_y").to_numpy()
    np.testing.assert_allclose(np.linalg.norm(ends - np.roll(ends, 1, axis=0), axis=1), 1, atol=1e-3)
    np.testing.assert_allclose(np.linalg.norm(ends - np.roll(ends, 2, axis=0), axis=1), np.sqrt(2), atol=1e-3)
    np.testing.assert_allclose(town.select("start_x", "start_y").to_numpy(), np.roll(ends, 1, axis=0), atol=1e-3)


def test_shares_of_shown_routes_add_up_to_one_but_among_all_paths_to_less(roads: Roads) -> None:
    study = run_trips(roads, 3, {5: 1})
    sums = study.routes.group_by("trip", "model").agg(pl.col("share").sum())
    np.testing.assert_allclose(sums.filter(pl.col("model") != "recursive-logit")["share"], 1)
    assert (sums.filter(model="recursive-logit")["share"] < 1).all()
    assert set(study.routes["route"]) == set(study.route_links["route"])
