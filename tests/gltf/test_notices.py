"""The notices of a run: what the versions of a document tell."""

from __future__ import annotations

from fixtures.make_fixtures import FOLDER
from skinbake.errors import InputError, Notice, Place, noticed
from skinbake.gltf.document import read_document

FIRST, SECOND = (Notice(code, "something is assumed", Place("a.glb")) for code in ("first", "second"))


def test_versions_of_a_document_tell_a_notice_once_in_order() -> None:
    document = read_document(str(FOLDER / "seam.glb"))
    document.edited(json={}).notices.tell(SECOND, FIRST)
    document.notices.tell(FIRST, SECOND)
    assert list(document.notices) == [SECOND, FIRST]
    assert not list(read_document(str(FOLDER / "seam.glb")).notices)


def test_what_is_withheld_is_told_only_by_its_user() -> None:
    document = read_document(str(FOLDER / "seam.glb"))
    document.notices.tell(FIRST)
    with document.notices.withheld() as found:
        document.notices.tell(SECOND)
        with document.notices.withheld():
            document.notices.tell(FIRST)
        assert list(document.notices) == [SECOND]
    assert (list(found), list(document.notices)) == ([SECOND], [FIRST])
    document.notices.tell(*found)
    assert list(document.notices) == [FIRST, SECOND]


def test_an_error_carries_what_was_told_until_then() -> None:
    document = read_document(str(FOLDER / "seam.glb"))
    error = InputError("it is broken")
    try:
        with noticed(document.notices):
            document.notices.tell(FIRST)
            with document.notices.withheld():
                document.notices.tell(SECOND)
            raise error
    except InputError:
        document.notices.tell(SECOND)
    assert error.notices == (FIRST,)
