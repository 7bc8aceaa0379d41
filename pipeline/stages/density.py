"""Stage: the scale of the features, and the kernel density of each set of alternatives at its own members.

Sets of up to one partition are computed whole, side by side. A larger set goes through part by part: its bounds, its
sketch, and its kernel sums, each a fold over its rows; see `pipeline.choice.streaming`.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from itertools import groupby
from pathlib import Path

import numpy as np
import polars as pl

from pipeline.arrays import FloatArray
from pipeline.choice import Bandwidth, choose_engine, log_density, select_bandwidth
from pipeline.choice.kernel.bandwidth import sampled_bandwidth
from pipeline.choice.kernel.cost_model import LONGEST_S, pair_seconds
from pipeline.choice.kernel.domain_split import Slab
from pipeline.choice.kernel.fourier import Sketch
from pipeline.choice.scaling import Spread
from pipeline.choice.streaming import log_sums_of_part, log_sums_over_part, sketch_seconds, sketch_slabs, slab_of_part
from pipeline.errors import BandwidthError, StageError, few_of
from pipeline.formats.files.links import require_inside
from pipeline.formats.parquet.checked.conformance import GROUPS
from pipeline.formats.parquet.checked.open_table import Piece
from pipeline.formats.parquet.partitions import PARTITIONS, Contents, Scaled, SetRows, batches, cut, gathered
from pipeline.formats.parquet.tables import table_writer, write_table
from pipeline.formats.parquet.task_tables import TaskTables
from pipeline.stages.registry import parameters
from pipeline.workspace.compute.executor import Workers, workers
from pipeline.workspace.compute.streamed_alternatives import StreamedSet
from pipeline.workspace.project import SCRATCH, Project, recorded_run
from pipeline.workspace.provenance import provenance

IN_MEMORY = 20_000_000  # rows of a set that are read at once where there is no other way
DEMONSTRATIONS = ""  # stands where the anchor of alternatives would
Spreads = dict[str, Spread]  # by anchor
SLABBED = 2_000_000  # rows of a set that are read at once where each part would transform every slab anew


@dataclass(frozen=True, eq=False)
class Sketched:
    """A part of a set whose sketch is known.

    Attributes:
        features: of all sets.
        rows: of the part.
        sigma: the set's bandwidth.
        slabs, totals, files: the set's sketches and their rows; their coefficients are in files, as they may be large.
        parts: all parts of the set.
    """

    features: Scaled
    rows: tuple[Piece, ...]
    sigma: float
    slabs: tuple[Slab, ...]
    totals: tuple[float, ...]
    files: tuple[Path, ...]
    parts: tuple[tuple[Piece, ...], ...]


def run(project: Project, name: str) -> None:
    """Write scales.parquet and densities.parquet of the task `name`."""
    project.params.task(name)
    partition = project.params.compute.partition
    with (
        recorded_run(project, "density", name) as record,
        TaskTables(project.tables(name, ("features", "feature_units"))) as tables,
        workers() as pool,
    ):
        tables.check()
        there, units = tables.contents("features"), tables["feature_units"].read()
        sets, names, method = there.sets, tuple(units["feature"]), project.params.features.scale
        unscaled = Scaled(tables.for_jobs("features"), names, np.ones(len(names)))
        spreads = _spreads(pool, unscaled, there)
        demonstrations = spreads.pop(DEMONSTRATIONS, None)
        spread = reduce(Spread.__add__, spreads.values())
        scale = spread.scale(method, names, demonstrations)
        used = pl.lit(method if isinstance(method, str) else "given")
        scales = units.select(
            "feature",
            "unit",
            "direction",
            "over_time",
            method=used,
            scale=pl.Series(scale),
            varies=pl.Series(spread.varies),
        )
        record.notes += _unvaried(names, spread, spreads)
        stated = provenance(project, parameters("density", name), tables.values())
        write_table(project.table(name, "scales"), "scales", scales, stated)
        features, bandwidth = replace(unscaled, scale=scale), project.params.density.bandwidth
        with (
            table_writer(project.table(name, "densities"), "densities", stated) as writer,
            gathered(writer, partition) as table,
        ):
            for large, some in groupby(sets, lambda one: one.rows > partition):
                if large:
                    for one in some:
                        for rows in _streamed(project, pool, features, one, bandwidth):
                            table.add(rows)
                else:
                    jobs = [(features, batch, bandwidth) for batch in batches(list(some), 4 * pool.cores(), partition)]
                    for some_rows in pool.mapped(set_densities, jobs, f"density {name}"):
                        for rows in some_rows:  # one by one, as the batches depend on the number of cores
                            table.add(rows)
        record.produced = f"{len(sets)} sets, {table.rows:,} log densities"


def _spreads(pool: Workers, unscaled: Scaled, there: Contents) -> Spreads:
    """Of the unscaled features over the sets of each anchor and over the demonstrations."""
    parts: dict[int, list[tuple[str, Piece]]] = {}
    for anchor, piece in (
        *((one.anchor, piece) for one in there.sets for piece in one.pieces),
        *((DEMONSTRATIONS, piece) for piece in there.others),
    ):
        parts.setdefault(piece.part, []).append((anchor, piece))
    jobs = [(unscaled, tuple(sorted(parts[part], key=lambda row: row[1].first))) for part in sorted(parts)]
    return pool.merged(spreads_of, jobs, _added, "spread of the features")


def spreads_of(job: tuple[Scaled, Sequence[tuple[str, Piece]]]) -> Spreads:
    """By anchor, of the features of some rows of one part."""
    features, labelled = job
    rows = features.read([piece for _, piece in labelled])
    anchors = np.repeat([anchor for anchor, _ in labelled], [piece.count for _, piece in labelled])
    return {anchor: Spread.of(rows[anchors == anchor]) for anchor in dict.fromkeys(anchor for anchor, _ in labelled)}


def _added(one: Spreads, other: Spreads) -> Spreads:
    both = dict(one)
    for anchor, spread in other.items():
        both[anchor] = both[anchor] + spread if anchor in both else spread
    return both


def _unvaried(names: Sequence[str], spread: Spread, spreads: Mapping[str, Spread]) -> list[str]:
    """A sentence for each feature that is the same for all alternatives, of the task or of some anchors."""
    found = []
    for f, name in enumerate(names):
        same = [anchor for anchor, own in spreads.items() if not own.varies[f]]
        if not spread.varies[f]:
            found.append(
                f"feature {name!r} is the same for all {spread.count:,} alternatives, so that nothing tells its weight"
            )
        elif same:
            found.append(
                f"feature {name!r} is the same for all alternatives of {few_of(same)} (of {len(spreads)} anchors), so "
                "that these demonstrations hardly tell its weight"
            )
    return found


def spread_of(job: tuple[Scaled, Sequence[Piece]]) -> Spread:
    """Of the features of some rows."""
    features, rows = job
    return Spread.of(features.read(rows))


def set_densities(job: tuple[Scaled, Sequence[SetRows], str | float]) -> list[pl.DataFrame]:
    """Rows of densities.parquet for each of some whole sets."""
    features, sets, bandwidth = job
    tables = []
    for one in sets:
        phi = features.read(one.pieces)
        try:
            sigma = select_bandwidth(phi, bandwidth)
        except BandwidthError as error:
            raise error.of(one.set_size, one.set_id, one.anchor) from None
        engine = choose_engine(phi, sigma.value).engine
        log_sums = log_density(phi, sigma.value, engine=engine)
        tables.append(_rows(features, one.pieces, sigma, log_sums, engine))
    return tables


def _rows(
    features: Scaled, pieces: Sequence[Piece], sigma: Bandwidth, log_sums: FloatArray, engine: str
) -> pl.DataFrame:
    """Rows of densities.parquet for rows of features.parquet."""
    return pl.concat(features.file.table().pieces(pieces, [*GROUPS, "id"])).select(
        *GROUPS,
        alternative_id="id",
        bandwidth=pl.lit(sigma.value),
        rows_scored=pl.lit(sigma.rows_scored, pl.Int64),
        bandwidth_error=pl.lit(sigma.value_error, pl.Float64),
        engine=pl.lit(engine),
        log_density=pl.Series(log_sums),
    )


def _streamed(
    project: Project, pool: Workers, features: Scaled, one: SetRows, bandwidth: str | float
) -> Iterator[pl.DataFrame]:
    """Rows of densities.parquet for a set larger than a partition, in parts of a partition."""
    partition, what = project.params.compute.partition, f"density {one.set_id}"
    parts = tuple(one.between(first, first + count) for first, count in cut(one.rows, PARTITIONS * partition))
    spread = pool.merged(spread_of, [(features, rows) for rows in parts], Spread.__add__, f"{what}: bounds")
    memory_bytes = 1e9 * project.params.compute.memory_gb
    longest_part = min(one.rows, PARTITIONS * partition)
    sigma = _bandwidth(pool, features, one, parts, spread, bandwidth, memory_bytes, what)
    lower, upper = spread.lower.tolist(), spread.upper.tolist()
    slabs = sketch_slabs(lower, upper, sigma.value, one.rows, longest_part, memory_bytes)
    seconds = math.inf if slabs is None else sketch_seconds(slabs, one.rows, longest_part)
    if slabs is None or _better_whole(one.rows, len(slabs), seconds):
        phi = _whole(features, one, "their features are too many, or the bandwidth too narrow, for a sketch")
        engine = choose_engine(phi, sigma.value).engine
        log_sums = log_density(phi, sigma.value, engine=engine)
        for first, count in cut(one.rows, partition):
            pieces = one.between(first, first + count)
            yield _rows(features, pieces, sigma, log_sums[first : first + count], engine)
        return
    cores = pool.cores()
    if seconds > LONGEST_S * cores:
        raise StageError(
            f"the kernel sums of the set {one.set_id!r} of {one.rows:,} alternatives at bandwidth {sigma.value:g} "
            f"would take about {seconds / 3600 / cores:.0f} hours on {cores} cores; use more workers "
            "(docs/cluster.md), a larger compute.memory_gb, a wider density.bandwidth or fewer alternatives"
        )
    scratch = project.root / SCRATCH
    require_inside(scratch / "any")
    scratch.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="density-", dir=scratch) as folder:
        files = tuple(Path(folder) / f"{number}.npy" for number, _ in enumerate(slabs))
        totals = []
        for slab, file in zip(slabs, files, strict=True):
            sketch = pool.merged(slab_of, [(features, rows, slab) for rows in parts], Sketch.__add__, f"{what}: sketch")
            np.save(file, sketch.coefficients)
            totals.append(sketch.total)
        jobs = [Sketched(features, rows, sigma.value, slabs, tuple(totals), files, parts) for rows in parts]
        for part, log_sums in zip(parts, pool.mapped(log_sums_of, jobs, f"{what}: kernel sums"), strict=True):
            table = _rows(features, part, sigma, log_sums, "spectral")
            yield from (table.slice(first, count) for first, count in cut(table.height, partition))


def _better_whole(rows: int, slabs: int, seconds: float) -> bool:
    """Whether a set is read at once though sketches would do: by the set alone, never by how many cores there are."""
    return (slabs > 1 and rows <= SLABBED) or (seconds > LONGEST_S and rows <= IN_MEMORY)


def slab_of(job: tuple[Scaled, Sequence[Piece], Slab]) -> Sketch:
    """Of some rows."""
    features, rows, slab = job
    return slab_of_part(features.read(rows), slab)


def log_sums_of(part: Sketched) -> FloatArray:
    """(M,) log kernel sums over the whole set at the rows of a part."""
    total = sum(piece.count for rows in part.parts for piece in rows)
    sketches = (
        Sketch(slab.grid, np.load(file, mmap_mode="r"), count)
        for slab, file, count in zip(part.slabs, part.files, part.totals, strict=True)
    )
    phi = part.features.read(part.rows)
    log_sums, wrong = log_sums_of_part(phi, part.slabs, sketches, part.sigma)
    if wrong.any():
        if pair_seconds(float(wrong.sum()) * total) > LONGEST_S:
            raise StageError(
                f"{wrong.sum():,} of {len(phi):,} rows are too isolated in a set of {total:,} for its sketch, and all "
                "pairs would take hours; use a wider density.bandwidth or fewer alternatives"
            )
        sums = (log_sums_over_part(phi[wrong], part.features.read(rows), part.sigma) for rows in part.parts)
        log_sums[wrong] = reduce(np.logaddexp, sums)
    return log_sums


def _bandwidth(
    pool: Workers, features: Scaled, one: SetRows, parts: Sequence[Sequence[Piece]], spread: Spread,
    bandwidth: str | float, memory_bytes: float, what: str,
) -> Bandwidth:  # fmt: skip
    """Of one part, as of a set in memory; of more, `leave-one-out` on some rows alone."""
    if not isinstance(bandwidth, str):
        return Bandwidth(float(bandwidth), None, "fixed", True)
    if len(parts) == 1:
        return select_bandwidth(features.read(one.pieces), bandwidth)
    if bandwidth != "leave-one-out":
        raise StageError(
            f"density.bandwidth is {bandwidth!r}, which compares all pairs, and the set {one.set_id!r} has "
            f"{one.rows:,} alternatives; use leave-one-out or a number"
        )
    return sampled_bandwidth(StreamedSet(pool, features, parts, spread, memory_bytes, what))


def _whole(features: Scaled, one: SetRows, reason: str) -> FloatArray:
    """(N, F) of a set that must be in memory after all."""
    if one.rows > IN_MEMORY:
        raise StageError(
            f"the set {one.set_id!r} has {one.rows:,} alternatives and {reason}, up to {IN_MEMORY:,} are possible; "
            "give density.bandwidth as a number, wide enough for up to three features, or use fewer alternatives"
        )
    return features.read(one.pieces)
