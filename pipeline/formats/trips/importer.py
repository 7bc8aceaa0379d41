"""Trips in a road network as RecursiveLogit.Classical.V2 publishes them: four sparse matrices in text files.

A line is `row column value`, numbers separated by blanks, rows and columns counted from 1. The states are the links of
the network, and after them one state for each destination.
"""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import polars as pl

from pipeline.arrays import FloatArray, IntArray
from pipeline.errors import StageError

STEPS, TIMES, ANGLES, TRIPS = (
    "linkIncidence.txt", "ATTRIBUTEestimatedtime.txt", "ATTRIBUTEturnangles.txt", "observationsForEstimBAI.txt",
)  # fmt: skip
FILES = (STEPS, TIMES, ANGLES, TRIPS)
MAX_BYTES = 1 << 27
MAX_NUMBER = 10_000_000  # of a link, a trip or a place in a trip
LEFT_RAD = (-3.1, -0.5236)
U_TURN_RAD = 3.1


@dataclass(frozen=True)
class TripTables:
    """The rows of the tables trips_network and trips_observed."""

    network: pl.DataFrame
    observed: pl.DataFrame


@dataclass(frozen=True)
class _Matrix:
    """Rows and columns, counted from 1, and values, ordered by row and column."""

    rows: IntArray
    columns: IntArray
    values: FloatArray


def read_trips(folder: Path) -> TripTables:
    """The network and the trips in the four files of `folder`. All is checked; nothing is written.

    Raises:
        StageError: a file is missing, too large or no such matrix, or the files do not fit together.
    """
    if not folder.is_dir():
        raise StageError(f"{folder}: there is no such folder; give the one that has {', '.join(FILES)}")
    steps, times, angles, trips = (_matrix(folder / name) for name in FILES)
    network = _network(folder, steps, times, angles)
    return TripTables(network, _observed(folder / TRIPS, trips, network))


def _matrix(file: Path) -> _Matrix:
    entries: list[tuple[float, float, float]] = []
    for number, line in enumerate(_text(file).splitlines(), start=1):
        fields = line.split()
        if not fields:
            continue
        try:
            row, column, value = (float(field) for field in fields)
        except ValueError:
            raise StageError(
                f"{file}: line {number} is {line[:60]!r}; three numbers are needed: row column value"
            ) from None
        if not (_whole(row) and _whole(column) and math.isfinite(value)):
            raise StageError(
                f"{file}: line {number} is {line[:60]!r}; row and column are whole numbers from 1 to "
                f"{MAX_NUMBER:,} and the value is finite"
            )
        entries.append((row, column, value))
    if not entries:
        raise StageError(f"{file}: has no entries; lines of `row column value` are needed")
    array = np.array(sorted(entries))
    alike = (np.diff(array[:, :2], axis=0) == 0).all(axis=1)
    if alike.any():
        row, column = array[np.flatnonzero(alike)[0], :2].astype(int)
        raise StageError(f"{file}: has the entry of row {row} and column {column} twice; keep one")
    return _Matrix(array[:, 0].astype(np.int64), array[:, 1].astype(np.int64), array[:, 2])


def _whole(number: float) -> bool:
    return 1 <= number <= MAX_NUMBER and number == int(number)


def _text(file: Path) -> str:
    if not file.is_file():
        raise StageError(f"{file}: there is no such file; the folder needs {', '.join(FILES)}")
    try:
        with file.open("rb") as stream:
            size = os.fstat(stream.fileno()).st_size
            if size > MAX_BYTES:
                raise StageError(f"{file}: has {size:,} bytes; {MAX_BYTES:,} is the most for such a matrix")
            return stream.read(MAX_BYTES).decode("ascii")
    except OSError as error:
        raise StageError(f"{file}: cannot be read ({error.strerror or error})") from None
    except UnicodeDecodeError:
        raise StageError(f"{file}: is no plain text; lines of `row column value` are needed") from None


def _network(folder: Path, steps: _Matrix, times: _Matrix, angles: _Matrix) -> pl.DataFrame:
    if not (steps.values == 1).all():
        raise StageError(f"{folder / STEPS}: has a value other than 1; an entry says that one link leads to another")
    keys = ["from_link", "to_link"]
    table = pl.DataFrame({"from_link": steps.rows, "to_link": steps.columns})
    for name, matrix in (("travel_time", times), ("turn_angle", angles)):
        values = pl.DataFrame({"from_link": matrix.rows, "to_link": matrix.columns, name: matrix.values})
        table = table.join(values, on=keys, how="left", maintain_order="left").with_columns(pl.col(name).fill_null(0.0))
    if negative := table.filter(pl.col("travel_time") < 0).rows():
        raise StageError(f"{folder / TIMES}: has a negative travel time from link {negative[0][0]} to {negative[0][1]}")
    if wide := table.filter(pl.col("turn_angle").abs() > 3.1416).rows():
        raise StageError(f"{folder / ANGLES}: has an angle beyond pi from link {wide[0][0]} to {wide[0][1]}; give rad")
    return table.select(
        *keys,
        pl.col("travel_time"),
        (pl.col("turn_angle").is_between(*LEFT_RAD, closed="none")).cast(pl.Int64).alias("left_turn"),
        (pl.col("travel_time") > 0).cast(pl.Int64).alias("link"),
        (pl.col("turn_angle").abs() > U_TURN_RAD).cast(pl.Int64).alias("u_turn"),
        pl.col("turn_angle"),
    )


def _observed(file: Path, trips: _Matrix, network: pl.DataFrame) -> pl.DataFrame:
    """Each trip's links in order, the last one its destination."""
    if not (trips.values == np.round(trips.values)).all():
        raise StageError(f"{file}: has a value that is no whole number; values are links")
    table = pl.DataFrame({"trip": trips.rows, "place": trips.columns, "link": trips.values.astype(np.int64)})
    _refuse(file, table.filter(pl.col("place") != pl.int_range(1, pl.len() + 1).over("trip")), "leaves out a place")
    _refuse(file, table.filter(pl.len().over("trip") < 3), "has fewer than two links")
    ends = pl.col("link").first().over("trip") != pl.col("link").last().over("trip")
    _refuse(file, table.filter(ends), "does not end at its destination, which comes first")
    path = table.filter(pl.col("place") > 1).with_columns(place=pl.col("place") - 1)
    left = pl.col("link").last().over("trip").is_in(network["from_link"].unique().implode())
    _refuse(file, path.filter(left), "ends in a link that leads on; destinations are states of their own")
    known = network.select(link="from_link", next="to_link", known=pl.lit(True))
    moves = path.with_columns(next=pl.col("link").shift(-1).over("trip")).drop_nulls("next")
    unknown = moves.join(known, on=["link", "next"], how="left", maintain_order="left").filter(
        pl.col("known").is_null()
    )
    _refuse(file, unknown, "goes from a link to one that it does not lead to")
    return path


def _refuse(file: Path, rows: pl.DataFrame, what: str) -> None:
    if rows.height:
        raise StageError(f"{file}: trip {rows['trip'][0]} {what}; repair the file at its source or drop the trip")
