"""The page in a real browser: from its address to the tables of the study."""

import shutil
import subprocess
import tarfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import polars as pl
import pytest

from pipeline.commands.choices import told
from pipeline.survey.choices_file import ChoicesFile
from pipeline.survey.questionnaire import PAPER, read_questionnaire
from pipeline.survey.server import Server, serving
from pipeline.survey.visits import Visits
from pipeline.survey.words import read_words
from tests.support.browser import PROGRAM, Page, chromium_page

pytestmark = pytest.mark.skipif(PROGRAM is None, reason="there is no Chromium here (apt-get install chromium)")
AXE = "axe-core@4.14.1"  # Deque's checks of accessibility, from the npm registry
TAB, ENTER, SPACE, DOWN = ("Tab", 9, ""), ("Enter", 13, "\r"), (" ", 32, " "), ("ArrowDown", 40, "")
PHONE, DESKTOP = 390, 1280
CLIPS = {name: {
    "width": 480, "height": 360, "seconds": 0.5, "colours": ["rgba(255,0,0,1.00)", "rgba(0,0,255,1.00)"],
    "still": [[0, [0, 300, 480, 300, 480, 360, 0, 360]]],
    "frames": [[[1, [x, 100, x + 40, 100, x + 40, 140, x, 140]]] for x in range(0, 420, 20)],
    "path": [0, 120, end, 120],
} for name, end in (("first", 440), ("second", 430))}  # fmt: skip
MOTIONS = """
title: Which motion would you want?
trials:
  pair: {task: table, options: {first: {alternative: a/0}, second: {alternative: a/1}}}
"""
THANKED = "!!document.body && document.body.innerText.includes('Thank you')"


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    with chromium_page(tmp_path_factory.mktemp("profile")) as opened:
        yield opened


@pytest.fixture
def serve(tmp_path: Path) -> Iterator[Callable[..., Server]]:
    running = []

    def start(words: str = "en", study: Path = PAPER) -> Server:
        visits = Visits(read_questionnaire(study), ChoicesFile(tmp_path / "c.csv"), lambda trial, option: CLIPS[option])
        context = serving("127.0.0.1", 0, visits, read_words(words))
        running.append(context)
        return context.__enter__()

    yield start
    for context in running:
        context.__exit__(None, None, None)


def begin(page: Page, server: Server, address: str, width: int = DESKTOP) -> None:
    """To the first question."""
    page.open(f"http://127.0.0.1:{server.server_port}/{address}", width)
    page.wait_for("!!document.querySelector('#agree')")
    page.ask("document.querySelector('#agree').click(); document.querySelector('button').click()")
    page.ask("document.querySelector('button').click()")
    page.wait_for("!!document.querySelector('form.trial')")


def finish(page: Page, option: str) -> None:
    page.ask(f"document.querySelector('input[value={option}]').click()")
    page.ask("document.querySelector('form.trial > button').click()")
    page.wait_for(THANKED)


def rows(server: Server) -> list[dict[str, Any]]:
    return pl.read_csv(server.visits.file.path).to_dicts()


def test_by_keyboard_alone(page: Page, serve: Callable[..., Server]) -> None:
    server = serve()
    page.open(f"http://127.0.0.1:{server.server_port}/?code=keys", DESKTOP)
    page.wait_for("!!document.querySelector('#agree')")
    for key in (TAB, SPACE, TAB, ENTER):
        page.press(*key)
    page.wait_for("!document.querySelector('#agree') && !!document.querySelector('button')")
    for key in (TAB, ENTER):
        page.press(*key)
    page.wait_for("!!document.querySelector('form.trial')")
    for key in (TAB, SPACE, DOWN, TAB, ENTER):
        page.press(*key)
    page.wait_for(THANKED)

    assert [row["choice"] for row in rows(server)] == ["right"], "the second of the three"


def test_reloading_and_going_back_lose_and_double_nothing(page: Page, serve: Callable[..., Server]) -> None:
    server = serve()
    begin(page, server, "?code=back", PHONE)
    page.do("Page.reload")
    page.wait_for("!!document.querySelector('form.trial')")
    finish(page, "left")
    page.do("Page.reload")
    page.wait_for(THANKED)
    page.open("about:blank", PHONE)
    page.ask("history.back()")
    page.wait_for(THANKED)

    (row,) = rows(server)
    assert (row["participant"], row["choice"]) == ("back", "left")
    assert row["screen_width"] == PHONE
    assert row["seconds"] < 60


def test_without_a_code_one_is_drawn_and_survives_a_reload(page: Page, serve: Callable[..., Server]) -> None:
    server = serve()
    begin(page, server, "")
    page.do("Page.reload")
    page.wait_for("!!document.querySelector('form.trial')")
    finish(page, "left")

    (row,) = rows(server)
    assert len(str(row["participant"])) == 16
    assert len(server.visits.file.assigned) == 1


def test_nothing_is_asked_of_anybody_else(page: Page, serve: Callable[..., Server]) -> None:
    server = serve()
    page.requests.clear()
    begin(page, server, "?code=alone")
    finish(page, "left")

    here = f"http://127.0.0.1:{server.server_port}/"
    assert page.requests
    assert [address for address in page.requests if not address.startswith((here, "data:"))] == []


def test_in_another_language_and_on_a_phone_nothing_is_cut_off(page: Page, serve: Callable[..., Server]) -> None:
    server = serve("de")
    begin(page, server, "?code=de", PHONE)

    assert page.ask("document.documentElement.lang") == "de"
    assert page.ask("document.querySelector('h1').innerText") == "Welchen Weg würden Sie nehmen?"
    assert page.ask("document.querySelector('svg').getAttribute('aria-label')").startswith("Möglichkeit 1: 5 nach oben")
    assert page.ask("document.documentElement.scrollWidth <= window.innerWidth")


def test_without_a_choice_the_page_says_so(page: Page, serve: Callable[..., Server]) -> None:
    server = serve()
    begin(page, server, "?code=none")
    page.ask("document.querySelector('form.trial button').click()")

    page.wait_for("document.querySelector('#said').innerText === 'Choose one of the options first.'")
    assert rows(server) == []


def test_a_server_that_is_away_for_a_moment_costs_no_choice(page: Page, serve: Callable[..., Server]) -> None:
    server = serve()
    begin(page, server, "?code=later")
    page.do("Network.emulateNetworkConditions", offline=True, latency=0, downloadThroughput=-1, uploadThroughput=-1)
    page.ask("document.querySelector('input[value=left]').click(); document.querySelector('button').click()")
    page.wait_for("document.querySelector('#said').innerText === 'Sending ...'")
    page.do("Network.emulateNetworkConditions", offline=False, latency=0, downloadThroughput=-1, uploadThroughput=-1)
    page.wait_for(THANKED)

    assert [row["choice"] for row in rows(server)] == ["left"]


def test_a_hostile_code_is_refused_and_shown_as_text(page: Page, serve: Callable[..., Server]) -> None:
    server = serve()
    page.open(f"http://127.0.0.1:{server.server_port}/?code=%3Cimg%20src%3Dx%20onerror%3Dalert(1)%3E", DESKTOP)
    page.wait_for("!!document.querySelector('#agree')")
    page.ask("document.querySelector('#agree').click(); document.querySelector('button').click()")
    page.ask("document.querySelector('button').click()")
    page.wait_for("document.querySelector('#said').innerText.startsWith('code has 1 to 64 letters')")

    assert page.ask("document.images.length") == 0
    assert not server.visits.file.assigned


def test_from_the_browser_to_the_tables_of_the_study(page: Page, serve: Callable[..., Server]) -> None:
    server = serve()
    wanted = {"control": ["left", "right", "through"], "experimental": ["L", "R2", "R3"]}
    for person in range(12):
        begin(page, server, f"?code=p{person}")
        offered = page.ask("Array.from(document.querySelectorAll('input')).map(input => input.value)")
        trial = "experimental" if "R2" in offered else "control"
        finish(page, wanted[trial][person // 2 % 3])

    lines = told(server.visits.file.path)

    assert (
        lines[0]
        == "4 people in the control trial, 6 in the experimental one; 2 more failed the attention test and are left out"
    )
    assert any(line.startswith("  R1 (right): chosen by 0") for line in lines)
    assert lines[-1].startswith("LESS: posterior probability 0.")


def test_motions_play_to_their_end_though_the_first_frame_is_older_than_the_click(
    page: Page, serve: Callable[..., Server], tmp_path: Path
) -> None:
    """Browsers give a frame the time at which it began, which may lie before the script that asked for it."""
    (tmp_path / "motions.yaml").write_text(MOTIONS)
    server = serve(study=tmp_path / "motions.yaml")
    early = "const now = performance.now.bind(performance); performance.now = () => now() + 150;"
    added = page.do("Page.addScriptToEvaluateOnNewDocument", source=early)
    begin(page, server, "?code=frames", PHONE)
    page.do("Page.removeScriptToEvaluateOnNewDocument", identifier=added["identifier"])
    page.wait_for("Array.from(document.querySelectorAll('button.second')).every(one => one.textContent === 'Play')")
    colour = "Array.from(document.querySelectorAll('canvas')[{}].getContext('2d').getImageData({}, {}, 1, 1).data)"
    for index in range(2):
        assert page.ask(colour.format(index, 420, 110)) == [0, 0, 255, 255], "the arm at the end of its motion"
        assert page.ask(colour.format(index, 20, 110)) == [0, 0, 0, 0], "and no longer at its beginning"
        assert page.ask(colour.format(index, 20, 330)) == [255, 0, 0, 255], "the table"
    page.ask("document.querySelectorAll('button.second')[1].click()")
    assert page.ask("document.querySelectorAll('button.second')[1].getAttribute('aria-label')") == "Pause: Option 2"
    finish(page, "second")
    (row,) = rows(server)
    assert (row["trial"], row["choice"]) == ("pair", "second")


@pytest.fixture(scope="module")
def axe(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The script that checks a page."""
    folder = tmp_path_factory.mktemp("axe")
    npm = shutil.which("npm")
    if npm is None:
        pytest.skip("there is no npm here, which would bring axe-core")
    try:
        subprocess.run([npm, "pack", AXE], cwd=folder, check=True, capture_output=True, timeout=60)
    except (subprocess.CalledProcessError, subprocess.TimeoutExpired):
        pytest.skip(f"npm cannot bring {AXE} here")
    with tarfile.open(next(folder.glob("*.tgz"))) as archive:
        script = archive.extractfile("package/axe.min.js")
        assert script is not None
        return script.read().decode()


@pytest.mark.parametrize("width", [PHONE, DESKTOP])
def test_axe_finds_nothing_on_any_page(page: Page, serve: Callable[..., Server], axe: str, width: int) -> None:
    server = serve()

    def check() -> None:
        page.ask(f"{axe}; 1")
        found = page.ask("axe.run().then(result => result.violations.map(one => one.id + ': ' + one.help))")
        assert found == []

    page.open(f"http://127.0.0.1:{server.server_port}/?code=axe{width}", width)
    page.wait_for("!!document.querySelector('#agree')")
    check()
    page.ask("document.querySelector('#agree').click(); document.querySelector('button').click()")
    check()
    page.ask("document.querySelector('button').click()")
    page.wait_for("!!document.querySelector('form.trial')")
    check()
    finish(page, page.ask("document.querySelector('input').value"))
    check()


def test_axe_finds_nothing_on_motions(page: Page, serve: Callable[..., Server], axe: str, tmp_path: Path) -> None:
    (tmp_path / "motions.yaml").write_text(MOTIONS)
    begin(page, serve(study=tmp_path / "motions.yaml"), "?code=motions", PHONE)
    page.ask(f"{axe}; 1")
    assert page.ask("axe.run().then(result => result.violations.map(one => one.id + ': ' + one.help))") == []
