"""What a file that is replaced in place keeps: its owner, its mode, its extended attributes."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

from tests.support.command_line import document, invoke
from tests.support.models import copied


def replaced(path: Path, command: str) -> list[dict[str, str]]:
    """Bake a file in place, or strip the bake in place; return the warnings of the last run."""
    for each in ("bake", "strip")[: 1 if command == "bake" else 2]:
        result = invoke(each, path, "--in-place", "--json")
        assert result.exit_code == 0, result.stderr
    warnings: list[dict[str, str]] = document(result)["files"][0]["warnings"]
    return warnings


@pytest.mark.skipif(sys.platform == "win32", reason="modes are those of POSIX")
@pytest.mark.parametrize("command", ["bake", "strip"])
class TestKept:
    @pytest.mark.parametrize("mode", [0o600, 0o640, 0o4755, 0o444 | 0o200])
    def test_mode_and_owner(self, command: str, mode: int, tmp_path: Path) -> None:
        path = copied("seam.glb", tmp_path)
        if os.geteuid() == 0:
            os.chown(path, 12345, 23456)
        path.chmod(mode)
        before = path.stat()
        replaced(path, command)
        after = path.stat()
        assert (after.st_mode, after.st_uid, after.st_gid) == (before.st_mode, before.st_uid, before.st_gid)

    @pytest.mark.skipif(sys.platform != "linux", reason="Python reads extended attributes on Linux only")
    def test_extended_attributes(self, command: str, tmp_path: Path) -> None:
        path = copied("seam.glb", tmp_path)
        given = {"user.rights": b"CC BY \0 4.0", "user.empty": b""}
        try:
            for name, value in given.items():
                os.setxattr(path, name, value)
        except OSError:
            pytest.skip("this file system has no extended attributes")
        replaced(path, command)
        assert {name: os.getxattr(path, name) for name in os.listxattr(path)} == given

    @pytest.mark.parametrize("count", [1, 2])
    def test_hard_links_of_a_replaced_file_are_told(self, command: str, count: int, tmp_path: Path) -> None:
        path = copied("seam.glb", tmp_path)
        assert "hard-links" not in {one["code"] for one in replaced(path, command)}
        path = copied("seam.glb", tmp_path)
        if command == "strip":
            assert invoke("bake", path, "--in-place").exit_code == 0
        before = path.read_bytes()
        for number in range(count):
            os.link(path, tmp_path / f"{number}.other")
        result = invoke(command, path, "--in-place", "--json")
        (told,) = [one for one in document(result)["files"][0]["warnings"] if one["code"] == "hard-links"]
        assert f"{count} other name" in told["message"]
        assert {(tmp_path / f"{number}.other").read_bytes() for number in range(count)} == {before}
        assert path.read_bytes() != before


def test_a_new_output_does_not_take_over_attributes_of_the_file_it_replaces(tmp_path: Path) -> None:
    """They may tell of its bytes, such as a checksum."""
    if sys.platform != "linux":
        pytest.skip("Python reads extended attributes on Linux only")
    source, target = copied("seam.glb", tmp_path), tmp_path / "out.glb"
    target.write_bytes(b"before")
    try:
        os.setxattr(target, "user.checksum", b"1")
    except OSError:
        pytest.skip("this file system has no extended attributes")
    assert invoke("bake", source, "-o", target).exit_code == 0
    assert os.listxattr(target) == []
