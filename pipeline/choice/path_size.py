"""Paths as sets of links, and how much of its length each path does not share with others."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from pipeline.arrays import FloatArray
from pipeline.choice.validation import vector
from pipeline.errors import ArgumentError


def log_path_sizes(incidence: sparse.csr_array, lengths: FloatArray, users: FloatArray) -> FloatArray:
    """log PS_i = log [ sum_a delta_ai l_a / m_a / L_i ], with L_i the length of path i.

    Args:
        incidence: (N, E) delta, 1 where path i uses link a.
        lengths: (E,) l_a.
        users: (E,) m_a, how many paths of the choice set use link a; at least 1 where delta is.

    Returns:
        (N,) logs between -log N and 0.
    """
    shares = lengths / np.maximum(users, 1.0)  # a link that no path uses enters no sum; 1 avoids dividing by zero
    return np.asarray(np.log((incidence @ shares) / (incidence @ lengths)))


def check_lengths(lengths: ArrayLike) -> FloatArray:
    """`lengths` as a vector of positive numbers.

    Raises:
        ArgumentError: a length is not positive and finite.
    """
    array = vector("lengths", lengths)
    if not np.all(array > 0):
        raise ArgumentError(f"lengths contains {array.min():g}; every link has a positive length.")
    return array


def check_incidence(incidence: Any, links: int | None) -> sparse.csr_array:
    """`incidence` as a sparse (N, E) matrix of ones, each path with at least one link.

    Raises:
        ArgumentError: it is not such a matrix, or `links` is given and is not its number of columns.
    """
    try:
        array = sparse.csr_array(incidence, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ArgumentError(f"the link incidence matrix cannot be read ({error}).") from None
    array.sum_duplicates()
    array.eliminate_zeros()
    if array.ndim != 2 or array.shape[0] == 0 or links not in (None, array.shape[1]):
        raise ArgumentError(
            f"the link incidence matrix has shape {array.shape}; (paths, links) with at least one path and "
            f"{links or 'any number of'} links is needed."
        )
    if not np.all(array.data == 1):
        raise ArgumentError(
            "the link incidence matrix holds numbers other than 0 and 1; give the links of each path "
            "(as `similarity` where features are asked for as well)."
        )
    if not np.all(np.diff(array.indptr) > 0):
        raise ArgumentError("the link incidence matrix has a path without links; every path uses at least one.")
    return array
