"""A road network and trips in it, from other people's text files into tables of the project."""

from __future__ import annotations

from pathlib import Path

from pipeline.formats.parquet.tables import write_table
from pipeline.formats.trips.importer import FILES, read_trips
from pipeline.vocabulary import STUDIES
from pipeline.workspace.project import Project, recorded_run
from pipeline.workspace.provenance import provenance


def run(project: Project, folder: Path) -> None:
    """Write the tables trips_network and trips_observed from the four files of `folder`.

    Raises:
        StageError: see `read_trips`; nothing is written then.
    """
    with recorded_run(project, "import-trips", STUDIES) as record:
        read = read_trips(folder)
        stated = provenance(project, (), [folder / name for name in FILES])
        for name, table in (("trips_network", read.network), ("trips_observed", read.observed)):
            write_table(project.table(STUDIES, name), name, table, stated)
        record.produced = f"{read.observed['trip'].n_unique():,} trips, {read.network.height:,} steps between links"
