"""What is in a project that came from elsewhere: what would run, what leads out of it, what is odd. Nothing is run."""

from __future__ import annotations

import os
import re
import stat
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from xml.parsers import expat

import pipeline
from pipeline import params
from pipeline.errors import ParameterError, WorkbenchError
from pipeline.stages.dvc_yaml import FILE as DVC_YAML
from pipeline.stages.dvc_yaml import dvc_yaml
from pipeline.yaml_text import YamlError, plain_yaml

MOST_FILES = 200_000
LARGEST_TEXT = 5_000_000  # bytes of a YAML, XML or configuration file that are read
LARGE = 1_000_000_000  # bytes of a file that is named for its size
PROGRAM = ("pipeline", "schemas")
SKIPPED = (".git/objects", ".dvc/cache")  # contents by their hashes, of which nothing runs
RUNS, LEADS_OUT, ODD = "runs code", "leads out of the folder", "is odd"

_BY_HAND = {
    ".py": "Python", ".ipynb": "a notebook", ".sh": "a shell script", ".pkl": "a pickle", ".pickle": "a pickle",
    ".p": "a pickle", ".joblib": "a pickle", ".pt": "a pickle", ".pth": "Python that every start of Python runs",
    ".pyc": "compiled Python, which may be of another text",
    ".so": "machine code", ".dylib": "machine code", ".dll": "machine code", ".exe": "machine code", ".bat": "a script",
}  # fmt: skip
_BY_NAME = {
    "Makefile": "rules of make", "makefile": "rules of make", "GNUmakefile": "rules of make", ".envrc": "a script",
    "Dockerfile": "steps of an image", "pyproject.toml": "steps of an installation", "setup.cfg": "settings of tools",
    ".pre-commit-config.yaml": "hooks of git", "tasks.json": "tasks of an editor", "noxfile.py": "Python",
}  # fmt: skip
_GIT_RUNS = re.compile(
    r"(?im)^\s*(fsmonitor|sshcommand|hookspath|pager|editor|textconv|command|clean|smudge|process|helper|external|"
    r"program|askpass|uploadpack|receivepack)\s*=\s*(?!true\s*$|false\s*$)(.+)$"
)
_REMOTE = re.compile(r"(?im)^\s*url\s*=\s*(.+)$")
_NAME_FILES = {
    "scene",
    "arm",
    "recordings",
    "given",
    "choices",
    "deps",
    "outs",
    "path",
    "wdir",
    "feature_files",
    "scene_files",
}
_FILE_ATTRIBUTES = ("file", "meshdir", "texturedir", "assetdir", "hfile", "filename")


@dataclass(frozen=True, order=True)
class Finding:
    """One thing to know: of which kind, about which file, and a sentence."""

    kind: str
    file: str
    sentence: str


@dataclass
class Inspection:
    """What was found in a folder.

    Attributes:
        files: how many there are.
        size: of all, bytes.
        findings: in the order of their files.
    """

    files: int = 0
    size: int = 0
    findings: list[Finding] = field(default_factory=list)

    def add(self, kind: str, file: str, sentence: str) -> None:
        """Keep a finding."""
        self.findings.append(Finding(kind, file, sentence))

    def lines(self) -> list[str]:
        """What is said of the folder."""
        said = [f"{self.files:,} files, {self.size / 1e6:,.1f} MB; nothing of them was run"]
        for kind in (RUNS, LEADS_OUT, ODD):
            alike = dict[str, list[str]]()
            for one in sorted(one for one in self.findings if one.kind == kind):
                alike.setdefault(one.sentence, []).append(one.file)
            for sentence, files in alike.items():
                more = f" (and {len(files) - 1} more: {', '.join(files[1:4])})" if len(files) > 1 else ""
                said.append(f"{kind}: {files[0]}: {sentence}{more}")
        if not self.findings:
            said.append("only the stages of this program run in it, and nothing leads out of it")
        elif any(one.kind == RUNS for one in self.findings):
            said.append("`dvc repro` runs the commands of its dvc.yaml and its own code: read these first")
        return said


def inspect_project(folder: Path) -> Inspection:
    """Look through a folder without running, importing or following anything of it.

    Raises:
        ParameterError: there is no such folder.
    """
    if not folder.is_dir() or folder.is_symlink():
        raise ParameterError(f"{folder}: there is no such folder; name the folder of the project that you received")
    found = Inspection()
    for path, about in _walk(folder, found):
        shown = PurePosixPath(path.relative_to(folder)).as_posix()
        if not shown.isprintable():
            found.add(ODD, shown, "has a name with characters that control a terminal or cannot be seen")
        if stat.S_ISLNK(about.st_mode):
            _look_at_link(folder, path, shown, found)
        elif not stat.S_ISREG(about.st_mode):
            found.add(ODD, shown, "is not a file but a pipe, a socket or a device; reading it may never end")
        else:
            found.files += 1
            found.size += about.st_size
            _look_at_file(path, shown, about, found)
    return found


def _walk(folder: Path, found: Inspection) -> Iterator[tuple[Path, os.stat_result]]:
    """All that is in the folder but folders; links are not followed."""
    waiting, seen = [folder], 0
    while waiting:
        here = waiting.pop()
        try:
            with os.scandir(here) as listed:
                entries = sorted(listed, key=lambda entry: entry.name)
        except OSError as error:
            found.add(ODD, str(here.relative_to(folder)), f"cannot be looked into: {error.strerror or error}")
            continue
        if any(entry.name == "pyvenv.cfg" for entry in entries):
            found.add(RUNS, here.relative_to(folder).as_posix(), "is a virtual environment; make your own instead")
            continue
        for entry in entries:
            seen += 1
            if seen > MOST_FILES:
                found.add(ODD, ".", f"holds more than {MOST_FILES:,} files; the others were not looked at")
                return
            path = Path(entry.path)
            if not entry.is_dir(follow_symlinks=False):
                yield path, entry.stat(follow_symlinks=False)
            elif path.relative_to(folder).as_posix() not in SKIPPED:
                waiting.append(path)


def _look_at_link(folder: Path, path: Path, shown: str, found: Inspection) -> None:
    if shown.partition("/")[0] in PROGRAM:
        found.add(RUNS, shown, f"is a link to {path.readlink()} where the program should be")
    try:
        inside = path.resolve().is_relative_to(folder.resolve())
    except (OSError, RuntimeError):
        inside = False
    if not inside:
        found.add(LEADS_OUT, shown, f"is a link to {path.readlink()}")


def _look_at_file(path: Path, shown: str, about: os.stat_result, found: Inspection) -> None:
    if about.st_mode & (stat.S_ISUID | stat.S_ISGID):
        found.add(ODD, shown, "runs with the rights of its owner or group")
    if about.st_size > LARGE:
        found.add(ODD, shown, f"is {about.st_size / 1e9:,.1f} GB large")
    if about.st_size > 10_000_000 and about.st_blocks * 512 < about.st_size / 10:
        found.add(ODD, shown, f"claims {about.st_size / 1e9:,.1f} GB, of which hardly any is there")
    first, name = shown.partition("/")[0], path.name
    if shown.startswith(".git/hooks/") and not name.endswith(".sample"):
        found.add(RUNS, shown, "is a hook, which git runs")
    elif shown in {".git/config", ".dvc/config", ".dvc/config.local"}:
        _look_at_settings(path, shown, found)
    elif name == "dvc.yaml":
        _look_at_commands(path, shown, found)
    elif name in _BY_NAME and not _same_as_ours(path, shown):
        found.add(RUNS, shown, f"holds {_BY_NAME[name]}, which run when you call for them")
    elif first in PROGRAM and path.suffix != ".pyc":
        if not _same_as_ours(path, shown):
            found.add(RUNS, shown, "is not as in the program that is installed here, and `dvc repro` runs it")
    elif path.suffix in _BY_HAND and not _same_as_ours(path, shown):
        found.add(RUNS, shown, f"is {_BY_HAND[path.suffix]}, which runs when it is started, imported or loaded")
    elif path.suffix in {".yaml", ".yml"}:
        _look_at_parameters(path, shown, found)
    elif path.suffix in {".xml", ".mjcf", ".urdf"}:
        _look_at_scene(path, shown, found)


def _look_at_settings(path: Path, shown: str, found: Inspection) -> None:
    text = _text(path, shown, found)
    for name, value in _GIT_RUNS.findall(text):
        found.add(RUNS, shown, f"sets {name} = {value.strip()}, which may run a program")
    for url in _REMOTE.findall(text):
        found.add(LEADS_OUT, shown, f"names the address {url.strip()}")


def _look_at_commands(path: Path, shown: str, found: Inspection) -> None:
    """Every command, unless the file is to the letter what this program writes for the parameters beside it.

    Nothing less will do: DVC puts values of the parameters into commands, unquoted, for a shell.
    """
    if shown == DVC_YAML and _text(path, shown, found) == _written_here(path.parent):
        return
    document = _document(path, shown, found)
    _look_at_names(document, shown, found)
    found.add(RUNS, shown, "is not what this program writes for the parameters beside it")
    for command in _commands(document):
        found.add(RUNS, shown, f"`dvc repro` would run `{command}`")


def _written_here(folder: Path) -> str | None:
    """The dvc.yaml of these parameters; None if they are none that this program takes."""
    try:
        return dvc_yaml(params.load(folder / params.FILE), params.own_tasks(folder))
    except (WorkbenchError, OSError):
        return None


def _commands(value: object) -> Iterator[str]:
    """Every `cmd` in a document, wherever it is."""
    if isinstance(value, Mapping):
        for key, inner in value.items():
            if key == "cmd":
                yield from map(str, inner if isinstance(inner, list) else [inner])
            else:
                yield from _commands(inner)
    elif isinstance(value, list):
        for inner in value:
            yield from _commands(inner)


def _look_at_parameters(path: Path, shown: str, found: Inspection) -> None:
    _look_at_names(_document(path, shown, found), shown, found)


def _look_at_names(document: object, shown: str, found: Inspection) -> None:
    """Feature files, and files and addresses elsewhere, that a document names."""
    for place, text in _texts(document):
        if re.sub(r"[.]\d+$", "", place).rpartition(".")[2] == "feature_files":
            found.add(RUNS, shown, f"{place} names the feature file {text}, which runs once you `lessbench trust` it")
        if text.startswith(("tcp://", "tls://")):
            found.add(LEADS_OUT, shown, f"{place} names the address {text}")
        elif re.sub(r"[.]\d+$", "", place).rpartition(".")[2] in _NAME_FILES and _leads_out(
            text, _folder(place, shown)
        ):
            found.add(LEADS_OUT, shown, f"{place} names {text}")


def _folder(place: str, shown: str) -> str:
    """From where a parameter names a file: the project, or, of the arm of a described scene, the file's own folder."""
    return PurePosixPath(shown).parent.as_posix() if place == "arm" else ""


def _texts(value: object, place: str = "") -> Iterator[tuple[str, str]]:
    if isinstance(value, Mapping):
        for key, inner in value.items():
            yield from _texts(inner, f"{place}.{key}" if place else str(key))
    elif isinstance(value, list):
        for number, inner in enumerate(value):
            yield from _texts(inner, f"{place}.{number}")
    elif isinstance(value, str):
        yield place, value


def _look_at_scene(path: Path, shown: str, found: Inspection) -> None:
    """Files that a scene names; entities, which can grow without bound, are not followed."""
    text = _text(path, shown, found)

    def element(name: str, attributes: dict[str, str]) -> None:
        for key in _FILE_ATTRIBUTES:
            if _leads_out(attributes.get(key, ""), PurePosixPath(shown).parent.as_posix()):
                found.add(LEADS_OUT, shown, f"<{name}> names {attributes[key]}")

    def entity(*_: object) -> None:
        raise _EntityError

    parser = expat.ParserCreate()
    parser.StartElementHandler, parser.EntityDeclHandler = element, entity
    try:
        parser.Parse(text, True)
    except _EntityError:
        found.add(ODD, shown, "declares entities, with which a small file can become a large one")
    except (expat.ExpatError, UnicodeError) as error:
        found.add(ODD, shown, f"is not readable XML ({error})")


class _EntityError(Exception):
    """A document declares an entity."""


def _leads_out(name: str, folder: str = "") -> bool:
    """Whether a name of a file, seen from a folder of the project, is absolute or outside of the project."""
    name = name.replace("\\", "/")
    if name.startswith(("/", "~")) or name[1:2] == ":":
        return True
    return os.path.normpath(os.path.join(folder, name)).split("/")[0] == ".."  # noqa: PTH118


def _same_as_ours(path: Path, shown: str) -> bool:
    return _equal(path, Path(pipeline.__file__).resolve().parents[1] / shown)


def _equal(path: Path, ours: Path) -> bool:
    try:
        same_size = path.stat().st_size == ours.stat().st_size < LARGEST_TEXT
        return same_size and path.read_bytes() == ours.read_bytes()
    except OSError:
        return False


def _document(path: Path, shown: str, found: Inspection) -> object:
    try:
        return plain_yaml(_text(path, shown, found))
    except YamlError as error:
        found.add(ODD, shown, str(error))
        return None


def _text(path: Path, shown: str, found: Inspection) -> str:
    """The beginning of a file as text."""
    try:
        with path.open("rb") as stream:
            content = stream.read(LARGEST_TEXT + 1)
    except OSError as error:
        found.add(ODD, shown, f"cannot be read: {error.strerror or error}")
        return ""
    if len(content) > LARGEST_TEXT:
        found.add(ODD, shown, f"has more than {LARGEST_TEXT:,} bytes, of which only the first were looked at")
    return content[:LARGEST_TEXT].decode("utf-8", "replace")
