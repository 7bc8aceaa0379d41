"""Pickles of joint arrays that Python 2 wrote, read as data: nothing in them is imported, called or built.

Python's own unpickler calls whatever a file names, and numpy's own reconstruction trusts shapes and types. Here the few
opcodes of protocol 0 that such files need are interpreted over plain values; seven global names are known as words.
Work and memory are bounded by the size of the file and the number of its opcodes.
"""

from __future__ import annotations

import codecs
import math
import re
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import ClassVar

import numpy as np

from pipeline.arrays import FloatArray
from pipeline.errors import RecordingError
from pipeline.formats.mcap.rejection_reasons import rejection

MAX_OPCODES = 250_000  # a published file with 20 demonstrations has 570


class Name(Enum):
    """The globals a file may name; nothing of that name is ever looked up."""

    RECONSTRUCT = b"numpy.core.multiarray _reconstruct"
    SCALAR = b"numpy.core.multiarray scalar"
    NDARRAY = b"numpy ndarray"
    DTYPE = b"numpy dtype"
    NEW_OBJECT = b"copy_reg _reconstructor"
    OBJECT = b"__builtin__ object"
    TRAJECTORY = b"utils.trajectory Trajectory"


@dataclass(eq=False)
class Array:
    """An array of one or two axes; `values` are None until the file has given them."""

    values: FloatArray | None = None


@dataclass(eq=False)
class Trajectory:
    """The attributes of an object of the class `utils.trajectory.Trajectory`."""

    attributes: dict[str, object]


@dataclass(eq=False)
class _Dtype:
    """The type `f8`; complete once its byte order is known."""

    complete: bool = False


def load(content: bytes) -> object:
    """What the pickle holds: lists, tuples, dicts, bytes, numbers, None, and the classes above.

    Raises:
        RecordingError: truncated, corrupt, too-large, or unsupported-encoding: it needs more than arrays of 8-byte
            floats, and what it asks for is not done.
    """
    if content[:1] == b"\x80":
        raise rejection(
            "unsupported-encoding",
            f"The file is a pickle of protocol {content[1] if len(content) > 1 else '?'}; only protocol 0, "
            "in which Python 2 wrote, is read.",
        )
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # an escape that Python 2 never wrote
        return _Machine(content).run()


class _Mark:
    """Where the items of the next tuple, list or dict begin."""


_MARK = _Mark()
_INTEGER = re.compile(rb"-?[0-9]{1,18}")
_FLOAT = re.compile(rb"-?([0-9]{1,25}(\.[0-9]{0,25})?(e[+-]?[0-9]{1,3})?|inf|nan)")
_LITTLE_ENDIAN = (3, b"<", None, None, None, -1, -1, 0)


class _Machine:
    """The stack and the memo of one pickle."""

    def __init__(self, content: bytes) -> None:
        self._content, self._at = content, 0
        self._stack: list[object] = []
        self._memo: dict[int, object] = {}

    def run(self) -> object:
        for _ in range(MAX_OPCODES):
            code = self._content[self._at : self._at + 1]
            self._at += 1
            if code == b".":
                return self._result()
            if not code:
                raise _truncated()
            if code not in self._STEPS:
                raise rejection(
                    "unsupported-encoding",
                    f"The pickle has the opcode {code!r} at byte {self._at - 1}, which arrays do not need; it is "
                    "refused.",
                )
            self._STEPS[code](self)
        raise rejection("too-large", f"The pickle has more than {MAX_OPCODES:,} opcodes; joint arrays need far fewer.")

    def _result(self) -> object:
        result = self._pop()
        if self._stack or self._at != len(self._content):
            raise _corrupt("has something beside or after its one object")
        return result

    def _line(self) -> bytes:
        end = self._content.find(b"\n", self._at)
        if end < 0:
            raise _truncated()
        line = self._content[self._at : end]
        self._at = end + 1
        return line

    def _pop(self) -> object:
        if not self._stack or self._stack[-1] is _MARK:
            raise _corrupt("takes a value where there is none")
        return self._stack.pop()

    def _top(self) -> object:
        value = self._pop()
        self._stack.append(value)
        return value

    def _since_mark(self) -> list[object]:
        items: list[object] = []
        while self._stack:
            item = self._stack.pop()
            if item is _MARK:
                return items[::-1]
            items.append(item)
        raise _corrupt("closes a group that was not opened")

    def _mark(self) -> None:
        self._stack.append(_MARK)

    def _none(self) -> None:
        self._stack.append(None)

    def _int(self) -> None:
        line = self._line()
        self._stack.append(line == b"01" if line in (b"00", b"01") else _integer(line))

    def _float(self) -> None:
        line = self._line()
        if not _FLOAT.fullmatch(line):
            raise _corrupt("has a number that is none, or is too long")
        self._stack.append(float(line))

    def _string(self) -> None:
        line = self._line()
        if len(line) < 2 or line[:1] not in (b"'", b'"') or line[-1:] != line[:1]:
            raise _corrupt("has a text without quotes")
        try:
            self._stack.append(codecs.escape_decode(line[1:-1])[0])
        except (ValueError, DeprecationWarning):
            raise _corrupt("has a text with a broken escape") from None

    def _tuple(self) -> None:
        self._stack.append(tuple(self._since_mark()))

    def _list(self) -> None:
        self._stack.append(self._since_mark())

    def _dict(self) -> None:
        if self._since_mark():
            raise _corrupt("fills a dict in a way that protocol 0 does not")
        self._stack.append({})

    def _append(self) -> None:
        item, target = self._pop(), self._top()
        if not isinstance(target, list):
            raise _corrupt("appends to what is no list")
        target.append(item)

    def _set_item(self) -> None:
        value, key, target = self._pop(), self._pop(), self._top()
        if not isinstance(target, dict) or not isinstance(key, bytes):
            raise _corrupt("sets an item of what is no dict of texts")
        target[key.decode("latin-1")] = value

    def _put(self) -> None:
        self._memo[_integer(self._line())] = self._top()

    def _get(self) -> None:
        index = _integer(self._line())
        if index not in self._memo:
            raise _corrupt(f"refers to object {index}, which it does not have")
        self._stack.append(self._memo[index])

    def _global(self) -> None:
        name = self._line() + b" " + self._line()
        if name not in _KNOWN:
            raise _refused(f"names {name.replace(b' ', b'.')[:80].decode('ascii', 'backslashreplace')}")
        self._stack.append(_KNOWN[name])

    def _reduce(self) -> None:
        arguments, function = self._pop(), self._pop()
        if function is Name.RECONSTRUCT and arguments == (Name.NDARRAY, (0,), b"b"):
            self._stack.append(Array())
        elif function is Name.DTYPE and isinstance(arguments, tuple) and arguments[1:] == (0, 1):
            if arguments[0] != b"f8":
                kind = arguments[0][:8] if isinstance(arguments[0], bytes) else b"?"
                raise _refused(f"holds arrays of the type {kind.decode('ascii', 'backslashreplace')}")
            self._stack.append(_Dtype())
        elif function is Name.SCALAR and isinstance(arguments, tuple) and len(arguments) == 2:
            self._stack.append(float(_values(arguments[0], (1,), arguments[1])[0]))
        elif function is Name.NEW_OBJECT and arguments == (Name.TRAJECTORY, Name.OBJECT, None):
            self._stack.append(Trajectory({}))
        else:
            raise _refused("calls something")

    def _build(self) -> None:
        state, target = self._pop(), self._top()
        if isinstance(target, _Dtype) and state == _LITTLE_ENDIAN:
            target.complete = True
        elif isinstance(target, Array) and isinstance(state, tuple) and len(state) == 5 and state[0] == 1:
            _, shape, dtype, fortran, data = state
            flat = _values(dtype, shape, data)
            target.values = flat.reshape(shape, order="F" if fortran else "C")
        elif isinstance(target, Trajectory) and isinstance(state, dict):
            target.attributes = state
        else:
            raise _refused("sets the state of something")

    _STEPS: ClassVar[dict[bytes, Callable[[_Machine], None]]] = {
        b"(": _mark, b"N": _none, b"I": _int, b"F": _float, b"S": _string, b"t": _tuple, b"l": _list, b"d": _dict,
        b"a": _append, b"s": _set_item, b"p": _put, b"g": _get, b"c": _global, b"R": _reduce, b"b": _build,
    }  # fmt: skip


_KNOWN = {name.value: name for name in Name}


def _values(dtype: object, shape: object, data: object) -> FloatArray:
    """The flat array over `data`, if it has what `shape` says."""
    if not isinstance(dtype, _Dtype) or not dtype.complete:
        raise _refused("has an array of an unknown type")
    if not isinstance(shape, tuple) or len(shape) not in (1, 2) or not all(type(n) is int and n > 0 for n in shape):
        raise _refused("has an array without entries or not of one or two axes")
    if not isinstance(data, bytes) or len(data) != 8 * math.prod(shape):
        raise _corrupt("has an array whose shape does not fit its data")
    return np.frombuffer(data, "<f8")


def _integer(text: bytes) -> int:
    if not _INTEGER.fullmatch(text):
        raise _corrupt("has a whole number that is none, or is too long")
    return int(text)


def _refused(what: str) -> RecordingError:
    return rejection(
        "unsupported-encoding",
        f"The pickle {what}; only arrays of little-endian 8-byte floats and trajectories of them are read, nothing is "
        "run.",
    )


def _corrupt(what: str) -> RecordingError:
    return rejection("corrupt", f"The pickle {what}.")


def _truncated() -> RecordingError:
    return rejection("truncated", "The pickle ends before its end mark.")
