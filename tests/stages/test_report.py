"""The report of a small project, also as a browser shows it: whole, readable, and alone."""

from __future__ import annotations

import re
import socket
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from pipeline.errors import WorkbenchError
from pipeline.stages import answer, catalog, density, featurize, figures, infer, ingest, report, sample
from pipeline.workspace.project import Project, recorded_runs
from tests.support.browser import PROGRAM, chromium_page
from tests.support.gantry_project import record

Make = Callable[[dict[str, Any]], Project]


@pytest.fixture
def reported(make_project: Make, parameters: dict[str, Any]) -> Project:
    """One task with three good recordings, a remark on one of them, and one that is cut off; and its report."""
    parameters["sample"] |= {"sampler": "deformation", "sizes": [5]}
    parameters["ingest"]["on_rejected"] = "continue"
    project = make_project(parameters)
    record(project.root / "mine" / "demo-1.mcap", bow=0.1, start=(-0.3, -0.4, 0.1))
    (project.root / "mine" / "notes.txt").write_text("Person 2 was tired.")
    whole = (project.root / "mine" / "demo-0.mcap").read_bytes()
    (project.root / "mine" / "cut & <b>off.mcap").write_bytes(whole[: len(whole) // 2])
    for stage in (ingest, sample, featurize, density, infer, answer, figures):
        stage.run(project, "sweep")
    catalog.run(project)
    report.run(project)
    return project


def test_the_report_tells_what_was_run_and_what_came_out(reported: Project) -> None:
    path = reported.datasets / "report.html"
    page = path.read_text()
    assert re.findall("<h2>(.+)</h2>", page) == [
        "Answers", "In short", "Task: sweep", "What to be careful about", "Words", "Made with", "Parameters",
    ]  # fmt: skip
    assert page.count("<figure") == len(list(reported.figures("sweep").glob("*.svg"))) == 6
    shown = re.sub("<details>.*?</details>", "", page, flags=re.DOTALL)  # what is printed, and seen without a click
    assert 1 <= shown.count("<figure") <= 4
    assert "Task sweep: 1 of 4 recordings were rejected" in page
    assert "cut &amp; &lt;b&gt;off.mcap" in page
    assert (
        "Task sweep: 1 of the files beside its recordings were set aside, such as notes.txt (not-a-recording)" in page
    )
    assert "Task sweep: 1 of 3 recordings are used with remarks, such as demo-1.mcap: starts 0.2" in page
    assert page.count("starts 0.2") == 2
    assert "<b>" not in page
    linked = set(re.findall(r'href="#(word-[^"]+)"', page))
    assert {"word-less", "word-boltzmann", "word-beta", "word-held-out", "word-klaggregate"} <= linked
    assert linked <= set(re.findall(r'<dt id="([^"]+)"', page))
    for word in ("person-2", "demo-1.mcap", "effort", "held-out (nat)", "gantry.xml", "mujoco", "theta_values"):
        assert word in page, word
    assert recorded_runs(reported)[-1]["produced"] == f"{path.stat().st_size / 1e6:.1f} MB"
    before = path.read_bytes()
    report.run(reported)
    assert path.read_bytes() == before

    # a recording that changed after the posterior was inferred
    record(reported.root / "mine" / "demo-2.mcap", bow=0.25)
    ingest.run(reported, "sweep")
    catalog.run(reported)
    report.run(reported)
    page = (reported.datasets / "report.html").read_text()
    assert "tables are out of date" in page


def test_without_a_catalog_there_is_a_sentence(make_project: Make, parameters: dict[str, Any]) -> None:
    with pytest.raises(WorkbenchError, match=r"no catalog yet; make it with `dvc repro`"):
        report.run(make_project(parameters))


@pytest.mark.skipif(PROGRAM is None, reason="there is no Chromium here (apt-get install chromium)")
def test_a_browser_shows_all_of_it_and_fetches_nothing(reported: Project, tmp_path: Path) -> None:
    path = reported.datasets / "report.html"
    with chromium_page(tmp_path / "profile") as page:
        for width in (390, 1200):
            page.open(path, width)
            assert page.ask("document.title") == "LESS Workbench: sweep"
            shown = page.ask(
                "[...document.images].map(i => [i.complete, i.naturalWidth, i.getBoundingClientRect().height])"
            )
            assert len(shown) == 6
            assert all(complete and natural > 100 and height > 50 for complete, natural, height in shown), shown
            # the three tasks of params.yaml print on nine pages: what is folded is not printed
            assert 2 <= page.printed_pages() <= 4
            page.ask("document.querySelectorAll('details').forEach(one => { one.open = true })")
            text = page.ask("document.body.innerText")
            for words in ("What to be careful about", "Boltzmann", "cut & <b>off.mcap", "person-2", "theta_values"):
                assert words in text, words
            assert page.ask("document.documentElement.scrollWidth <= innerWidth"), f"wider than a screen of {width}"
        assert page.printed_pages() > 4, "what is unfolded is printed"
        assert [address for address in page.requests if not address.startswith(("file:", "data:"))] == []
        with socket.create_server(("127.0.0.1", 0)) as listener:
            listener.setblocking(False)
            address = f"http://127.0.0.1:{listener.getsockname()[1]}/x.png"
            listen = "i.onload = () => done('loaded'); i.onerror = () => done('refused')"
            put = f"const i = new Image(); {listen}; i.src = '{address}'"
            assert page.ask(f"new Promise(done => {{ {put} }})") == "refused"
            with pytest.raises(BlockingIOError):
                listener.accept()
