"""What a scene's XML declares, looked at before MuJoCo builds it: sizes without bound, and files that never end.

MuJoCo multiplies replicates, allocates grids and reads files while it compiles, without limits of its own.
"""

from __future__ import annotations

import os
import stat
from collections.abc import Callable, Mapping
from math import prod
from pathlib import Path
from xml.parsers import expat

from pipeline.errors import SceneError

LARGEST_XML = 50_000_000  # bytes
MOST_INCLUDES = 1_000
MOST = {"copies": 100_000, "grid points": 25_000_000, "vertices": 1_000_000, "pixels": 100_000_000}
_FOLDERS = ("meshdir", "texturedir", "assetdir")


def check_declared_sizes(path: Path) -> None:
    """Refuse a scene that declares more than can be built, or a file that is none.

    Args:
        path: of the scene; what it includes is looked at too.

    Raises:
        SceneError: the message names the file, the element, what it declares and what is allowed.
    """
    waiting, seen = [path], set[Path]()
    files: list[tuple[Path, str]] = []
    folders = {Path()}
    while waiting:
        file = waiting.pop()
        if file in seen:
            continue
        seen.add(file)
        if len(seen) > MOST_INCLUDES:
            raise SceneError(f"{path} includes more than {MOST_INCLUDES:,} files; include fewer.")
        require_file(path, file)
        for element, attributes in _elements(file):
            folders |= {Path(attributes[key]) for key in _FOLDERS if key in attributes}
            if "file" in attributes:
                name = attributes["file"]
                if element in {"include", "model"}:
                    waiting += [one for one in (path.parent / name, file.parent / name) if os.path.lexists(one)][:1]
                else:
                    files.append((file, name))
    for file, name in files:
        for folder in folders:
            for base in (path.parent, file.parent):
                if os.path.lexists(place := base / folder / name):
                    require_file(path, place)


def _elements(file: Path) -> list[tuple[str, Mapping[str, str]]]:
    """All elements of an XML file with their attributes, each checked; what is not XML is left to MuJoCo to name."""
    found: list[tuple[str, Mapping[str, str]]] = []
    copies = [1]

    def begin(element: str, attributes: dict[str, str]) -> None:
        found.append((element, attributes))
        copies.append(copies[-1])
        if element == "replicate":
            copies[-1] *= _product(attributes.get("count", ""))
        for what, count in (
            ("copies", copies[-1] if element == "replicate" else 0),
            ("copies", _product(attributes.get("count", "")) if element == "composite" else 0),
            ("vertices", _product(attributes.get("count", "")) * copies[-1] if element == "flexcomp" else 0),
            ("grid points", _of(attributes, "nrow", "ncol") if element == "hfield" else 0),
            ("pixels", _of(attributes, "width", "height") if element == "texture" else 0),
        ):
            if count > MOST[what]:
                raise SceneError(
                    f"{file}: <{element}> declares {count:,} {what}; at most {MOST[what]:,} can be built; declare "
                    "fewer."
                )

    def end(_: str) -> None:
        copies.pop()

    def entity(*_: object) -> None:
        raise SceneError(f"{file} declares entities, with which a small file can become a large one; write them out.")

    parser = expat.ParserCreate()
    parser.StartElementHandler, parser.EndElementHandler, parser.EntityDeclHandler = begin, end, entity
    with file.open("rb") as stream:
        content = stream.read(LARGEST_XML + 1)
    if len(content) > LARGEST_XML:
        raise SceneError(f"{file} has more than {LARGEST_XML:,} bytes; a scene takes far less.")
    _parse(parser.Parse, content)
    return found


def _parse(parse: Callable[[bytes, bool], object], content: bytes) -> None:
    try:
        parse(content, True)
    except (expat.ExpatError, ValueError, LookupError):
        return  # MuJoCo's own reader is more lenient in places, and says what is wrong where it is not


def _of(attributes: Mapping[str, str], *names: str) -> int:
    return prod(_product(attributes.get(name, "")) for name in names)


def _product(numbers: str) -> int:
    """Of the whole numbers in a text; 1 for what is none, which MuJoCo refuses."""
    return prod(int(word) for word in numbers.split() if word.isdecimal() and len(word) < 20)


def require_file(scene: Path, file: Path) -> None:
    """Raise a SceneError if what a scene names is there and is no file or folder."""
    try:
        mode = file.stat().st_mode
    except OSError:
        return  # MuJoCo says that it is not there
    if not stat.S_ISREG(mode) and not stat.S_ISDIR(mode):
        raise SceneError(
            f"{scene} names {file}, which is a pipe, a socket or a device and no file; name a file of a mesh "
            "or picture."
        )
