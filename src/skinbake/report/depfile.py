"""Dependencies of outputs as rules that Make and Ninja read, escaped as GCC writes them (``-MD -MP``)."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Sequence
from pathlib import Path

from skinbake.errors import OutputError, Place

ESCAPED = re.compile("[ #:]")
"""What a backslash makes a part of the name, for Make and for Ninja."""

IN_NO_RULE = re.compile(
    r"""
      ^(?:\./+)*(?:\.[A-Z]|\.[^/]*$|[-~\ufeff])  # .IGNORE, .c.o, -lm, ~root, a mark of UTF-8. Make drops ./
    | [^\w+,./@!{}()~\ #:\x80-\U0010ffff-]
    | [\ :)]$                                    # lib(member), also with the member in the next name
    """,
    re.VERBOSE | re.ASCII,
)
"""What Make, Ninja or both read as something else than a name, however it is escaped.

All characters that are not listed here count: names come from strangers, and a name that is misread is a rule
that the user has not written. Make reads ``$`` twice after ``.SECONDEXPANSION``, and runs ``$(shell …)``.
``[a]`` is a pattern that also finds ``a``. ``.c`` is a suffix rule: its recipe overwrites the file under
``make -B``. Ninja 1.11 ends a name at quotes and at ``&``.
"""


def depfile(rules: Iterable[tuple[str, Sequence[str]]]) -> str:
    """Return the rules of (output, files read). A rule for each file read lets it vanish without an error.

    Raises OutputError for a name that no rule can hold.
    """
    made = [(output, tuple(dict.fromkeys(read))) for output, read in rules]
    lines = [f"{_name(output)}: {' '.join(map(_name, read))}\n" for output, read in made]
    every = dict.fromkeys(file for _, read in made for file in read)
    return "".join([*lines, *(f"\n{_name(file)}:\n" for file in every)])


def prerequisites(source: str, files: Iterable[str]) -> tuple[str, ...]:
    """Return absolute paths as they stand in rules: relative to the current folder if the source is relative.

    Raises OutputError for a name that no rule can hold. Call it before the output is written: an output
    without its rule would count as new at the next build.
    """
    named = tuple(file if Path(source).is_absolute() else _relative(file) for file in files)
    for name in named:
        _name(name)
    return named


def _relative(path: str) -> str:
    try:
        return os.path.relpath(path)
    except ValueError:  # another drive of Windows
        return path


def _name(name: str) -> str:
    """Return a file's name as it stands in a rule."""
    wrong = IN_NO_RULE.search(name)
    if wrong:
        raise OutputError(
            f"its name cannot stand in a depfile: Make or Ninja would not read {wrong[0]!r} as a part of it. "
            "Rename the file",
            Place(name),
        )
    return ESCAPED.sub(lambda found: f"\\{found[0]}", name)
