"""The functions of the Python API: the commands for files, and the gradients for arrays.

``import skinbake`` imports this module only when one of its functions is first used.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, TypedDict, Unpack, overload

import numpy as np
import numpy.typing as npt

from skinbake.choices import (
    SLOTS_PER_SET,
    Baseline,
    CorrectiveAim,
    Encoding,
    FrameChoice,
    Gradients,
    Layout,
    Method,
    Neighbours,
    PoseKind,
    Scheme,
    Truth,
    Weighting,
    Weld,
)
from skinbake.errors import InputError, OutputError, Place
from skinbake.files.bounds import Bounds, Within
from skinbake.files.urls import File, is_url, named_file
from skinbake.geometry.skinned import Float32Array, IntArray, SkinnedPrimitive
from skinbake.options import BAKE, INSPECT, STRIP, VERIFY, checked
from skinbake.threads import threads_limited
from skinbake.wording import SUFFIXES, did_you_mean

if TYPE_CHECKING:
    from pygltflib import GLTF2

    from skinbake.report.normals import PosedNormals

FilePath: TypeAlias = str | os.PathLike[str]
BaselineName: TypeAlias = Baseline | Literal["blended", "inverse-transpose", "cofactor"]
CorrectiveAimName: TypeAlias = CorrectiveAim | Literal["truths", "gradients"]
EncodingName: TypeAlias = Encoding | Literal["float32", "snorm16", "packed8"]
FrameName: TypeAlias = FrameChoice | Literal["auto", "tangent", "normal"]
GradientsName: TypeAlias = Gradients | Literal["surface", "fitted"]
LayoutName: TypeAlias = Layout | Literal["attributes", "texcoord", "custom"]
MethodName: TypeAlias = Method | Literal["lbs", "dqs", "blend"]
NeighboursName: TypeAlias = Neighbours | Literal["adopt", "extend", "drop"]
SchemeName: TypeAlias = Scheme | Literal["keep", "none", "draco", "meshopt"]
TruthName: TypeAlias = Truth | Literal["triangles", "tangents", "relief"]
WeightingName: TypeAlias = Weighting | Literal["max", "angle", "area", "angle-area"]
WeldName: TypeAlias = Weld | Literal["mesh", "skin"]


class BakeOptions(TypedDict, total=False):
    """The options of ``bake``, under the same names as on the command line.

    Enumerations may be given as members or by their values. ``gradients`` is ``fitted`` or ``surface``.
    ``crease_angle`` is in degrees.
    """

    gradients: GradientsName
    fit_poses: Sequence[str]
    weighting: WeightingName
    crease_angle: float
    weld: WeldName
    neighbours: NeighboursName
    frame: FrameName
    limit_influences: int | None
    generate_normals: bool
    morph_normals: bool
    morph_frames: bool
    blend: str | None
    correctives: int | Literal["auto"] | None
    clips: Sequence[str]
    clips_own_weights: bool
    corrective_aim: CorrectiveAimName
    alpha_name: str | None
    beta_name: str | None
    compress: SchemeName
    compress_level: int | None
    position_bits: int | None
    normal_bits: int | None
    texcoord_bits: int | None
    encoding: EncodingName
    layout: LayoutName
    leave_under: float | None
    require_baked: bool
    warnings_as_errors: bool


@overload
def bake(
    source: FilePath,
    target: FilePath,
    *,
    allow_outside: Sequence[FilePath] = (),
    dry_run: bool = False,
    pack: bool = False,
    sync: bool = True,
    threads: int | Literal["auto"] = "auto",
    **options: Unpack[BakeOptions],
) -> dict[str, Any]: ...


@overload
def bake(
    source: GLTF2, *, threads: int | Literal["auto"] = "auto", **options: Unpack[BakeOptions]
) -> GLTF2: ...


def bake(
    source: FilePath | GLTF2,
    target: FilePath | None = None,
    *,
    allow_outside: Sequence[FilePath] = (),
    dry_run: bool = False,
    pack: bool = False,
    sync: bool = True,
    threads: int | Literal["auto"] = "auto",
    **options: Unpack[BakeOptions],
) -> dict[str, Any] | GLTF2:
    """Add α and β, the skin-weight gradients, to every skinned primitive of a file or a model.

    Parameters
    ----------
    source
        A ``.glb``, ``.gltf`` or ``.vrm`` file, or a ``GLTF2`` of pygltflib.
    target
        The file to write. It may be the source, by any path; then the source is replaced. A ``GLTF2`` has no
        target.
    allow_outside
        Folders in which a document may name files, besides its own folder.
    dry_run
        Do everything except writing.
    pack
        Bring the files of images and buffers into the target, which must be a ``.glb`` or ``.vrm``.
    sync
        Wait until the output is on the disk.
    threads
        The number of threads, or ``auto``: one for each core. The result is the same at any number.
    **options
        The options of ``skinbake bake``: see ``BakeOptions``.

    Returns
    -------
    dict or GLTF2
        For a file: its entry in ``files`` of ``skinbake bake --json`` (docs/reference/json.md).
        For a ``GLTF2``: a new one with α and β. The given one is not changed.

    Raises
    ------
    skinbake.ChoiceError
        An option has a value of another type, or one that does not exist, or two options contradict each
        other.
    skinbake.InputError
        The source cannot be read, or cannot be baked.
    skinbake.OutputError
        The target cannot be written. Then nothing has been written.

    Examples
    --------
    >>> result = skinbake.bake("fixtures/bent_tube.glb", folder / "tube.glb", encoding="packed8")
    >>> result["status"], result["primitives"][0]["vertices"]
    ('baked', 1518)

    """
    from skinbake.commands import bake_options
    from skinbake.commands.bake import bake_file
    from skinbake.gltf.writing.output import Writing

    for name in options.keys() - BakeOptions.__annotations__.keys():
        meant = did_you_mean(name, BakeOptions.__annotations__)
        question = f"; {meant}" if meant else ""
        raise TypeError(f"bake() got an unexpected keyword argument {name!r}{question}")
    given = {"allow_outside": allow_outside, "dry_run": dry_run, "pack": pack, "sync": sync}
    count = checked(BAKE, {**given, "threads": threads})["threads"]
    chosen = bake_options.BakeOptions(**options)  # type: ignore[arg-type]  # it takes the values of enumerations too
    with threads_limited(count):
        if not isinstance(source, str | os.PathLike):
            from skinbake.pygltflib_models import baked_model

            if target is not None or dry_run or pack or allow_outside:
                raise TypeError(
                    "bake() returns the new GLTF2: it takes no target, dry_run, pack or allow_outside"
                )
            return baked_model(source, chosen)
        if target is None:
            raise TypeError("bake() needs a target for a file")
        from skinbake.report.bake import file_json

        writing = Writing(dry_run=dry_run, sync=sync, pack=pack)
        within = Within(_bounds(allow_outside))
        file = _source(source)
        return file_json(bake_file(file.given, _target(target, file), chosen, writing, within))


def verify(
    source: FilePath,
    *,
    methods: Sequence[MethodName] = (),
    poses: PoseKind | str = PoseKind.ANIMATION,
    samples: int | None = None,
    angle: float = 30.0,
    seed: int = 0,
    baseline: BaselineName = Baseline.BLENDED,
    cap: float | None = None,
    max_mean_error: float | None = None,
    max_p95_error: float | None = None,
    min_gain: float | None = None,
    truth: TruthName | None = None,
    require_baked: bool = False,
    warnings_as_errors: bool = False,
    allow_outside: Sequence[FilePath] = (),
    threads: int | Literal["auto"] = "auto",
) -> dict[str, Any]:
    """Check that a file still carries the right α and β, and measure its lighting in degrees.

    Parameters
    ----------
    source
        A ``.glb``, ``.gltf`` or ``.vrm`` file.
    methods
        ``lbs``, ``dqs`` or both. If empty: both.
    poses, samples, angle, seed
        ``animation`` samples each clip of the file in the middle of ``samples`` equal parts, and takes 24
        random poses if there is no clip. ``random`` takes ``samples`` poses, ``random:8`` takes 8. Each turns
        each joint by at most ``angle`` degrees. ``rest`` takes the rest pose.
    baseline, cap
        As ``--baseline`` and ``--cap``.
    max_mean_error, max_p95_error, min_gain
        Limits of the accurate lighting, in degrees and as a factor: the lower of two measurements. None sets
        no limit. A skinned file that is not baked meets none.
    truth
        ``triangles``, ``tangents`` or ``relief``: the true normals for the limits (docs/lighting.md). None:
        the first two.
    require_baked, warnings_as_errors
        Fail if the file holds no bake, or if there are warnings.
    allow_outside
        Folders in which the document may name files, besides its own folder.
    threads
        The number of threads, or ``auto``: one for each core. The figures are the same at any number.

    Returns
    -------
    dict
        The file's entry in ``files`` of ``skinbake verify --json`` (docs/reference/json.md). Its ``passed``
        is the verdict.

    Raises
    ------
    skinbake.ChoiceError
        An option has a value that does not exist.
    skinbake.InputError
        The file cannot be read.

    Examples
    --------
    >>> verdict = skinbake.verify(baked, poses="random", samples=4, min_gain=2.0)
    >>> verdict["passed"]
    True

    """
    from skinbake.commands.verify import verify_file
    from skinbake.measure.options import VerifyOptions
    from skinbake.report.verify import file_json

    given = {
        "methods": methods,
        "poses": poses,
        "samples": samples,
        "angle": angle,
        "seed": seed,
        "baseline": baseline,
        "cap": cap,
        "max_mean_error": max_mean_error,
        "max_p95_error": max_p95_error,
        "min_gain": min_gain,
        "truth": truth,
        "require_baked": require_baked,
        "warnings_as_errors": warnings_as_errors,
    }
    count = checked(VERIFY, {"allow_outside": allow_outside, "threads": threads})["threads"]
    options = VerifyOptions.of(**given)
    with threads_limited(count):
        return file_json(verify_file(_source(source).given, options, bounds=_bounds(allow_outside)))


def normals(
    source: FilePath,
    clip: str | int | None = None,
    time: float | None = None,
    *,
    methods: Sequence[MethodName] = (),
    baseline: BaselineName = Baseline.BLENDED,
    cap: float | None = None,
    allow_outside: Sequence[FilePath] = (),
    threads: int | Literal["auto"] = "auto",
) -> list[PosedNormals]:
    """Return the normals of a baked file in one pose, of every lighting and by both truths.

    A port of the shader is held to them. All is in the space of the scene, in float64.

    Parameters
    ----------
    source
        A ``.glb``, ``.gltf`` or ``.vrm`` file with α and β, or with correctives.
    clip
        The name or the number of a clip. None: the one in which the bake shows most.
    time
        Seconds in the clip, or in random poses if no clip moves the file. None: where the bake shows most.
    methods
        ``lbs``, ``dqs`` or both. If empty: ``lbs``.
    baseline, cap
        As in ``verify``.
    allow_outside
        Folders in which the document may name files, besides its own folder.
    threads
        The number of threads, or ``auto``: one for each core.

    Returns
    -------
    list of PosedNormals
        One for each baked primitive of the shown scene, each skin that draws it, and each method.

    Raises
    ------
    skinbake.ChoiceError
        The clip does not exist, the time is outside it, or an option has a value that does not exist.
    skinbake.InputError
        The file cannot be read or posed, or is not baked.

    Examples
    --------
    >>> [posed] = skinbake.normals(baked, "bend", 0.5)
    >>> posed.positions.shape, sorted(posed.normals), sorted(posed.truths)
    ((1518, 3), ['accurate', 'standard'], ['tangents', 'triangles'])

    """
    from skinbake.commands.normals import NormalsRequest, normals_of_file

    asked = str(clip) if isinstance(clip, int) and not isinstance(clip, bool) else clip
    given = {"clip": asked, "time": time, "methods": methods, "baseline": baseline, "cap": cap}
    words = checked(VERIFY, {**given, "allow_outside": allow_outside, "threads": threads})
    request = NormalsRequest(
        words["clip"], words["time"], words["methods"] or (Method.LBS,), words["cap"], words["baseline"]
    )
    with threads_limited(words["threads"]):
        return normals_of_file(_source(source).given, request, _bounds(allow_outside))


def inspect(source: FilePath, *, allow_outside: Sequence[FilePath] = ()) -> dict[str, Any]:
    """Return the skinned primitives of a file, and the bakes in it.

    Parameters
    ----------
    source
        A ``.glb``, ``.gltf`` or ``.vrm`` file.
    allow_outside
        Folders in which the document may name files, besides its own folder.

    Returns
    -------
    dict
        The object of ``skinbake inspect --json`` (docs/reference/json.md).

    Raises
    ------
    skinbake.InputError
        The file cannot be read.

    Examples
    --------
    >>> skinbake.inspect(baked)["primitives"][0]["joints"]
    3

    """
    from skinbake.commands.inspect import inspect_file
    from skinbake.report.inspect import as_json

    checked(INSPECT, {"allow_outside": allow_outside})
    return as_json(inspect_file(_source(source).given, _bounds(allow_outside)))


def strip(
    source: FilePath,
    target: FilePath,
    *,
    warnings_as_errors: bool = False,
    sync: bool = True,
    allow_outside: Sequence[FilePath] = (),
) -> dict[str, Any]:
    """Write a file as it was before its bake. It is byte-identical if no tool has changed it since.

    Parameters
    ----------
    source, target
        The baked file, and the file to write. They may be the same.
    warnings_as_errors
        Raise InputError, and write nothing, if there are warnings.
    sync
        Wait until the output is on the disk.
    allow_outside
        Folders in which the document may name files, besides its own folder.

    Returns
    -------
    dict
        The object of ``skinbake strip --json`` (docs/reference/json.md).

    Raises
    ------
    skinbake.InputError
        The source cannot be read.
    skinbake.OutputError
        The target cannot be written. Then nothing has been written.

    Examples
    --------
    >>> skinbake.strip(baked, folder / "as_it_was.glb")["primitives"]
    1
    >>> (folder / "as_it_was.glb").read_bytes() == pathlib.Path("fixtures/bent_tube.glb").read_bytes()
    True

    """
    from skinbake.commands.strip import strip_file
    from skinbake.files.bounds import Within
    from skinbake.gltf.writing.output import Writing
    from skinbake.report.strip import as_json

    given = {"warnings_as_errors": warnings_as_errors, "sync": sync, "allow_outside": allow_outside}
    checked(STRIP, given)
    file, writing, within = _source(source), Writing(sync=sync), Within(_bounds(allow_outside))
    paths = file.given, _target(target, file)
    return as_json(strip_file(*paths, writing, within, warnings_as_errors=warnings_as_errors))


def _source(path: FilePath) -> File:
    """Return a file to read. Raises InputError for a URL."""
    name = os.fspath(path)
    if is_url(name):
        raise InputError("only the command line reads URLs", Place(name))
    return named_file(name)


def _target(path: FilePath, source: File) -> str:
    """Return the path of a file to write: that of the source, if it is the source by another path.

    Another name of the source by a hard link is another file: writing replaces a name. Raises OutputError for
    a URL, and if the name is not a model's.
    """
    name = os.fspath(path)
    if is_url(name):
        raise OutputError("only the command line writes to URLs", Place(name))
    if not name.lower().endswith(SUFFIXES):
        raise OutputError(f"expected a name that ends in {', '.join(SUFFIXES)}", Place(name))
    return source.given if named_file(name).place == source.place else name


def _bounds(allow_outside: Sequence[FilePath]) -> Bounds:
    return Bounds(None, tuple(os.fspath(folder) for folder in allow_outside))


@dataclass(frozen=True, slots=True, eq=False)
class WeightGradients:
    """The gradients of a surface's skin weights, along its tangents and bitangents.

    It unpacks into two names: ``alpha, beta = weight_gradients(…)``.

    Attributes
    ----------
    alpha, beta : ndarray (V, K − 1) float32
        ∇w · t0 and ∇w · b0 of slots 1 … K − 1, in 1 / length unit of the positions. The entry of slot 0 is
        minus their sum.
    joints : ndarray (V, K) integer
        The joints of α and β. They are the given joints, unless a vertex adopted others.
    tangents, bitangents : ndarray (V, 3) float
        The frame: t0 and b0.
    frame : str
        ``tangent`` if the frame comes from the given tangents, else ``normal``.
    lost : float
        The share of the gradients that no slot holds, from 0 to 1.

    """

    alpha: Float32Array
    beta: Float32Array
    joints: IntArray
    tangents: npt.NDArray[np.floating]
    bitangents: npt.NDArray[np.floating]
    frame: str
    lost: float

    def __iter__(self) -> Iterator[Float32Array]:
        yield self.alpha
        yield self.beta


def weight_gradients(
    positions: npt.ArrayLike,
    normals: npt.ArrayLike,
    triangles: npt.ArrayLike,
    joints: npt.ArrayLike,
    weights: npt.ArrayLike,
    *,
    tangents: npt.ArrayLike | None = None,
    weighting: WeightingName = Weighting.MAX,
    crease_angle: float = 15.0,
    neighbours: NeighboursName = Neighbours.DROP,
    frame: FrameName = FrameChoice.AUTO,
) -> WeightGradients:
    """Return α and β of one skinned surface: arrays in, arrays out, no file.

    They are the gradients of the weights on the surface, as ``skinbake.bake`` gives with
    ``gradients="surface"``: arrays without a rig have no turns to which α and β could be fitted. Copies of a
    vertex (equal position, weights, and normals within ``crease_angle``) count as one.

    Parameters
    ----------
    positions : (V, 3) float
        Rest positions.
    normals : (V, 3) float
        Rest normals, of any length.
    triangles : (T, 3) integer
        Indices of vertices, counter-clockwise.
    joints : (V, K) integer
        Joint indices of K ≥ 2 slots.
    weights : (V, K) float
        Skin weights. They are divided by their sum.
    tangents : (V, 4) float, optional
        As glTF's TANGENT: unit vectors, and the handedness 1 or −1.
    weighting
        ``max``, ``angle``, ``area`` or ``angle-area``.
    crease_angle
        Degrees. Copies of a vertex are a hard edge if their normals differ by more.
    neighbours
        ``drop`` leaves out joints that only the neighbours of a vertex have. ``adopt`` takes them into slots
        of weight 0; a shader must then read the result's ``joints``.
    frame
        ``auto``, ``tangent`` or ``normal``: see docs/reference/frame.md.

    Returns
    -------
    WeightGradients
        α, β and their frame.

    Raises
    ------
    ValueError
        An array has another shape, an index is out of range, or a number is not finite.
    skinbake.ChoiceError
        An option has a value that does not exist.
    skinbake.InputError
        α or β of a vertex are not finite.

    Examples
    --------
    The weight of joint 1 grows by 1 along x, over a square with its normals along z:

    >>> positions = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
    >>> weights = [[1, 0], [0, 1], [0, 1], [1, 0]]
    >>> alpha, beta = skinbake.weight_gradients(
    ...     positions, [[0, 0, 1]] * 4, [[0, 1, 2], [0, 2, 3]], [[0, 1]] * 4, weights
    ... )
    >>> alpha.ravel().tolist(), beta.ravel().tolist()
    ([1.0, 1.0, 1.0, 1.0], [0.0, 0.0, 0.0, 0.0])

    Notes
    -----
    Tarini, Panozzo, Sorkine-Hornung 2014, section 4: doi:10.1111/cgf.12330.

    """
    from skinbake.gradients.assumptions import check_finite
    from skinbake.gradients.baker import BakeSettings, bake_primitives
    from skinbake.gradients.tangents import frame_vectors

    given = {"weighting": weighting, "crease_angle": crease_angle, "neighbours": neighbours, "frame": frame}
    words = checked(BAKE, given)
    settings = BakeSettings(
        words["weighting"], math.radians(crease_angle), words["neighbours"], words["frame"]
    )
    if settings.neighbours is Neighbours.EXTEND:
        raise ValueError('neighbours is "extend", which works on files only: expected adopt or drop')
    if settings.frame is FrameChoice.TANGENT and tangents is None:
        raise ValueError('frame is "tangent", and there are no tangents')
    primitive = _surface(positions, normals, triangles, joints, weights, tangents)
    [(baked, findings)] = bake_primitives([primitive], settings)
    check_finite(primitive, baked, Place("weight_gradients"))
    t0, b0 = frame_vectors(primitive, baked.frame)
    adopted = baked.adopted_joints
    return WeightGradients(
        baked.alpha,
        baked.beta,
        np.where(adopted >= 0, adopted, primitive.joints),
        t0,
        b0,
        str(baked.frame),
        findings.lost,
    )


MOST_REPEATED = 1 << 22
"""The most numbers of an array that repeats itself in memory. Such an array may have any size."""


def _surface(
    positions: npt.ArrayLike,
    normals: npt.ArrayLike,
    triangles: npt.ArrayLike,
    joints: npt.ArrayLike,
    weights: npt.ArrayLike,
    tangents: npt.ArrayLike | None,
) -> SkinnedPrimitive:
    """Return the arrays as a primitive. Raises ValueError if they do not fit together."""
    from skinbake.gltf.reading.meshes import MOST_SETS

    most = SLOTS_PER_SET * MOST_SETS
    points = _floats("positions", positions, (None, 3))
    count = len(points)
    weighed = _floats("weights", weights, (count, None))
    slots = weighed.shape[1]
    if not 2 <= slots <= most:
        raise ValueError(f"weights have shape {weighed.shape}: expected 2 to {most} slots for a vertex")
    return SkinnedPrimitive(
        positions=points,
        normals=_floats("normals", normals, (count, 3)),
        tangents=None if tangents is None else _floats("tangents", tangents, (count, 4)),
        joints=_indices("joints", joints, (count, slots), np.iinfo(np.int32).max),
        weights=weighed,
        triangles=_indices("triangles", triangles, (None, 3), count),
    )


def _floats(name: str, values: npt.ArrayLike, shape: tuple[int | None, int | None]) -> npt.NDArray[Any]:
    array = _array(name, values, shape)
    if array.dtype.kind not in "fiub":
        raise ValueError(f"{name} are {array.dtype}: expected numbers")
    if array.dtype != np.float32:
        array = array.astype(np.float64)
    if not np.isfinite(array).all():
        raise ValueError(f"{name} hold numbers that are not finite")
    return np.ascontiguousarray(array)


def _indices(name: str, values: npt.ArrayLike, shape: tuple[int | None, int | None], end: int) -> IntArray:
    array = _array(name, values, shape)
    if array.dtype.kind not in "iu":
        raise ValueError(f"{name} are {array.dtype}: expected integers")
    if not 0 <= int(array.min()) <= int(array.max()) < end:
        raise ValueError(f"{name} hold {array.min()} to {array.max()}: expected 0 to {end - 1}")
    return np.ascontiguousarray(array.astype(np.uint32))


def _array(name: str, values: npt.ArrayLike, shape: tuple[int | None, int | None]) -> npt.NDArray[Any]:
    """Return values as an array of a shape. Raises ValueError if they are none."""
    if isinstance(values, range):  # it may be longer than memory
        raise ValueError(f"{name} are a range: expected an array of {len(shape)} dimensions")
    try:
        array = np.asarray(values)
    except Exception as error:  # an array of another library raises what it likes
        raise ValueError(f"{name} are not an array: {error}") from error
    fits = array.ndim == len(shape) and all(
        wanted is None or found == wanted for found, wanted in zip(array.shape, shape, strict=True)
    )
    if not fits or len(array) == 0:
        wanted = ", ".join("any" if size is None else str(size) for size in shape)
        raise ValueError(f"{name} have shape {array.shape}: expected ({wanted})")
    if array.size > MOST_REPEATED and 0 in array.strides:
        raise ValueError(
            f"{name} have shape {array.shape}, and repeat few numbers in memory: expected a copy"
        )
    return array
