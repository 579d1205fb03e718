"""Memory that was freed, and that the C library of Linux keeps for itself."""

from __future__ import annotations


def give_back_freed_memory() -> None:
    """Give the system what this process has freed. Other C libraries than glibc do so by themselves.

    glibc keeps arrays of up to 32 MB for later ones. After the preparation of a million vertices that is a
    third of all memory.
    """
    import ctypes  # few files are that large

    try:
        trim = ctypes.CDLL(None).malloc_trim
    except (AttributeError, OSError, TypeError):
        return
    trim(0)
