"""Watching a folder: recordings come while it runs, one of them half written at first, one bad, one never closed."""

from __future__ import annotations

import json
import shutil
import signal
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from polars import testing as pl_testing
from rerun.chunk import RrdReader

from pipeline.choice import LESS, Boltzmann
from pipeline.choice.weights import Choices, sample_weights, weighted_quantiles
from pipeline.commands.watch import belief, session
from pipeline.commands.watch.belief import Belief
from pipeline.commands.watch.session import Until, run, which_task
from pipeline.commands.watch.setting import read_setting
from pipeline.errors import StageError, TableError, WorkbenchError
from pipeline.formats.mcap.joint_states import write_joint_states
from pipeline.formats.parquet.tables import read_table
from pipeline.stages import answer, density, featurize, infer, ingest, inspect, sample
from pipeline.views.rerun.timelines import DEMONSTRATIONS
from pipeline.workspace.project import Project
from tests.support.live_viewer import entities, lessbench, listening, not_blank, pictures, received

Make = Callable[[dict[str, Any]], Project]
KEYS = ["model", "demonstration_id", "participant", "theta_id", "beta"]


@pytest.fixture(autouse=True)
def _often(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(session, "LOOK_S", 0.02)


@pytest.fixture
def project(make_project: Make, parameters: dict[str, Any]) -> Project:
    project = make_project(parameters)
    for stage in (ingest, sample, featurize, density, infer):
        stage.run(project, "sweep")
    return project


def working(path: Path) -> pl.DataFrame:
    return read_table(path, "posteriors").filter(set_id="working").sort(KEYS)


def bow(path: Path) -> None:
    """A recording that leaves the straight line further than those of the project."""
    s = np.linspace(0, 1, 200)[:, None]
    start, goal = np.array([-0.3, -0.6, 0.1]), np.array([0.3, 0.9, -0.2])
    pose = start + s * (goal - start) + 0.3 * np.sin(np.pi * s)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_joint_states(
        path, 10_000_000 * np.arange(1, 201), ["rail", "swing", "bend"], pose, topic="/arm/joints", metadata={}
    )


def when(there: Callable[[], bool]) -> None:
    """Wait for something, at most half a minute."""
    deadline = time.monotonic() + 30
    while not there() and time.monotonic() < deadline:
        time.sleep(0.02)


def test_recordings_come_while_it_runs(project: Project, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source, folder = project.root / "mine", tmp_path / "coming"
    before = {path: path.read_bytes() for path in (project.datasets / "sweep" / "tables").glob("*.parquet")}
    said: list[str] = []

    def heard(text: str) -> bool:
        said.append(capsys.readouterr().out)
        return text in "".join(said)

    def people() -> None:
        when(lambda: heard("(not there yet)"))
        folder.mkdir()
        half = (source / "demo-1.mcap").read_bytes()
        (folder / "demo-1.mcap").write_bytes(half[: len(half) // 2])
        (folder / "broken.mcap").write_text("no recording")
        shutil.copy(source / "demo-2.mcap", folder)
        when(lambda: heard("demo-1.mcap: waits"))
        (folder / "demo-1.mcap").write_bytes(half)
        when(lambda: heard("2 demo-1.mcap"))
        (folder / "late.mcap").write_bytes(half[:-3])
        shutil.copy(source / "demo-0.mcap", folder)

    feeder = threading.Thread(target=people)
    feeder.start()
    run(project, folder, None, Until(demonstrations=3, idle_s=60), None)
    feeder.join()
    said.append(capsys.readouterr().out)
    lines = "".join(said).splitlines()

    assert lines[0] == f"watching {folder} (not there yet) for sweep: 30 alternatives, 5 thetas x 3 betas; Ctrl-C ends"
    order = [line.split()[1] for line in lines if line.startswith("  ")]
    assert order == ["demo-2.mcap:", "demo-1.mcap:", "demo-0.mcap:"]
    assert sum("broken.mcap: not used (not-mcap)" in line for line in lines) == 1
    assert sum("demo-1.mcap: not read yet, as it is not closed" in line for line in lines) == 1
    assert "Boltzmann " in lines[-3]
    assert "; LESS " in lines[-3]
    assert lines[-2].startswith("3 demonstrations, 1 not used")
    assert lines[-2].endswith("kept in datasets/sweep/watch")
    assert lines[-1].startswith("these posteriors come without a verdict; `lessbench answer sweep`")

    kept = project.datasets / "sweep" / "watch"
    assert sorted(path.name for path in kept.iterdir()) == [
        "demonstrations.parquet", "inspect.rrd", "posteriors.parquet", "rejected.parquet",
    ]  # fmt: skip
    mine, theirs = working(kept / "posteriors.parquet"), working(project.table("sweep", "posteriors"))
    assert mine.select(KEYS).equals(theirs.select(KEYS))
    np.testing.assert_allclose(mine["log_posterior"], theirs["log_posterior"], rtol=0, atol=1e-12)
    again = read_table(kept / "demonstrations.parquet", "demonstrations")
    assert again.equals(read_table(project.table("sweep", "demonstrations"), "demonstrations"))
    assert read_table(kept / "rejected.parquet", "rejected")["source"].to_list() == ["broken.mcap"]
    assert {"/posterior/less/bars", "/scene/playing", "/summary", "/map/demonstrations"} <= entities(
        kept / "inspect.rrd"
    )
    # whatever DVC keeps is as it was
    assert {path: path.read_bytes() for path in before} == before


def test_what_changes_is_taken_anew_and_what_goes_is_forgotten(
    project: Project, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "coming"
    shutil.copytree(project.root / "mine", folder)
    said: list[str] = []

    def heard(text: str) -> bool:
        said.append(capsys.readouterr().out)
        return text in "".join(said)

    def people() -> None:
        when(lambda: heard("3 demo-2.mcap"))
        bow(folder / "demo-1.mcap")
        when(lambda: heard("demo-1.mcap again"))
        (folder / "demo-2.mcap").write_text("damaged")
        when(lambda: heard("demo-2.mcap: not used"))
        (folder / "demo-0.mcap").unlink()
        when(lambda: heard("demo-0.mcap is gone"))

    feeder = threading.Thread(target=people)
    feeder.start()
    run(project, folder, None, Until(idle_s=3.0), None)
    feeder.join()
    assert heard("1 demonstration, 1 not used; kept in datasets/sweep/watch")

    shutil.rmtree(project.root / "mine")
    bow(project.root / "mine" / "demo-1.mcap")
    for stage in (ingest, featurize, infer):
        stage.run(project, "sweep")
    kept = project.datasets / "sweep" / "watch" / "posteriors.parquet"
    mine, theirs = working(kept), working(project.table("sweep", "posteriors"))
    np.testing.assert_allclose(mine["log_posterior"], theirs["log_posterior"], rtol=0, atol=1e-12)


def test_a_copy_counts_once(project: Project, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "coming"
    for name in ("first.mcap", "second.mcap"):
        bow(folder / name)
    run(project, folder, None, Until(idle_s=0.5), None)
    said = capsys.readouterr().out
    assert "second.mcap: not used (copy): It holds the same recording as first.mcap, which is used" in said
    assert "1 demonstration, 1 not used; kept in datasets/sweep/watch" in said


def test_what_happens_as_json(project: Project, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "coming"
    for name in ("first.mcap", "second.mcap"):
        bow(folder / name)
    run(project, folder, None, Until(idle_s=0.5), None, as_json=True)
    events = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [event["event"] for event in events] == ["watching", "taken", "rejected", "end", "note"]
    _, taken, rejected, end, _ = events
    assert (taken["file"], taken["demonstrations"], rejected["reason"]) == ("first.mcap", 1, "copy")
    assert set(taken["models"]) == set(project.params.infer.models)
    for found in taken["models"].values():
        assert set(found["theta"]) == set(project.params.task("sweep").features)
        assert 0 < found["probability"] <= 1 <= found["plausible"]
    assert end["kept"] == "datasets/sweep/watch"


def test_it_serves_while_it_watches_and_keeps_what_it_has_when_told_to_end(project: Project, tmp_path: Path) -> None:
    words = ("watch", "mine", "--live", "--port", "0")
    with lessbench(project, *words) as process:
        assert process.stdout is not None
        uri = process.stdout.readline().split(" at ")[1].strip()
        port = int(uri.split(":")[-1].removesuffix("/proxy"))
        assert listening(port) == {"0100007F"}
        for line in process.stdout:
            if line.startswith("  3 "):
                break
        assert "/scene/demonstrations/demo-2" in received(
            uri, tmp_path / "received.rrd", "/scene/demonstrations/demo-2"
        )
        process.send_signal(signal.SIGINT)
        rest, complained = process.communicate(timeout=60)
    assert process.returncode == 0, complained
    assert rest.splitlines()[-2] == "3 demonstrations; kept in datasets/sweep/watch"
    assert "/summary" in entities(project.datasets / "sweep" / "watch" / "inspect.rrd")


def test_the_real_viewer_shows_what_was_watched(project: Project, tmp_path: Path) -> None:
    drawn = pictures()
    run(project, None, None, Until(demonstrations=3), None)
    with drawn.headless_viewer(project.datasets / "sweep" / "watch" / "inspect.rrd") as viewer:
        time.sleep(1.0)
        state = viewer.get_state()
        assert len(state.views) == 12
        assert [view.reports for view in state.views if view.reports] == []
        viewer.save_screenshot(str(tmp_path / "watched.png"))
    not_blank(tmp_path / "watched.png")


def test_the_recording_ends_with_the_rows_names_and_axes_of_inspect(project: Project) -> None:
    run(project, None, None, Until(demonstrations=3), None)
    answer.run(project, "sweep")
    inspect.run(project, "sweep")
    folder = project.datasets / "sweep"
    watched, inspected = (logged(path / "inspect.rrd") for path in (folder / "watch", folder))
    entities = ("/posterior/names", "/map/axis_names", "/series/joints/rail", "/weights/names")
    for entity in entities:
        (last,) = watched[entity][-1:]
        assert last == inspected[entity][-1], entity
    series = {entity for entity in inspected if entity.startswith("/series/features")}
    assert series
    assert series <= set(watched)
    # each recording is a step of the timeline of demonstrations, and the plots are against them
    steps = [
        step
        for chunk in RrdReader(folder / "watch" / "inspect.rrd").stream()
        if chunk.entity_path == "/series/belief/plausible/less" and not chunk.is_static
        for step in chunk.to_record_batch().column(DEMONSTRATIONS).to_pylist()
    ]
    assert steps == [1, 2, 3]


def test_weights_of_all_so_far_whatever_the_order(project: Project) -> None:
    setting = read_setting(project, "sweep")
    rows = read_table(project.table("sweep", "demonstrations"), "demonstrations").to_dicts()
    for row in rows:
        row["waypoints"] = np.array(row["waypoints"], dtype=np.float64)
    one, other = (Belief(setting, ("less", "boltzmann")) for _ in range(2))
    assert one.weights() is None
    for row, last in zip(rows, reversed(rows), strict=True):
        one.take(row)
        other.take(last)
    found, again = one.weights(), other.weights()
    assert found is not None
    assert again is not None
    pl_testing.assert_frame_equal(found.summary, again.summary)
    phi, alternatives = one.phi, setting.raw / setting.scale
    for label, model in (("less", LESS(setting.bandwidth)), ("boltzmann", Boltzmann())):
        choices = Choices.outside(model, phi, alternatives)
        draws = sample_weights(np.random.default_rng(5), choices, count=8192)
        mine = found.summary.filter(model=label)
        assert mine["feature"].to_list() == list(setting.features)
        for column, level in (("low", 0.05), ("median", 0.5), ("high", 0.95)):
            expected = weighted_quantiles(draws.directions, draws.weight, [level])[0]
            # both by chance, from 1,024 and 8,192 draws
            np.testing.assert_allclose(mine[column].to_numpy(), expected, atol=0.12)
    for row in rows:
        one.drop(row["demonstration_id"])
    assert one.weights() is None


def test_weights_that_cannot_be_inferred_are_left_out(project: Project, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: Any, **__: Any) -> None:
        raise WorkbenchError("no mode was found")

    monkeypatch.setattr(belief, "sample_weights", fails)
    run(project, None, None, Until(demonstrations=2), None)
    shown = logged(project.datasets / "sweep" / "watch" / "inspect.rrd")
    assert "/weights/names" not in shown
    assert shown["/posterior/names"]


def logged(path: Path) -> dict[str, list[Any]]:
    """By entity, the names and labels that were logged, in their order."""
    found: dict[str, list[Any]] = {}
    for chunk in RrdReader(path).stream():
        batch = chunk.to_record_batch()
        names = [name for name in batch.schema.names if name.rpartition(":")[2] in ("labels", "names")]
        rows = found.setdefault(chunk.entity_path, [])
        rows += [row for name in names for row in batch.column(name).to_pylist() if row is not None]
    return found


def test_nothing_came_and_nothing_is_lost(project: Project, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    kept = project.datasets / "sweep" / "watch"
    kept.mkdir()
    (kept / "posteriors.parquet").write_text("of an earlier day")
    run(project, tmp_path / "nowhere", None, Until(idle_s=0.0), None)
    assert capsys.readouterr().out.splitlines()[-1] == "no demonstration came, so nothing was kept"
    assert (kept / "posteriors.parquet").read_text() == "of an earlier day"


def test_task_and_folder_say_each_other(make_project: Make, parameters: dict[str, Any], tmp_path: Path) -> None:
    project = make_project(parameters)
    mine = project.root / "mine"
    assert which_task(project, None, None) == ("sweep", mine)
    assert which_task(project, tmp_path, None) == ("sweep", tmp_path)
    parameters["tasks"]["other"] = parameters["tasks"]["sweep"] | {"recordings": "theirs"}
    project = make_project(parameters)
    assert which_task(project, mine, None) == ("sweep", mine)
    assert which_task(project, None, "other") == ("other", project.root / "theirs")
    with pytest.raises(
        StageError, match=r"is not the folder of recordings of exactly one task; .* --task: other, sweep"
    ):
        which_task(project, tmp_path, None)
    with pytest.raises(StageError, match=r"no folder was given; .* --task: other, sweep"):
        which_task(project, None, None)


def test_tables_that_cannot_serve_are_refused(make_project: Make, parameters: dict[str, Any]) -> None:
    project = make_project(parameters)
    with pytest.raises(TableError, match="dvc repro"):
        run(project, None, None, Until(idle_s=0), None)
    parameters["tasks"]["sweep"]["anchor"] = "demonstration"
    with pytest.raises(StageError, match="each demonstration needs alternatives of its own"):
        run(make_project(parameters), None, None, Until(idle_s=0), None)
