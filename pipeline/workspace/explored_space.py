"""The explored choice space of a task as its tables have it, for demonstrations that come later."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pipeline.arrays import FloatArray
from pipeline.choice import Posterior, posterior_from
from pipeline.choice.explored import Region, region_log_likelihood
from pipeline.formats.parquet.checked.open_table import OpenTable


@dataclass(frozen=True, eq=False)
class ExploredSpace:
    """What the posterior of any demonstration follows from.

    Attributes:
        thetas, betas: the hypotheses, (K, F) and (B,).
        normalisers: by model, (R, K, B) log normaliser of each exploration; empty if the space is not explored.
        regions: by model, the mean of the explorations, which weights are inferred over; empty likewise.
    """

    thetas: FloatArray
    betas: FloatArray
    normalisers: dict[str, FloatArray]
    regions: dict[str, Region]

    @classmethod
    def of(cls, path: Path, thetas: FloatArray, betas: FloatArray) -> ExploredSpace:
        """From the table `explored`, which need not be there.

        Raises:
            TableError: it is not such a table.
        """
        if not path.exists():
            return cls(thetas, betas, {}, {})
        with OpenTable(path, "explored") as table:
            rows = table.read(["exploration", "model", "features", "log_weight"])
        nowhere = np.zeros((1, thetas.shape[1]))  # whose log likelihood is minus the log normaliser
        found: dict[str, list[FloatArray]] = {}
        parts: dict[str, list[Region]] = {}
        for (model, _), part in rows.group_by("model", "exploration", maintain_order=True):
            phi, log_w = np.ascontiguousarray(part["features"].to_numpy()), part["log_weight"].to_numpy()
            found.setdefault(str(model), []).append(-region_log_likelihood(nowhere, phi, log_w, thetas, betas)[0])
            parts.setdefault(str(model), []).append(Region(phi, log_w))
        return cls(
            thetas,
            betas,
            {model: np.stack(values) for model, values in found.items()},
            {model: Region.mean(some) for model, some in parts.items()},
        )

    def posteriors(self, model: str, phi: FloatArray) -> list[Posterior]:
        """Of demonstrations (n, F) in scaled features together, one for each exploration; n may be 0."""
        own = (phi.sum(axis=0) @ self.thetas.T)[:, None] * self.betas
        return [posterior_from(own - len(phi) * log_z, self.thetas, self.betas) for log_z in self.normalisers[model]]
