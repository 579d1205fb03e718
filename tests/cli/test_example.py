"""``skinbake example`` writes the model that the README begins with."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.command_line import invoke, run
from tests.support.models import FOLDER

TUBE = FOLDER / "bent_tube.glb"


def test_example_writes_the_fixture(tmp_path: Path) -> None:
    target = tmp_path / "new" / "hero.glb"
    result = invoke("example", "-o", target)
    assert (result.exit_code, result.stdout) == (0, f"{target}: an arm that bends, 99,880 bytes\n")
    assert target.read_bytes() == TUBE.read_bytes()


def test_example_writes_to_stdout() -> None:
    process = run("example", "-o", "-")
    assert (process.returncode, process.stdout, process.stderr) == (0, TUBE.read_bytes(), b"")


@pytest.mark.parametrize(
    ("target", "code", "said"),
    [
        (
            "hero.gltf",
            2,
            "hero.gltf: the example is a GLB; expected a name that ends in .glb, or - for stdout",
        ),
        ("{}", 2, "is a folder: name the file"),
        ("{}/file/hero.glb", 4, "file is a file, not a folder"),
    ],
)
def test_example_refuses_targets_that_are_no_glb_file(
    target: str, code: int, said: str, tmp_path: Path
) -> None:
    (tmp_path / "file").touch()
    result = invoke("example", "-o", target.format(tmp_path))
    assert result.exit_code == code
    assert said in result.stderr


def test_example_leaves_a_users_own_model_alone(tmp_path: Path) -> None:
    """The README's first command is pasted in any folder."""
    target = tmp_path / "hero.glb"
    for own in (b"mine", bytes(TUBE.stat().st_size)):
        target.write_bytes(own)
        result = invoke("example", "-o", target)
        assert result.exit_code == 4
        assert "another file has this name already; give the example a new one" in result.stderr
        assert target.read_bytes() == own


def test_example_may_be_written_twice(tmp_path: Path) -> None:
    target = tmp_path / "hero.glb"
    assert [invoke("example", "-o", target).exit_code for _ in range(2)] == [0, 0]
    assert target.read_bytes() == TUBE.read_bytes()
