"""How people choose: a softmax in which each model gives every alternative its own log weight.

log p(i | theta, beta) = beta theta . phi_i + log_w_i - logsumexp_j (beta theta . phi_j + log_w_j)

What a model *compares* has one row per alternative. It is the features unless the caller gives something else
(waypoints for similarity in trajectory space, the link incidence matrix for paths).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar, Protocol, Self

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from pipeline import vocabulary
from pipeline.arrays import FloatArray
from pipeline.choice.kernel.bandwidth import METHODS, select_bandwidth
from pipeline.choice.kernel.density import log_density
from pipeline.choice.kernel.join import join, own_log_weights
from pipeline.choice.kernel.unique_rows import distinct_rows
from pipeline.choice.path_size import check_incidence, check_lengths, log_path_sizes
from pipeline.choice.validation import matrix, positive, read_only
from pipeline.errors import ArgumentError, ParameterError, one_of
from pipeline.plug_ins import MODELS, installed, installed_names


@dataclass(frozen=True)
class WeightedSet:
    """The log weights of one choice set under one model.

    Attributes:
        log_w: (N,) log weights of the alternatives.
        joined: a function of the compared row (1, D) of a trajectory outside the set. It returns the log weights of
            the set that this trajectory has joined: (N,) of the alternatives, and that of the trajectory. All else,
            such as the bandwidth, stays as it is for the alternatives alone.
    """

    log_w: FloatArray
    joined: Callable[[Any], tuple[FloatArray, float]]


class Model(Protocol):
    """A model of choice: a name and the weights it gives a set."""

    @property
    def name(self) -> str:
        """The model's name in tables."""

    def weigh(self, compared: Any) -> WeightedSet:
        """The log weights of a set of N alternatives, from what the model compares (N, D)."""


class ChoiceModel:
    """The base class of all models: give a `name`, and say in `weigh` what weight each alternative has."""

    name: ClassVar[str]

    @classmethod
    def with_bandwidth(cls, bandwidth: str | float) -> Self:
        """The model with the kernel's bandwidth, or as it is if it has no kernel."""
        return cls()

    def weigh(self, compared: Any) -> WeightedSet:
        """The log weights of a set of N alternatives, from what the model compares (N, D)."""
        raise NotImplementedError

    def log_weights(self, features: ArrayLike, similarity: Any = None) -> FloatArray:
        """Log weight of each alternative.

        Args:
            features: (N, F) scaled features of the choice set.
            similarity: (N, D) what the model compares instead of the features, e.g. waypoints.

        Returns:
            (N,) log weights, defined up to a common constant.

        Raises:
            ArgumentError: an array has the wrong shape or content.
            BandwidthError: the bandwidth cannot be selected.
        """
        return self.weigh(features if similarity is None else similarity).log_w


@dataclass(frozen=True)
class Boltzmann(ChoiceModel):
    """Luce-Shepard choice: log_w_i = 0 (paper, the Boltzmann model).

    >>> Boltzmann().log_weights([[0.0], [1.0]])
    array([0., 0.])
    """

    name: ClassVar[str] = vocabulary.BOLTZMANN

    def weigh(self, compared: Any) -> WeightedSet:
        """All weights are one, also when a trajectory has joined the set."""
        # Only the number of rows matters here, so a sparse link incidence matrix will do as well.
        count = int(compared.shape[0]) if hasattr(compared, "tocsr") else len(matrix("features", compared))
        log_w = read_only(np.zeros(count))
        return WeightedSet(log_w, lambda row: (log_w, 0.0))


@dataclass(frozen=True)
class AttributeRule(ChoiceModel):
    """Identical alternatives share one weight: log_w_i = -log(number of rows identical to row i).

    >>> AttributeRule().log_weights([[0.0], [0.0], [1.0]]).round(6)
    array([-0.693147, -0.693147,  0.      ])

    Source: paper, the attribute rule for trajectories with identical features.
    """

    name: ClassVar[str] = vocabulary.ATTRIBUTE_RULE

    def weigh(self, compared: Any) -> WeightedSet:
        """The log weights from how often each row occurs, number for number."""
        rows = matrix("features", compared)
        groups = distinct_rows(rows)
        log_w = read_only(0.0 - np.log(groups.counts[groups.index]))
        return WeightedSet(log_w, partial(_attribute_rule_joined, rows, log_w))


@dataclass(frozen=True)
class LESS(ChoiceModel):
    """Choice in which the weight of an alternative is divided by how crowded its surroundings are.

    log_w_i = -log sum_j exp(-|phi_i - phi_j|^2 / (2 sigma^2)), over the whole set, i included.

    >>> LESS(bandwidth=0.1).log_weights([[0.0], [0.0], [9.0]]).round(6)
    array([-0.693147, -0.693147,  0.      ])

    Attributes:
        bandwidth: sigma, or how to select it from the alternatives: `leave-one-out`, `k-fold`, `literal`.

    Raises:
        ArgumentError: `bandwidth` is neither a positive number nor such a method.

    Source: paper, the LESS model and "Similarity as Density".
    """

    bandwidth: str | float = "leave-one-out"
    name: ClassVar[str] = vocabulary.LESS

    @classmethod
    def with_bandwidth(cls, bandwidth: str | float) -> Self:
        """The model with this bandwidth of its kernel, or this way to select it."""
        return cls(bandwidth)

    def __post_init__(self) -> None:
        if not isinstance(self.bandwidth, str):
            positive("bandwidth", self.bandwidth)
        elif self.bandwidth not in METHODS:
            raise ArgumentError(
                f"bandwidth is {self.bandwidth!r}; it is a positive number or one of {one_of(METHODS)}."
            )

    def weigh(self, compared: Any) -> WeightedSet:
        """The log weights from kernel sums, with the bandwidth selected once, from these rows."""
        rows = matrix("features", compared)
        sigma = select_bandwidth(rows, self.bandwidth).value
        log_sums = log_density(rows, sigma)
        return WeightedSet(read_only(0.0 - log_sums), partial(_less_joined, rows, log_sums, sigma))


@dataclass(frozen=True, eq=False)
class PathSize(ChoiceModel):
    """Paths that share links share weight: log_w_i = log PS_i.

    PS_i = sum over the links a of path i of (l_a / L_i) / (number of paths of the set that use link a).
    It compares rows of a link incidence matrix: (N, E) of zeros and ones, sparse or dense.

    >>> PathSize().log_weights([[1, 1, 0], [1, 0, 1]]).round(6)  # each: half its length is shared by two
    array([-0.287682, -0.287682])

    Attributes:
        lengths: (E,) positive link lengths l_a; all one if not given.

    Raises:
        ArgumentError: a length is not positive and finite.

    Source: Ben-Akiva and Bierlaire (1999), Discrete choice methods and their applications to short term travel
    decisions, the path-size logit.
    """

    lengths: FloatArray | None = None
    name: ClassVar[str] = vocabulary.PATH_SIZE

    def __post_init__(self) -> None:
        if self.lengths is not None:
            object.__setattr__(self, "lengths", read_only(check_lengths(self.lengths)))

    def weigh(self, compared: Any) -> WeightedSet:
        """The log weights from the link incidence matrix of the paths."""
        incidence = check_incidence(compared, None if self.lengths is None else len(self.lengths))
        lengths = np.ones(incidence.shape[1]) if self.lengths is None else self.lengths
        users = np.asarray(incidence.sum(axis=0), dtype=np.float64)
        log_w = read_only(log_path_sizes(incidence, lengths, users))
        return WeightedSet(log_w, partial(_path_size_joined, incidence, lengths, users))


def choice_model(name: str, bandwidth: str | float) -> Model:
    """The model that tables and parameters call `name`.

    Args:
        name: one of those in `pipeline.vocabulary`, or of an installed package.
        bandwidth: of the kernel, in scaled features, or how to select it; models without a kernel ignore it.

    Raises:
        ArgumentError: there is no model of that name.
        ParameterError: its package cannot be imported, or brings no model of that name.
    """
    own = {model.name: model for model in ChoiceModel.__subclasses__() if model.__module__ == __name__}
    found = own.get(name) or installed(MODELS, name)
    if found is None:
        raise ArgumentError(f"there is no model {name!r}; there are {one_of({*own, *installed_names(MODELS)})}.")
    if not (isinstance(found, type) and issubclass(found, ChoiceModel) and found.name == name):
        raise ParameterError(
            f"the model {name!r} of an installed package is {found!r}; it must be a subclass of "
            f"pipeline.choice.ChoiceModel whose name is {name!r}"
        )
    return found.with_bandwidth(bandwidth)


def _attribute_rule_joined(rows: FloatArray, log_w: FloatArray, row: Any) -> tuple[FloatArray, float]:
    identical = np.all(rows == matrix("demonstrations", row, columns=rows.shape[1]), axis=1)
    return -np.log(np.exp(-log_w) + identical), -math.log1p(int(identical.sum()))


def _less_joined(rows: FloatArray, log_sums: FloatArray, sigma: float, row: Any) -> tuple[FloatArray, float]:
    log_w, at_row = join(rows, log_sums, matrix("demonstrations", row, columns=rows.shape[1]), sigma)
    return log_w[0], float(own_log_weights(at_row)[0])


def _path_size_joined(
    incidence: sparse.csr_array, lengths: FloatArray, users: FloatArray, row: Any
) -> tuple[FloatArray, float]:
    path = check_incidence(row, incidence.shape[1])
    joined_users = users + path.sum(axis=0)
    alone = log_path_sizes(path, lengths, joined_users)
    return log_path_sizes(incidence, lengths, joined_users), float(alone[0])
