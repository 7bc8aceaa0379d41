"""The server answers its own page, loses nothing under load, and refuses the rest."""

import http.client
import json
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import polars as pl
import pytest

from pipeline.survey.choices_file import ChoicesFile
from pipeline.survey.questionnaire import PAPER, read_questionnaire
from pipeline.survey.server import LARGEST_REQUEST, Server, serving
from pipeline.survey.visits import Visits
from pipeline.survey.words import read_words

AT_ONCE = 200


@pytest.fixture
def server(tmp_path: Path) -> Iterator[Server]:
    visits = Visits(read_questionnaire(PAPER), ChoicesFile(tmp_path / "c.csv"), lambda trial, option: None)
    with serving("127.0.0.1", 0, visits, read_words("en")) as running:
        yield running


def asked(server: Server, method: str, path: str, body: bytes | None = None, **headers: str) -> tuple[int, Any, Any]:
    connection = http.client.HTTPConnection("127.0.0.1", server.server_port, timeout=30)
    connection.request(method, path, body, {"Content-Type": "application/json"} | headers)
    answer = connection.getresponse()
    text = answer.read()
    connection.close()
    return answer.status, answer.headers, text


def sent(server: Server, path: str, value: object) -> Any:
    status, _, text = asked(server, "POST", path, json.dumps(value).encode())
    assert status == 200, text
    return json.loads(text)


def test_two_hundred_people_at_once_lose_nothing(server: Server) -> None:
    def take_part(person: int) -> str:
        step = sent(server, "/enter", {"code": f"p{person}"})
        option = step["options"][person % len(step["options"])]["name"]
        choice = {"code": f"p{person}", "trial": step["trial"], "option": option, "seconds": 1, "screen": [1, 1]}
        assert sent(server, "/choose", choice)["done"]
        assert sent(server, "/choose", choice)["done"], "sent twice, as by a page that got no answer"
        return option

    with ThreadPoolExecutor(AT_ONCE) as people:
        chosen = dict(enumerate(people.map(take_part, range(AT_ONCE))))

    table = pl.read_csv(server.visits.file.path)
    kept = dict(table.select("participant", "choice").iter_rows())
    assert kept == {f"p{person}": option for person, option in chosen.items()}
    assert table.height == AT_ONCE
    cells = table.group_by("trial", "mirrored").len()["len"].to_list()
    assert cells == [50, 50, 50, 50]


@pytest.mark.parametrize("path", ["/", "/survey.js", "/survey.css", "/words", "/?code=x"])
def test_pages_allow_nothing_from_elsewhere(server: Server, path: str) -> None:
    status, headers, text = asked(server, "GET", path)

    assert status == 200
    assert headers["Content-Security-Policy"].startswith("default-src 'none'")
    assert headers["X-Content-Type-Options"] == "nosniff"
    assert b"http://" not in text.replace(b"http://www.w3.org/2000/svg", b"")
    assert b"https://" not in text


@pytest.mark.parametrize(
    ("method", "path", "body", "headers", "status"),
    [
        ("GET", "/../../etc/passwd", None, {}, 404),
        ("GET", "/pages/../server.py", None, {}, 404),
        ("GET", "/c.csv", None, {}, 404),
        ("GET", "/", None, {"Host": "evil.example"}, 403),
        ("POST", "/enter", b'{"code": "p1"}', {"Host": "evil.example"}, 403),
        ("POST", "/enter", b'{"code": "p1"}', {"Origin": "http://evil.example"}, 403),
        ("POST", "/enter", b'{"code": "p1"}', {"Content-Type": "text/plain"}, 400),
        ("POST", "/enter", b"code=p1", {"Content-Type": "application/x-www-form-urlencoded"}, 400),
        ("POST", "/enter", b"\xff\xfe", {}, 400),
        ("POST", "/enter", b"[" * 4000, {}, 400),
        ("POST", "/enter", b'{"code": "\\ud800"}', {}, 400),
        ("POST", "/enter", b"1" * 4000, {}, 400),
        ("POST", "/enter", b" " * (LARGEST_REQUEST + 1), {}, 413),
        ("POST", "/enter", b"", {"Content-Length": "9" * 30}, 413),
        ("POST", "/enter", b"", {"Content-Length": "-1"}, 400),
        ("POST", "/enter", b"", {"Content-Length": "\xb2"}, 400),
        ("POST", "/elsewhere", b"{}", {}, 404),
        ("PUT", "/enter", b"{}", {}, 501),
        ("DELETE", "/", None, {}, 501),
    ],
)
def test_what_is_refused(
    server: Server, method: str, path: str, body: bytes | None, headers: dict[str, str], status: int
) -> None:
    assert asked(server, method, path, body, **headers)[0] == status
    assert not server.visits.file.assigned
    assert sent(server, "/enter", {"code": "p1"})["trial"] == "control", "and it goes on"
