"""A choice set as Fourier coefficients: kernel sums of any bandwidth, anywhere, from a record of fixed size.

The Gaussian kernel, repeated with period L_k in each of F dimensions, is a Fourier series, so the kernel sum at x is

    S(x) = sum_m  g_m f_m exp(i omega_m . x),   f_m = sum_j c_j exp(-i omega_m . phi_j),   omega_m = 2 pi m / L,
    g_m = prod_k sqrt(2 pi) sigma / L_k exp(-(sigma omega_mk)^2 / 2).

The coefficients f do not know sigma, and those of two sets add up to those of their union. They come from one
nonuniform FFT of type 1, the sums from one of type 2. As the sums are real, f_-m is the conjugate of f_m, and only
frequencies that are not negative in the first dimension are kept: half the work and memory.

For N rows in a box of sides R_k the error of a sum is at most

    N [ 2 eps + sum_k erfc(sigma omega_k / sqrt(2)) + 2 sum_k exp(-(L_k - R_k)^2 / 2 sigma^2) + 3e-17 sqrt(N) ],

where omega_k is the largest frequency kept. The terms are
- both transforms: FINUFFT's tolerance eps relative to the sum of the absolute strengths, N and N sum_m g_m = N,
- the frequencies left out: |f_m| <= N, and sum_{m > M} g_m is below the integral from M on,
- the nearest repetitions, L - R away or farther, of rows at opposite walls,
- rounding: N additions of numbers of one sign, as a random walk; the factor is three times the largest one measured.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import reduce
from operator import iadd
from typing import TypeVar

import finufft
import numpy as np
from numpy.typing import ArrayLike
from scipy.fft import next_fast_len
from scipy.special import erfc, erfcinv

from pipeline.arrays import BoolArray, ComplexArray, FloatArray
from pipeline.choice.validation import matrix, positive
from pipeline.errors import ArgumentError

DIMENSIONS = 3  # the most features that a sketch can have

Part = TypeVar("Part")

# Allowed error of a kernel sum. At a row of the set the sum is at least 1, so its relative error is below 1e-6.
_ACCURACY = 5e-7
_FINEST = 2e-14  # about the smallest tolerance that FINUFFT reaches in double precision
_MANY = 2**18  # from this many points on, a second thread saves time
_SPREADING = 200  # points of kernels per point of the grid at which spreading takes three times as long as the FFT
_WIDEST = 16  # points of FINUFFT's widest kernel
_LARGE = 2**25  # points of an oversampled grid (0.5 GB) above which it is oversampled less than twice

_FORWARD = {1: finufft.nufft1d1, 2: finufft.nufft2d1, 3: finufft.nufft3d1}
_BACKWARD = {1: finufft.nufft1d2, 2: finufft.nufft2d2, 3: finufft.nufft3d2}


def _cut(share: float, dimensions: int) -> float:
    """The sigma omega above which frequencies are left out, in all dimensions a `share` of the kernel's spectrum."""
    return math.sqrt(2) * float(erfcinv(share / dimensions))


@dataclass(frozen=True)
class Grid:
    """Box and frequencies of a sketch.

    Attributes:
        lower: least value of each feature; there are no kernel sums outside the box [lower, upper].
        upper: largest value of each feature.
        length: periods L_k, longer than the box.
        modes: largest frequency M_k of each dimension, in units of 2 pi / L_k.
        eps: tolerance of the transforms.
    """

    lower: tuple[float, ...]
    upper: tuple[float, ...]
    length: tuple[float, ...]
    modes: tuple[int, ...]
    eps: float

    @classmethod
    def covering(
        cls,
        lower: Sequence[float],
        upper: Sequence[float],
        narrowest: float,
        widest: float,
        total: float,
        accuracy: float = _ACCURACY,
    ) -> Grid:
        """The smallest grid for `total` rows in a box and bandwidths from `narrowest` to `widest`.

        The error of a sum is at most `accuracy`, shared among the terms of the bound, as far as double precision
        allows.
        """
        share = max(accuracy / total / 4, _FINEST / 2)
        dimensions = len(lower)
        reach = math.sqrt(2 * math.log(2 * dimensions / share))
        cut = _cut(share, dimensions)
        length = tuple(high - low + reach * widest for low, high in zip(lower, upper, strict=True))
        modes = [cut * side / (2 * math.pi * narrowest) for side in length]
        if not max(modes) < 2**31:
            raise ArgumentError(
                f"bandwidth is {narrowest:g} where the features span {max(length):g}: too narrow for the spectral "
                "engine; use engine 'neighbours' or 'auto'."
            )
        return cls(
            tuple(map(float, lower)),
            tuple(map(float, upper)),
            length,
            tuple(math.ceil(mode) for mode in modes),
            max(share, _FINEST),
        )

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of coefficients per dimension."""
        return (self.modes[0] + 1, *(2 * mode + 1 for mode in self.modes[1:]))

    def cropped(self, sigma: float) -> Grid:
        """The grid with only those frequencies that `sigma` needs: the wider the kernel, the fewer."""
        share = self.eps if self.eps > _FINEST else _FINEST / 2
        cut = _cut(share, len(self.modes)) / (2 * math.pi * sigma)
        modes = tuple(min(mode, math.ceil(cut * length)) for mode, length in zip(self.modes, self.length, strict=True))
        return Grid(self.lower, self.upper, self.length, modes, self.eps)

    def inside(self, points: FloatArray) -> BoolArray:
        """(M,) which points lie in the box."""
        return np.asarray(np.all((points >= self.lower) & (points <= self.upper), axis=1))

    def error(self, sigma: float, total: float) -> float:
        """The largest error of any kernel sum, by the bound in the module's docstring."""
        bound = 2 * self.eps + 3e-17 * math.sqrt(total)
        for low, high, length, mode in zip(self.lower, self.upper, self.length, self.modes, strict=True):
            bound += float(erfc(math.sqrt(2) * math.pi * sigma * mode / length))
            bound += 2 * math.exp(-0.5 * ((length - (high - low)) / sigma) ** 2)
        return total * bound

    def phases(self, points: FloatArray) -> list[FloatArray]:
        """For each dimension, (M,) positions of the points within the period, in [-pi, pi)."""
        return [
            (points[:, k] - (low + 0.5 * (high - low))) * (2 * math.pi / length)
            for k, (low, high, length) in enumerate(zip(self.lower, self.upper, self.length, strict=True))
        ]

    def shift(self, points: FloatArray) -> ComplexArray:
        """(M,) factors that shift the first dimension's frequencies, as FINUFFT takes the middle one for zero."""
        return np.asarray(np.exp(1j * (self.shape[0] // 2) * self.phases(points)[0]))

    def parts(self, points: int) -> list[slice]:
        """Slices of the points that are transformed in parallel, each on its own grid.

        Two halves if there are many points and the FFT takes much less time than they do, else all at once.
        """
        if points < _MANY or points * self.width(points) ** len(self.modes) < _SPREADING * self.oversampled(points):
            return [slice(None)]
        return [slice(points // 2), slice(points // 2, None)]

    def oversampling(self, points: int) -> float:
        """The oversampling factor of FINUFFT's own grid: 2, or less where its FFT costs more than the points.

        With factor u, a kernel of width w reaches eps = exp(-pi w sqrt(1 - 1 / u)); the widest has 16 points. Adding
        0.1 to u keeps the error of three dimensions near eps.
        """
        double = math.prod(self.shape) * 2 ** len(self.shape)
        if double <= min(25 * points, _LARGE):
            return 2.0
        smallest = 1 / (1 - (math.log(self.eps) / (_WIDEST * math.pi)) ** 2)
        return max(smallest + 0.1, 1.25)

    def width(self, points: int) -> float:
        """Width of FINUFFT's kernel, in points of its own grid."""
        return 1 - math.log10(self.eps) if self.oversampling(points) == 2 else _WIDEST

    def oversampled(self, points: int) -> float:
        """Number of points of FINUFFT's own grid."""
        return float(math.prod(_sizes(self.shape, self.oversampling(points))))


def _sizes(shape: tuple[int, ...], oversampling: float) -> tuple[int, ...]:
    """Sides of FINUFFT's own grid: even numbers of at least 32, without prime factors above 5."""
    halves = (math.ceil(max(oversampling * count / 2, _WIDEST)) for count in shape)
    return tuple(2 * int(next_fast_len(half, real=True)) for half in halves)


def _side_by_side(function: Callable[[slice], Part], parts: list[slice]) -> list[Part]:
    """The results for all parts, in order. Each part runs on one thread, so no bit depends on how many there are."""
    if len(parts) == 1:
        return [function(parts[0])]
    with ThreadPoolExecutor(len(parts)) as pool:
        return list(pool.map(function, parts))


@dataclass(frozen=True, eq=False)
class Sketch:
    """The Fourier coefficients of a choice set. Sketches on one grid add up; add them in a fixed order.

    Attributes:
        grid: box and frequencies.
        coefficients: complex, `grid.shape`; read-only.
        total: number of rows N, repeated ones included.
    """

    grid: Grid
    coefficients: ComplexArray
    total: float

    def __post_init__(self) -> None:
        self.coefficients.flags.writeable = False

    @classmethod
    def of(cls, features: ArrayLike, grid: Grid, counts: ArrayLike | None = None) -> Sketch:
        """The sketch of rows (N, F) inside the grid's box, each counted once or `counts` (N,) times.

        The same rows in the same order give the same bits, on any number of cores.

        Raises:
            ArgumentError: a row lies outside the box, or has another number of features.
        """
        rows = matrix("features", features, columns=len(grid.modes))
        if not np.all(grid.inside(rows)):
            raise ArgumentError("features has rows outside the grid's box; make the grid from the bounds of all parts.")
        strengths = np.ones(len(rows)) if counts is None else np.asarray(counts, dtype=np.float64)
        total = len(rows) if counts is None else float(np.sum(strengths))
        shape = grid.shape if len(grid.shape) > 1 else grid.shape[0]

        def transform(part: slice) -> ComplexArray:
            part_rows = rows[part]
            coefficients = _FORWARD[len(grid.modes)](
                *grid.phases(part_rows), strengths[part] * grid.shift(part_rows), shape,
                eps=grid.eps, isign=1, nthreads=1, upsampfac=grid.oversampling(len(part_rows)),
            )  # fmt: skip
            # with isign=-1, FFTW takes up to twice the time of isign=1 and a conjugate (benchmarks/unit_costs.py)
            return np.asarray(np.conjugate(coefficients, out=coefficients))

        coefficients = reduce(iadd, _side_by_side(transform, grid.parts(len(rows))))
        return cls(grid, coefficients, float(total))

    def __add__(self, other: Sketch) -> Sketch:
        if other.grid != self.grid:
            raise ArgumentError("sketches on different grids do not add up; make all of them on one grid.")
        return Sketch(self.grid, self.coefficients + other.coefficients, self.total + other.total)

    def sums(self, points: FloatArray, sigma: float) -> tuple[FloatArray, float]:
        """(M,) kernel sums at points inside the box, and a bound on their error.

        Raises:
            ArgumentError: a point lies outside the box.
        """
        positive("sigma", sigma)
        if not np.all(self.grid.inside(points)):
            raise ArgumentError("points lie outside the sketch's box; sum those over the rows themselves.")
        grid = self.grid.cropped(sigma)
        modes = zip(self.grid.modes[1:], grid.modes[1:], strict=True)
        inner = tuple(slice(mode - cropped, mode + cropped + 1) for mode, cropped in modes)
        weighted = self.coefficients[(slice(grid.modes[0] + 1), *inner)].copy()
        weighted[1:] *= 2  # each also stands for its conjugate, which is not kept
        for k, (length, mode) in enumerate(zip(grid.length, grid.modes, strict=True)):
            frequencies = np.arange(-mode if k else 0, mode + 1) * (2 * math.pi * sigma / length)
            spectrum = math.sqrt(2 * math.pi) * sigma / length * np.exp(-0.5 * frequencies**2)
            weighted *= np.expand_dims(spectrum, tuple(a for a in range(len(grid.modes)) if a != k))

        def transform(part: slice) -> FloatArray:
            part_points = points[part]
            sums = _BACKWARD[len(grid.modes)](
                *grid.phases(part_points), weighted,
                eps=grid.eps, isign=1, nthreads=1, upsampfac=grid.oversampling(len(part_points)),
            )  # fmt: skip
            sums *= grid.shift(part_points)
            return np.ascontiguousarray(sums.real)

        parts = _side_by_side(transform, grid.parts(len(points)))
        return np.concatenate(parts), grid.error(sigma, self.total)
