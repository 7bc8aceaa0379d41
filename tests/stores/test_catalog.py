"""The catalog: all tasks in one file, opened from anywhere, and questions that cannot do harm."""

from pathlib import Path

import duckdb
import numpy as np
import polars as pl
import pytest

from pipeline.errors import QueryError
from pipeline.stores.catalog import CONTENTS, EXAMPLES, ask, build_catalog
from pipeline.stores.tables import write_table


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
        files.append((task, tmp_path / f"{task}.parquet"))
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


def test_the_contents_and_the_examples_can_be_asked(catalog: Path) -> None:
    contents = ask(catalog, CONTENTS)
    assert set(contents["name"]) == {"posteriors", "best_hypothesis", "theta_marginals"}
    assert contents["what it holds"].null_count() == 0
    assert ask(catalog, EXAMPLES[0]).is_empty()
    assert ask(catalog, EXAMPLES[2])["column_name"].to_list()[0] == "task"
