"""On which addresses a process listens, as the kernel tells."""

from __future__ import annotations

from pathlib import Path

LOOPBACK = {"0100007F", "00000000000000000000000001000000"}


def listening(pid: int) -> set[str]:
    """The addresses on which a process listens, as the kernel writes them."""
    links = [str(link.readlink()) for link in Path(f"/proc/{pid}/fd").iterdir() if link.is_symlink()]
    inodes = {link[len("socket:[") : -1] for link in links if link.startswith("socket:[")}
    lines = [
        line.split() for table in ("tcp", "tcp6") for line in Path(f"/proc/net/{table}").read_text().splitlines()[1:]
    ]
    return {line[1].rpartition(":")[0] for line in lines if line[3] == "0A" and line[9] in inodes}
