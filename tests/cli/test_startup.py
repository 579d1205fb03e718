"""The process around the command line: fast to start, and never a traceback."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

import skinbake
from skinbake.cli.main import COMMANDS
from skinbake.format.note import VERSION
from tests.support.command_line import LINUX, invoke, run
from tests.support.models import FOLDER, edited
from tests.support.signals import HEARING
from tests.support.strictness import missing_tool
from tests.support.tools import required_program

SEAM = FOLDER / "seam.glb"
HEAVY = (
    "DracoPy",
    "meshopt",
    "numpy",
    "scipy",
    "igl",
    "rich",
    "fsspec",
    "distributed",
    "skinbake.commands",
    "skinbake.gltf",
    "skinbake.gradients",
)
MODULES = """
import sys
from skinbake.cli.main import main
try:
    main(sys.argv[1:], prog_name="skinbake")
except SystemExit:
    pass
import json
print(json.dumps(sorted(sys.modules)), file=sys.stderr)
"""


def modules(*arguments: str) -> set[str]:
    process = run(*arguments, command=("-c", MODULES))
    return set(json.loads(process.stderr.decode().splitlines()[-1]))


@pytest.mark.parametrize("arguments", [["--help"], ["--version"], ["bake", "--help"], ["shader", "--help"]])
def test_help_imports_nothing_heavy(arguments: list[str]) -> None:
    loaded = modules(*arguments)
    assert "click" in loaded
    assert [name for name in HEAVY if name in loaded] == []


def test_the_list_of_commands_imports_none_of_them() -> None:
    loaded = modules("--help")
    assert [name for name in COMMANDS if f"skinbake.cli.{name}" in loaded] == []
    assert "logging" not in loaded


@pytest.mark.slow
def test_a_small_bake_imports_nothing_that_only_verify_needs(tmp_path: Path) -> None:
    loaded = modules("bake", str(SEAM), "-o", str(tmp_path / "out.glb"), "-q")
    assert "numpy" in loaded
    assert not {"scipy", "igl", "rich", "pygltflib", "DracoPy", "meshopt", "fsspec", "distributed"} & loaded


def test_help_names_every_command_and_the_exit_codes() -> None:
    text = " ".join(invoke("--help").stdout.split())
    for name, sentence in COMMANDS.items():
        assert f"{name} {sentence}" in text
    assert "Exit codes: 0 fine, 1 verification failed, 2 usage, 3 input cannot be read" in text


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_help(name: str) -> None:
    result = invoke(name, "--help")
    assert result.exit_code == 0
    assert result.stdout.startswith(f"Usage: skinbake {name}")


def test_version_is_the_package_s() -> None:
    process = run("--version")
    assert process.stdout.decode() == f"skinbake, version {skinbake.__version__}, file format {VERSION}\n"


@pytest.mark.slow
def test_the_script_is_installed_and_does_the_same(tmp_path: Path) -> None:
    script = shutil.which("skinbake", path=str(Path(sys.executable).parent))
    if script is None:
        missing_tool("skinbake is not installed, only importable")
    command = [script, "bake", str(SEAM), "-o", str(tmp_path / "a.glb")]
    first = subprocess.run(command, capture_output=True, check=True)
    second = run("bake", SEAM, "-o", tmp_path / "b.glb")
    assert first.stdout.replace(b"a.glb", b"b.glb") == second.stdout
    assert (tmp_path / "a.glb").read_bytes() == (tmp_path / "b.glb").read_bytes()


BREAKING = """
import sys
import skinbake.commands.inspect as inspect
def broken(*arguments):
    raise RuntimeError("a defect of skinbake")
inspect.inspect_file = broken
from skinbake.cli.main import entry_point
entry_point()
"""


@pytest.mark.slow
def test_a_defect_is_a_sentence_and_a_traceback_only_where_it_is_asked_for() -> None:
    process = run("inspect", SEAM, command=("-c", BREAKING))
    assert process.returncode == 3
    assert b"RuntimeError: a defect of skinbake" in process.stderr
    assert b"Traceback" not in process.stderr
    for flags in (["-vv"], ["-v", "-v"]):
        process = run("inspect", SEAM, *flags, command=("-c", BREAKING))
        assert b"Traceback" in process.stderr, flags


@pytest.mark.slow
@pytest.mark.parametrize("encoding", [pytest.param("latin-1", marks=pytest.mark.slow), "cp1252"])
@pytest.mark.parametrize("arguments", [["--help"], ["bake", "--help"], ["inspect", str(SEAM)]])
def test_any_encoding_of_the_terminal_will_do(encoding: str, arguments: list[str]) -> None:
    """Output to a pipe on Windows is cp1252, which has no α."""
    process = run(*arguments, env={"PYTHONIOENCODING": encoding, "PYTHONUTF8": "0"})
    assert (process.returncode, process.stderr) == (0, b"")


@pytest.mark.slow
def test_a_name_that_is_no_text_is_a_name(tmp_path: Path) -> None:
    if sys.platform != "linux":
        pytest.skip("only on Linux are names bytes")
    name = os.fsdecode(b"\xff\xfe.glb")
    shutil.copyfile(SEAM, tmp_path / name)
    for arguments in (["--in-place"], ["--dry-run", "--json"], ["-o", os.fsdecode(b"\xfd.gltf")]):
        process = run("bake", name, *arguments, folder=tmp_path, env={"PYTHONIOENCODING": "utf-8"})
        assert process.returncode == 0, (arguments, process.stderr)


@pytest.mark.slow
def test_lone_surrogates_in_a_mesh_s_name_can_be_shown(tmp_path: Path) -> None:
    path = edited("seam.glb", tmp_path, lambda content: content["meshes"][0].update(name="\ud800"))
    process = run("inspect", path, env={"PYTHONIOENCODING": "utf-8"})
    assert process.returncode == 0, process.stderr


def shell(line: str) -> subprocess.CompletedProcess[bytes]:
    bash = required_program("bash")
    line = f'set -o pipefail; skinbake() {{ "{sys.executable}" -m skinbake "$@"; }}; {line}'
    return subprocess.run([bash, "-c", line], capture_output=True, check=False, timeout=60)


FULL = pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full here")


@FULL
@pytest.mark.parametrize(
    "command",
    [
        "bake {} -o -",
        *(
            pytest.param(command, marks=pytest.mark.slow)
            for command in (
                "bake {} --dry-run",
                "bake {} --dry-run --json",
                "inspect {}",
                "inspect {} --json",
                "bake --help",
            )
        ),
        "--version",
    ],
)
def test_a_full_disk_behind_stdout_is_an_output_error(command: str) -> None:
    process = shell(f"skinbake {command.format(SEAM)} > /dev/full")
    assert process.returncode == 4, process.stderr
    assert b"No space left on device" in process.stderr
    assert b"should not" not in process.stderr
    assert b"Traceback" not in process.stderr


@pytest.mark.slow
@pytest.mark.parametrize("command", ["bake {} -o -", "inspect {} --json", "bake --help"])
def test_a_reader_that_goes_away_gets_no_traceback(command: str) -> None:
    process = shell(f"set -o pipefail; skinbake {command.format(FOLDER / 'bent_tube.glb')} | true")
    assert process.returncode in {0, 4, 141}  # 0: all was written before; 4: the GLB was not
    assert b"Traceback" not in process.stderr
    assert b"Exception ignored" not in process.stderr


@pytest.mark.slow
@pytest.mark.parametrize("command", ["bake {} -o - >&-", "bake - -o - <&-", "inspect - <&-"])
def test_closed_streams_are_not_defects_of_skinbake(command: str) -> None:
    process = shell(f"skinbake {command.format(SEAM)}")
    assert process.returncode in {3, 4}
    assert b"should not" not in process.stderr


@pytest.mark.slow
@pytest.mark.parametrize(
    ("command", "code"),
    [
        ("verify {} --poses rest --json", 4),
        ("verify {} --poses rest", 4),
        ("verify {} --poses rest -q", 0),
        ("inspect {}", 4),
        ("inspect {} --json", 4),
        ("cost --json", 4),
        ("config", 4),
        ("shader --lang glsl", 4),
        ("bake {} --dry-run --json", 4),
        ("bake {} -o out.glb", 0),
        ("view {} -o page.html", 0),
    ],
)
def test_a_result_that_closed_stdout_cannot_take_is_an_error(command: str, code: int, tmp_path: Path) -> None:
    process = shell(f"cd {tmp_path}; skinbake {command.format(SEAM)} >&-")
    said = b"error: <stdout>: cannot be written: it is closed\n" if code else b""
    errors = [line for line in process.stderr.splitlines(keepends=True) if not line.startswith(b"warning: ")]
    assert (process.returncode, b"".join(errors)) == (code, said)


@LINUX
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_at_exit_needs_no_traceback(number: signal.Signals) -> None:
    script = (
        "import atexit, os, sys; from skinbake.cli.main import entry_point; "
        f"atexit.register(os.kill, os.getpid(), {int(number)}); sys.argv[1:] = ['--version']; entry_point()"
    )
    process = subprocess.run([sys.executable, "-c", HEARING, "-c", script], capture_output=True, check=False)
    assert (process.returncode, process.stderr) == (-number, b"")


@pytest.mark.slow
@LINUX
def test_ctrl_c_while_click_is_imported_needs_no_traceback() -> None:
    script = """
import signal, sys
class Interrupting:
    def find_spec(self, name, path, target=None):
        if name == "click":
            signal.raise_signal(signal.SIGINT)
sys.meta_path.insert(0, Interrupting())
from skinbake.__main__ import run
run()
"""
    for signals, code in ((HEARING, -signal.SIGINT), (HEARING.replace("SIG_DFL", "SIG_IGN"), 0)):
        command = [sys.executable, "-c", signals, "-c", script, "--version"]
        process = subprocess.run(command, capture_output=True, check=False)
        assert (process.returncode, process.stderr) == (code, b"")


@pytest.mark.slow
def test_a_short_run_spends_no_time_on_garbage(tmp_path: Path) -> None:
    """Python looked 80 times during the imports, and at exit once more through all that they had made."""
    script = """
import atexit, gc
from skinbake.__main__ import run
searches = []
gc.callbacks.append(lambda phase, found: searches.append(phase))
atexit.register(lambda: print(len(searches), len(gc.get_objects()) < gc.get_freeze_count() / 100))
run()
"""
    command = [sys.executable, "-c", script, "bake", str(SEAM), "-o", str(tmp_path / "a.glb"), "-q"]
    process = subprocess.run(command, capture_output=True, text=True, check=True)
    assert process.stdout == "0 True\n"


@LINUX
@pytest.mark.slow
@pytest.mark.parametrize(
    ("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGHUP, 129)]
)
def test_an_interrupt_ends_without_a_traceback_or_a_file(
    number: signal.Signals, code: int, tmp_path: Path
) -> None:
    process = subprocess.Popen(
        [sys.executable, "-c", HEARING, "-m", "skinbake", "bake", "-", "-o", str(tmp_path / "out.glb")],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    # It waits for stdin once numpy is there.
    deadline = time.monotonic() + 20
    while "numpy" not in Path(f"/proc/{process.pid}/maps").read_text() and time.monotonic() < deadline:
        time.sleep(0.05)
    time.sleep(0.5)
    process.send_signal(number)
    _, errors = process.communicate(timeout=20)
    assert process.returncode == code
    assert b"Traceback" not in errors
    assert list(tmp_path.iterdir()) == []
