"""Tables: what is written comes back, what breaks the contract is refused, and nothing partial is left."""

from pathlib import Path

import numpy as np
import polars as pl
import pyarrow.parquet as pq
import pytest

import schemas
from pipeline.errors import TableError
from pipeline.formats.parquet.tables import read_table, write_table
from tests.support.tables import provenance_of

PLAIN = {"string": "x", "bool": False, "int64": 1, "double": 1.5}


def demonstrations(**changes: object) -> pl.DataFrame:
    """Two rows of the table, every column that is not given here or as a change filled with something plain."""
    contract = schemas.schema("demonstrations")
    columns: dict[str, object] = {column.name: [PLAIN.get(column.scalar)] * 2 for column in contract.columns}
    columns |= {
        "demonstration_id": ["a", "b"],
        "participant": ["p", "q"],
        "source": ["a.mcap", "b.mcap"],
        "simulated": [False, True],
        "true_theta": [None, "{}"],
        "duration_s": [1.5, 2.5],
        "lost": [None, "the rest"],
        "waypoints": pl.Series(np.arange(12.0).reshape(2, 3, 2)),
    }
    return pl.DataFrame({name: values for name, values in (columns | changes).items() if values is not None})


def test_a_table_comes_back_with_its_provenance_and_in_the_schemas_order(tmp_path: Path) -> None:
    path = tmp_path / "deep" / "demonstrations.parquet"
    shuffled = demonstrations().select(reversed(demonstrations().columns))
    write_table(path, "demonstrations", shuffled, {"seed": 3})
    back = read_table(path, "demonstrations")
    assert back.equals(demonstrations())
    assert back.columns == [column.name for column in schemas.schema("demonstrations").columns]
    assert provenance_of(path) == {"seed": 3}


def test_all_but_trajectories_are_written_with_dictionaries(tmp_path: Path) -> None:
    write_table(tmp_path / "table", "demonstrations", demonstrations(), {})
    row_group = pq.ParquetFile(tmp_path / "table").metadata.row_group(0)
    columns = [row_group.column(number) for number in range(row_group.num_columns)]
    encoded = {column.path_in_schema: "RLE_DICTIONARY" in column.encodings for column in columns}
    assert not encoded.pop("waypoints.list.element.list.element")
    assert encoded.pop("simulated") is encoded.pop("salvaged") is False  # one bit each
    assert encoded
    assert all(encoded.values())
    posteriors = pl.DataFrame(
        {
            "task": "t", "demonstration_id": "d", "participant": "p", "model": "less", "set_size": 3,
            "set_id": "00", "theta_id": [0, 1], "theta": pl.Series(np.eye(2)), "beta": 1.0, "log_posterior": -0.7,
            "posterior": 0.5,
        }
    )  # fmt: skip
    write_table(tmp_path / "posteriors", "posteriors", posteriors, {})
    row_group = pq.ParquetFile(tmp_path / "posteriors").metadata.row_group(0)
    columns = [row_group.column(number) for number in range(row_group.num_columns)]
    assert all("RLE_DICTIONARY" in column.encodings for column in columns)


def test_equal_tables_give_equal_bytes(tmp_path: Path) -> None:
    for name in ("one", "two"):
        write_table(tmp_path / name, "demonstrations", demonstrations(), {"seed": 3})
    assert (tmp_path / "one").read_bytes() == (tmp_path / "two").read_bytes()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"participant": None}, "lacks the column 'participant'"),
        ({"extra": [1, 2]}, "no column 'extra'"),
        ({"duration_s": [1.0, float("nan")]}, "'duration_s' holds NaN"),
        ({"duration_s": ["x", "y"]}, "'duration_s' is String, needed is double"),
        ({"source": ["a.mcap", None]}, "'source' has 1 missing values"),
        ({"demonstration_id": ["a", "a"]}, "more than one row"),
        ({"waypoints": pl.Series([[1.0, 2.0], [3.0, 4.0]])}, "needed is double"),
        ({"waypoints": pl.Series(np.full((2, 3, 2), np.nan))}, "'waypoints' holds NaN"),
    ],
)
def test_a_table_that_breaks_its_schema_is_not_written(
    tmp_path: Path, changes: dict[str, object], message: str
) -> None:
    path = tmp_path / "demonstrations.parquet"
    write_table(path, "demonstrations", demonstrations(), {})
    before = path.read_bytes()
    with pytest.raises(TableError, match=message):
        write_table(path, "demonstrations", demonstrations(**changes), {})
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_another_version_or_another_table_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "t.parquet"
    write_table(path, "demonstrations", demonstrations(), {})
    version = schemas.schema("demonstrations").version
    with pytest.raises(
        TableError, match=f"holds table 'demonstrations' version {version}, needed is 'features' version 1"
    ):
        read_table(path, "features")
    table = pq.read_table(path)
    pq.write_table(
        table.replace_schema_metadata({b"lessbench.schema": b'{"name": "demonstrations", "version": 99}'}), path
    )
    with pytest.raises(TableError, match="version 99"):
        read_table(path, "demonstrations")
    pq.write_table(table.replace_schema_metadata(None), path)
    with pytest.raises(TableError, match="does not say which table"):
        read_table(path, "demonstrations")


@pytest.mark.parametrize("content", [b"", b"PAR1", b"not parquet at all" * 100])
def test_a_file_that_is_no_parquet_is_refused_in_a_sentence(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "t.parquet"
    path.write_bytes(content)
    with pytest.raises(TableError, match="cannot be read as Parquet"):
        read_table(path, "demonstrations")


def test_a_missing_file_names_the_remedy(tmp_path: Path) -> None:
    with pytest.raises(TableError, match="no such file; run the stage"):
        read_table(tmp_path / "t.parquet", "demonstrations")


def test_lengths_that_a_table_shares_must_agree(tmp_path: Path) -> None:
    rows = pl.DataFrame(
        {"kind": ["alternative"], "id": ["x"], "anchor": ["task"], "set_size": [1], "set_id": ["0"], "f": [1.0]}
    )
    write_table(tmp_path / "f.parquet", "features", rows, {})
    assert read_table(tmp_path / "f.parquet", "features")["f"].to_list() == [1.0]
    with pytest.raises(TableError, match="'g' is String"):
        write_table(tmp_path / "f.parquet", "features", rows.with_columns(g=pl.lit("x")), {})


def test_every_schema_loads_and_documents_every_column() -> None:
    assert {"alternatives", "densities", "demonstrations", "features", "posteriors", "rejected"} <= set(schemas.names())
    for name in schemas.names():
        contract = schemas.schema(name)
        assert contract.version >= 1
        assert set(contract.key) <= {column.name for column in contract.columns}
        assert all(column.description and column.scalar for column in contract.columns)
    with pytest.raises(KeyError, match="no schema named 'x'"):
        schemas.schema("x")


def test_a_flipped_bit_in_a_table_is_noticed(tmp_path: Path) -> None:
    path = tmp_path / "t.parquet"
    write_table(path, "demonstrations", demonstrations(), {"seed": 3})
    whole = path.read_bytes()
    places = np.random.default_rng(1).choice(8 * len(whole), 300, replace=False)
    noticed: list[str] = []
    for place in places.tolist():
        damaged = bytearray(whole)
        damaged[place // 8] ^= 1 << (place % 8)
        path.write_bytes(damaged)
        try:
            assert read_table(path, "demonstrations").equals(demonstrations())
        except TableError as error:
            noticed.append(str(error))
    assert len(noticed) > 100
    assert not any("\n" in message for message in noticed)
