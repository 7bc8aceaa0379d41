"""Section 4 of the paper: how well a robot in a grid world infers what people want.

Hypotheses H3 and H4: inference is better when it uses the model by which people choose. The sets on which each model
does best are examined more closely (section 4.2). H5: LESS is better than Boltzmann even when people see similarity in
features that the robot does not have. The paper does not publish its environment; `GridWorldSettings` describes ours.
"""

from __future__ import annotations

from dataclasses import dataclass

import polars as pl

from pipeline.params import GridWorldSettings
from pipeline.studies.grid_world.analysis import GridWorldAnalysis, analyse
from pipeline.studies.grid_world.examples import GridWorldExamples, examples
from pipeline.studies.grid_world.trials import build_world, run_trials


@dataclass(frozen=True, eq=False)
class GridWorldStudy:
    """The tables of section 4.

    Attributes:
        trials: one row per demonstration set and inference model, see `run_trials`.
        analysis: means, statistics and hypotheses.
        examples: the sets where each model does best.
        bandwidths: `sampling_model`, `bandwidth`: sigma of each LESS model, in scaled features.
    """

    trials: pl.DataFrame
    analysis: GridWorldAnalysis
    examples: GridWorldExamples
    bandwidths: pl.DataFrame


def run_grid_world(settings: GridWorldSettings, random_seed: int, bandwidth: float | None = None) -> GridWorldStudy:
    """Run the whole study.

    Args:
        settings: the grid world and how much is drawn in it.
        random_seed: root of every random number.
        bandwidth: sigma of the LESS kernels in scaled features, selected by leave-one-out if not given.

    Raises:
        ArgumentError: the bandwidth is not positive, or the trials do not vary enough for the statistics.
        BandwidthError: no bandwidth could be selected.
    """
    world = build_world(settings, bandwidth)
    trials = run_trials(world, settings, random_seed)
    bandwidths = pl.DataFrame({"sampling_model": list(world.bandwidths), "bandwidth": list(world.bandwidths.values())})
    return GridWorldStudy(trials, analyse(trials), examples(world, settings, random_seed, trials), bandwidths)
