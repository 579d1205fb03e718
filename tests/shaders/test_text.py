"""The promises of every text to its user: pure functions under one prefix, nothing unused."""

from __future__ import annotations

import re
from collections import Counter
from functools import cache

import pytest

from skinbake.choices import Language, Method
from skinbake.shaders.choices import ShaderChoices
from tests.shaders.combinations import every_stored_and_morphed, every_text, usage
from tests.support.whole_fields import shader_text

FUNCTION = re.compile(r"^(?:fn |[\w\[\]]+ )(\w+)\(", re.MULTILINE)
STRUCT = re.compile(r"^struct (\w+)", re.MULTILINE)
IMPURE = re.compile(
    r"^\s*(?:attribute|varying|uniform|buffer|layout|precision|override|in|out(?! float3 a\[)|static)\b"
    r"|\binverse\(|#import|#include|\bgl_|@\w|\bregister\(|Buffer<|\bcbuffer\b|\bSV_",
    re.MULTILINE,
)


@cache
def texts(language: Language) -> dict[str, tuple[ShaderChoices, str]]:
    """All choices of a language by name, with their text."""
    every = every_text(language) | every_stored_and_morphed(language)
    return {name: (choices, shader_text(choices)) for name, choices in every.items()}


def code(text: str) -> str:
    """The text without its comments."""
    return re.sub(r"//.*", "", text)


def outside_functions(text: str) -> str:
    """The code at module level, every pair of braces emptied, without directives."""
    found, depth = [], 0
    for character in re.sub(r"^#.*", "", code(text), flags=re.MULTILINE):
        depth -= character == "}"
        if depth == 0:
            found.append(character)
        depth += character == "{"
    assert depth == 0
    return "".join(found)


@pytest.mark.parametrize("language", Language)
class TestEveryText:
    @pytest.mark.slow
    def test_every_combination_has_a_text(self, language: Language) -> None:
        plain = Counter(
            (choices.method, choices.algorithm, choices.frame)
            for choices in every_text(language).values()
            if choices.cap is None
            and not choices.mirrored_joints
            and not choices.normal_map
            and not choices.scaled_joints
            and choices.influences <= 8
        )
        blended = {key: plain.pop(key) for key in list(plain) if key[0] is Method.BLEND}
        assert len(plain) == 12
        assert set(plain.values()) == {8}
        assert len(blended) == 4
        assert set(blended.values()) == {3}
        assert len({text for _, text in texts(language).values()}) == len(texts(language))

    @pytest.mark.slow
    def test_is_ascii_and_ends_in_one_newline(self, language: Language) -> None:
        for name, (_, text) in texts(language).items():
            assert text.isascii(), name
            assert text.replace("\n", "").isprintable(), name
            assert text.endswith("\n"), name
            assert not text.endswith("\n\n"), name
            assert not re.search(r"[ \t]$", text, re.MULTILINE), name

    @pytest.mark.slow
    def test_is_functions_and_structs_and_nothing_else(self, language: Language) -> None:
        for name, (_, text) in texts(language).items():
            assert not IMPURE.search(code(text)), name
            for declaration in re.split(r"\{\};?", outside_functions(text)):
                assert re.fullmatch(r"\s*|\s*struct \w+\s*|[^;=]*\)[^;=]*", declaration), (name, declaration)

    def test_names_begin_with_the_prefix_and_are_unique(self, language: Language) -> None:
        for name, (_, text) in texts(language).items():
            names = FUNCTION.findall(code(text)) + STRUCT.findall(code(text))
            assert len(names) >= 4, name
            assert len(set(names)) == len(names), name
            assert [found for found in names if not found.startswith("skinbake_")] == [], name
            macros = re.findall(r"#\w+ (\w+)", code(text))
            assert [found for found in macros if not found.startswith("SKINBAKE_")] == [], name

    @pytest.mark.slow
    def test_no_function_is_dead(self, language: Language) -> None:
        """The header names each function that the text does not call, or the function is for the host."""
        for name, (choices, text) in texts(language).items():
            names = FUNCTION.findall(code(text))
            uncalled = {found for found in names if len(re.findall(rf"\b{found}\(", code(text))) == 1}
            shown = "\n".join(usage(text))
            expected = {found for found in names if f"{found}(" in shown}
            assert len(expected) >= 2, name
            if choices.method != "lbs":  # for the host
                host = "scaled_motion" if choices.scaled_joints else "dual_quaternion"
                expected.add(f"skinbake_{host}")
            assert uncalled == expected, name

    def test_include_guards_nest(self, language: Language) -> None:
        """Each is opened by #ifndef and #define of one name, and closed; all code stands within one."""
        for name, (_, text) in texts(language).items():
            lines = [line for line in code(text).splitlines() if line.strip()]
            if language is Language.WGSL:
                assert not any(line.startswith("#") for line in lines), name
                continue
            depth, opened = 0, []
            for line, following in zip(lines, [*lines[1:], ""], strict=True):
                if line.startswith("#ifndef "):
                    depth += 1
                    opened.append(line.split()[1])
                    assert following == f"#define {opened[-1]}", name
                assert depth > 0, (name, line)
                depth -= line == "#endif"
            assert depth == 0, name
            assert len(set(opened)) == len(opened), name

    def test_reads_every_slot_that_it_has_and_no_other(self, language: Language) -> None:
        """Slot 0 has a weight, and no α and β."""
        for name, (choices, text) in texts(language).items():
            count = choices.influences
            expected = {f"weights_{slot // 4}.{'xyzw'[slot % 4]}" for slot in range(count)}
            for slot in range(1, count) if choices.reads_gradients else ():
                letter = "xyzw"[slot % 4] if slot >= 4 else "xyz"[slot - 1]
                expected |= {f"{kind}_{slot // 4}.{letter}" for kind in ("alpha", "beta")}
            assert set(re.findall(r"\b(?:weights|alpha|beta)_\d+\.\w+", code(text))) == expected, name


@pytest.mark.slow
def test_the_same_choices_give_the_same_text() -> None:
    for choices, text in texts(Language.WGSL).values():
        assert shader_text(choices) == text
