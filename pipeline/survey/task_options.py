"""The alternatives of a task as things to choose from: what each model says of any set of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import polars as pl

from pipeline.arrays import FloatArray
from pipeline.choice.models import choice_model
from pipeline.errors import SurveyError, few_of
from pipeline.formats.parquet.tables import read_table
from pipeline.studies.choice_design import answer_probabilities
from pipeline.studies.posteriors import hypotheses
from pipeline.vocabulary import WORKING
from pipeline.workspace.project import Project


@dataclass(frozen=True, eq=False)
class TaskOptions:
    """The alternatives of a task's working sets.

    Attributes:
        task: its name.
        models: names of the models that are compared.
        ids: of the alternatives, by anchor.
        features: (N, F) scaled, by anchor.
        bandwidths: of LESS, by anchor; that of the task's inference.
        thetas: (K, F) and
        betas: (B,) that the task's inference looks at.
    """

    task: str
    models: tuple[str, ...]
    ids: Mapping[str, list[str]]
    features: Mapping[str, FloatArray]
    bandwidths: Mapping[str, float]
    thetas: FloatArray
    betas: FloatArray

    @classmethod
    def of(cls, project: Project, name: str) -> TaskOptions:
        """From the tables of the task.

        Raises:
            SurveyError: the tables are not there, or the task's inference compares one model alone.
            TableError: a table is not what it should be.
        """
        task, settings = project.params.task(name), project.params.infer
        if len(set(settings.models)) < 2:
            raise SurveyError("infer.models in params.yaml names one model; a design needs two that can be told apart")
        paths = {table: project.table(name, table) for table in ("features", "scales", "densities")}
        if missing := next((path for path in paths.values() if not path.exists()), None):
            raise SurveyError(f"{missing}: there is no such table; make it with `dvc repro` or `lessbench run {name}`")
        scales = read_table(paths["scales"], "scales")
        names, scale = scales["feature"].to_list(), scales["scale"].to_numpy()
        rows = read_table(paths["features"], "features", ["kind", "id", "anchor", "set_id", *names])
        rows = rows.filter(pl.col("set_id") == WORKING).drop_nulls("anchor")
        of_sets = read_table(paths["densities"], "densities", ["anchor", "set_id", "bandwidth"])
        widths = dict(of_sets.filter(pl.col("set_id") == WORKING).select("anchor", "bandwidth").unique().iter_rows())
        parts = {str(anchor): part for (anchor,), part in rows.group_by("anchor", maintain_order=True)}
        if not parts or parts.keys() - widths.keys():
            raise SurveyError(f"the tables of {name} do not go together; make them again with `dvc repro`")
        return cls(
            name,
            tuple(dict.fromkeys(settings.models)),
            {anchor: part["id"].to_list() for anchor, part in parts.items()},
            {anchor: part.select(names).to_numpy() / scale for anchor, part in parts.items()},
            {anchor: float(widths[anchor]) for anchor in parts},
            hypotheses(task, settings, names, tuple(scales["direction"])),
            np.array(settings.betas),
        )

    def probabilities(self, anchor: str, rows: Sequence[int]) -> FloatArray:
        """(M, K, B, k) the probability of each of some alternatives, given by their rows, if they are all there is."""
        phi = self.features[anchor][list(rows)]
        log_w = [choice_model(model, self.bandwidths[anchor]).weigh(phi).log_w for model in self.models]
        return answer_probabilities(phi, np.stack(log_w), self.thetas, self.betas)

    def of_ids(self, wanted: Sequence[str]) -> FloatArray:
        """The same for alternatives by their ids, which must have one anchor.

        Raises:
            SurveyError: they have not.
        """
        for anchor, ids in self.ids.items():
            places = {key: row for row, key in enumerate(ids)}
            if all(key in places for key in wanted):
                return self.probabilities(anchor, [places[key] for key in wanted])
        raise SurveyError(f"the working set of {self.task} has no anchor with all of {few_of(wanted)}")
