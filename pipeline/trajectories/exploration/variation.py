"""How a child is made from its parents, in the coefficients of the choice space.

Every child is its parent, perhaps drawn towards the straight path, perhaps moved along a line that other elites give,
perhaps disturbed by a few smooth waves of random width. The shapes of what is found so far so guide what is tried next.

Source of the line operator: Vassiliades and Mouret, "Discovering the elite hypervolume by leveraging interspecies
correlation", GECCO 2018; of the difference of two elites: differential evolution, Storn and Price (1997).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pipeline.arrays import FloatArray


@dataclass(frozen=True)
class Variation:
    """Chances and sizes of the operators; the sizes do not depend on the arm, as elites set the scale of a line.

    Attributes:
        noise: chance of smooth noise.
        width_rad: least and greatest width of the noise, between which its logarithm is uniform.
        roughness: half wave k of the noise is k^roughness times as high as that of the base measure.
        line: chance of a move along the line to another elite.
        difference: chance of a move along the difference of two other elites.
        shrink: chance of being drawn towards the straight path.
    """

    noise: float = 0.7
    width_rad: tuple[float, float] = (0.005, 0.4)
    roughness: float = 0.5
    line: float = 0.5
    difference: float = 0.3
    shrink: float = 0.3

    def children(
        self, rng: np.random.Generator, parents: FloatArray, others: FloatArray, unit_rad: float
    ) -> FloatArray:
        """One child per parent.

        Args:
            rng: the stream of this exploration.
            parents: (B, K, J) coefficients.
            others: (3, B, K, J) other elites.
            unit_rad: width in rad of one unit of the coefficients.

        Returns:
            (B, K, J).
        """
        count, modes, joints = parents.shape

        def some(chance: float) -> FloatArray:
            return (rng.random((count, 1, 1)) < chance).astype(np.float64)

        shrunk = 1 - some(self.shrink) * (1 - rng.uniform(0.6, 1.05, (count, 1, 1)))
        line = some(self.line) * rng.normal(0, 0.4, (count, 1, 1))
        difference = some(self.difference) * rng.normal(0, 0.4, (count, 1, 1))
        least, most = np.log(self.width_rad)
        width = np.exp(rng.uniform(least, most, (count, 1, 1))) / unit_rad
        # Few joints or all: a hand that turns one joint reaches what isotropic noise would not.
        joint = rng.random((count, 1, joints)) < rng.uniform(0.2, 1, (count, 1, 1))
        wave = np.arange(1.0, modes + 1)[:, None] ** self.roughness
        noise = some(self.noise) * width * joint * wave * rng.standard_normal(parents.shape)
        moved = line * (others[0] - parents) + difference * (others[1] - others[2])
        return np.asarray(shrunk * parents + moved + noise)
