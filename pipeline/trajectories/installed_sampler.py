"""Samplers of installed packages, and a check of what they draw."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pipeline.arrays import FloatArray
from pipeline.errors import ParameterError
from pipeline.plug_ins import SAMPLERS, installed
from pipeline.trajectories.paths import Anchor
from pipeline.trajectories.samplers import Sampler

END_RAD = 1e-9  # how exactly paths start and end at their anchor


@dataclass(frozen=True)
class InstalledSampler:
    """A sampler of an installed package whose paths are checked as they are drawn.

    Attributes:
        name: its name in parameters and tables.
        inner: the sampler itself.
    """

    name: str
    inner: Sampler

    def sample(self, rng: np.random.Generator, anchor: Anchor, count: int, n_waypoints: int) -> FloatArray:
        """Draw (count, n_waypoints, J) paths.

        Raises:
            ParameterError: the sampler fails, or what it draws has another shape, other ends, or numbers that are not
                finite.
        """
        shape = (count, n_waypoints, anchor.start.size)
        try:
            paths = np.asarray(self.inner.sample(rng, anchor, count, n_waypoints), dtype=np.float64)
        except Exception as error:
            raise ParameterError(f"the sampler {self.name!r} fails: {type(error).__name__}: {error}") from error
        if paths.shape != shape or not np.isfinite(paths).all():
            raise ParameterError(
                f"the sampler {self.name!r} draws an array of shape {paths.shape}; needed are finite numbers of "
                f"shape {shape}"
            )
        if np.abs(paths[:, [0, -1]] - np.stack([anchor.start, anchor.goal])).max(initial=0.0) > END_RAD:
            raise ParameterError(f"the sampler {self.name!r} draws paths that do not start and end at their anchor")
        return paths


def installed_sampler(name: str, settings: Mapping[str, str | float | int | bool]) -> InstalledSampler:
    """The sampler of an installed package, made with keyword arguments.

    Raises:
        ParameterError: no package has it, it cannot be imported, or it does not take these arguments.
    """
    make = installed(SAMPLERS, name)
    if make is None:
        raise ParameterError(f"sample.sampler is {name!r}, and no installed package has a sampler of that name")
    try:
        inner = make(**settings)
    except Exception as error:
        raise ParameterError(
            f"the sampler {name!r} cannot be made with sample.settings {dict(settings)} "
            f"({type(error).__name__}: {error})"
        ) from error
    if not callable(getattr(inner, "sample", None)):
        raise ParameterError(f"the sampler {name!r} has no method `sample`; docs/plug-ins.md says what it must have")
    return InstalledSampler(name, inner)
