"""Section 4 of the paper in a grid world: how well a robot infers what people want who choose by one model or another.

H3 and H4: is inference better when its model is that of the people? The sets where each model does best are
kept for a closer look (section 4.2). H5: is LESS still ahead when people see similarity in features the robot lacks?
The paper does not publish its environment; ours is described by `GridWorldSettings`.
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
    """All of section 4.

    Attributes:
        trials: one row per demonstration set and inference model, see `run_trials`.
        analysis: means, statistics and hypotheses.
        examples: the sets where each model does best.
        bandwidths: `sampling_model`, `bandwidth`: the kernel width of each LESS model, in scaled features.
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
        bandwidth: as in `build_world`.

    Raises:
        ArgumentError: the bandwidth is not positive, or the trials do not vary enough for the statistics.
        BandwidthError: no bandwidth could be selected.
    """
    world = build_world(settings, bandwidth)
    trials = run_trials(world, settings, random_seed)
    bandwidths = pl.DataFrame({"sampling_model": list(world.bandwidths), "bandwidth": list(world.bandwidths.values())})
    return GridWorldStudy(trials, analyse(trials), examples(world, settings, random_seed, trials), bandwidths)
