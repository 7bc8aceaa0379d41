"""The road network and the trips, as the numerics take them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import polars as pl

from pipeline.arrays import FloatArray, IndexArray
from pipeline.choice.recursive_logit import Paths, RecursiveLogit
from pipeline.trajectories.network_walks import Network

FEATURES = ("travel_time", "left_turn", "link", "u_turn")


@dataclass(frozen=True)
class Roads:
    """A network and the trips in it.

    Attributes:
        network: its steps between links; links are counted from 0.
        features: (A, 4) of the steps, in the order of `FEATURES`.
        trips: (n,) their numbers.
        paths: the steps of each trip, in order.
    """

    network: Network
    features: FloatArray
    trips: tuple[int, ...]
    paths: tuple[IndexArray, ...]

    @classmethod
    def of(cls, network: pl.DataFrame, observed: pl.DataFrame) -> Roads:
        """From the rows of the tables trips_network and trips_observed, which may come in any order."""
        steps = network.sort("from_link", "to_link").with_row_index("step")
        moves = (
            observed.sort("trip", "place")
            .with_columns(next=pl.col("link").shift(-1).over("trip"))
            .drop_nulls("next")
            .join(
                steps.select("from_link", "to_link", "step"),
                left_on=["link", "next"], right_on=["from_link", "to_link"], how="inner", maintain_order="left",
            )
            .group_by("trip", maintain_order=True)
            .agg("step")
        )  # fmt: skip
        return cls(
            Network(steps["from_link"].to_numpy().astype(np.intp) - 1, steps["to_link"].to_numpy().astype(np.intp) - 1),
            steps.select(FEATURES).to_numpy().astype(np.float64),
            tuple(moves["trip"].to_list()),
            tuple(np.array(path, dtype=np.intp) for path in moves["step"].to_list()),
        )

    @cached_property
    def origins(self) -> IndexArray:
        """(n,) the first link of each trip."""
        return self.network.sources[[path[0] for path in self.paths]]

    @cached_property
    def destinations(self) -> IndexArray:
        """(n,) the destination of each trip."""
        return self.network.targets[[path[-1] for path in self.paths]]

    def recursive_logit(self) -> RecursiveLogit:
        """Boltzmann over all paths, for these trips."""
        totals = np.array([self.features[path].sum(axis=0) for path in self.paths])
        paths = Paths(self.origins, self.destinations, totals)
        return RecursiveLogit(self.network.sources, self.network.targets, self.features, paths)
