"""The result has the error that a command raises, and no exception passes the boundary of a file."""

from __future__ import annotations

import logging
import pickle
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from skinbake.commands.bake import bake_file
from skinbake.commands.verify import verify_file
from skinbake.errors import InputError, Notice, OutputError, Place, SkinbakeError, noticed
from skinbake.jobs.bake import Bake
from skinbake.jobs.file_work import FileWork
from skinbake.jobs.verify import Verify
from skinbake.jobs.work import Job, survived
from skinbake.measure.options import VerifyOptions
from tests.support.models import FOLDER, sheet, write_model

MEMORY = "it needs more memory than there is or --max-memory allows"
SEAM = str(FOLDER / "seam.glb")


def raising(error: BaseException) -> Callable[..., None]:
    def work(*arguments: object) -> None:
        raise error

    return work


def test_an_error_of_ours_is_the_failure() -> None:
    error = InputError("it is broken", Place("a.glb"))
    assert survived(raising(error), lambda failure: failure, "b.glb") is error


def test_memory_that_lacks_is_the_file_s_own_failure() -> None:
    failure = survived(raising(MemoryError()), lambda failure: failure, "b.glb")
    assert (type(failure), str(failure)) == (InputError, f"b.glb: {MEMORY}")


def test_a_defect_is_said_and_where_it_failed_is_logged(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.DEBUG, "skinbake.jobs.work"):
        failure = survived(raising(KeyError("x")), lambda failure: failure, "b.glb")
    assert str(failure).startswith("b.glb: skinbake failed where it should not: KeyError: 'x'. ")
    assert "KeyError: 'x'" in caplog.text
    assert "Traceback" in caplog.text


def test_an_interrupt_passes() -> None:
    with pytest.raises(KeyboardInterrupt):
        survived(raising(KeyboardInterrupt()), lambda failure: None, "b.glb")


@pytest.mark.parametrize("where", ["commands", "URLs"])
def test_bake_and_verify_say_the_same_of_lacking_memory(where: str, monkeypatch: pytest.MonkeyPatch) -> None:
    source = SEAM if where == "commands" else "memory://b/seam.glb"
    lacking = raising(MemoryError())
    monkeypatch.setattr("skinbake.jobs.bake.bake_file", lacking)
    monkeypatch.setattr("skinbake.jobs.verify.verify_file", lacking)
    monkeypatch.setattr("skinbake.jobs.remote.storages.Storage.fetch_file", lacking)
    baked, verified = (
        FileWork((Bake(),))(Job(source)),
        FileWork((Verify(VerifyOptions()),))(Job(source)),
    )
    assert str(baked.error) == str(verified.error) == f"{source}: {MEMORY}"


def test_commands_raise(tmp_path: Path) -> None:
    broken = tmp_path / "broken.glb"
    broken.write_bytes(b"glTF")
    with pytest.raises(InputError, match=r"broken\.glb: ") as raised:
        bake_file(str(broken), str(tmp_path / "out.glb"))
    assert raised.value.notices == ()
    with pytest.raises(InputError, match=r"broken\.glb: "):
        verify_file(str(broken), VerifyOptions())
    for result in (
        FileWork((Bake(),))(Job(str(broken), str(tmp_path / "out.glb"))),
        FileWork((Verify(VerifyOptions()),))(Job(str(broken))),
    ):
        assert str(result.error) == str(raised.value)


def test_an_error_in_writing_carries_what_was_noticed_before(tmp_path: Path) -> None:
    model = write_model(tmp_path / "a.glb", [sheet(WEIGHTS_0=np.full((20, 4), 0.5, np.float32))])
    noticed_before = bake_file(str(model), None).notices
    assert [notice.code for notice in noticed_before] == ["weights-sum", "joints-repeated"]
    target = str(model / "b.glb")  # a file is not a folder
    with pytest.raises(OutputError) as raised:
        bake_file(str(model), target)
    assert raised.value.notices == noticed_before
    assert FileWork((Bake(),))(Job(str(model), target)).notices == noticed_before
    assert pickle.loads(pickle.dumps(raised.value)).notices == noticed_before


def test_what_was_noticed_first_comes_first() -> None:
    first, second = (Notice(code, "it is odd", Place("a.glb")) for code in ("first", "second"))
    error = SkinbakeError("no more")
    with pytest.raises(SkinbakeError), noticed([first]), noticed([second]):
        raise error
    assert error.notices == (first, second)
