"""The boundary at which an exception becomes a failed result. A failing file does not stop other files."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from skinbake.errors import InputError, Place, SkinbakeError, defect

T = TypeVar("T")


def survived(work: Callable[[], T], failed: Callable[[SkinbakeError], T], file: str) -> T:
    """Return the result of ``work``. If an exception ends it, return the result of ``failed``.

    A message names ``file`` if the exception has no place.
    """
    try:
        return work()
    except SkinbakeError as error:
        failure = error
    except MemoryError:
        failure = InputError("it needs more memory than there is or --max-memory allows", Place(file))
    except Exception as error:  # a defect of skinbake must not harm the other files
        import logging  # it takes some milliseconds

        logging.getLogger(__name__).debug("where it failed", exc_info=True)
        failure = defect(error, file)
    return failed(failure)
