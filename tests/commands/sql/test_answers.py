"""`lessbench sql "..."`: a bounded table for people, everything for other programs, and nothing cut off."""

from __future__ import annotations

import io
import itertools
import json
import os
import re
import resource
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from pipeline.commands.sql import answers
from pipeline.commands.sql.answers import Format, Wanted, answer_once
from pipeline.errors import QueryError, StageError
from pipeline.formats.duckdb.catalog import SourceFile, build_catalog
from pipeline.formats.parquet.checked.open_table import OpenTable
from pipeline.formats.parquet.tables import write_table
from tests.support.terminal import on_a_terminal

ANEW = "`lessbench catalog` makes it anew"

ROOT = Path(__file__).resolve().parents[3]
TABLE, CSV, JSON, PARQUET = (Wanted(form) for form in Format)


@pytest.fixture(scope="module")
def catalog(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("catalog")
    table = pl.DataFrame(
        {
            "task": "a", "demonstration_id": "d", "participant": "[red]p[/]", "model": "less", "set_size": 10,
            "set_id": "00",
            "theta_id": [0, 1], "theta": pl.Series(np.eye(2)), "beta": 1.0, "log_posterior": np.log([0.25, 0.75]),
            "posterior": [0.25, 0.75],
        }
    )  # fmt: skip
    write_table(folder / "posteriors.parquet", "posteriors", table, {})
    with OpenTable(folder / "posteriors.parquet", "posteriors") as posteriors:
        source = SourceFile("a/posteriors.parquet", "posteriors", "a", "00", {})
        build_catalog(folder / "catalog.duckdb", {"posteriors": [("a", posteriors)]}, [source])
    (folder / "params.yaml").write_text("{}")
    (folder / "datasets").mkdir()
    (folder / "datasets" / "catalog.duckdb").symlink_to(folder / "catalog.duckdb")
    return folder / "catalog.duckdb"


QUESTION = "select participant, theta, posterior from posteriors order by posterior"


def test_an_answer_in_every_form(catalog: Path, capsys: pytest.CaptureFixture[str]) -> None:
    answer_once(catalog, QUESTION, TABLE)
    shown = capsys.readouterr().out
    assert "[red]p[/]" in shown
    assert "[0, 1]" in shown
    assert shown.endswith("2 rows\n")
    answer_once(catalog, QUESTION, JSON)
    assert json.loads(capsys.readouterr().out)[1] == {
        "participant": "[red]p[/]",
        "theta": [0.0, 1.0],
        "posterior": 0.75,
    }
    answer_once(catalog, QUESTION, CSV)
    table = pl.read_csv(io.StringIO(capsys.readouterr().out))
    assert table.row(0) == ("[red]p[/]", "[1.0, 0.0]", 0.25)


def test_an_answer_as_parquet(catalog: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    with (tmp_path / "answer.parquet").open("w") as stream:
        monkeypatch.setattr(sys, "stdout", stream)
        answer_once(catalog, QUESTION, PARQUET)
    assert pl.read_parquet(tmp_path / "answer.parquet")["theta"].to_list() == [[1.0, 0.0], [0.0, 1.0]]


def test_parquet_is_not_thrown_on_a_terminal(catalog: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    with pytest.raises(QueryError, match=r"--output answer\.parquet"):
        answer_once(catalog, QUESTION, PARQUET)


def test_without_a_question_it_says_what_there_is(catalog: Path, capsys: pytest.CaptureFixture[str]) -> None:
    answer_once(catalog, None, TABLE)
    shown = capsys.readouterr().out
    assert "best_hypothesis" in shown
    assert "Whose demonstration says something else?\n    from people_against_group" in shown


@pytest.mark.parametrize("ending", ["csv", "json", "parquet", "CSV"])
def test_a_file_says_by_its_ending_what_it_holds(catalog: Path, tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"answer.{ending}"
    answer_once(catalog, QUESTION, Wanted(output=path))
    read = {"csv": pl.read_csv, "json": pl.read_json, "parquet": pl.read_parquet}[ending.lower()]
    assert read(path)["posterior"].to_list() == [0.25, 0.75]
    assert list(tmp_path.iterdir()) == [path]


def test_other_endings_need_a_format(catalog: Path, tmp_path: Path) -> None:
    with pytest.raises(QueryError, match=r"\.csv, \.json or \.parquet"):
        answer_once(catalog, QUESTION, Wanted(output=tmp_path / "answer.xlsx"))
    answer_once(catalog, QUESTION, Wanted(Format.table, tmp_path / "answer.txt"))
    assert (tmp_path / "answer.txt").read_text().endswith("2 rows\n")


@pytest.mark.parametrize("form", [CSV, JSON, PARQUET, TABLE])
def test_a_file_whose_question_fails_on_the_way_is_not_there(catalog: Path, tmp_path: Path, form: Wanted) -> None:
    (tmp_path / "there.before").write_text("as it was")
    for name in ("answer", "there.before"):
        with pytest.raises(QueryError, match="midway"):
            answer_once(catalog, FAILING, Wanted(form.form, tmp_path / name))
    assert [path.name for path in tmp_path.iterdir()] == ["there.before"]
    assert (tmp_path / "there.before").read_text() == "as it was"


@pytest.mark.parametrize(
    ("question", "said"),
    [
        ("from posteriors where task = 'b'", f"the catalog has no task 'b'; it has a; {ANEW}\n"),
        (
            "from posteriors where TASK='\x1b[2J'",
            f"the catalog has no task '\\x1b[2J'; it has a; {ANEW}\n",
        ),
        ("from posteriors where task = 'a' and beta = 7", ""),
        ("from posteriors where beta = 7", ""),
        ("select count(*) from posteriors where task == 'b'", f"the catalog has no task 'b'; it has a; {ANEW}\n"),
        ("select count(*) from posteriors where task == 'a'", ""),
        (
            "from posteriors where task in ( 'b' , 'c')",
            f"the catalog has no task 'b'; it has a; {ANEW}\nthe catalog has no task 'c'; it has a; {ANEW}\n",
        ),
    ],
)
@pytest.mark.parametrize("form", [TABLE, CSV])
def test_a_task_that_is_not_there_is_named(
    catalog: Path, capsys: pytest.CaptureFixture[str], question: str, said: str, form: Wanted
) -> None:
    answer_once(catalog, question, form)
    assert capsys.readouterr().err == said


def test_no_formulas_is_for_csv(catalog: Path, capsys: pytest.CaptureFixture[str]) -> None:
    answer_once(catalog, "select '=1' as a", Wanted(Format.csv, formulas=False))
    assert capsys.readouterr().out == "a\n'=1\n"
    with pytest.raises(QueryError, match="--no-formulas is for CSV"):
        answer_once(catalog, "select 1", Wanted(Format.json, formulas=False))


FAILING = "select case when range = 150000 then error('midway') else range end as id from range(200000)"


@pytest.mark.parametrize(
    ("rows", "expected"),
    [
        (0, "0 rows"),
        (1, "1 row"),
        (1000, "1,000 rows"),
        (1001, "the first 1,000 of 1,001 rows; `--rows 10000` shows more, `--output answer.csv` writes all"),
        (680_238, "the first 1,000 of 680,238 rows; `--rows 10000` shows more, `--output answer.csv` writes all"),
    ],
)
def test_a_table_is_bounded_and_its_rows_are_counted(
    catalog: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, rows: int, expected: str
) -> None:
    monkeypatch.setattr(answers, "COUNTING_S", 60.0)
    answer_once(catalog, f"from range({rows})", Wanted())
    lines = capsys.readouterr().out.splitlines()
    assert lines[-1] == expected
    assert len(lines) <= 1000 + 5


def test_rows_without_end_are_counted_for_a_while(
    catalog: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(answers, "COUNTING_S", 0.0)
    answer_once(catalog, "from range(1000000000000)", Wanted(rows=3))
    assert (
        capsys.readouterr().out.splitlines()[-1].startswith("the first 3 of more than 20,000 rows; `--rows 30` shows")
    )


class Watched(io.StringIO):
    """A terminal that notes what it is shown, and when."""

    def __init__(self, frames: list[int]) -> None:
        super().__init__()
        self.buffer = self
        self.shown: list[tuple[int, str]] = []
        self._frames = frames

    @property
    def encoding(self) -> str:
        return "utf-8"

    def isatty(self) -> bool:
        return True

    def write(self, text: str | bytes) -> int:
        if text:
            self.shown.append((self._frames[0], text if isinstance(text, str) else text.decode()))
        return len(text)


def test_a_terminal_is_shown_the_first_rows_before_others_are_counted(
    catalog: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    taken = [0]

    def counted(answer: answers.Answer) -> Iterator[pl.DataFrame]:
        for taken[0] in itertools.count():
            yield pl.DataFrame(
                {"id": range(10 * taken[0], 10 * taken[0] + 10 * (taken[0] > 0))}, schema={"id": pl.Int64}
            )
            if taken[0] == 50:
                return

    from pipeline.formats.duckdb import questions

    monkeypatch.setattr(questions.Answer, "frames", counted)
    monkeypatch.setenv("TERM", "dumb")
    screen = Watched(taken)
    monkeypatch.setattr(sys, "stdout", screen)
    answer_once(catalog, "from range(500)", Wanted())
    first, last = screen.shown[0], screen.shown[-1]
    assert first[0] == 5, "more rows were taken than are shown"
    assert "39" in first[1]
    assert last == (50, "the first 40 of 500 rows; `--rows 400` shows more, `--output answer.csv` writes all\n")


@pytest.mark.parametrize(
    ("rows", "pager", "shown"),
    [
        (40, "sed s/^/paged/", ["paged│ 39", "paged40 rows"]),
        (10, "sed s/^/paged/", ["│ 9", "10 rows"]),  # fits on the screen
        (680_238, "sed s/^/paged/", ["paged│ 39", "pagedthe first 40 of 680,238 rows"]),
        (40, "head -n 1", ["┏━"]),  # whoever leaves the pager has seen enough
        (40, "no-such-pager", ["│ 39", "40 rows"]),
    ],
)
def test_what_is_higher_than_the_terminal_goes_through_a_pager(
    catalog: Path, rows: int, pager: str, shown: list[str]
) -> None:
    out = on_a_terminal(catalog.parent, "-m", "pipeline", "sql", f"from range({rows})", env={"PAGER": pager})
    lines = out.splitlines()
    for beginning in shown:
        assert any(re.sub(r"\x1b\[[0-9;]*m", "", line).startswith(beginning) for line in lines), out


def run(catalog: Path, *words: str, stdout: object, **options: object) -> subprocess.CompletedProcess[bytes]:
    return subprocess.run(
        [sys.executable, "-m", "pipeline", "sql", *words], cwd=catalog.parent, stdout=stdout, stderr=subprocess.PIPE,
        timeout=120, **options,
    )  # type: ignore[call-overload,no-any-return]  # fmt: skip


MANY = "select range as id, repeat('x', 50) as word from range(100000)"


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="/dev/full is a device of Linux")
@pytest.mark.parametrize("form", list(Format))
@pytest.mark.parametrize("unbuffered", ["", "1"])
def test_a_full_disk_is_an_error(catalog: Path, form: Format, unbuffered: str) -> None:
    with Path("/dev/full").open("wb") as full:
        done = run(catalog, MANY, "--format", form, stdout=full, env=os.environ | {"PYTHONUNBUFFERED": unbuffered})
    assert done.returncode == 1
    assert done.stderr.startswith(b"lessbench: standard output cannot be written (no space left on device)")
    assert done.stderr.count(b"\n") == 1


@pytest.mark.parametrize("form", list(Format))
@pytest.mark.parametrize("unbuffered", ["", "1"])
@pytest.mark.parametrize("mode", ["wb", "ab"])
def test_a_file_that_cannot_take_all_is_left_as_it_was(
    catalog: Path, tmp_path: Path, form: Format, unbuffered: str, mode: str
) -> None:
    path = tmp_path / "answer"
    path.write_bytes(b"before\n")
    with path.open(mode) as stream:
        done = run(
            catalog, MANY, "--format", form, stdout=stream, env=os.environ | {"PYTHONUNBUFFERED": unbuffered},
            preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (40_000, 40_000)),
        )  # fmt: skip
    assert done.returncode == 1
    assert b"standard output cannot be written (file too large)" in done.stderr
    assert path.read_bytes() == (b"before\n" if mode == "ab" else b"")


@pytest.mark.parametrize("form", [Format.csv, Format.json])
def test_a_question_that_fails_on_the_way_leaves_nothing_in_a_redirected_file(
    catalog: Path, tmp_path: Path, form: Format
) -> None:
    with (tmp_path / "answer").open("wb") as stream:
        done = run(catalog, FAILING, "--format", form, stdout=stream)
    assert done.returncode == 1
    assert b"midway" in done.stderr
    assert (tmp_path / "answer").read_bytes() == b""


@pytest.mark.parametrize("unbuffered", ["", "1"])
def test_whoever_reads_may_stop_reading(catalog: Path, unbuffered: str) -> None:
    command = f'{sys.executable} -m pipeline sql "{MANY}" --format csv | head -n 1; exit ${{PIPESTATUS[0]}}'
    done = subprocess.run(
        ["bash", "-c", command], cwd=catalog.parent, capture_output=True, timeout=120,
        env=os.environ | {"PYTHONUNBUFFERED": unbuffered},
    )  # fmt: skip
    assert (done.returncode, done.stdout, done.stderr) == (1, b"id,word\n", b"")


def test_a_file_of_our_own_is_whole_or_not_there(catalog: Path, tmp_path: Path) -> None:
    path = tmp_path / "answer.csv"
    done = run(
        catalog, MANY, "--output", str(path), stdout=subprocess.PIPE,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (40_000, 40_000)),
    )  # fmt: skip
    assert (done.returncode, done.stdout) == (1, b"")
    assert b"answer.csv: cannot be written (file too large)" in done.stderr
    assert not list(tmp_path.iterdir())
    with pytest.raises(StageError, match="cannot be written"):
        answer_once(catalog, "select 1", Wanted(Format.csv, tmp_path))
