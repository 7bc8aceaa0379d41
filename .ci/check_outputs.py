"""After `make repro`: every output is there, follows its contract, and says what it must."""

import json
import subprocess
import sys
from pathlib import Path

import polars as pl

import schemas
from pipeline.formats.duckdb.questions import ask
from pipeline.formats.duckdb.views import FILES, INPUTS
from pipeline.formats.parquet.tables import read_table
from pipeline.stages.registry import BY_COMMAND, STAGES, table_makers
from pipeline.views.rerun.recording import quiet_environment
from pipeline.vocabulary import STUDIES
from pipeline.workspace.project import Project

ROOT = Path(__file__).resolve().parents[1]


def main() -> None:
    """Exit with a sentence about the first thing that is wrong."""
    project = Project(ROOT)
    params = project.params
    rerun = Path(sys.executable).with_name("rerun")
    for task in params.tasks:
        tables = {
            name: read_table(project.table(task, name), name)
            for name, maker in table_makers(task).items()
            if maker in STAGES
        }
        people = params.simulate.participants
        expect(tables["demonstrations"].height == people, f"{task}: {people} demonstrations")
        expect(tables["rejected"].is_empty(), f"{task}: no rejected recording")
        sets = params.sample.sets * len(params.sample.sizes) + 1
        expect(tables["alternatives"].n_unique(["set_size", "set_id"]) == sets, f"{task}: {sets} sets")
        expect(tables["densities"]["log_density"].min() >= -1e-12, f"{task}: self mass in every density")
        groups = ["demonstration_id", "participant", "model", "set_size", "set_id"]
        totals = tables["posteriors"].group_by(groups).agg(pl.col("posterior").sum())
        expect(totals.height == (people + 1) * sets * len(params.infer.models), f"{task}: one posterior per question")
        expect((totals["posterior"] - 1).abs().max() < 1e-9, f"{task}: posteriors that sum to one")
        scores = people * sets * len(params.infer.models)
        expect(tables["held_out"].height == scores, f"{task}: one held-out score per demonstration, model and set")
        recording = project.datasets / task / "inspect.rrd"
        expect(0 < recording.stat().st_size < 20_000_000, f"{task}: a recording under 20 MB")
    by_command = {table for one in BY_COMMAND for table in one.makes}  # from data that the project does not have
    for name in table_makers(STUDIES).keys() - by_command:
        read_table(project.table(STUDIES, name), name)
    for folder in (*params.tasks, STUDIES):
        figures = list(project.figures(folder).iterdir())
        kinds = [figure.suffix for figure in figures]
        expect(kinds.count(".svg") == kinds.count(".png") > 0, f"{folder}: every figure as SVG and PNG")
        expect(json.loads(project.metrics(folder).read_text()), f"{folder}: headline numbers")
        subprocess.run(
            [rerun, "rrd", "verify", project.datasets / folder / "inspect.rrd"], check=True, env=quiet_environment()
        )
    report = (project.datasets / "report.html").read_text(encoding="utf-8")
    expect(len(report) < 10_000_000 and report.count("<figure") > 30, "a report with all figures under 10 MB")
    expect("are out of date" not in report, "a report of what is there now")
    known = set(ask(project.catalog, "select table_name from duckdb_tables()")["table_name"])
    wanted = {*schemas.names(), FILES, INPUTS}
    expect(known | by_command == wanted, "a catalog of the tables with a schema and their files")
    expect(ask(project.catalog, "from outdated").is_empty(), "tables made from those that are there")
    print("all outputs are there and sound")


def expect(fact: bool, what: str) -> None:
    """Stop with `what` unless it is so."""
    if not fact:
        sys.exit(f"expected, but not found: {what}")


main()
