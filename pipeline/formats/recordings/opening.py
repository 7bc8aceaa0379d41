"""What is looked at in a file that is not trusted before its reader: kind, length and hash; and how it is inflated."""

from __future__ import annotations

import hashlib
import os
import shutil
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import BinaryIO

import zstandard

from pipeline.formats.mcap.limits import Limits
from pipeline.formats.mcap.rejection_reasons import rejection

COMPRESSED = (".zstd", ".zst")
_PIECE = 1 << 20


def require_regular(path: Path, limits: Limits) -> os.stat_result:
    """What the operating system says of a file.

    Raises:
        RecordingError: unreadable or too-large.
    """
    try:
        about = path.stat()
        if not stat.S_ISREG(about.st_mode):
            raise rejection("unreadable", f"{path} is not a regular file.")
        with path.open("rb"):
            pass
    except OSError as error:
        raise rejection("unreadable", f"{path} cannot be read: {error.strerror or error}.") from error
    if about.st_size > limits.stored_bytes:
        raise rejection(
            "too-large",
            f"{path.name} has {about.st_size} bytes, at most {limits.stored_bytes} are read; cut it to fewer "
            f"recordings.",
        )
    return about


def hash_of(path: Path) -> str:
    """SHA-256 of a file, remembered while the file stays as it is."""
    about = path.stat()
    return _hashed(path, about.st_size, about.st_mtime_ns, about.st_ino)


@lru_cache(maxsize=256)
def _hashed(path: Path, *_: int) -> str:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


@contextmanager
def inflated(path: Path, limits: Limits) -> Iterator[Path]:
    """The file itself, or of one that is compressed as a whole with zstd a copy that is not.

    Raises:
        RecordingError: too-large or corrupt.
    """
    if path.suffix.lower() not in COMPRESSED:
        yield path
        return
    with tempfile.TemporaryDirectory(prefix="lessbench-") as folder:
        copy = Path(folder) / path.stem
        with path.open("rb") as source, copy.open("wb") as target:
            _inflate(path, source, target, limits.stored_bytes)
        yield copy


def _inflate(path: Path, source: BinaryIO, target: BinaryIO, most: int) -> None:
    free = shutil.disk_usage(tempfile.gettempdir()).free
    written = 0
    try:
        with zstandard.ZstdDecompressor(max_window_size=1 << 27).stream_reader(
            source, read_across_frames=True
        ) as stream:
            while piece := stream.read(_PIECE):
                written += len(piece)
                if written > most:
                    raise rejection("too-large", f"{path.name} inflates to more than {most} bytes; cut it.")
                if written > free - (64 << 20):
                    raise rejection(
                        "too-large",
                        f"{path.name} does not fit into {tempfile.gettempdir()} inflated; set TMPDIR, or unpack it "
                        f"with "
                        f"`zstd -d {path.name}`.",
                    )
                target.write(piece)
    except zstandard.ZstdError as error:
        raise rejection("corrupt", f"{path.name} is damaged, or no zstd file.") from error
    except OSError as error:
        raise rejection("unreadable", f"{path.name} cannot be unpacked: {error.strerror or error}.") from error
