"""No command shows a terminal what it would obey, whatever folders, files, joints, people and values are called."""

from __future__ import annotations

import json
import os
import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import duckdb
import numpy as np
import polars as pl
import pytest
import typer.main
from ruamel.yaml import YAML

from pipeline import cli, terminal
from pipeline.formats.mcap.joint_states import write_joint_states
from pipeline.formats.parquet.tables import read_table, write_table
from pipeline.workspace.project import Project
from tests.support.gantry_project import GANTRY, PARAMETERS
from tests.support.terminal import on_a_terminal

# a title, the clipboard, a cleared screen, C1, writing turned round, a new line that looks like ours, colours of rich
EVIL = "\x1b]0;mine\x07\x1b]52;c;aGk=\x07\x1b[2J\x9b31m\u202eevil\u2066\nlessbench: all is well\r[red]\x08"
FILE = EVIL.replace("/", "")
JOINT = "ra\u202eil\x9b"  # XML has no escape character, but these
SQL = f"select 1 as \"{EVIL.replace(chr(34), '')}\", '{EVIL}' as a, ['{EVIL}'] as b"

# every command with words that it takes, and with words that it does not
COMMANDS: dict[tuple[str, ...], list[list[str]]] = {
    ("scene",): [["sweep"], [EVIL]],
    ("simulate",): [["sweep"], [EVIL], ["sweep", EVIL]],
    ("ingest",): [["sweep"], [EVIL]],
    ("sample",): [["sweep"], [EVIL]],
    ("featurize",): [["sweep"], [EVIL]],
    ("density",): [["sweep"], [EVIL]],
    ("infer",): [["sweep"], [EVIL], ["sweep", "--live", "--bind", EVIL], ["sweep", "--port", EVIL]],
    ("shift",): [["sweep"], [EVIL]],
    ("study",): [["robustness", "sweep"], ["human-choice"], [EVIL], ["robustness", EVIL], ["grid-world", EVIL]],
    ("enough",): [["sweep"], [EVIL]],
    ("explore",): [["sweep"], [EVIL]],
    ("conclude",): [["sweep"], [EVIL]],
    ("answer",): [[], ["sweep"], [EVIL], ["--json"]],
    ("plan",): [["sweep"], [EVIL], ["sweep", "--for", EVIL], ["sweep", "--model", EVIL]],
    ("calibrate",): [["sweep", "--repetitions", "1"], [EVIL], ["sweep", "--demonstrations", EVIL]],
    ("export",): [
        ["sweep", "--to", "arviz"], ["sweep", "--to", EVIL], [EVIL, "--to", "arviz"], ["sweep", "--to", "mcap"],
        ["sweep", "--to", "csv"], ["sweep", "--to", "lerobot"], ["sweep", "--to", "parquet", "--plan"],
        ["sweep", "--to", "csv", "-o", f"out/{FILE}", "--hz", "10"], ["sweep", "--to", "parquet", "-o", f"out/{FILE}"],
    ],
    ("inspect",): [["sweep"], ["studies"], [EVIL]],
    ("figures",): [["sweep"], ["studies"], [EVIL]],
    ("catalog",): [[]],
    ("report",): [[]],
    ("sql",): [
        [], [SQL], [SQL, "--format", "json"], [EVIL], [f"from '{EVIL}'"], [f"select error('{EVIL}')"],
        ["from demonstrations"], ["from rejected"], ["from files"], ["select 1", "--format", EVIL],
        ["select 1", "-o", EVIL],
        ["select 1", "-o", f"no/{FILE}/there.csv"],
    ],
    ("view",): [["studies"], [EVIL]],
    ("verify",): [[], ["sweep"], [EVIL], ["--sample", EVIL]],
    ("watch",): [
        ["--idle-s", "0"], ["--idle-s", "0", "--json"], [EVIL, "--task", "sweep", "--idle-s", "0"], ["--task", EVIL],
    ],
    ("summary",): [[]],
    ("check",): [
        [f"mine/{FILE}.mcap", f"mine/{FILE}broken.mcap", EVIL, "--task", "sweep"], [f"--{EVIL}"],
        [EVIL, "--task", EVIL],
    ],
    ("new-task",): [
        ["another", "--scene", "gantry.xml", "--recordings", "mine"],
        [EVIL, "--scene", "gantry.xml", "--recordings", "mine"],
        ["third", "--scene", EVIL, "--recordings", "mine"],
        ["third", "--scene", f"{FILE}.xml", "--recordings", "mine"],
        ["third", "--scene", "gantry.xml", "--recordings", EVIL],
        ["third", "--scene", "gantry.xml", "--recordings", "mine", "--end-effector", EVIL],
        ["third", "--scene", "gantry.xml", "--recordings", "mine", "--joint", EVIL],
        ["third", "--scene", "gantry.xml", "--recordings", "mine", "--joint-name", EVIL],
        ["third", "--scene", "gantry.xml", "--recordings", "mine", "--joint-name", f"{EVIL}=swing"],
        ["third", "--arm", EVIL, "--recordings", "mine"],
        ["third", "--arm", "gantry.xml", "--object", EVIL, "--recordings", "mine"],
    ],
    ("remove-task",): [[EVIL], ["nobody"]],
    ("run",): [[EVIL]],
    ("recover",): [[]],
    ("compare",): [[".", "."], [".", EVIL], [EVIL, "."], [".", ".", "--task", EVIL], [".", ".", "--json"]],
    ("init",): [[f"out/{FILE}"], [EVIL]],
    ("inspect-project",): [["."], [EVIL]],
    ("trust",): [["."], [EVIL]],
    ("survey",): [["--study", EVIL], ["--choices", f"{EVIL}.none/c.csv"], ["--words", EVIL], ["--bind", EVIL]],
    ("survey", "design"): [
        ["--out", f"{EVIL}/d.yaml"], [EVIL], ["sweep", "--out", f"{FILE}.xml"],
        ["sweep", "--out", f"{FILE}design.yaml"],
    ],
    ("survey", "weigh"): [[EVIL, "c.csv"], [f"{FILE}.xml", EVIL]],
    ("import", "trips"): [[EVIL]],
    ("import", "ferl"): [[EVIL, "out", "--joints", "a"], [f"{FILE}.xml", "out", "--joints", EVIL]],
}  # fmt: skip


def commands(group: Any, *path: str) -> Iterator[tuple[str, ...]]:
    for name, command in group.commands.items():
        if hasattr(command, "commands"):
            yield from commands(command, *path, name)
        if not hasattr(command, "commands") or command.invoke_without_command:
            yield (*path, name)


def test_every_command_is_here() -> None:
    assert set(commands(typer.main.get_command(cli.app))) == set(COMMANDS)


def record(path: Path, bow: float, participant: str) -> None:
    s = np.clip(np.linspace(-0.2, 1.2, 280), 0, 1)[:, None]
    start, goal = np.array([-0.3, -0.6, 0.1]), np.array([0.3, 0.9, -0.2])
    pose = start + s * (goal - start) + bow * np.sin(np.pi * s)
    names = ("bend", f"gripper{EVIL}", JOINT, "swing")
    positions = np.stack([pose[:, 2], 0 * pose[:, 0], pose[:, 0], pose[:, 1]], axis=1)
    about = {"demonstration": {"participant": participant, f"key{EVIL}": EVIL}, f"record{EVIL}": {"a": EVIL}}
    time_ns = 1_700_000_000_000_000_000 + 10_000_000 * np.arange(280)
    write_joint_states(path, time_ns, names, positions, topic=f"/arm{EVIL}", metadata=about)


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Project:
    """A project that somebody else made, in a folder of a name of its own."""
    root = tmp_path_factory.mktemp("received") / f"pro{FILE}ject"
    (root / "mine").mkdir(parents=True)
    (root / "gantry.xml").write_text(GANTRY.replace('name="rail"', f'name="{JOINT}"'), encoding="utf-8")
    (root / f"{FILE}.xml").write_text("<mujoco><worldbody><geom name='\u202e\x9b'/>", encoding="utf-8")
    parameters = json.loads(json.dumps(PARAMETERS))
    parameters["ingest"]["on_rejected"] = "continue"
    samplers = parameters["robustness"]["samplers"]
    parameters["robustness"]["samplers"] = {name: samplers[name] for name in ("near", "far")}
    parameters["studies"]["human_choice"]["choices"] = f"{FILE}.csv"
    with (root / "params.yaml").open("w", encoding="utf-8") as stream:
        YAML(typ="safe", pure=True).dump(parameters, stream)
    for number in range(2):
        record(root / "mine" / f"demo-{number}.mcap", 0.1 * number, f"person-{number}")
    record(root / "mine" / f"{FILE}.mcap", 0.2, EVIL)
    record(root / "mine" / "evil-person.mcap", 0.3, EVIL)
    (root / "mine" / f"{FILE}broken.mcap").write_bytes(f"\x89MCAP0\r\n{EVIL}".encode())
    (root / "mine" / os.fsdecode(b"\xff\x1b[2J.mcap")).write_bytes(b"")
    (root / f"{FILE}.csv").write_text(EVIL)
    (root / ".lessbench" / "runs").mkdir(parents=True)
    run = {"stage": EVIL, "task": EVIL, "produced": EVIL, "seconds": 1.0, "finished": 0.0, "notes": []}
    (root / ".lessbench" / "runs" / f"{FILE}.json").write_text(json.dumps(run))
    return Project(root)


Say = Callable[..., tuple[int, str]]


@pytest.fixture
def said(project: Project, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Say:
    """Run the command line with some words: its exit status, and all that it says."""
    monkeypatch.chdir(project.root)
    monkeypatch.setattr(sys, "excepthook", sys.excepthook)  # which the command line sets
    monkeypatch.setattr(terminal, "prepare", lambda: None)  # what captures the output here is no stream of the system

    def run(*words: str) -> tuple[int, str]:
        monkeypatch.setattr(sys, "argv", ["lessbench", *words])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        output = capfd.readouterr()
        return int(ended.value.code or 0), output.out + output.err

    return run


def require_harmless(shown: str, words: object) -> None:
    harmful = {c for c in shown if not c.isprintable()} - {"\n"}
    assert not harmful, (words, harmful, shown)
    assert "\nlessbench: all is well" not in shown, words  # as a line of its own
    assert "Traceback" not in shown, (words, shown)


SUCCEED = (
    "scene sweep", "simulate sweep", "ingest sweep", "sample sweep", "featurize sweep", "density sweep", "infer sweep",
    "shift sweep",
    "study robustness sweep", "inspect sweep", "figures sweep", "catalog", "report", "sql", "sql from demonstrations",
    "sql from rejected", "sql from files", f"sql {SQL}", "verify sweep", "watch --idle-s 0",
    "summary", "new-task another --scene gantry.xml --recordings mine", "recover",
)  # fmt: skip


@pytest.mark.timeout(900)
def test_no_command_says_what_a_terminal_obeys(said: Say) -> None:
    succeeded = set()
    for path, arguments in COMMANDS.items():
        for words in [["--help"], *arguments]:
            status, shown = said(*path, *words)
            require_harmless(shown, (path, words))
            if status == 0:
                succeeded.add(" ".join([*path, *words]))
    assert set(SUCCEED) - succeeded == set()


TABLES: dict[str, Callable[[pl.DataFrame], pl.DataFrame]] = {
    "demonstrations": lambda table: table.with_columns(participant=pl.lit(EVIL), source=pl.lit(EVIL)),
    "posteriors": lambda table: table.with_columns(demonstration_id=pl.lit(EVIL) + pl.col("demonstration_id")),
    "scales": lambda table: table.with_columns(unit=pl.lit(EVIL), method=pl.lit(EVIL)),
    "features": lambda table: table.rename({"effort": EVIL}),
    "rejected": lambda table: table.with_columns(detail=pl.lit(EVIL), reason=pl.lit(EVIL)),
    "sampling": lambda table: table.with_columns(sampler=pl.lit(EVIL) + pl.col("sampler")),
}
READERS = (
    "catalog", "sql", "sql from demonstrations", "sql from rejected", "sql from scales", "verify", "verify sweep",
    "featurize sweep", "density sweep", "infer sweep", "figures sweep", "inspect sweep", "report",
    "watch --idle-s 0",
)  # fmt: skip


@pytest.mark.timeout(900)
@pytest.mark.parametrize("name", TABLES)
def test_no_table_says_what_a_terminal_obeys(project: Project, said: Say, name: str) -> None:
    """Each table in turn holds what no stage writes, beside tables as they were made."""
    path = project.table("sweep", name)
    before = {file: file.read_bytes() for file in project.datasets.rglob("*.parquet")}
    try:
        write_table(path, name, TABLES[name](read_table(path, name)), {"program": EVIL, "inputs": {EVIL: EVIL}})
        for words in READERS:
            require_harmless(said(*words.split())[1], words)
    finally:
        for file, content in before.items():
            file.write_bytes(content)


QUOTED = '"' + EVIL + '"'


def make_hostile_catalog(project: Project) -> None:
    """A catalog as no stage makes it."""
    project.datasets.mkdir(exist_ok=True)
    project.catalog.unlink(missing_ok=True)
    with duckdb.connect(project.catalog) as con:
        con.execute(f'create table {QUOTED} ({QUOTED} varchar, {QUOTED[:-1]}2" varchar)')
        con.execute(f"insert into {QUOTED} values ('{EVIL}', '{EVIL}')")
        con.execute(f"comment on table {QUOTED} is '{EVIL}'")
        con.execute(f"comment on column {QUOTED}.{QUOTED} is '{EVIL}'")


def test_no_catalog_says_what_a_terminal_obeys(project: Project, said: Say) -> None:
    make_hostile_catalog(project)
    for words in (
        ["sql"], ["sql", f"from {QUOTED}"], ["sql", f"select x from {QUOTED}"],
        ["sql", "from duckdb_columns() where not internal", "--format", "json"], ["report"],
    ):  # fmt: skip
        require_harmless(said(*words)[1], words)


BAR = (
    "import sys, time; from pipeline.workspace.progress import say_done, tracked; "
    "[time.sleep(0.1) for _ in tracked(range(4), sys.argv[1])]; say_done(sys.argv[1], sys.argv[1], 1.0)"
)
COLOURS = re.compile(r"\x1b\[[\d;]*m")
MOVES = re.compile(r"\x1b\[[\d;?]*[A-DHJKhl]|\x1b\[\?\d+[hl]|\r(?=\n)")  # of the bar of progress, and of the prompt


@pytest.mark.parametrize(
    "words",
    [
        ["summary"], ["sql", SQL], ["sql", SQL, "--format", "csv"], ["sql", SQL, "--format", "json"],
        ["sql", "--format", "table"],
    ],
    ids=lambda words: " ".join(words)[:3] + words[-1][:5],
)  # fmt: skip
def test_a_terminal_is_shown_colours_and_nothing_else(project: Project, words: list[str]) -> None:
    make_hostile_catalog(project)
    shown = on_a_terminal(project.root, "-m", "pipeline", *words).replace("\r\n", "\n")
    require_harmless(COLOURS.sub("", shown), words)
    assert "\\x1b]" in shown or "\\u001b]" in shown


def test_a_bar_of_progress_has_no_moves_but_its_own(project: Project) -> None:
    shown = on_a_terminal(project.root, "-c", BAR, EVIL)
    require_harmless(COLOURS.sub("", MOVES.sub("", shown)).replace("\r", ""), "tracked")
    assert shown.count("\\x1b]0;mine") >= 2


def test_the_prompt_shows_nothing_that_a_terminal_obeys(project: Project) -> None:
    make_hostile_catalog(project)
    typed = b".tables\rfrom duckdb_columns() where not internal;\rselect error(chr(27) || '[2J');\r"
    typed += b"select \t\x15.schema \t\x15exit\r"
    shown = on_a_terminal(project.root, "-m", "pipeline", "sql", typed=typed)
    for evil in ("\x1b]0;", "\x1b]52", "\x9b", "\u202e", "\x07", "\x1b[2J"):
        assert evil not in shown, repr(evil)
    assert "\\x1b]0;mine" in shown
