"""URDF as MuJoCo needs it: its meshes found, links without inertia kept, links on fixed joints kept as bodies.

MuJoCo reads URDF itself, but looks for meshes beside the file alone, reads no Collada, fuses what fixed joints hold
into one body, so that `tool0` is no longer there, and refuses moving links without mass (its manual, "URDF
extensions").
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from urllib.parse import unquote, urlparse
from xml.etree import ElementTree
from xml.parsers import expat

import numpy as np

from pipeline.errors import SceneError, few_of
from pipeline.replay.declared_sizes import LARGEST_XML, require_file

READ = (".stl", ".obj", ".msh")  # formats of meshes that MuJoCo reads
LARGEST_MESH = 200_000_000  # bytes
STAND_IN_M = "0.03"  # radius of the sphere in place of a mesh that is not there
_BEGINNING = 64_000  # bytes in which the outermost element begins
_ABOVE = 6  # folders above the file in which packages are looked for
_AXES = ("xx", "xy", "xz", "yy", "yz", "zz")
_COMPILER = {  # where the file says nothing else
    "fusestatic": "false",
    "discardvisual": "true",
    "balanceinertia": "true",
    "boundmass": "1e-4",
    "boundinertia": "1e-7",
}


@dataclass(frozen=True)
class Urdf:
    """A URDF file, prepared.

    Attributes:
        text: for MuJoCo.
        meshes: the file of each mesh by the name that the text has for it.
        remarks: what was replaced, a phrase each.
    """

    text: str
    meshes: dict[str, Path]
    remarks: tuple[str, ...]

    @property
    def assets(self) -> dict[str, bytes]:
        """Content of the meshes, by name."""
        return {name: path.read_bytes() for name, path in self.meshes.items()}


def is_urdf(path: Path) -> bool:
    """Whether the outermost element of an XML file is URDF's; False for what is no XML."""
    found = list[str]()
    parser = expat.ParserCreate()
    parser.StartElementHandler = lambda element, _: found.append(element)
    with contextlib.suppress(expat.ExpatError, OSError, ValueError, LookupError), path.open("rb") as stream:
        parser.Parse(stream.read(_BEGINNING), False)
    return found[:1] == ["robot"]


def read_urdf(path: Path) -> Urdf:
    """Prepare a URDF file whose declared sizes have been checked.

    A mesh that cannot be found or read gives way to a small sphere. Only solids are kept, unless the file has none.

    Raises:
        SceneError: it is no XML, a template that xacro has to expand, or a mesh is too large.
    """
    root = _tree(path)
    if any(element.tag.startswith("xacro:") for element in root.iter()):
        raise SceneError(f"{path} is a template; expand it with `xacro {path.name} > {path.stem}.urdf` and name that.")
    solid = root.find("link/collision") is not None
    extension = root.find("mujoco")
    if extension is None:
        extension = ElementTree.SubElement(root, "mujoco")
    compiler = extension.find("compiler")
    if compiler is None:
        compiler = ElementTree.SubElement(extension, "compiler")
    folders = [path.parent / compiler.attrib.pop("meshdir", ""), path.parent]
    for key, value in (_COMPILER | ({} if solid else {"discardvisual": "false"})).items():
        compiler.attrib.setdefault(key, value)
    compiler.set("strippath", "false")
    if solid and compiler.get("discardvisual") == "true":
        for link in root.iter("link"):
            for visual in link.findall("visual"):
                link.remove(visual)
    odd = _without_impossible_inertia(root)
    meshes, absent = dict[str, Path](), dict[str, None]()
    names = dict[Path, str]()
    for geometry, mesh in _meshes(root):
        stated = mesh.get("filename", "")
        found = _find(stated, path, folders)
        if found is None or found.suffix.lower() not in READ:
            absent[stated] = None
            geometry.remove(mesh)
            ElementTree.SubElement(geometry, "sphere", radius=STAND_IN_M)
            continue
        require_file(path, found)
        if found.stat().st_size > LARGEST_MESH:
            raise SceneError(f"{path} names {found}, which has more than {LARGEST_MESH:,} bytes; use a simpler mesh.")
        name = names.setdefault(found, f"{len(names)}_{found.stem}{found.suffix.lower()}")
        meshes[name] = found
        mesh.set("filename", name)
    remarks = list[str]()
    if absent:
        few = few_of([PurePosixPath(name).name for name in absent])
        remarks.append(
            f"{len(absent)} meshes ({few}) are not there or in none of the formats {', '.join(READ)}; a sphere "
            f"of {float(STAND_IN_M):g} m stands for each"
        )
    if odd:
        remarks.append(f"the inertia of {few_of(odd)} is none that a body can have, and is left out; paths need none")
    return Urdf(ElementTree.tostring(root, encoding="unicode"), meshes, tuple(remarks))


def _tree(path: Path) -> ElementTree.Element:
    builder = ElementTree.TreeBuilder()
    parser = expat.ParserCreate()
    parser.StartElementHandler, parser.EndElementHandler = builder.start, builder.end
    with path.open("rb") as stream:
        content = stream.read(LARGEST_XML + 1)
    try:
        parser.Parse(content, True)
    except (expat.ExpatError, ValueError, LookupError) as error:
        raise SceneError(f"{path} is not readable URDF: {error}") from error
    return builder.close()


def _without_impossible_inertia(root: ElementTree.Element) -> list[str]:
    """Take out inertias that are no positive definite matrix, which MuJoCo refuses.

    Returns:
        names of the links whose inertia is not only zero, but none that a body can have.
    """
    found = []
    for link in root.iter("link"):
        for inertial in link.findall("inertial"):
            inertia = inertial.find("inertia")
            stated = {} if inertia is None else inertia.attrib
            try:
                xx, xy, xz, yy, yz, zz = (float(stated.get(f"i{axes}", "0")) for axes in _AXES)
            except ValueError:
                continue  # MuJoCo says what is wrong
            matrix = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
            least = np.linalg.eigvalsh(matrix)[0] if np.isfinite(matrix).all() else -np.inf
            if inertia is not None and least <= 0:
                link.remove(inertial)
                found += [link.get("name", "")] if least < 0 else []
    return found


def _meshes(root: ElementTree.Element) -> Iterator[tuple[ElementTree.Element, ElementTree.Element]]:
    for geometry in list(root.iter("geometry")):
        for mesh in geometry.findall("mesh"):
            yield geometry, mesh


def _find(stated: str, path: Path, folders: list[Path]) -> Path | None:
    """Where a mesh is: as it is named, in a package above the file, or beside the file under the end of its name."""
    parsed = urlparse(stated)
    if parsed.scheme not in ("", "file", "package", "model"):
        return None
    name = unquote(parsed.path) if parsed.scheme else stated
    parts = [part for part in PurePosixPath(name.lstrip("/")).parts if part != ".."]
    places = [folder / name for folder in folders] if not parsed.scheme else []
    if parsed.scheme in ("package", "model"):
        places += _in_packages(path.resolve().parent, parsed.netloc, "/".join(parts))
    places += [folder.joinpath(*parts[first:]) for folder in folders for first in range(len(parts))]
    found = next((place for place in places if place.is_file()), None)
    if found is not None and found.suffix.lower() not in READ:  # the same shape in a format that can be read
        return next((one for kind in READ if (one := found.with_suffix(kind)).is_file()), found)
    return found


def _in_packages(folder: Path, package: str, name: str) -> Iterator[Path]:
    """Where a package may be above a file; of a file in a project, not outside of the project."""
    for above in [folder, *folder.parents][: _ABOVE + 1]:
        if above.name == package:
            yield above / name
        yield above / package / name
        if (above / "params.yaml").is_file():
            return
