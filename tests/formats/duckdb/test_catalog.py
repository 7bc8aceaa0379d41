"""The catalog: all tasks in one file, opened from anywhere, and questions that cannot do harm."""

from pathlib import Path

import duckdb
import numpy as np
import polars as pl
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from pipeline.errors import QueryError, TableError
from pipeline.formats.duckdb import catalog as catalog_module
from pipeline.formats.duckdb.catalog import SourceFile, build_catalog
from pipeline.formats.duckdb.questions import CONTENTS, EXAMPLES, ask
from pipeline.formats.duckdb.views import FILES, INPUTS, VIEWS
from pipeline.formats.parquet.checked.open_table import OpenTable
from pipeline.formats.parquet.tables import table_writer, write_table
from schemas import schema


def posteriors(task: str, features: int) -> pl.DataFrame:
    return pl.DataFrame(
        {
            "task": task, "demonstration_id": ["d", "d"], "participant": "p", "model": "less", "set_size": 10,
            "set_id": "00", "theta_id": [0, 1], "theta": pl.Series(np.eye(2, features)), "beta": 1.0,
            "log_posterior": np.log([0.25, 0.75]), "posterior": [0.25, 0.75],
        }
    )  # fmt: skip


@pytest.fixture
def catalog(tmp_path: Path) -> Path:
    files = []
    for task, features in (("a", 3), ("b", 2)):
        write_table(tmp_path / f"{task}.parquet", "posteriors", posteriors(task, features), {})
        files.append((task, OpenTable(tmp_path / f"{task}.parquet", "posteriors")))
    path = tmp_path / "it's" / "catalog.duckdb"
    assert build_catalog(path, {"posteriors": files}) == {"posteriors": 4}
    return path


def test_tasks_with_different_numbers_of_features_share_a_table(catalog: Path) -> None:
    answer = ask(catalog, "select task, theta, posterior from posteriors order by task, theta_id")
    assert answer["theta"].to_list() == [[1, 0, 0], [0, 1, 0], [1, 0], [0, 1]]
    best = ask(catalog, "select theta_id, posterior from best_hypothesis order by task")
    assert best.rows() == [(1, 0.75), (1, 0.75)]


def test_columns_carry_their_meaning(catalog: Path) -> None:
    comments = ask(
        catalog, "select comment from duckdb_columns() where column_name = 'beta' and table_name = 'posteriors'"
    )
    assert "inverse temperature" in comments.item()


def test_any_client_opens_it_from_anywhere(catalog: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path.parent)
    with duckdb.connect(catalog, read_only=True) as con:
        assert con.execute("select count(*) from posteriors").fetchone() == (4,)
    assert [p.name for p in catalog.parent.iterdir()] == ["catalog.duckdb"]


@pytest.mark.parametrize(
    "question",
    [
        "create table t as select 1",
        "drop table posteriors",
        "update posteriors set beta = 2",
        "copy posteriors to 'out.csv'",
        "from read_text('/etc/hostname')",
        "attach 'other.db'",
        "install httpfs",
        "load httpfs",
        "set memory_limit = '100GB'",
        "select * from nowhere",
        "selec 1",
        "",
    ],
)
def test_a_question_that_would_do_more_than_ask_is_refused_in_one_line(catalog: Path, question: str) -> None:
    before = catalog.read_bytes()
    with pytest.raises(QueryError) as refused:
        ask(catalog, question)
    assert "\n" not in str(refused.value)
    assert catalog.read_bytes() == before


def test_a_question_without_end_is_stopped(catalog: Path) -> None:
    with pytest.raises(QueryError, match=r"more than 0\.3 s"):
        ask(catalog, "select count(*) from range(10000000000) a, range(1000000) b where a.range % 7 = b.range", 0.3)


def test_no_catalog_is_said_with_its_remedy(tmp_path: Path) -> None:
    with pytest.raises(QueryError, match="dvc repro"):
        ask(tmp_path / "catalog.duckdb", "select 1")


def test_columns_of_one_name_are_told_apart(catalog: Path) -> None:
    assert ask(catalog, "select 1 as a, 2 as a, 3 as a_2, 4 as a").columns == ["a", "a_2", "a_2_2", "a_3"]


def test_the_contents_and_the_examples_can_be_asked(whole: Path) -> None:
    contents = ask(whole, CONTENTS)
    assert set(contents["name"]) == {*TABLES, FILES, INPUTS, *VIEWS}
    assert contents["what it holds"].null_count() == 0
    for example in EXAMPLES.values():
        assert ask(whole, example).width > 2
    assert not ask(whole, next(iter(EXAMPLES.values()))).is_empty()


def test_every_column_of_every_table_and_view_says_what_it_is(whole: Path) -> None:
    columns = ask(whole, "from duckdb_columns() where not internal")
    assert columns.height > 100
    assert columns.filter(pl.col("comment").is_null() | (pl.col("comment") == "")).is_empty()
    own = [(name, column) for name, view in VIEWS.items() for column in view.columns]
    assert set(own) <= set(columns.select("table_name", "column_name").iter_rows())


def test_views_are_there_for_the_tables_that_are(catalog: Path) -> None:
    names = set(ask(catalog, CONTENTS)["name"])
    assert names == {
        "posteriors", FILES, INPUTS, "every_posterior", "best_hypothesis", "theta_marginals", "beta_marginals",
        "beta_at_edge", "derived_from", "outdated",
        "disagreement_between_sets", "disagreement_between_models", "people_against_group",
    }  # fmt: skip


SAID = ("weights_summary", "answers", "predictions")
TABLES = ("posteriors", "held_out", "demonstrations", "rejected", "scales", *SAID)
KEYS = ("task", "demonstration_id", "participant", "model", "set_size", "set_id")
HALF, NARROW = [0.5, 0.5], [0.9, 0.1]
# theta 0 and 1 with one beta: two sets that disagree about `ana`, one that shows all together
BELIEFS = {
    ("t", "ana", "ana", "less", 10, "00"): [0.2, 0.8],
    ("t", "ana", "ana", "less", 10, "01"): [0.7, 0.3],
    ("t", "ana", "ana", "less", 30, "working"): NARROW,
    ("t", "ana", "ana", "boltzmann", 30, "working"): [0.3, 0.7],
    ("t", "bea-1", "bea", "less", 30, "working"): HALF,
    ("t", "bea-2", "bea", "less", 30, "working"): HALF,
    ("t", "all", "bea", "less", 30, "working"): HALF,
    ("t", "all", "all", "less", 30, "working"): [0.1, 0.9],
}


@pytest.fixture
def whole(tmp_path: Path) -> Path:
    """A catalog of one task small enough to do in the head, with the files it was made from."""
    rows = [
        (*key, k, [-1.0, 0.0] if k == 0 else [-0.6, -0.8], 1.0, float(np.log(p)), p)
        for key, belief in BELIEFS.items()
        for k, p in enumerate(belief)
    ]
    people = pl.DataFrame({"demonstration_id": ["ana", "bea-1", "bea-2"], "participant": ["ana", "bea", "bea"]})
    tables = {
        "posteriors": pl.DataFrame(
            rows, schema=[*KEYS, "theta_id", "theta", "beta", "log_posterior", "posterior"], orient="row"
        ).with_columns(pl.col("theta").cast(pl.Array(pl.Float64, 2))),
        "held_out": pl.DataFrame(
            {
                "task": "t", "model": ["boltzmann", "less"], "set_size": 30, "set_id": "working",
                "log_predictive": [-3.0, -2.0],
            }
        ).with_columns(demonstration_id=pl.lit("ana"), participant=pl.lit("ana")),
        "demonstrations": sample_of("demonstrations", 3).with_columns(
            people["demonstration_id"], people["participant"], source=people["demonstration_id"] + ".mcap"
        ),
        "rejected": pl.DataFrame({"source": ["cut.mcap"], "reason": "truncated", "detail": "It ends too soon."}),
        "scales": sample_of("scales", 2).with_columns(feature=pl.Series(["z", "a"]), scale=1.0),
    }  # fmt: skip
    tables |= {name: sample_of(name, 1).with_columns(task=pl.lit("t")) for name in SAID}
    tables["weights_summary"] = tables["weights_summary"].with_columns(participant=pl.lit("all"))
    sources = []
    for name, table in tables.items():
        write_table(tmp_path / f"{name}.parquet", name, table, {})
        inputs = {"demonstrations": {"rec/ana.mcap": "1a", "rec/bea-1.mcap": "1b", "rec/bea-2.mcap": "1c"}}
        inputs |= {"posteriors": {"t/demonstrations.parquet": "old"}}
        made = {"program": "lessbench 9", "parameters": "ff", "seed": 7, "mujoco": "4", "inputs": inputs.get(name, {})}
        sources.append(SourceFile(f"t/{name}.parquet", name, "t", f"hash of {name}", made))
    build_catalog(
        tmp_path / "catalog.duckdb",
        {name: [("t", OpenTable(tmp_path / f"{name}.parquet", name))] for name in tables},
        sources,
    )
    return tmp_path / "catalog.duckdb"


def sample_of(name: str, rows: int) -> pl.DataFrame:
    """Rows of a table that follow its schema and say nothing."""
    plain = {"string": "", "bool": False, "int64": 0, "float": 0.0, "double": 0.0}
    columns = {
        column.name: pl.Series(np.zeros((rows, *(2 for _ in column.lengths))))
        if column.lengths else [plain[column.scalar]] * rows
        for column in schema(name).columns
    }  # fmt: skip
    return pl.DataFrame(columns)


def test_weights_have_their_features_names(whole: Path) -> None:
    answer = ask(whole, "select feature, weight from best_weights where participant = 'all'")
    assert answer.rows() == [("z", -0.6), ("a", -0.8)]


def test_disagreement_between_sets(whole: Path) -> None:
    (row,) = ask(whole, "from disagreement_between_sets").to_dicts()
    assert (row["demonstration_id"], row["sets"], row["answers"], row["agreeing"]) == ("ana", 2, 2, 0.5)
    assert row["mean_total_variation"] == row["largest_total_variation"] == pytest.approx(0.5)


def test_disagreement_between_models_and_people(whole: Path) -> None:
    (row,) = ask(whole, "from disagreement_between_models").to_dicts()
    assert (row["model"], row["theta_id"], row["other_model"], row["other_theta_id"]) == ("boltzmann", 1, "less", 0)
    assert row["total_variation"] == pytest.approx(0.6)
    people = ask(whole, "from people_against_group where differs and demonstration_id = 'ana'").to_dicts()
    assert [row["angle_deg"] for row in people] == [pytest.approx(np.degrees(np.arccos(0.6)))]


def test_models_are_compared(whole: Path) -> None:
    answer = ask(whole, "select model, mean, difference from model_comparison order by model")
    assert answer.rows() == [("boltzmann", -3.0, 0.0), ("less", -2.0, 1.0)]


def test_every_recording_is_accounted_for(whole: Path) -> None:
    answer = ask(whole, "select source, used, reason from recordings")
    assert answer.rows() == [
        ("ana.mcap", True, None), ("bea-1.mcap", True, None), ("bea-2.mcap", True, None),
        ("cut.mcap", False, "truncated"),
    ]  # fmt: skip


def test_a_posterior_goes_back_to_its_recordings(whole: Path) -> None:
    ana = ask(whole, "from lineage where demonstration_id = 'ana' and set_id = '00'").to_dicts()
    assert [(row["recording"], row["recording_sha256"], row["program"]) for row in ana] == [
        ("rec/ana.mcap", "1a", "lessbench 9")
    ]
    for participant, expected in (("bea", ["1b", "1c"]), ("all", ["1a", "1b", "1c"])):
        question = f"from lineage where demonstration_id = 'all' and participant = '{participant}'"
        assert sorted(ask(whole, question)["recording_sha256"]) == expected
    origins = ask(whole, "from derived_from where file = 't/posteriors.parquet'")
    assert origins["steps"].to_list() == [1, 2, 2, 2]
    assert ask(whole, "select mujoco, seed from files limit 1").rows() == [("4", 7)]


def test_tables_made_from_another_version_are_named(whole: Path) -> None:
    (row,) = ask(whole, "from outdated").to_dicts()
    assert (row["file"], row["was"], row["is_now"]) == ("t/posteriors.parquet", "old", "hash of demonstrations")


def features(**columns: list[float]) -> pl.DataFrame:
    row = {"kind": ["alternative"], "id": ["a"], "anchor": ["task"], "set_size": [1], "set_id": ["00"]}
    return pl.DataFrame(row | columns)


def build_from(folder: Path, name: str, table: pl.DataFrame, task: str = "t") -> Path:
    write_table(folder / f"{name}.parquet", name, table, {})
    with OpenTable(folder / f"{name}.parquet", name) as open_table:
        build_catalog(folder / "catalog.duckdb", {name: [(task, open_table)]})
    return folder / "catalog.duckdb"


HOSTILE_NAMES = (
    "kind\" as x from read_parquet('{folder}/features.parquet'); copy (select 42) to '{folder}/stolen'; select \"kind",
    "x\" ; COPY (select 42) TO '{folder}/stolen' --",
    "effort\", (select content from read_text('/etc/hostname')) as \"stolen",
    "effort'); copy (select 42) to '{folder}/stolen'; --",
    "effort\x1b]0;mine\x07",
    "two words",
    "",
    "e" * 201,
    "ID",  # DuckDB takes it for `id`
)


@pytest.mark.parametrize("name", HOSTILE_NAMES)
def test_a_column_that_no_feature_can_be_is_refused_and_never_becomes_sql(tmp_path: Path, name: str) -> None:
    hostile = name.replace("{folder}", str(tmp_path))
    with pytest.raises(TableError, match="only names of features are allowed"):
        build_from(tmp_path, "features", features(**{hostile: [1.0]}))
    assert [path.name for path in tmp_path.iterdir()] == ["features.parquet"]


def test_features_that_differ_in_case_alone_are_refused_in_one_task_and_joined_between_tasks(tmp_path: Path) -> None:
    with pytest.raises(TableError, match="'effort'"):
        build_from(tmp_path, "features", features(Effort=[1.0], effort=[2.0]))
    write_table(tmp_path / "a.parquet", "features", features(Effort=[1.0]), {})
    write_table(tmp_path / "b.parquet", "features", features(effort=[2.0], height=[3.0]), {})
    files = [(task, OpenTable(tmp_path / f"{task}.parquet", "features")) for task in ("a", "b")]
    build_catalog(tmp_path / "catalog.duckdb", {"features": files})
    found = ask(tmp_path / "catalog.duckdb", "select task, Effort, height from features")
    assert found.rows() == [("a", 1.0, None), ("b", 2.0, 3.0)]


@pytest.mark.parametrize("hostile", ["it's", 'a"b', "'; drop table features; --", "\x1b[31m", "$$", "?", "\u202e"])
def test_values_and_tasks_are_texts_whatever_is_in_them(tmp_path: Path, hostile: str) -> None:
    path = build_from(tmp_path, "features", features(effort=[1.0]).with_columns(id=pl.lit(hostile)), hostile)
    assert ask(path, "select task, id, effort from features").rows() == [(hostile, hostile, 1.0)]


def test_a_table_is_handed_over_part_by_part(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with table_writer(tmp_path / "features.parquet", "features", {}) as writer:
        for number in range(5):
            writer.write(features(effort=[float(number)]).with_columns(id=pl.lit(f"a{number}")))
    read = []

    def counted(table: OpenTable, number: int) -> pl.DataFrame:
        read.append(number)
        return part(table, number)

    part = OpenTable.part
    monkeypatch.setattr(OpenTable, "part", counted)
    path = tmp_path / "catalog.duckdb"
    with OpenTable(tmp_path / "features.parquet", "features") as open_table:
        assert build_catalog(path, {"features": [("t", open_table)]}) == {"features": 5}
    assert read == [0, 1, 2, 3, 4]
    assert ask(path, "select effort from features")["effort"].to_list() == [0, 1, 2, 3, 4]


def test_a_value_that_breaks_the_schema_stops_it_with_its_file_and_row(tmp_path: Path) -> None:
    path = tmp_path / "features.parquet"
    with table_writer(path, "features", {}) as writer:
        for number in range(3):
            writer.write(features(effort=[float(number)]).with_columns(id=pl.lit(f"a{number}")))
    broken = pq.read_table(path)
    values = pa.array([0.0, 1.0, float("nan")])
    broken = broken.set_column(5, broken.schema.field(5), values)
    pq.write_table(broken, path, row_group_size=1)
    with OpenTable(path, "features") as open_table, pytest.raises(TableError, match=r"holds NaN in row 3"):
        build_catalog(tmp_path / "catalog.duckdb", {"features": [("t", open_table)]})
    assert list(tmp_path.iterdir()) == [path]


def test_it_is_stored_so_that_the_first_stable_duckdb_opens_it(catalog: Path) -> None:
    header = catalog.read_bytes()[:20]
    assert header[8:12] == b"DUCK"
    assert int.from_bytes(header[12:20], "little") == 64  # of DuckDB 1.0; what 1.2 and later store by default is more


def test_no_setting_lets_the_connection_that_builds_it_reach_a_file(tmp_path: Path) -> None:
    with duckdb.connect(tmp_path / "new.duckdb", config=catalog_module.BUILDING) as con:
        for sql in (
            "from read_csv('/etc/passwd')",
            "copy (select 1) to 'out.csv'",
            "attach 'other.db'",
            "from tmp_path",
        ):
            with pytest.raises(duckdb.Error):
                con.execute(sql)
