"""Every option of every command, once: name, values, default, help, heading, and who may set it.

The command line, configuration files, help, the typed classes of options, and Blender's panel read these
declarations. The keywords of the Python API stand in its signatures too; a test holds both equal.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Callable, Collection, Iterable, Mapping
from enum import Flag, StrEnum, auto
from numbers import Integral, Real
from typing import Any, NamedTuple, TypeAlias, cast

from skinbake.choices import (
    POSES_EXPECTED,
    READERS_OF_FOUR,
    SLOTS_PER_SET,
    Baseline,
    CorrectiveAim,
    Encoding,
    Frame,
    FrameChoice,
    Gradients,
    Language,
    Layout,
    Lighting,
    Method,
    Morphs,
    Neighbours,
    PoseKind,
    Scheme,
    Stage,
    Truth,
    Weighting,
    Weld,
    pose_choice,
)
from skinbake.errors import ChoiceError, Chosen
from skinbake.threads import LARGEST
from skinbake.wording import did_you_mean

STATE_NAME = ".skinbake-state.jsonl"
"""The state file in the folder of the outputs. A file of this name belongs to skinbake."""

MOST_PROCESSES = 256
"""The largest number for --jobs. A configuration file of a stranger may ask for any number."""

MOST_CORRECTIVES = 32
"""The largest number for --correctives. Engines with limits morph eight attributes."""

PUBLISHED_CAP = 0.9
"""The limit of the paper's published demo."""

SMALLEST_SIDE, LARGEST_SIDE = 16, 2048
"""The sides of a picture, in pixels."""

PATHS = {"INPUT", "FILE", "BAKED_FILE", "PAGE", "PICTURE", "DIR"}
"""The metavars of names of files and folders."""

MEMORY = re.compile(r"(\d+(?:\.\d+)?) ?([KMGT]?)(?:i?B)?", re.IGNORECASE)


class Range(NamedTuple):
    """The numbers that an option takes: from ``least`` on, or above it if is_open; None: without an end."""

    least: int | None = None
    most: int | None = None
    is_whole: bool = False
    is_open: bool = False

    def __str__(self) -> str:
        """Return which numbers these are."""
        kind = "a whole number" if self.is_whole else "a number"
        if self.least is None:
            return kind
        if self.most is not None:
            return f"{kind} from {self.least} to {self.most}"
        return f"{kind} {'above' if self.is_open else 'of at least'} {self.least}"

    def __contains__(self, value: object) -> bool:
        """Tell whether a value is one of these numbers."""
        if not isinstance(value, Integral if self.is_whole else Real):
            return False
        number = cast("float", value)  # an integer may be larger than any float
        least = -math.inf if self.least is None else self.least
        above = number > least if self.is_open or self.least is None else number >= least
        return above and (number < math.inf if self.most is None else number <= self.most)


class Text(NamedTuple):
    """Text that stands for something else. ``read`` returns it, or raises ValueError."""

    expected: str
    read: Callable[[str], Any]
    is_number: bool = False


Values: TypeAlias = "type[StrEnum] | tuple[str, ...] | Range | Text | type[bool] | type[int] | type[str]"
"""The values of an option: words, numbers, text, a flag (bool), or a flag that is counted (int)."""


class By(Flag):
    """Who may set an option besides the command line.

    A configuration file may come with a stranger's repository. So it sets no option that names a file or a
    host, decides what is written, or lifts a limit.
    """

    TABLE = auto()
    """The table of a command in a configuration file."""
    OVERRIDE = auto()
    """An override for some files in a configuration file."""
    PYTHON = auto()
    """The functions of the Python API."""
    NOBODY = 0
    FILE = TABLE | OVERRIDE
    ALL = FILE | PYTHON


class Option(NamedTuple):
    """The declaration of an option.

    ``name`` is that of the value in the code. ``flags`` are the spellings of the command line if they do not
    follow from it. The command line shows the default, but not if ``shown`` is False, or it shows another
    text. ``bare`` is the value of the option without one. ``is_many``: it may be given several times.
    """

    name: str
    values: Values
    default: Any
    by: By = By.TABLE
    metavar: str | None = None
    help: str = ""
    flags: tuple[str, ...] = ()
    heading: str = ""
    shown: bool | str = True
    bare: float | None = None
    is_many: bool = False
    is_required: bool = False

    @property
    def flag(self) -> str:
        """Return the long spelling on the command line."""
        return self.flags[-1] if self.flags else "--" + self.name.replace("_", "-")

    @property
    def keyword(self) -> str:
        """Return the keyword of the Python API: a flag that begins with ``no`` is its opposite there."""
        return self.name.removeprefix("no_")

    @property
    def is_path(self) -> bool:
        """Tell whether the values are names of files or folders."""
        return self.metavar in PATHS

    def checked(self, value: Any) -> Any:
        """Return a value of Python's as the code has it: members for words. Raises ChoiceError."""
        if value is None and self.default is None:
            return None
        if not self.is_many:
            return self._checked(value)
        if isinstance(value, str | bytes) or not isinstance(value, Collection):
            raise ChoiceError(self.keyword, value, "a list of names")
        return tuple(map(self._checked, value))

    def _checked(self, value: Any) -> Any:
        values, fits = self.values, isinstance(value, str)
        if isinstance(values, type) and issubclass(values, StrEnum):
            try:
                return values(value)
            except ValueError as error:
                meant = did_you_mean(value, map(str, values)) if fits else ""
                expected = f"one of {', '.join(values)}{'; ' if meant else ''}{meant}"
                raise ChoiceError(self.keyword, value, expected) from error
        if isinstance(values, Text):
            if values.is_number and fits and value != "auto":  # in Python a number is not a text
                raise ChoiceError(self.keyword, value, values.expected)
            try:
                return values.read(value)
            except (ValueError, TypeError, AttributeError) as error:  # of a value that is not text
                raise ChoiceError(self.keyword, value, values.expected) from error
        if isinstance(values, Range):
            fits, expected = value in values, str(values)
        elif values is bool:
            # numpy's own may be one too, and numpy is slow to import.
            fits, expected = type(value).__name__ in {"bool", "bool_"}, "True or False"
        elif self.is_path:
            fits, expected = (
                isinstance(value, str | os.PathLike),
                "a list of names" if self.is_many else "a path",
            )
        else:
            expected = "a list of names" if self.is_many else "a text"
        if not fits:
            raise ChoiceError(self.keyword, value, expected)
        return value


def checked(options: Iterable[Option], given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the given values as the code has them, by keyword. Raises ChoiceError, and KeyError."""
    declared = {one.keyword: one for one in options}
    return {keyword: declared[keyword].checked(value) for keyword, value in given.items()}


def defaults(options: Iterable[Option], by: By) -> dict[str, Any]:
    """Return the defaults of the options that may be set in a way, by name."""
    return {one.name: one.default for one in options if by in one.by}


def _under(heading: str, *options: Option) -> tuple[Option, ...]:
    """Return options with the heading under which help shows them."""
    return tuple(one._replace(heading=heading) for one in options)


def _number_or_auto(least: int, most: int, auto: Any) -> Callable[[str], Any]:
    """Return what reads a whole number, or ``auto`` as what it means. It raises ValueError."""

    def read(value: str | int) -> Any:
        text = str(value)
        if text != "auto" and not (text.isdecimal() and len(text) < 9 and least <= int(text) <= most):
            raise ValueError
        return auto if text == "auto" else int(text)

    return read


def _memory(text: str) -> int:
    """Return a size in bytes. Raises ValueError."""
    found = MEMORY.fullmatch(text.strip())
    size = float(found[1]) * 1024 ** " KMGT".index(found[2].upper() or " ") if found else 0.0
    if not 1 <= size < math.inf:
        raise ValueError
    return int(size)


def _size(text: str) -> tuple[int, int]:
    """Return the width and height of a picture. Raises ValueError."""
    found = re.fullmatch(r"(\d{1,5})x(\d{1,5})", text)
    width, height = (int(found[1]), int(found[2])) if found else (0, 0)
    if not SMALLEST_SIDE <= min(width, height) <= max(width, height) <= LARGEST_SIDE:
        raise ValueError
    return width, height


def _poses(value: str) -> str:
    """Return a choice of poses as it is. Raises ValueError."""
    pose_choice(value)
    return value


PROCESSES, THREADS, TARGETS = (
    Text(f"a number of {what} {of}, or auto", _number_or_auto(least, most, auto), is_number=True)
    for what, of, least, most, auto in (
        ("processes", f"up to {MOST_PROCESSES}", 0, MOST_PROCESSES, 0),
        ("threads", f"from 1 to {LARGEST}", 1, LARGEST, None),
        ("targets", f"from 1 to {MOST_CORRECTIVES}", 1, MOST_CORRECTIVES, "auto"),
    )
)
BYTES = Text("a size in bytes, or like 512M or 2G", _memory)
PIXELS = Text(f"a size like 960x600, each side from {SMALLEST_SIDE} to {LARGEST_SIDE}", _size)
POSES = Text(POSES_EXPECTED, _poses)

# A line for each argument would take six pages.
# fmt: off
OUTPUT = Option("output", str, None, By.NOBODY, "FILE", flags=("-o", "--output"), help=
    "Output file; - is a GLB on stdout.")
OUT_DIR = Option("out_dir", str, None, By.NOBODY, "DIR", help=
    "Output folder, made if it is missing. A named input keeps its name. A file found in a folder or by a "
    "pattern keeps its path from there.")
FRAME = Option("frame", FrameChoice, FrameChoice.AUTO, By.ALL, help=
    "Compute the tangent frame from TANGENT, or from NORMAL alone; auto prefers TANGENT.")
ENCODING = Option("encoding", Encoding, Encoding.FLOAT32, By.ALL, help=
    "Number type of α and β: 24, 16 or 8 bytes for a vertex with four influences; or of correctives: floats, "
    "shorts or bytes.")
LAYOUT = Option("layout", Layout, Layout.ATTRIBUTES, By.ALL, help=
    "Attributes of α and β: their own, free TEXCOORD_n, or _CUSTOM0 and _CUSTOM1.")
REQUIRE_BAKED = Option("require_baked", bool, False, By.ALL, help=
    "Fail (exit 3) if nothing in a file can be baked.")
LEAVE_UNDER = Option("leave_under", Range(0), None, By.ALL, "X", help=
    "Leave a file unbaked, and note it, if its gain is under X by one of two measurements, or standard "
    "lighting is off by under 0.3°.")
REQUIRE_TRACKED = Option("require_tracked", bool, False, help=
    "Fail (exit 4) if an output names a file that git does not track, such as a new buffer.")
WARNINGS_AS_ERRORS = Option("warnings_as_errors", bool, False, By.ALL, help=
    "Fail (exit 3) and write nothing if there are warnings.")
JSON = Option("as_json", bool, False, flags=("--json",), help="Print the results as JSON.")
SUMMARY = Option("summary", str, None, By.NOBODY, "FILE", help=
    "Also write JSON lines: each file's result as soon as it is there, totals at the end.")
DEPFILE = Option("depfile", str, None, By.NOBODY, "FILE", help=
    "Also write the files that each output was made of, as rules for Make and Ninja.")
TIMINGS = Option("timings", bool, False, help=
    "Say where the time goes, by stage; in --json and --summary too.")
JOBS = Option("jobs", PROCESSES, "1", metavar="N", flags=("-j", "--jobs"), help=
    "Processes to work in; 0 or auto: one for each usable core.")
STATE = Option("state", str, None, By.NOBODY, "FILE", help=
    f"The file for the notes of --skip-unchanged; by default {STATE_NAME} in --out-dir.")
MAX_MEMORY = Option("max_memory", BYTES, None, By.NOBODY, "SIZE", help=
    "Memory that a file may use, like 512M or 2G; by default a quarter of the machine's memory.")
TIMEOUT = Option("timeout", Range(0, is_open=True), None, metavar="SECONDS", help=
    "Give up a file that takes longer.")
ISOLATE = Option("isolate", bool, False, help=
    "Work on each file in its own process, limited to --max-memory, so that a crash is exit 3.")
ALLOW_OUTSIDE = Option("allow_outside", str, (), By.PYTHON, "DIR", is_many=True, help=
    "Also read files of this folder that a document names. Without it, only files in the document's own "
    "folder, or in the folder given as INPUT, are read. May be given several times.")
NO_SYNC = Option("no_sync", bool, False, By.NOBODY, help=
    "Do not wait until files are on the disk. This is faster, but a power cut may leave them empty.")
SAFETY = "Limits and safety"
"""The heading of the options that protect the user. A configuration file lifts no limit."""
END = (
    *_under("Configuration",
        Option("config", str, None, By.NOBODY, "FILE", help=
            "Configuration file, instead of the nearest skinbake.toml or pyproject.toml."),
        Option("no_config", bool, False, By.NOBODY, help="Read no configuration file.")),
    *_under("Messages",
        Option("verbose", int, 0, flags=("-v", "--verbose"), help="Print more; give it twice for debugging."),
        Option("quiet", bool, False, flags=("-q", "--quiet"), help="Print errors only."),
        Option("color", ("auto", "always", "never"), "auto", shown=False, help=
            "Colour of messages; auto uses colours on a terminal if NO_COLOR is not set.")),
)
"""The last options of every command."""
THREADS_OPTION = Option("threads", THREADS, "auto", By.TABLE | By.PYTHON, "N", help=
    "Threads for the work on a file; auto: the usable cores, divided by --jobs.")
SKIP_UNCHANGED = Option("skip_unchanged", bool, False, help=
    "Pass over files whose input, options and output have not changed, by digest.")
DASK = Option("dask", str, None, By.NOBODY, "ADDRESS", help=
    "Work on the machines of a running Dask scheduler, like tcp://host:8786.")
CLIP = Option("clip", str, None, metavar="NAME", help=
    "Name or number of a clip; by default the one in which the bake shows most.")
TIME = Option("time", Range(), None, metavar="SECONDS")
LIMITS = _under(SAFETY, MAX_MEMORY, TIMEOUT, ISOLATE, ALLOW_OUTSIDE)
SYNC = _under(SAFETY, NO_SYNC)
SYNC_IN_PYTHON = (SYNC[0]._replace(by=By.PYTHON),)
BAKE = (
    *_under("Output", OUTPUT, OUT_DIR,
        Option("in_place", bool, False, By.NOBODY, help="Replace each input by its baked version."),
        Option("pack", bool, False, By.TABLE | By.PYTHON, help=
            "Bring the files of images and buffers into the output, which must be a .glb or .vrm."),
        Option("dry_run", bool, False, By.PYTHON, help="Do everything except writing.")),
    *_under("α and β",
        Option("gradients", Gradients, Gradients.FITTED, By.ALL, help=
            "α and β: the paper's gradients of the weights on the surface; or fitted to poses of the clips "
            "and to turns of the joints, which lights coarse meshes better."),
        Option("fit_poses", str, (), By.ALL, "FILE|animations|random:N", is_many=True, help=
            "Poses of the fit: the file's own animations (default), those of another file whose nodes "
            "have the same names, or random poses. May be given several times."),
        Option("weighting", Weighting, Weighting.MAX, By.ALL, help=
            "Weight of the triangles at a vertex (Max 1999 is the most accurate)."),
        Option("crease_angle", Range(0, 180), 15.0, By.ALL, "DEG", help=
            "Copies of a vertex form a hard edge if their normals differ by more than this angle."),
        Option("weld", Weld, Weld.MESH, By.ALL, help=
            "Compute gradients over one mesh, or over all meshes that the same skins draw. The latter is for "
            "characters cut into several meshes."),
        Option("neighbours", Neighbours, Neighbours.ADOPT, By.ALL, help=
            "Joints that only the neighbours of a vertex have: put them into free slots, add an influence "
            "set where these are too few, or drop them. "
            f"{READERS_OF_FOUR} read only one set."),
        FRAME,
        Option("limit_influences", Range(SLOTS_PER_SET, is_whole=True), None, By.ALL, "N", help=
            "Keep the N largest influences of each vertex, N a multiple of 4."),
        Option("generate_normals", bool, False, By.ALL, help=
            "Add smooth NORMALs to primitives without NORMAL."),
        Option("morph_normals", bool, False, By.ALL, help=
            "Add NORMAL to morph targets without it, with or without a skin. Else engines light them as at "
            "rest."),
        Option("morph_frames", bool, False, By.ALL, help=
            "Store beside each morph target how it moves the frame, so that α and β light morphs exactly."),
        Option("blend", str, None, By.ALL, "ATTRIBUTE", help=
            "The attribute with each vertex's weight of dual quaternions against linear blending, 0 to 1: "
            "store its gradient too.")),
    *_under("Correctives",
        Option("correctives", TARGETS, None, By.ALL, "auto|K", help=
            "Instead of α and β, add K morph targets of normals that the clips play, for engines without the "
            "shader; auto adds up to 4. A ragdoll, or a clip from elsewhere, keeps the last "
            "correction: docs/correctives.md shows how to end it."),
        Option("clips", str, (), By.ALL, "NAMES", is_many=True, help=
            "The clips that play correctives, by name or number, with commas between; by default all. May be "
            "given several times."),
        Option("one_character", bool, False, help=
            "The files hold one character, each with its own clips: all get the same correctives, so that a "
            "clip of one file plays those of another. A file without the mesh cannot play any."),
        Option("clips_own_weights", bool, False, By.ALL, help=
            "Correct meshes too whose morph targets no clip and no node moves. Clips then play zeros over "
            "what a page or a script sets."),
        Option("corrective_aim", CorrectiveAim, CorrectiveAim.TRUTHS, By.ALL, help=
            "Fit correctives to true normals, or to those that α and β would give.")),
    *_under("Storage", ENCODING, LAYOUT,
        Option("alpha_name", str, None, By.ALL, "PATTERN", shown="_SKINBAKE_ALPHA_{set}", help=
            "Name of the α attributes; {set} is the number of the influence set."),
        Option("beta_name", str, None, By.ALL, "PATTERN", shown="_SKINBAKE_BETA_{set}", help=
            "Name of the β attributes."),
        Option("compress", Scheme, Scheme.KEEP, By.ALL, help=
            "Keep geometry compressed as it is, decompress it, or compress skinned primitives without loss."),
        Option("compress_level", Range(0, 10, is_whole=True), None, By.ALL, "N", help=
            "Effort: 0 (fast) to 10 (small), for meshopt 0 to 3. It changes little in Draco. Each codec has "
            "its own default. Without --compress it is for α and β of compressed files."),
        # A float has no more than 24 bits, and Draco keeps tables of 4 · 2^bits bytes. At 24 bits the whole
        # program takes 110 MiB, at 28 0.5 GiB, at 30 1.8 GiB for POSITION and 4.3 GiB for NORMAL.
        Option("position_bits", Range(1, 24, is_whole=True), None, By.ALL, "N", help=
            "Quantise POSITION before baking, with --compress draco."),
        Option("normal_bits", Range(2, 24, is_whole=True), None, By.ALL, "N", help=
            "Quantise NORMAL in the same way."),
        Option("texcoord_bits", Range(1, 24, is_whole=True), None, By.ALL, "N", help=
            "Quantise TEXCOORD_0 in the same way.")),
    *_under("Conditions", LEAVE_UNDER, REQUIRE_BAKED, REQUIRE_TRACKED, WARNINGS_AS_ERRORS),
    *_under("Reports", JSON, SUMMARY, DEPFILE, TIMINGS),
    *_under("Many files", JOBS, THREADS_OPTION, SKIP_UNCHANGED, STATE, DASK),
    *LIMITS,
    *SYNC_IN_PYTHON,
    *END,
)

VERIFY = (
    *_under("Poses",
        Option("poses", POSES, str(PoseKind.ANIMATION), By.ALL, "WHICH", help=
            "animation (the file's own clips), random or random:N, or rest."),
        Option("samples", Range(1, is_whole=True), None, By.ALL, "N", help=
            "Poses of each clip, in the middle of as many equal parts of it. By default about 60 in all, at "
            "least 3 for each clip. A file without clips has 24 random poses; --poses random:N gives another "
            "number."),
        Option("angle", Range(0, 180), 30.0, By.ALL, "DEG", help=
            "Largest rotation of a joint in random poses."),
        Option("seed", Range(0, is_whole=True), 0, By.ALL, "N", help="Seed of random poses."),
        CLIP._replace(by=By.NOBODY, help="Name or number of the clip of --dump-normals."),
        TIME._replace(by=By.NOBODY, help=
            "The time in that clip. By default, the clip and time at which the bake shows most.")),
    *_under("Measurement",
        Option("methods", Method, (), By.ALL, flags=("--method",), is_many=True, help=
            "Skinning to measure; by default every one that the file has data for."),
        Option("baseline", Baseline, Baseline.BLENDED, By.ALL, help=
            "Standard LBS lighting to compare with: that of three.js, Bevy or Filament."),
        Option("cap", Range(0, is_open=True), None, By.ALL, "X", help=
            "Limit a tangent's correction to X times its length (0.9 in the authors' demo); off by default."),
        Option("truth", Truth, None, By.ALL, help=
            "The true normals that limits use: on triangles or along tangents (by default both), or those "
            "of a normal map (relief).")),
    *_under("Conditions",
        Option("max_mean_error", Range(0), None, By.ALL, "DEG", help="Fail if the mean error is larger."),
        Option("max_p95_error", Range(0), None, By.ALL, "DEG", help=
            "Fail if the 95th percentile of the error is larger."),
        Option("min_gain", Range(0), None, By.ALL, "X", help=
            "Fail if the gain over standard lighting is smaller, by one of two measurements."),
        REQUIRE_BAKED._replace(help="Fail if a file holds no bake."),
        Option("sources", str, None, By.NOBODY, "DIR", help=
            "Fail if an output is not of its source as it is now, or a source in DIR has no output, by the "
            f"notes of bake --skip-unchanged ({STATE_NAME} in the folder given as INPUT, or --state)."),
        WARNINGS_AS_ERRORS._replace(help="Fail if there are warnings.")),
    *_under("Reports", JSON,
        Option("junit", str, None, By.NOBODY, "FILE", help="Also write the results as JUnit XML."),
        Option("html", str, None, By.NOBODY, "PAGE", help=
            "Also write a page that shows the file and its results; for several files a sheet of "
            "pictures, and their pages in a folder of its name."),
        Option("dump_normals", str, None, By.NOBODY, "FILE", help=
            "Also write positions, normals of every lighting, and true normals of one pose, as JSON lines."),
        SUMMARY, TIMINGS),
    *_under("Many files", JOBS, THREADS_OPTION, SKIP_UNCHANGED,
        STATE._replace(help="The file for the notes of --skip-unchanged, or of --sources."), DASK),
    *LIMITS,
    *SYNC,
    *END,
)

INSPECT = (
    *_under("Reports",
        JSON._replace(help="Print the summary as JSON."), SUMMARY, TIMINGS),
    *_under("Many files", JOBS),
    *LIMITS,
    *SYNC,
    *END,
)

STRIP = (
    *_under("Output", OUTPUT, OUT_DIR,
        Option("in_place", bool, False, By.NOBODY, help="Replace each input by its version before bake.")),
    *_under("Conditions", WARNINGS_AS_ERRORS),
    *_under("Reports",
        JSON._replace(help="Print the result as JSON."), SUMMARY, DEPFILE, TIMINGS),
    *_under("Many files", JOBS),
    *LIMITS,
    *SYNC_IN_PYTHON,
    *END,
)

VIEW = (
    *_under("Output",
        OUTPUT._replace(metavar="PAGE", help=
            "Write the page to a file (.html or .htm), or - for stdout, and end."),
        Option("port", Range(0, 65535, is_whole=True), 0, By.NOBODY, "P", shown=False, help=
            "Port on this machine; by default any free one."),
        Option("no_browser", bool, False, By.NOBODY, help="Print the address, but do not open the browser.")),
    *_under(SAFETY, MAX_MEMORY, TIMEOUT, ALLOW_OUTSIDE, NO_SYNC),
    *END,
)

RENDER = (
    *_under("Output",
        OUTPUT._replace(metavar="PICTURE", is_required=True, help=
            "Output file: .png, or .webp or .gif that move.")),
    *_under("Poses",
        CLIP,
        TIME._replace(help=
            "Time in the clip. By default the pose in which the bake shows most, or, in .webp and "
            ".gif, the whole clip.")),
    *_under("Picture",
        Option("mode", ("shaded", "reflections", "error", "normals"), "shaded", help=
            "Shading, stripes mirrored in the surface, angle to the true normals as colour, or normals."),
        Option("split", bool, False, help="Standard lighting on the left, that of the bake on the right."),
        Option("lighting", (str(Lighting.STANDARD), str(Lighting.ACCURATE), "corrected"), None, help=
            "Lighting without --split. By default that of the bake: accurate, or corrected by correctives."),
        Option("closeup", bool, False, help="Look at the place where the bake shows most, and follow it."),
        Option("clay", bool, False, help="Without the colours and images of the materials."),
        Option("turntable", bool, False, help="Turn the camera once around the model (.webp, .gif)."),
        Option("size", PIXELS, "960x600", metavar="WxH", help=
            f"Width and height in pixels, each from {SMALLEST_SIDE} to {LARGEST_SIDE}.")),
    *_under(SAFETY, MAX_MEMORY, TIMEOUT, ALLOW_OUTSIDE, NO_SYNC),
    *END,
)

INFLUENCES = Option("influences", Range(1, 64, is_whole=True), None, metavar="N", help=
    "Influences per vertex, 1 to 64; by default those of --for, else 4.")
SHADER = (
    *_under("Output",
        OUTPUT._replace(default="-", shown=False, help="Output file; stdout by default.")),
    *_under("α and β",
        FRAME._replace(values=Frame, default=None, by=By.TABLE, help=
            "Source of the tangent frame (t0, b0); by default that of --for.")),
    *_under("Storage",
        ENCODING._replace(default=None, by=By.TABLE, help=
            "Number type of α and β; by default that of --for, else float32."),
        LAYOUT._replace(default=None, by=By.TABLE, help=
            "Attributes of α and β; by default those of --for, else their own.")),
    *_under("Shader",
        Option("language", Language, None, flags=("--lang",), help=
            "Shading language; not needed if --target has only one."),
        # Its words are the names of the templates.
        Option("target", str, "plain", help="plain functions, or an adapter for an engine."),
        Option("source", str, None, By.NOBODY, "BAKED_FILE", flags=("--for",), help=
            "Match this baked file (.glb, .gltf, .vrm; - for a GLB on stdin), and refuse options that "
            "contradict it."),
        Option("method", Method, Method.LBS, help=
            "Linear blend skinning, dual quaternions, or each vertex between the two."),
        Option("lighting", Lighting, None, help=
            "standard (that of common engines), direct (LBS only), accurate, exact (DQS only). By default "
            "accurate for LBS, exact for DQS."),
        Option("stage", Stage, Stage.VERTEX, help=
            "Functions for a vertex stage, or a whole compute pass over buffers."),
        INFLUENCES,
        Option("morphs", Morphs, None, help=
            "How t0 and b0 follow morph targets: by the morphed normal, by the morphed TANGENT, or by six "
            "(frames) or four (frames-normal) numbers of the bake. By default as the targets of --for need, "
            "else none."),
        Option("mirrored_joints", bool, False, help=
            "Keep normals outside where joints mirror the surface; --for sets it if they do."),
        Option("scaled_joints", bool, False, help=
            "Dual quaternions of joints that scale, shear or mirror; --for sets it if they do."),
        Option("normal_map", bool, False, help=
            "Also what normal maps need: two vectors beside the normal, and the line for the pixel."),
        Option("cap", Range(0, is_open=True), None, metavar="[X]", bare=PUBLISHED_CAP, help=
            f"Limit a tangent's correction to X times its length ({PUBLISHED_CAP} without X); off by "
            "default.")),
    *_under(SAFETY, MAX_MEMORY, ALLOW_OUTSIDE, NO_SYNC),
    *END,
)

COST = (
    *_under("Reports",
        JSON._replace(help="Print the costs as JSON."),
        INFLUENCES._replace(help=
            "Print line by line for N influences per vertex, 1 to 64, instead of a table for 1 to 8.")),
    *END,
)

CONFIG = (
    *_under("Reports",
        JSON._replace(help="Print the options as JSON."),
        Option("changed", bool, False, help="Leave out the options that have their default.")),
    *END,
)

EXAMPLE = (
    *_under("Output",
        OUTPUT._replace(is_required=True, help="Output file, a .glb; - is stdout.")),
    *_under(SAFETY, NO_SYNC),
    *END,
)

OPTIONS = {
    "example": EXAMPLE,
    "bake": BAKE,
    "verify": VERIFY,
    "view": VIEW,
    "render": RENDER,
    "shader": SHADER,
    "inspect": INSPECT,
    "strip": STRIP,
    "cost": COST,
    "config": CONFIG,
}
# fmt: on
"""The options of each command, in the order in which help shows them."""

FLAGS = {one.name: one.flag for options in OPTIONS.values() for one in options}


def on_command_line(chosen: Chosen) -> str:
    """Return an option as it is typed, like ``--encoding float32``. Other names stay as they are."""
    flag, value = FLAGS.get(chosen.option, chosen.option), chosen.value
    if value is ...:
        return flag
    return f"{flag} {value:g}" if isinstance(value, float) else f"{flag} {value}"


def in_toml(chosen: Chosen) -> str:
    """Return an option as a configuration file has it, like ``encoding = "float32"``."""
    key, value = FLAGS.get(chosen.option, chosen.option).removeprefix("--"), chosen.value
    if value is ...:
        return key
    return f'{key} = "{value}"' if isinstance(value, str) else f"{key} = {value}"
