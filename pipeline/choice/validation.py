"""Checks of public arguments: each error names the argument, what it was, what is allowed and what to do."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from pipeline.arrays import FloatArray
from pipeline.errors import ArgumentError

# The largest number allowed: squared differences of larger ones would overflow.
LARGEST = 1e150


def matrix(name: str, values: ArrayLike, columns: int | None = None) -> FloatArray:
    """`values` as a float64 (N, F) array with N, F >= 1 and finite entries no larger than 1e150.

    Raises:
        ArgumentError: `values` is something else, or `columns` is given and is not its number of columns.
    """
    array = _floats(name, values)
    if array.ndim != 2:
        raise ArgumentError(
            f"{name} has shape {array.shape}; two axes are needed, one row per trajectory: "
            "give a list of rows, each with one number per feature, for example [[0.2, 1.0]]."
        )
    if array.shape[0] == 0 or array.shape[1] == 0:
        raise ArgumentError(f"{name} is empty, shape {array.shape}; at least one row and one column are needed.")
    if columns is not None and array.shape[1] != columns:
        raise ArgumentError(
            f"{name} has {array.shape[1]} columns where {columns} are needed; give all arrays the same columns."
        )
    check_finite(name, array)
    return array


def vector(name: str, values: ArrayLike, length: int | None = None) -> FloatArray:
    """`values` as a float64 vector of finite entries: at least one, or exactly `length` where that is given."""
    array = _floats(name, values)
    if array.ndim != 1 or array.size == 0:
        raise ArgumentError(f"{name} has shape {array.shape}; one axis with at least one number is needed.")
    if length is not None and array.size != length:
        raise ArgumentError(f"{name} has {array.size} entries where {length} are needed.")
    check_finite(name, array)
    return array


def positive(name: str, value: float) -> float:
    """`value` as a float between 1e-150 and 1e150."""
    if not isinstance(value, (int, float, np.integer, np.floating)) or isinstance(value, bool):
        raise ArgumentError(f"{name} is {value!r}; a positive number is needed.")
    if not 1 / LARGEST <= value <= LARGEST:
        raise ArgumentError(f"{name} is {value!r}; a number between {1 / LARGEST:g} and {LARGEST:g} is needed.")
    return float(value)


def inverse_temperatures(betas: ArrayLike) -> FloatArray:
    """`betas` as a vector of positive numbers."""
    array = vector("betas", betas)
    if not np.all(array > 0):
        raise ArgumentError(f"betas contains {array.min():g}; every beta is a positive number.")
    return array


def check_finite(name: str, array: FloatArray) -> None:
    """Refuse NaN, infinity and numbers beyond 1e150, and say where the first one is."""
    # `> LARGEST` would let NaN pass: a comparison with NaN is false.
    refused = ~(np.abs(array) <= LARGEST)
    if refused.any():
        place = tuple(int(index) for index in np.argwhere(refused)[0])
        raise ArgumentError(
            f"{name} contains {array[place]} at {list(place)}; finite numbers up to {LARGEST:g} are needed: "
            "drop or repair that entry at its source."
        )


def read_only(array: FloatArray) -> FloatArray:
    """A copy of `array` that cannot be written to."""
    copy = np.array(array, dtype=np.float64)
    copy.flags.writeable = False
    return copy


def _floats(name: str, values: ArrayLike) -> FloatArray:
    try:
        array = np.asarray(values)
        if array.dtype.kind not in "iuf":
            raise TypeError(f"dtype {array.dtype}")
        return array.astype(np.float64)
    except (TypeError, ValueError) as error:
        raise ArgumentError(f"{name} cannot be read as an array of numbers ({error}).") from None
