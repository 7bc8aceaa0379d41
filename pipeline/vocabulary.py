"""The words that parameters, tables and pictures share: each is written once, here, with the name that readers see.

The SQL of the catalog's views, the descriptions in `schemas` and the captions of figures spell the words out, because a
reader must be able to read them as they stand.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, get_args

# Models of choice, as the column `model` has them.
BOLTZMANN, LESS, ATTRIBUTE_RULE, PATH_SIZE = "boltzmann", "less", "attribute-rule", "path-size"

INFERRED_MODELS: Mapping[str, str] = {BOLTZMANN: "Boltzmann", LESS: "LESS", ATTRIBUTE_RULE: "attribute rule"}
"""The models that `infer.models` may list, with their display names. Each has a class in `pipeline.choice.models`."""

# Variants of models, which only the studies use.
LESS_HIDDEN, LESS_HIDDEN_OWN_BANDWIDTH = "less-hidden", "less-hidden-own-bandwidth"
LESS_CLEAN_BANDWIDTH = "less-clean-bandwidth"
BOLTZMANN_WEIGHTED = "boltzmann-weighted"
LESS_POOLED, NESTED_LOGIT = "less-pooled", "nested-logit"
BOLTZMANN_APART, BOLTZMANN_WEIGHTED_APART = "boltzmann-apart", "boltzmann-weighted-apart"

MODELS: Mapping[str, str] = {
    **INFERRED_MODELS,
    PATH_SIZE: "path-size logit",
    LESS_HIDDEN: "LESS, hidden, same σ",
    LESS_HIDDEN_OWN_BANDWIDTH: "LESS, hidden, own σ",
    LESS_CLEAN_BANDWIDTH: "LESS, clean set's bandwidth",
    LESS_POOLED: "LESS, density of a larger pool",
    NESTED_LOGIT: "nested logit",
    BOLTZMANN_WEIGHTED: "Boltzmann, importance weights",
    BOLTZMANN_APART: "Boltzmann, demonstration apart",
    BOLTZMANN_WEIGHTED_APART: "Boltzmann, importance weights, demonstration apart",
}
"""All models and variants with their display names."""

# Regimes of the robustness study: how the sets of alternatives that are compared came about.
INDEPENDENT, SAMPLER_SHIFT, KNOWN_DENSITY = "independent", "sampler-shift", "known-density"
WITH_OPTIMA, EXPLORED_SPACE = "with-optima", "explored-space"

REGIMES: Mapping[str, str] = {
    INDEPENDENT: "one sampler",
    SAMPLER_SHIFT: "different samplers",
    KNOWN_DENSITY: "samplers of known density",
    WITH_OPTIMA: "different samplers, with planned paths",
    EXPLORED_SPACE: "explored choice space",
}

# Whether a row of that study is about demonstrations one by one or about all of them together.
SINGLE, BATCH = "single", "batch"

KINDS: Mapping[str, str] = {SINGLE: "single demonstrations", BATCH: "all together"}

# What people are taken to want of a feature, unless the task's `thetas` say otherwise.
COST, WISH, EITHER = "cost", "wish", "either"

DIRECTIONS: Mapping[str, tuple[int, ...]] = {COST: (-1,), WISH: (1,), EITHER: (-1, 1)}
"""The signs that the weight of a feature may have: less of a cost is better, more of a wish."""

# How a feature makes one number of a whole trajectory.
SUM, MEAN, LEAST, GREATEST = "sum", "mean", "least", "greatest"
OVER_TIME = (SUM, MEAN, LEAST, GREATEST)

# Samplers of alternatives.
DEFORMATION, VIA_POINT, PLANNER, MIXTURE, GIVEN = "deformation", "via-point", "planner", "mixture", "given"

# Reserved words.
ALL = "all"
"""The `demonstration_id` and `participant` of all demonstrations together."""
TASK_ANCHOR, DEMONSTRATION_ANCHOR = "task", "demonstration"
"""Values of a task's `anchor`; the first is also the `anchor` of alternatives that all demonstrations share."""
WORKING = "working"
SCHEDULER = "LESSBENCH_SCHEDULER"  # environment variable with the address of a Dask scheduler
"""The `set_id` of the set that is shown."""
EXPLORED = "explored"
"""The `set_id` that stands for the explored choice space in the views of the catalog, which is no set."""
POOLED = "pooled"
"""The `exploration` that stands for the mean over all of them, which is shown."""
STUDIES = "studies"
"""Stands where a task's name would, for tables and files of no task."""
RESERVED_IDS = (ALL, TASK_ANCHOR)
"""What no recording and no participant can be called."""
RESERVED_FOLDERS = ("robots", "scenes", STUDIES)
"""Folders of datasets/ that belong to no task: what no task can be called."""


def model_name(model: str) -> str:
    """What readers see for a model; a model that is not listed here goes by its own name."""
    return MODELS.get(model, model)


Clock = Literal["header", "publish", "log"]
"""What the times of a recording are, as `ingest.clock` and the column `clock` have it."""
CLOCKS: tuple[Clock, ...] = get_args(Clock)
"""In the order in which they are preferred: when the arm was measured, when that was sent, when it was written down."""
