"""The boundary at which an exception becomes a failed result: no file fails another one's work."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import TypeVar

from skinbake.errors import InputError, Place, SkinbakeError, defect

logger = logging.getLogger(__name__)

T = TypeVar("T")


def survived(work: Callable[[], T], failed: Callable[[SkinbakeError], T], file: str) -> T:
    """Return what ``work`` returns, or what ``failed`` makes of the exception that ended it.

    file is what a message names where the exception has no place.
    """
    try:
        return work()
    except SkinbakeError as error:
        failure = error
    except MemoryError:
        failure = InputError("it needs more memory than there is or --max-memory allows", Place(file))
    except Exception as error:  # a defect of ours: the other files must not suffer from it
        logger.debug("where it failed", exc_info=True)
        failure = defect(error, file)
    return failed(failure)
