"""Whether this machine has the memory that something takes, so that nothing else is blamed for what it lacks."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

_GROUP = Path("/sys/fs/cgroup")  # a container's limits, where the system is Linux


def too_little(address_space: int, resident: int, who: str) -> str | None:
    """What this machine lacks for a process, in words; None if nothing is lacking as far as is known.

    Args:
        address_space: bytes that the process may reserve.
        resident: bytes of these that it may use.
        who: what needs it, for the words.
    """
    for what, there, needed in (
        ("the limit on the memory of a program (`ulimit -v`)", _limit(), address_space),
        ("what is free on this machine", _free(), resident),
        ("what is left to this container", _left_to_container(), resident),
    ):
        if there is not None and there < needed:
            return f"{what} is {there / (1 << 20):,.0f} MB, and {who} needs {needed / (1 << 20):,.0f} MB"
    return None


def _limit() -> int | None:
    try:
        import resource
    except ImportError:
        return None
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    return None if limit == resource.RLIM_INFINITY else limit


def _free() -> int | None:
    with suppress(OSError, ValueError, IndexError):
        for line in Path("/proc/meminfo").read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return int(line.split()[1]) << 10
    return None


def _left_to_container() -> int | None:
    with suppress(OSError, ValueError):  # without a limit the file says `max`
        return int((_GROUP / "memory.max").read_text()) - int((_GROUP / "memory.current").read_text())
    return None
