"""The options of click, made from their declarations, and errors about options in the words of a command."""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum
from typing import Any

import click
from click.shell_completion import CompletionItem

from skinbake.options import Option, Range, Text

ELSEWHERE = {
    "unity": "Unity takes no such shader. Bake with --correctives: docs/unity.md",
    "unreal": "Unreal takes no such shader. Bake with --correctives: docs/unreal.md",
}
"""Engines that are no target of shaders, and the page that shows what they take."""


class Words(click.Choice[str]):
    """The type of an option whose values are words. It asks about a word that is nearly one of them."""

    def get_invalid_choice_message(self, value: Any, ctx: click.Context | None) -> str:
        """Return the message for a value that is none of the words."""
        from skinbake.wording import did_you_mean, nearest

        message, known = super().get_invalid_choice_message(value, ctx), list(map(str, self.choices))
        engines = ELSEWHERE if "godot" in known else {}
        likeliest = nearest(str(value), [*known, *engines])[:1]
        if likeliest and likeliest[0] in engines:
            return f"{message} {engines[likeliest[0]]}"
        meant = did_you_mean(str(value), known)
        return f"{message} {meant[0].upper()}{meant[1:]}" if meant else message


class _Number(click.ParamType):  # type: ignore[type-arg]  # not in each version of click
    """The type of an option that takes finite numbers. It says how a number is written, and which fit."""

    def __init__(self, numbers: Range, *ends: Any, **of_click: Any) -> None:
        super().__init__(*ends, **of_click)
        self.numbers = numbers

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the number, or fail."""
        kind, like = (int, "a whole number like 4") if self.numbers.is_whole else (float, "a number like 1.5")
        try:
            found = kind(value)
        except ValueError:
            self.fail(f"expected {like}, found {value!r}", param, ctx)
        if found not in self.numbers:
            self.fail(f"expected {self.numbers}, found {value}", param, ctx)
        return found


class Number(_Number, click.types.FloatParamType):
    """Any finite number."""


class NumberInRange(_Number, click.FloatRange):
    """Numbers in a range, which help shows."""


class WholeNumber(_Number, click.IntRange):
    """Whole numbers in a range, which help shows."""


class Meaning(click.ParamType):  # type: ignore[type-arg]  # likewise
    """The type of an option whose text is read as something else."""

    name = "text"

    def __init__(self, text: Text) -> None:
        """Take what is expected, and how it is read."""
        self._text = text

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return what the text stands for, or fail."""
        try:
            return self._text.read(str(value))
        except ValueError:
            self.fail(f"expected {self._text.expected}, found {value!r}", param, ctx)


class PathName(click.types.StringParamType):
    """Text that a shell completes as a path. It may be a URL or ``-``, unlike that of click.Path."""

    def __init__(self, kind: str) -> None:
        """Take ``file`` or ``dir``."""
        self._kind = kind

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the path. Raises click.UsageError if it is empty, because a script's variable may be."""
        if not value:
            option = f"{param.opts[-1]}: " if isinstance(param, click.Option) else ""
            name = "the name" if option else "the name of an input"
            raise click.UsageError(f"{option}{name} is empty; is a variable of your script not set?", ctx)
        return super().convert(value, param, ctx)

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        """Have the shell complete the path."""
        return [CompletionItem(incomplete, type=self._kind)]


class DeclaredOption(click.Option):
    """The option of click for a declaration."""

    def __init__(self, declared: Option, words: Sequence[str] | None = None) -> None:
        """Take the declaration, and the words of an option that are known only at run time."""
        self.declared = declared
        attributes: dict[str, Any] = {"help": declared.help, "metavar": declared.metavar}
        if declared.values is bool:
            attributes["is_flag"] = True
        elif declared.values is int:
            attributes["count"] = True
        else:
            attributes |= {"type": _type_of(declared, words), "multiple": declared.is_many}
            if declared.default is not None and not declared.is_many:
                # click has a word in place of a member.
                plain = str(declared.default) if isinstance(declared.default, StrEnum) else declared.default
                attributes |= {"default": plain, "show_default": declared.shown}
            elif isinstance(declared.shown, str):
                attributes["show_default"] = declared.shown
        if declared.bare is not None:
            attributes |= {"is_flag": False, "flag_value": declared.bare}
        spellings = [*(declared.flags or (declared.flag,)), declared.name]
        super().__init__(spellings, required=declared.is_required, **attributes)


def _type_of(declared: Option, words: Sequence[str] | None) -> click.ParamType:  # type: ignore[type-arg]  # likewise
    values = words or declared.values
    if isinstance(values, Text):
        return Meaning(values)
    if isinstance(values, Range):
        if values.least is None:
            return Number(values)
        if values.is_whole:
            return WholeNumber(values, values.least, values.most)
        return NumberInRange(values, values.least, values.most, min_open=values.is_open)
    if values is str:
        kind = "dir" if declared.metavar == "DIR" else "file"
        return PathName(kind) if declared.is_path else click.STRING
    return Words([str(word) for word in values])  # type: ignore[union-attr]  # an enumeration has words too
