"""What each model of choice says about the paths of one set: their log weights, and a feature of its own if it has one.

All models but the recursive logit choose from the set:
log p(i) = weights . phi_i + coefficient * own_i + log_w_i - logsumexp over the set.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from scipy import sparse

from pipeline import vocabulary
from pipeline.arrays import FloatArray, IntArray
from pipeline.choice.kernel.density import log_density
from pipeline.errors import ArgumentError
from pipeline.studies.trips.drawn_paths import PathSet

BOLTZMANN, PATH_SIZE = vocabulary.BOLTZMANN, vocabulary.PATH_SIZE
BOLTZMANN_CORRECTED, EXPANDED_PATH_SIZE = "boltzmann-corrected", "expanded-path-size"
NESTED_LOGIT, NESTED_CORRECTED = vocabulary.NESTED_LOGIT, "nested-logit-corrected"
LESS, LESS_POOLED, LESS_LINKS = vocabulary.LESS, vocabulary.LESS_POOLED, "less-links"
RECURSIVE_LOGIT = "recursive-logit"
MODELS: Mapping[str, str] = MappingProxyType(
    {
        RECURSIVE_LOGIT: "Boltzmann over all paths (recursive logit)",
        BOLTZMANN_CORRECTED: "Boltzmann, corrected by the sampler's density",
        EXPANDED_PATH_SIZE: "expanded path size, corrected",
        NESTED_CORRECTED: "nested logit, corrected",
        BOLTZMANN: "Boltzmann",
        PATH_SIZE: "path size",
        NESTED_LOGIT: "nested logit",
        LESS: "LESS over features",
        LESS_POOLED: "LESS over features, pooled density",
        LESS_LINKS: "LESS over shared links",
    }
)
OWN_FEATURE = (PATH_SIZE, EXPANDED_PATH_SIZE)
BY_SET = tuple(model for model in MODELS if model != RECURSIVE_LOGIT)
_SMALL_PRODUCT = 200_000  # multiplications; from 262,144 on OpenBLAS starts threads
CORRECTED = (RECURSIVE_LOGIT, BOLTZMANN_CORRECTED, EXPANDED_PATH_SIZE, NESTED_CORRECTED)
NESTED = (NESTED_LOGIT, NESTED_CORRECTED)
PLAIN = (BOLTZMANN, PATH_SIZE, NESTED_LOGIT)  # models that take the set as it is


@dataclass(frozen=True)
class Kernels:
    """The scale of the features and the bandwidths of the kernels.

    Attributes:
        scale: (4,) what features are divided by.
        features: bandwidth over scaled features.
        links: bandwidth over shared links, whose distances lie between 0 and sqrt(2).
    """

    scale: FloatArray
    features: float
    links: float = 0.5


def log_weights(model: str, paths: PathSet, pool: FloatArray, kernels: Kernels) -> FloatArray:
    """(N,) log weights of the paths.

    Args:
        model: one of `MODELS`.
        paths: the set.
        pool: (P, 4) totals over each distinct path that any sampler drew for the trip.
        kernels: of the LESS models.

    Raises:
        ArgumentError: there is no such model.
    """
    if model in CORRECTED:  # McFadden (1978); with the path taken counted once more, Frejinger et al. (2009)
        return np.asarray(np.log(paths.drawn) - paths.log_q)
    weights: Mapping[str, Callable[[], FloatArray]] = {
        **dict.fromkeys(PLAIN, lambda: np.zeros(len(paths.features))),
        LESS: lambda: -log_density(paths.features / kernels.scale, kernels.features),
        LESS_POOLED: lambda: -log_density(pool / kernels.scale, kernels.features, at=paths.features / kernels.scale),
        LESS_LINKS: lambda: -_log_link_density(shared_links(paths.links), kernels.links),
    }
    if model not in weights:
        raise ArgumentError(f"there is no model {model!r} of paths; there are {', '.join(MODELS)}.")
    return weights[model]()


def own_feature(model: str, paths: PathSet) -> FloatArray:
    """(N,) the log path size of the model, or 0.

    ln PS_i = ln sum_a (n_ai / n_i) / M_a, with n_ai how often path i enters link a and n_i all its links. M_a counts
    the paths that use the link. In the expanded one each counts 1 / (R q) times if the sampler draws it less
    than once in the R draws, as it then stands for others that were not drawn.

    Source: Ben-Akiva and Bierlaire (1999); Frejinger, Bierlaire and Ben-Akiva (2009), the expanded path size.
    """
    if model not in OWN_FEATURE:
        return np.zeros(len(paths.features))
    counts = np.ones(len(paths.features))
    if model == EXPANDED_PATH_SIZE:
        draws = int(paths.drawn.sum()) - 1
        counts = np.exp(np.clip(-paths.log_q - np.log(draws), 0.0, 500.0))
        counts[paths.chosen] = 1.0
    users = (paths.links > 0).astype(np.float64).T @ counts
    return np.asarray(np.log((paths.links @ (1 / users)) / paths.links.sum(axis=1)))


def shared_links(links: sparse.csr_array) -> FloatArray:
    """(N, E) rows of length one, whose product is the share of links that two paths have in common.

    Their squared distance is 2 - 2 * share: 0 for the same links, 2 for none in common.
    """
    rows = links.toarray()
    return np.asarray(rows / np.linalg.norm(rows, axis=1, keepdims=True))


def _log_link_density(rows: FloatArray, bandwidth: float) -> FloatArray:
    """(N,) log of the Gaussian kernel sum over rows of length one, by products of matrices.

    They are so small that BLAS starts no threads for them, which cost more than they gain beside those of the study.
    """
    count, width = rows.shape
    side = max(int((_SMALL_PRODUCT / width) ** 0.5), 1)
    tiles = np.zeros((-(-count // side), side, width))
    tiles.reshape(-1, width)[:count] = rows / bandwidth
    sums = np.zeros((len(tiles), side))
    turned = tiles.swapaxes(1, 2)
    for start in range(len(tiles)):
        kernel = tiles[start] @ turned[start:]  # (tiles that are left, side, side): the others are these, turned
        kernel -= 1.0 / bandwidth**2  # -(2 - 2 share) / (2 bandwidth^2)
        np.exp(kernel, out=kernel)
        sums[start] += kernel.sum(axis=(0, 2))
        sums[start + 1 :] += kernel[1:].sum(axis=1)
    filled = (sums.size - count) * np.exp(-1.0 / bandwidth**2)  # by the rows of zeros in the last tile
    return np.asarray(np.log(sums.ravel()[:count] - filled))


def within_spread(features: FloatArray, sizes: IntArray) -> FloatArray:
    """(F,) standard deviation of the features within sets, over all sets; 1 where a feature does not vary.

    Args:
        features: (N, F) of sets one after the other.
        sizes: (n,) of the sets.
    """
    starts = np.append(0, np.cumsum(sizes)[:-1])
    means = np.add.reduceat(features, starts) / sizes[:, None]
    spread = np.sqrt(((features - np.repeat(means, sizes, axis=0)) ** 2).mean(axis=0))
    return np.asarray(np.where(spread > 0, spread, 1.0))
