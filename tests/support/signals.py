"""Programs that start a Python program with other signals than this process has."""

from __future__ import annotations

_START = """
import os, signal, sys
{signals}
os.execv(sys.executable, [sys.executable, *sys.argv[1:]])
"""

HEARING = _START.format(
    signals="signal.signal(signal.SIGINT, signal.SIG_DFL); signal.signal(signal.SIGHUP, signal.SIG_DFL)"
)
"""Children of a shell's background job ignore Ctrl-C, and those of nohup SIGHUP. This hears both."""

NOHUP = _START.format(signals="signal.signal(signal.SIGHUP, signal.SIG_IGN)")
"""The child ignores the end of the terminal."""

OWNING = _START.format(
    signals="import fcntl, termios; fcntl.ioctl(0, termios.TIOCSCTTY, 0); "
    "signal.signal(signal.SIGINT, signal.SIG_DFL); signal.signal(signal.SIGHUP, signal.SIG_DFL)"
)
"""A command that is started from a terminal hears of its end."""
