"""Hashes of what stages write, as DVC has them: of a file its MD5, of a folder that of a list of its files."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path


def output_hash(path: Path) -> str | None:
    """The hash of a file or folder as in dvc.lock; None if neither is there."""
    if path.is_dir():
        files = [
            {"md5": file_md5(file), "relpath": file.relative_to(path).as_posix()}
            for file in path.rglob("*")
            if file.is_file()
        ]
        listing = json.dumps(sorted(files, key=lambda file: file["relpath"]), sort_keys=True)
        return hashlib.md5(listing.encode(), usedforsecurity=False).hexdigest() + ".dir"
    return file_md5(path) if path.is_file() else None


def file_md5(path: Path) -> str:
    """The MD5 of a file."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, lambda: hashlib.md5(usedforsecurity=False)).hexdigest()
