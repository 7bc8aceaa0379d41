"""YAML of other people, read as plain data, and measured before it is built."""

from __future__ import annotations

from pipeline.errors import WorkbenchError

MOST_VALUES = 100_000
_SHORT = 20_000  # characters: without an anchor they cannot hold many values, and are not parsed twice


class YamlError(WorkbenchError):
    """A text is no YAML that is read here; the message says what it does, without its file."""


def plain_yaml(text: str, most: int = MOST_VALUES) -> object:
    """The document of a text: dictionaries, lists, texts, numbers, truth values and None.

    Aliases and merge keys are counted as often as they repeat, from the parser's events, so that a text that would grow
    without bound is refused before anything is built.

    Raises:
        YamlError: it is not YAML, is nested too deeply, or has more than `most` values once written out.
    """
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    try:
        if "&" in text or len(text) > _SHORT:
            _measure(text, most)
        document: object = YAML(typ="safe", pure=True).load(text)
    except RecursionError:
        raise YamlError("is nested too deeply") from None
    except (YAMLError, ValueError, OverflowError, TypeError) as error:
        raise YamlError(f"is not readable YAML ({' '.join(str(error).split())})") from None
    return document


def _measure(text: str, most: int) -> None:
    from ruamel.yaml import YAML
    from ruamel.yaml.events import AliasEvent, CollectionEndEvent, CollectionStartEvent, NodeEvent

    sizes = dict[str, int | None]()  # of what each anchor names; None while it is open
    open_: list[tuple[str | None, int]] = [(None, 0)]  # anchor and values so far of each collection around
    for event in YAML(typ="safe", pure=True).parse(text):
        if isinstance(event, CollectionStartEvent):
            open_.append((event.anchor, 1))
            if event.anchor is not None:
                sizes[event.anchor] = None
            continue
        if isinstance(event, CollectionEndEvent):
            anchor, size = open_.pop()
            if anchor is not None:
                sizes[anchor] = size
        elif isinstance(event, AliasEvent):
            repeated = sizes.get(event.anchor, 1)
            if repeated is None:
                raise YamlError("holds an alias of itself")
            size = repeated
        elif isinstance(event, NodeEvent):
            size = 1
            if event.anchor is not None:
                sizes[event.anchor] = size
        else:
            continue
        around, before = open_[-1]
        open_[-1] = (around, before + size)
        if before + size > most:
            raise YamlError(f"holds more than {most:,} values once its aliases are written out")
