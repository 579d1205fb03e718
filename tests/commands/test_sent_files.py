"""Plain paths for other machines: the files travel with the job, and what is made of them travels back."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import pytest

from skinbake.commands.verify import verify_file
from skinbake.errors import ChoiceError, InputError, OutputError
from skinbake.files.bounds import Bounds, Within
from skinbake.gltf.output import Writing
from skinbake.jobs.remote.sent_files import DoneHere, WorkWithFiles
from skinbake.jobs.work import Job
from skinbake.measure.options import VerifyOptions
from tests.commands.file_works import baking, verifying
from tests.support.libraries import stored, tree, upload, write_library


def elsewhere(work: Any, job: Job, hidden: Path | None = None) -> Any:
    """Do a job as another machine would: all by pickles, and with a folder out of sight meanwhile."""
    writing = getattr(work.command, "writing", Writing())
    sending = WorkWithFiles(work, writing)
    packed = sending.with_files(job)
    if isinstance(packed, DoneHere):
        return packed.result
    sent = pickle.dumps((sending, packed))
    away = None if hidden is None else hidden.rename(hidden.with_name("out of sight"))
    there, arrived = pickle.loads(sent)
    returned = pickle.loads(pickle.dumps(there.result_there(arrived, None)))
    if hidden is not None and away is not None:
        away.rename(hidden)
    return sending.result_here(job, returned)


def in_tree(source: str, target: str, name: str) -> Job:
    """Return the job of a file that was found in a folder, for a tree of the same shape."""
    return Job(f"{source}/{name}", f"{target}/{name}", within=Within(Bounds(source), target))


def test_what_comes_back_is_what_a_bake_here_makes(tmp_path: Path) -> None:
    names = write_library(tmp_path / "disk/lib")
    for name in names:
        here = baking()(in_tree(f"{tmp_path}/disk/lib", f"{tmp_path}/disk/here", name))
        assert here.error is None
    for name in names:
        job = in_tree(f"{tmp_path}/disk/lib", f"{tmp_path}/disk/away", name)
        result = elsewhere(baking(), job, tmp_path / "disk")
        assert (result.input, result.output, result.status) == (job.source, job.target, "baked")
        assert {notice.place.file for notice in result.notices} <= {job.source}
    assert tree(tmp_path / "disk/away") == tree(tmp_path / "disk/here")


def test_in_place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    names = write_library(tmp_path / "here")
    write_library(tmp_path / "away")
    for name in names:
        assert baking()(in_tree(f"{tmp_path}/here", f"{tmp_path}/here", name)).error is None
    monkeypatch.chdir(tmp_path)
    for name in names:
        assert elsewhere(baking(), in_tree("away", "away", name), tmp_path / "away").error is None
    assert tree(tmp_path / "away") == tree(tmp_path / "here")


def test_in_place_a_file_that_was_saved_meanwhile_stays(tmp_path: Path) -> None:
    name = write_library(tmp_path)[0]
    path = tmp_path / name
    job = Job(str(path), str(path))
    sending = WorkWithFiles(baking(), Writing())
    packed = sending.with_files(job)
    assert not isinstance(packed, DoneHere)
    returned = sending.result_there(packed, None)
    path.write_bytes(b"saved by another program")
    error = sending.result_here(job, returned).error
    assert isinstance(error, OutputError)
    assert "another program has saved it since it was read, so it is not replaced" in error.message
    assert path.read_bytes() == b"saved by another program"


def test_between_the_disk_and_a_storage(tmp_path: Path) -> None:
    name = write_library(tmp_path / "lib")[0]
    upload(tmp_path / "lib", "memory://shipping/lib")
    assert baking()(Job(f"{tmp_path}/lib/{name}", f"{tmp_path}/here.glb")).error is None
    to_url = Job(f"{tmp_path}/lib/{name}", "memory://shipping/there.glb")
    assert elsewhere(baking(), to_url, tmp_path / "lib").error is None
    from_url = Job(f"memory://shipping/lib/{name}", f"{tmp_path}/back.glb")
    assert elsewhere(baking(), from_url).error is None
    expected = (tmp_path / "here.glb").read_bytes()
    assert stored("memory://shipping")["there.glb"] == expected == (tmp_path / "back.glb").read_bytes()


def test_verdicts_come_back(tmp_path: Path) -> None:
    name = write_library(tmp_path / "lib")[0]
    baked = tmp_path / "baked" / "a.glb"
    baking()(Job(f"{tmp_path}/lib/{name}", str(baked)))
    here = verify_file(str(baked), VerifyOptions())
    assert here.passed
    assert elsewhere(verifying(), Job(str(baked)), baked.parent) == here


def test_files_of_others_beside_the_target_are_left_alone(tmp_path: Path) -> None:
    name = write_library(tmp_path / "lib")[-1]
    for side in ("here", "away"):
        folder = tmp_path / side / "props"
        (folder / "maps").mkdir(parents=True)
        (folder / "crate #1.bin").write_bytes(b"not ours")
        (folder / "maps/wood.png").write_bytes(b"wood")
    assert baking()(in_tree(f"{tmp_path}/lib", f"{tmp_path}/here", name)).error is None
    assert elsewhere(baking(), in_tree(f"{tmp_path}/lib", f"{tmp_path}/away", name)).error is None
    assert tree(tmp_path / "away")["props/crate #1.bin"] == b"not ours"
    assert tree(tmp_path / "away") == tree(tmp_path / "here")


def test_what_fails_is_said_as_on_one_machine(tmp_path: Path) -> None:
    name = write_library(tmp_path / "lib")[-1]
    source, gone = f"{tmp_path}/lib/{name}", f"{tmp_path}/gone/a.gltf"
    taken = f"{tmp_path}/taken.glb"
    Path(taken).mkdir()
    within = Within(Bounds(f"{tmp_path}/lib"))
    for work, job in (
        (baking(), Job(gone, f"{tmp_path}/a.glb")),
        (baking(), Job(source, f"{tmp_path}/a.glb")),
        (baking(), Job(source, taken, within=within)),
        (baking(dry_run=True), Job(source, taken, within=within)),
        (baking(), Job(source, f"{tmp_path}/lib/props/crate #1.bin", within=within)),
        (baking(warnings_as_errors=True), Job(source, f"{tmp_path}/a.gltf", within=within)),
        (verifying(), Job(gone)),
    ):
        before = tree(tmp_path)
        here, away = work(job), elsewhere(work, job)
        assert type(away.error) is type(here.error) in {InputError, OutputError}
        assert str(away.error) == str(here.error)
        assert set(here.notices) <= set(away.notices)
        assert tree(tmp_path) == before


def test_a_dry_run_writes_nothing(tmp_path: Path) -> None:
    name = write_library(tmp_path / "lib")[-1]
    before = tree(tmp_path)
    job = Job(f"{tmp_path}/lib/{name}", f"{tmp_path}/a.gltf", within=Within(Bounds(f"{tmp_path}/lib")))
    result = elsewhere(baking(dry_run=True), job, tmp_path / "lib")
    assert (result.status, result.error) == ("baked", None)
    assert tree(tmp_path) == before


def test_an_image_that_is_the_target_is_refused(tmp_path: Path) -> None:
    name = write_library(tmp_path / "lib")[-1]
    source = tmp_path / "lib" / name
    content = source.read_text().replace("maps/wood.png", "wood.glb")
    source.write_text(content.replace("../common/motion.bin", "motion.bin"))
    (tmp_path / "lib/common/motion.bin").rename(source.parent / "motion.bin")
    (source.parent / "maps/wood.png").rename(source.parent / "wood.glb")
    before = tree(tmp_path)
    result = elsewhere(baking(), Job(str(source), f"{source.parent}/wood.glb"))
    assert "it is a file of the input" in str(result.error)
    assert tree(tmp_path) == before


def test_standard_streams_are_for_one_process(tmp_path: Path) -> None:
    for job in (Job("-", f"{tmp_path}/a.glb"), Job(f"{tmp_path}/a.glb", "-")):
        assert isinstance(elsewhere(baking(), job).error, ChoiceError)
