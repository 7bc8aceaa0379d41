"""The words of the page, in any language, from a YAML file."""

from __future__ import annotations

from pathlib import Path

from pipeline.errors import SurveyError
from pipeline.yaml_text import YamlError, plain_yaml

FOLDER = Path(__file__).with_name("texts")
_LONGEST = 5_000


def read_words(name: str) -> dict[str, str]:
    """The words of a language that is here (`en`, `de`), or of a file.

    Raises:
        SurveyError: there is no such file, or it lacks a text, has one too many, or one that is no text.
    """
    here = {path.stem: path for path in FOLDER.glob("*.yaml")}
    path = here.get(name, Path(name))
    found = _texts(path)
    needed = _texts(here["en"])
    if missing := sorted(needed.keys() - found.keys()):
        raise SurveyError(f"{path}: lacks {', '.join(missing)}; {here['en'].name} has all of them, to be translated")
    if more := sorted(found.keys() - needed.keys()):
        raise SurveyError(f"{path}: has {', '.join(more)}, which the page does not use; take it out")
    if found["direction"] not in ("ltr", "rtl"):
        raise SurveyError(f"{path}: direction is {found['direction']!r}; ltr or rtl is needed")
    return found


def _texts(path: Path) -> dict[str, str]:
    try:
        document = plain_yaml(path.read_text(encoding="utf-8"), 1_000)
    except (OSError, UnicodeDecodeError, YamlError) as error:
        reason = error.strerror.lower() if isinstance(error, OSError) and error.strerror else str(error)
        raise SurveyError(f"{path}: cannot be read as the words of the page ({reason})") from None
    if not isinstance(document, dict) or not all(
        isinstance(key, str) and isinstance(value, str) and len(value) <= _LONGEST for key, value in document.items()
    ):
        raise SurveyError(f"{path}: each line is a name, a colon and a text of at most {_LONGEST:,} characters")
    return document
