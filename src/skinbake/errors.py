"""Errors and notices, each with the place where it was found.

The tree::

    SkinbakeError
    ├── InputError                  the file cannot be read, or is not valid glTF        exit 3
    │   ├── UnsupportedFeatureError it is valid, and this version cannot process it      exit 3
    │   └── BudgetError             it asks for too much memory or work for its size     exit 3
    ├── OutputError                 the result cannot be written                         exit 4
    │   └── ReaderGoneError         its reader has left                                  exit 141
    └── ChoiceError                 an option has a value that it does not take          exit 2

A file that was read and does not pass verification is not an error: it is a verdict (exit 1).
"""

from __future__ import annotations

import copyreg
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any, NamedTuple, Self


def printable(text: str) -> str:
    """Return text from a file with control characters escaped: a name cannot forge lines or colours."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text)


def printable_lines(text: str) -> str:
    """Return text with control characters escaped, but for the ends of its lines."""
    if text.isascii() and text.isprintable():
        return text
    return "\n".join(map(printable, text.split("\n")))


class Place(NamedTuple):
    """Where in which file: every message about data carries one."""

    file: str
    mesh: int | None = None
    mesh_name: str | None = None
    primitive: int | None = None
    attribute: str | None = None

    def at(self, attribute: str) -> Place:
        """Return this place, narrowed to one attribute (or ``indices``) of the primitive."""
        return self._replace(attribute=attribute)

    @property
    def within_file(self) -> str:
        """Read like ``mesh 2 "Body", primitive 0, WEIGHTS_0``; empty for the file as a whole."""
        parts = []
        if self.mesh is not None:
            name = f' "{printable(self.mesh_name)}"' if self.mesh_name else ""
            parts.append(f"mesh {self.mesh}{name}")
        if self.primitive is not None:
            parts.append(f"primitive {self.primitive}")
        if self.attribute is not None:
            parts.append(printable(self.attribute))
        return ", ".join(parts)

    def __str__(self) -> str:
        """Read like ``hero.glb: mesh 2 "Body", primitive 0, WEIGHTS_0``."""
        file = printable(self.file)
        return f"{file}: {self.within_file}" if self.within_file else file


class Chosen(NamedTuple):
    """An option in a message, by its declared name, and the value that it has or needs there, if any."""

    option: str
    value: object = ...


class Message(str):
    """A message in which options are named as the command line does, with these options as data.

    ``parts`` are its words and the options between them. A front end that has other words for options takes
    ``worded``.
    """

    parts: tuple[str | Chosen, ...]

    def __new__(cls, *parts: str | Chosen) -> Self:
        """Join the parts."""
        message = super().__new__(cls, _joined(parts, _typed))
        message.parts = parts
        return message

    def worded(self, words_of: Callable[[Chosen], str]) -> str:
        """Return the message with the words that a front end has for options."""
        return _joined(self.parts, words_of)

    def __reduce__(self) -> tuple[Any, ...]:
        """Let another process have the options too."""
        return Message, self.parts


def _joined(parts: Sequence[str | Chosen], words_of: Callable[[Chosen], str]) -> str:
    return "".join(part if isinstance(part, str) else words_of(part) for part in parts)


def _typed(chosen: Chosen) -> str:
    """Return an option as it is typed. Only options whose flag is their name stand in a ``Message``."""
    flag = f"--{chosen.option.replace('_', '-')}"
    return flag if chosen.value is ... else f"{flag} {chosen.value}"


ADVICE = frozenset({"morph-normals", "no-targets", "nothing-to-correct"})
"""Codes of notices that are advice: see ``Notice.is_advice``."""


@dataclass(frozen=True, slots=True)
class Notice:
    """Something that had to be assumed or was left out, aggregated over one primitive or file.

    ``code`` is a stable identifier for scripts, ``message`` a sentence for people, a ``Message`` if it names
    options that other front ends have too. ``count`` is how many vertices, triangles or files it concerns.
    """

    code: str
    message: str
    place: Place
    count: int = 1

    def __str__(self) -> str:
        """Read like a compiler's line: place, then message."""
        return f"{self.place}: {self.message}"

    @property
    def is_advice(self) -> bool:
        """Whether the bake is sound as it is, and the notice says what could be added, or why not."""
        return self.code in ADVICE


@dataclass(frozen=True, slots=True)
class Skipped(Notice):
    """A primitive that bake leaves out. ``reason`` is the message without the word for that."""

    reason: str = ""


def skipped(code: str, place: Place, *reason: str | Chosen) -> Skipped:
    """Return the notice on a primitive that is left out for a reason."""
    return Skipped(code, Message("skipped: ", *reason), place, reason=Message(*reason))


class Notices:
    """The notices of a run, each once, in the order in which they were told.

    A document has them for all its edited versions, as it has its budget. What is kept to serve again tells
    nothing when it is made: its users tell, each time.
    """

    def __init__(self) -> None:
        self._told: dict[Notice, None] = {}

    def tell(self, *notices: Notice) -> None:
        """Add notices that nobody has told before."""
        self._told.update(dict.fromkeys(notices))

    def __iter__(self) -> Iterator[Notice]:
        """Yield the notices that were told so far."""
        return iter(tuple(self._told))

    @contextmanager
    def withheld(self) -> Iterator[Collection[Notice]]:
        """Keep apart what is told in the block: for what is only tried or measured.

        Yields the notices of the block. Its user tells those that count, after the block.
        """
        before, self._told = self._told, {}
        try:
            yield self._told.keys()
        finally:
            self._told = before


def warnings_in(notices: Iterable[Notice]) -> list[Notice]:
    """Return the notices that are not advice."""
    return [notice for notice in notices if not notice.is_advice]


class SkinbakeError(Exception):
    """Base of every error that skinbake raises on purpose.

    ``notices`` were told about the file before it failed.
    """

    def __init__(self, message: str, place: Place | None = None) -> None:
        super().__init__(f"{place}: {message}" if place else message)
        self.message = message
        self.place = place
        self.notices: tuple[Notice, ...] = ()


@contextmanager
def noticed(notices: Iterable[Notice]) -> Iterator[None]:
    """Give an error that leaves the block the notices that came before it."""
    try:
        yield
    except SkinbakeError as error:
        error.notices = tuple(dict.fromkeys((*notices, *error.notices)))
        raise


class InputError(SkinbakeError):
    """The input cannot be read, or is not valid glTF."""


def defect(error: Exception, file: str) -> InputError:
    """Return the error for an unexpected exception. Other files are still tried."""
    return InputError(
        f"skinbake failed where it should not: {type(error).__name__}: {error}. "
        "Please report it with the file; -vv shows where",
        Place(file),
    )


class UnsupportedFeatureError(InputError):
    """The input is valid, and uses something that this version cannot process."""


class BudgetError(InputError):
    """A file asks for more memory or work than it may. No search passes over it to another part.

    Users meet it as an ``InputError``.
    """


class BrokenPassedOver(suppress):
    """A block that a broken part of a file ends without an error. Too much work is no such part."""

    def __init__(self) -> None:
        super().__init__(InputError)

    def __exit__(self, kind: type[BaseException] | None, error: object, trace: object) -> bool:
        """Tell whether the block goes on behind what ended it."""
        return kind is not None and issubclass(kind, InputError) and not issubclass(kind, BudgetError)


class OutputError(SkinbakeError):
    """The output cannot be written. ``reason`` says why, without the words that say so."""

    def __init__(self, message: str, place: Place | None = None, *, reason: str = "") -> None:
        super().__init__(message, place)
        self.reason = reason or message


def not_written(reason: object, place: Place, kind: type[OutputError] = OutputError) -> OutputError:
    """Return the error for an output that cannot be written for a reason."""
    return kind(f"cannot be written: {reason}", place, reason=str(reason))


class ReaderGoneError(OutputError):
    """The reader of the output has left."""


def in_python(chosen: Chosen) -> str:
    """Return ``encoding='float32'``, or the name of an option without a value."""
    option, value = chosen
    if value is ...:
        return option
    return f"{option}={(str(value) if isinstance(value, str) else value)!r}"


class ChoiceError(SkinbakeError):
    """An option has a value that it does not take, or that contradicts another option.

    ``option``, ``value`` and ``expected`` are the data of it. The value is ``...`` if it does not matter. For
    a contradiction, ``reason`` follows the option in the message, and ``expected`` is empty. ``options`` are
    all that the message is about, ``also`` those that it does not name. The message names options as Python
    does; ``worded`` names them in another way.
    """

    def __init__(
        self,
        option: str,
        value: object = ...,
        expected: str = "",
        *,
        reason: Sequence[str | Chosen] = (),
        also: Sequence[str] = (),
        place: Place | None = None,
    ) -> None:
        self.option, self.value, self.expected = option, value, expected
        self.parts = (Chosen(option, value), *(reason or (f": expected {expected}",)))
        self.options = [*(part.option for part in self.parts if isinstance(part, Chosen)), *also]
        super().__init__(self.worded(in_python), place)

    def worded(self, words_of: Callable[[Chosen], str]) -> str:
        """Return the message with the words that a front end has for options."""
        return _joined(self.parts, words_of)

    def __reduce__(self) -> tuple[Any, ...]:
        """Let another process have the error as it is."""
        return copyreg.__newobj__, (type(self), *self.args), self.__dict__  # type: ignore[attr-defined]
