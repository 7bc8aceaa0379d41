from __future__ import annotations

import numpy as np
import pytest
from scipy import special

from pipeline.answers.calibration import calibrate
from pipeline.answers.flatness import flatness
from pipeline.answers.group_calibration import calibrate_group
from pipeline.choice import LESS, Boltzmann
from pipeline.choice.weights import WeightPrior
from pipeline.errors import ArgumentError

RNG = np.random.default_rng(0)
# A dense clump and a thin cloud: models that differ must show it.
ROWS = np.vstack([RNG.normal(0.3, 0.04, size=(40, 2)), RNG.random((40, 2))])
MODELS = {"boltzmann": Boltzmann(), "less": LESS(0.1)}
REPETITIONS = 300


@pytest.fixture(scope="module")
def calibration():
    return calibrate(np.random.default_rng(1), MODELS, ROWS, demonstrations=5, repetitions=REPETITIONS)


@pytest.mark.parametrize("model", MODELS)
def test_places_of_the_truth_are_flat(calibration, model: str) -> None:
    """Simulation-based calibration: every weight, beta and the direction, within their bands."""
    found = calibration.recoveries[model, model]
    for places in (*found.place.T, found.beta_place, found.direction_place):
        assert flatness(places).flat
    assert found.coverage() == pytest.approx(0.9, abs=0.06)
    assert found.coverage(0.5) == pytest.approx(0.5, abs=0.1)
    # the cap of 0.9 is as wide as the errors are
    assert np.mean(found.angle <= found.cap) == pytest.approx(found.coverage(), abs=0.01)


def test_rank_histograms_of_all_that_is_inferred(calibration) -> None:
    found = calibration.rank_histograms(["near", "low"])
    of = ("near", "low", "beta", "direction")
    assert list(found) == [(model, name) for model in MODELS for name in of]
    assert all(one.counts.sum() == REPETITIONS and len(one.counts) == 10 for one in found.values())
    assert all(one.flat for one in found.values())
    assert found["less", "beta"].upper > flatness(calibration.recoveries["less", "less"].beta_place).upper


def test_rank_histograms_show_a_prior_that_is_not_that_of_the_truths() -> None:
    """People are ten times as decided as the prior says, which is too narrow."""
    prior = WeightPrior((0.5,))
    truths = 10 * prior.draw(np.random.default_rng(0), 60, 2)
    found = calibrate(np.random.default_rng(1), {"less": LESS(0.1)}, ROWS, 1, 60, prior=prior, truths=truths)
    assert not found.rank_histograms(["near", "low"])["less", "beta"].flat


def test_rank_histograms_need_enough_repetitions() -> None:
    enough, few = (calibrate(np.random.default_rng(1), {"less": LESS(0.1)}, ROWS, 1, n) for n in (50, 49))
    assert [len(one.counts) for one in enough.rank_histograms(["near", "low"]).values()] == [10] * 4
    assert few.rank_histograms(["near", "low"]) == {}


@pytest.mark.parametrize(("chosen_by", "inferred_by"), [("boltzmann", "less"), ("less", "boltzmann")])
def test_the_wrong_model_is_found_out(calibration, chosen_by: str, inferred_by: str) -> None:
    found = calibration.recoveries[chosen_by, inferred_by]
    assert not all(flatness(places).flat for places in found.place.T)


def test_evidence_tells_the_models_apart_and_more_demonstrations_tell_more(calibration) -> None:
    few = calibrate(np.random.default_rng(1), MODELS, ROWS, demonstrations=1, repetitions=60)
    for own, other in (("boltzmann", "less"), ("less", "boltzmann")):
        found = calibration.comparison(own, other)
        assert found.favoured > 0.6
        assert found.told() > few.comparison(own, other).told()
        # by Markov's inequality, odds of ten against the truth come up in at most a tenth
        assert found.misled() <= 0.1
        assert found.held_out.mean() > 0


def test_a_single_demonstration_has_no_held_out_score() -> None:
    found = calibrate(np.random.default_rng(1), MODELS, ROWS, 1, 3)
    assert np.isnan(found.recoveries["less", "less"].held_out).all()


def test_more_demonstrations_make_narrower_intervals() -> None:
    truths = [[-6.0, 3.0]]
    few, many = (
        calibrate(np.random.default_rng(2), {"less": LESS(0.1)}, ROWS, n, 30, truths=truths).recoveries["less", "less"]
        for n in (2, 20)
    )
    np.testing.assert_array_equal(few.truth, np.repeat(truths, 30, axis=0))
    assert np.median(many.angle) < np.median(few.angle)
    assert np.median(many.width) < np.median(few.width)


def test_people_who_choose_from_more_than_is_known_are_covered_less() -> None:
    """The alternatives show one side of what there is to choose from."""
    pool = RNG.random((400, 2))
    truths = RNG.normal(size=(40, 2)) * 8
    known, beyond = (
        calibrate(np.random.default_rng(3), {"less": LESS(0.1)}, rows, 10, 40, truths=truths, pool=pool)
        for rows in (pool, pool[pool[:, 0] < 0.4])
    )
    assert known.recoveries["less", "less"].coverage() > 0.75
    assert beyond.recoveries["less", "less"].coverage() < 0.6


@pytest.mark.parametrize("model", MODELS.values(), ids=lambda model: model.name)
def test_groups_are_calibrated(model) -> None:
    found = calibrate_group(
        np.random.default_rng(4), model, ROWS, people=4, demonstrations=2, repetitions=100, count=256
    )
    columns = [*found.group_place.T, found.spread_place, *found.person_place[:, 0].T, *found.next_place.T]
    for places in columns:
        assert flatness(places).flat


def test_flatness_knows_flat_from_not() -> None:
    uniform = np.random.default_rng(5).random(1000)
    assert flatness(uniform).flat
    assert flatness(uniform).p_value > 0.01
    assert not flatness(uniform**1.5).flat
    assert flatness(uniform**1.5).p_value < 1e-6
    assert not flatness(0.5 + (uniform - 0.5) * 0.8).flat
    bowl = np.repeat((np.arange(10) + 0.5) / 10, [22, 14, 6, 4, 4, 4, 4, 6, 14, 22])
    assert not flatness(bowl, together=10).flat  # no single bin shows it
    assert (flatness(bowl, together=10).counts <= flatness(bowl, together=10).upper).all()
    with pytest.raises(ArgumentError, match="at least 50"):
        flatness(uniform[:40])
    with pytest.raises(ArgumentError, match="between 0 and 1"):
        flatness(uniform + 1)


def test_flat_histograms_are_rarely_called_uneven_and_narrow_posteriors_often() -> None:
    rng = np.random.default_rng(6)
    uniform = [all(flatness(rng.random(100), together=10).flat for _ in range(10)) for _ in range(600)]
    # 0.01 of 600 is 6; more than 15 have probability 4e-4, and the chi-square of ten each is not quite exact
    assert 600 - sum(uniform) <= 15
    narrow = special.ndtr(2 * rng.standard_normal((200, 100)))  # of posteriors half as wide as they should be
    assert np.mean([flatness(places, together=10).flat for places in narrow]) < 0.1


def test_refusals() -> None:
    with pytest.raises(ArgumentError, match="both must be >= 1"):
        calibrate(np.random.default_rng(0), MODELS, ROWS, 0, 1)
