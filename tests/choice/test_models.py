from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import sparse

from pipeline.choice import LESS, AttributeRule, Boltzmann, PathSize, log_density, select_bandwidth
from pipeline.errors import ArgumentError, BandwidthError
from tests.oracles import slow_choice

LENGTHS = np.array([1.0, 2.0, 0.5, 3.0, 1.5, 1.0])
PATHS = np.array([[1, 1, 0, 0, 0, 1], [1, 0, 1, 0, 0, 1], [0, 0, 0, 1, 1, 0], [1, 1, 0, 0, 0, 1]])


@pytest.fixture
def features() -> np.ndarray:
    rows = np.random.default_rng(0).normal(size=(25, 2))
    rows[7] = rows[3]
    return rows


MODELS = [
    (Boltzmann(), slow_choice.boltzmann),
    (LESS(bandwidth=0.4), slow_choice.less(0.4)),
    (AttributeRule(), slow_choice.attribute_rule),
]


@pytest.mark.parametrize(("model", "slow"), MODELS, ids=lambda model: getattr(model, "name", ""))
def test_weights_and_joined_weights_equal_the_slow_loops(model, slow, features: np.ndarray) -> None:
    weighed = model.weigh(features)
    np.testing.assert_allclose(weighed.log_w, slow(list(features)), rtol=0, atol=1e-13)
    np.testing.assert_array_equal(model.log_weights(features), weighed.log_w)
    for outside in (np.array([0.1, 0.2]), features[3], np.array([50.0, 50.0])):
        log_w, own = weighed.joined(outside[None])
        np.testing.assert_allclose([*log_w, own], slow([*features, outside]), rtol=0, atol=1e-13)


@pytest.mark.parametrize("as_matrix", [np.asarray, sparse.csr_array, sparse.coo_matrix])
def test_path_sizes_equal_the_slow_loop(as_matrix) -> None:
    slow = slow_choice.path_size(LENGTHS)
    weighed = PathSize(lengths=LENGTHS).weigh(as_matrix(PATHS))
    np.testing.assert_allclose(weighed.log_w, slow(list(PATHS)), rtol=0, atol=1e-14)
    outside = np.array([[0, 0, 1, 0, 1, 1]])
    log_w, own = weighed.joined(as_matrix(outside))
    np.testing.assert_allclose([*log_w, own], slow([*PATHS, outside[0]]), rtol=0, atol=1e-14)


def test_path_size_closed_forms() -> None:
    """Identical paths share one; paths without a common link keep their own."""
    np.testing.assert_allclose(PathSize().log_weights(np.ones((3, 4))), -math.log(3), rtol=1e-15)
    np.testing.assert_array_equal(PathSize().log_weights(np.eye(3)), 0.0)


def test_names() -> None:
    names = [model.name for model in (Boltzmann(), LESS(), AttributeRule(), PathSize())]
    assert names == ["boltzmann", "less", "attribute-rule", "path-size"]


def test_less_is_minus_the_log_density_at_the_selected_bandwidth(features: np.ndarray) -> None:
    for method in ("leave-one-out", "k-fold"):
        sigma = select_bandwidth(features, method).value
        np.testing.assert_array_equal(LESS(method).log_weights(features), -log_density(features, sigma))


def test_joining_keeps_the_bandwidth_of_the_alternatives(features: np.ndarray) -> None:
    sigma = select_bandwidth(features).value
    far = np.array([[9.0, 9.0]])
    selected, fixed = LESS().weigh(features).joined(far), LESS(sigma).weigh(features).joined(far)
    np.testing.assert_array_equal(selected[0], fixed[0])
    assert selected[1] == fixed[1]


def test_similarity_replaces_the_features(features: np.ndarray) -> None:
    waypoints = np.random.default_rng(1).normal(size=(25, 12))
    np.testing.assert_array_equal(
        LESS(1.0).log_weights(features, similarity=waypoints), LESS(1.0).log_weights(waypoints)
    )


def test_models_are_values() -> None:
    assert LESS(0.5) == LESS(0.5) != LESS(0.6)
    with pytest.raises(AttributeError):
        LESS(0.5).bandwidth = 0.6
    with pytest.raises(ValueError, match="read-only"):
        LESS(0.5).log_weights([[0.0], [1.0]])[0] = 1.0


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: LESS("scott"), "bandwidth is 'scott'; it is a positive number or one of k-fold"),
        (lambda: LESS(0.0), "bandwidth is 0.0"),
        (lambda: LESS(math.nan), "bandwidth is nan"),
        (lambda: PathSize(lengths=[1.0, 0.0]), "every link has a positive length"),
        (lambda: PathSize(lengths=[1.0]).log_weights(PATHS), "shape [(]4, 6[)]"),
        (lambda: PathSize().log_weights([[0.5, 1.0]]), "numbers other than 0 and 1"),
        (lambda: PathSize().log_weights([[math.nan, 1.0]]), "numbers other than 0 and 1"),
        (lambda: PathSize().log_weights([[1, 0], [0, 0]]), "a path without links"),
        (lambda: PathSize().log_weights([["a"]]), "cannot be read"),
        (lambda: Boltzmann().log_weights(np.empty((0, 3))), "features is empty"),
        (lambda: Boltzmann().log_weights([[math.nan]]), "features contains nan"),
        (lambda: AttributeRule().log_weights([[math.inf]]), "features contains inf"),
        (lambda: LESS(1.0).weigh([[0.0]]).joined([[math.nan]]), "demonstrations contains nan"),
    ],
)
def test_refusals(call, message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        call()


def test_less_of_identical_alternatives_needs_a_number() -> None:
    with pytest.raises(BandwidthError):
        LESS().log_weights([[1.0], [1.0]])
    np.testing.assert_array_equal(LESS(0.1).log_weights([[1.0], [1.0]]), -np.log([2.0, 2.0]))
