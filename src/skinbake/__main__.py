"""The start of the command line: of ``skinbake``, and of ``python -m skinbake``."""

from __future__ import annotations

import gc
import signal


def run() -> None:
    """Run the command line. Ctrl-C during its imports ends the process at once, without a traceback."""
    if signal.getsignal(signal.SIGINT) == signal.default_int_handler:  # otherwise it is to be ignored
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    # Imports make hardly any garbage, and the search at exit finds nothing that is worth its time. Together
    # all searches take a fifth of the time of a short run.
    gc.set_threshold(100_000)
    try:
        from skinbake.cli.main import entry_point

        entry_point()
    finally:
        gc.freeze()


if __name__ == "__main__":
    run()
