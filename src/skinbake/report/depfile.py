"""Dependencies of outputs as rules that Make and Ninja read, escaped as GCC writes them (``-MD -MP``)."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

from skinbake.errors import OutputError, Place

TOLD_APART = re.compile(r"(\\*)([ #])|([$:])")
"""What is escaped. Backslashes are doubled before a space, and nowhere else."""

IN_NO_RULE = re.compile(r"[\x00-\x1f\x7f=;|^<>`*]|\\#|[\\:]$|\(.*\)$")
"""What Make, Ninja or both read as something else than a name, however it is escaped.

``lib(member)`` is a part of an archive to Make.
"""


def depfile(rules: Iterable[tuple[str, Sequence[str]]]) -> str:
    """Return the rules of (output, files read). A rule for each file read lets it vanish without an error.

    Raises OutputError for a name that no rule can hold.
    """
    made = [(output, tuple(dict.fromkeys(read))) for output, read in rules]
    lines = [f"{_name(output, is_output=True)}: {' '.join(map(_name, read))}\n" for output, read in made]
    every = dict.fromkeys(file for _, read in made for file in read)
    return "".join([*lines, *(f"\n{_name(file)}:\n" for file in every)])


def _name(name: str, *, is_output: bool = False) -> str:
    """Return a file's name as it stands in a rule."""
    wrong = IN_NO_RULE.search(name) or (is_output and re.search("%", name))
    if wrong:
        raise OutputError(
            f"its name cannot stand in a depfile: Make or Ninja would not read {wrong[0]!r} as a part of it. "
            "Rename the file",
            Place(name),
        )
    escaped = TOLD_APART.sub(_escaped, name)
    return f"./{escaped}" if escaped.startswith("~") else escaped  # ~ is a home folder to Make


def _escaped(found: re.Match[str]) -> str:
    if found[3] is not None:
        return "$$" if found[3] == "$" else r"\:"
    return f"{2 * found[1]}\\{found[2]}"
