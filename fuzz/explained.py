"""Branches of the readers that no damaged model and no fault reaches, and why, or what else reaches them.

By file, function, and the lines that a branch leads from and to, as ``python -m fuzz.branches`` prints them.
"""

from __future__ import annotations

WINDOWS = "only on Windows"
OTHER_SYSTEM = "only on systems other than this one's Linux"
RACE = "only where another process changes a file meanwhile: tests/files/test_writing.py"
ROOT = "the fuzzer's user may write anywhere: tests/gltf/test_output.py"
LIMITS = "only with other control groups than this system's: tests/gltf/test_budget.py"
NO_OPENAT2 = "only on systems without openat2: tests/files/test_containment.py"
HEADER = "no stream is known to decode to other counts than its header has: tests/gltf/test_draco.py"
BEFORE = "every command refuses it before that: "
COPIES = "takes thousands of copies of a vertex: tests/gltf/test_budget.py"
LARGE = "takes more memory than the fuzzer gives a run: tests/gltf/test_budget.py"

SELDOM = "only in some runs: "

BY_SYSTEM = frozenset((WINDOWS, OTHER_SYSTEM, NO_OPENAT2, ROOT, LIMITS))
"""Reasons of branches that are reached on some systems: they need not be missed. Nor need those of SELDOM."""

EXPLAINED: dict[tuple[str, str, str], str] = {
    (
        "gltf/beside.py",
        "_found",
        "if error.errno == errno.EACCES: -> place = Place(str(self._document.folder / uri))",
    ): ROOT,
    (
        "gltf/budget.py",
        "claim",
        "if spent > max(FREE, RATIO * self.backed): -> raise self._refusal(",
    ): LARGE,
    ("gltf/budget.py", "claim_welding", "if self.welded > most: -> raise self._refusal("): COPIES,
    (
        "gltf/budget.py",
        "claim_unpacked",
        "if self.unpacked > max(UNPACKED_RATIO * self.packed, UNPACKED_FREE): -> raise self._refusal(",
    ): LARGE,
    (
        "gltf/budget.py",
        "group_limits",
        'if text.isdecimal(): -> for name in ("memory.max", "memory.limit_in_bytes"):',
    ): LIMITS,
    (
        "gltf/codecs/draco_stream.py",
        "_check_counts",
        "if size > max(EXPANSION * length, SMALL): -> raise InputError(",
    ): "takes a stream that stands for 64 MiB: tests/gltf/test_draco.py",
    (
        "gltf/codecs/draco_stream.py",
        "_memory_limit",
        "if soft != resource.RLIM_INFINITY and soft <= limit: -> yield",
    ): "only under a tighter limit of memory than the fuzzer sets",
    (
        "gltf/codecs/draco_stream.py",
        "_skip_metadata",
        'if depth == 0: -> raise InputError("the metadata of its Draco stream is nested too deep", place)',
    ): "`python -m fuzz.targets draco` reaches it",
    (
        "gltf/glb.py",
        "join_glb",
        'if length > MAX_LENGTH: -> raise OutputError(f"the GLB would have {length} bytes, over the format\'s limit of 4 GiB; write .gltf")',
    ): "takes an output of 4 GiB: tests/gltf/test_glb.py",
    (
        "gltf/json_text.py",
        "collector_off",
        "if was_on: -> the end",
    ): "the collector is on whenever a command runs",
    (
        "gltf/output.py",
        "write",
        'for _ in range(ATTEMPTS): -> raise OutputError("cannot be written: the files beside it keep changing", Place(self.target))',
    ): RACE,
    (
        "files/replacing.py",
        "_put_back",
        "for _ in range(ATTEMPTS): -> put_in = _state(folder, temporary)",
    ): RACE,
    ("files/replacing.py", "_put_back", "for _ in range(ATTEMPTS): -> the end"): RACE,
    ("files/replacing.py", "_put_back", "if _state(folder, temporary) == assumed: -> assumed = put_in"): RACE,
    ("files/replacing.py", "_put_back", "if _state(folder, temporary) == assumed: -> return"): RACE,
    (
        "files/replacing.py",
        "exchange_call",
        "if call is None:  # a C library from before 2018 -> return None",
    ): OTHER_SYSTEM,
    (
        "files/replacing.py",
        "exchange_call",
        'if not sys.platform.startswith("linux"): -> return None',
    ): OTHER_SYSTEM,
    (
        "files/replacing.py",
        "replaced",
        "if error.errno == errno.ENOENT:  # another program has removed or renamed it -> return False",
    ): RACE,
    (
        "files/replacing.py",
        "replaced",
        "if exchange is None or folder.descriptor is None: -> return None",
    ): OTHER_SYSTEM,
    ("files/replacing.py", "replaced", "if is_as_read: -> if not is_as_read:"): RACE,
    (
        "files/replacing.py",
        "replaced",
        "if not is_as_read: -> _put_back(folder, temporary, name, ours, exchange)",
    ): RACE,
    (
        "gltf/resources.py",
        "_own_pages",
        'if hasattr(mmap, "MADV_HUGEPAGE"): -> return memoryview(pages)',
    ): OTHER_SYSTEM,
    (
        "gltf/resources.py",
        "_own_pages",
        'if not hasattr(mmap, "MAP_ANONYMOUS"): -> return memoryview(bytearray(size))',
    ): OTHER_SYSTEM,
    (
        "gltf/resources.py",
        "read_open_file",
        'if not len(data) == size == os.fstat(descriptor).st_size: -> raise OSError(errno.EBUSY, "it changed while it was read; try again")',
    ): RACE,
    ("files/writing.py", "", 'if sys.platform != "win32": -> MOST_PIECES = 512'): WINDOWS,
    (
        "files/writing.py",
        "_check_still_so",
        "if replaces is not None and not replaces.is_current: -> raise OutputError(SAVED_ANEW, place)",
    ): RACE,
    (
        "files/temporary.py",
        "remove_abandoned",
        "if len(_looked_through) >= REMEMBERED: -> _looked_through.clear()",
    ): "takes 4,096 folders in one run",
    ("files/writing.py", "_lock", 'if sys.platform == "win32": -> return'): WINDOWS,
    ("files/writing.py", "_lock", "if time.monotonic() > deadline: -> return"): RACE,
    ("files/writing.py", "_lock", "if time.monotonic() > deadline: -> time.sleep(pause)"): RACE,
    ("files/writing.py", "_locked", "if folder.descriptor is not None: -> for folder in folders:"): WINDOWS,
    (
        "files/writing.py",
        "_name_anew",
        "if not BY_DESCRIPTOR: -> os.rename(source, goal)  # Windows replaces nothing",
    ): WINDOWS,
    (
        "files/writing.py",
        "_parts",
        'if not parts or not {"", ".", ".."}.isdisjoint(parts): -> raise OutputError(f"cannot be written: {path} is not below {roots[-1]}", place)',
    ): "names that lead out are refused before: tests/files/test_writing.py",
    (
        "files/writing.py",
        "_put_new",
        'if not _has_content(one): -> message = f"cannot be written: another run has put its {one.name} there meanwhile"',
    ): RACE,
    ("files/writing.py", "_rename", "if is_replaced is False: -> raise OutputError(SAVED_ANEW, place)"): RACE,
    (
        "files/writing.py",
        "locked",
        'if sys.platform != "win32": -> for descriptor in held.values():',
    ): WINDOWS,
    (
        "files/writing.py",
        "_write_all",
        'if hasattr(os, "writev"): -> written = os.write(descriptor, left[0])',
    ): WINDOWS,
    (
        "files/writing.py",
        "check_target",
        'if path.exists() and not os.access(path, os.W_OK): -> raise OutputError("it exists and is read-only", Place(target))',
    ): ROOT,
    (
        "files/versions.py",
        "is_current",
        "if signature_of(self.path) != self.signature: -> return False",
    ): RACE,
    (
        "files/versions.py",
        "is_in",
        "if (found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns) != self.signature[:4]: -> return False",
    ): RACE,
    ("files/writing.py", "write_files", "if not begun.is_done: -> raise"): RACE,
    ("gltf/codecs/draco_stream.py", "decode", "if 3 * len(faces) != corners: -> raise InputError("): HEADER,
    ("gltf/codecs/draco_stream.py", "_values", "if found != vertices: -> raise InputError("): HEADER,
    (
        "gltf/codecs/draco_stream.py",
        "_check_arrays",
        'if components != 3: -> raise InputError(f"it has {counted(components, \'component\')}, 3 are needed", place.at("POSITION"))',
    ): BEFORE + "tests/gltf/test_draco.py",
    (
        "gltf/codecs/draco_stream.py",
        "_check_arrays",
        'if faces.size and faces.max() >= count: -> vertices = counted(count, "vertex", "vertices")',
    ): BEFORE + "tests/gltf/test_draco.py",
    (
        "gltf/compaction.py",
        "_by_buffer",
        'if buffer is None: -> raise InputError("a buffer view names no buffer", place)',
    ): BEFORE + "tests/gltf/test_compression.py",
    (
        "gltf/output.py",
        "write",
        "if planned.again is None: -> raise",
    ): "only in a Dask worker: tests/files/test_writing.py",
    ("files/writing.py", "_put_new", "if not _has_content(one): -> is_renamed = False"): RACE,
    (
        "files/writing.py",
        "_name_anew",
        "if goal in os.listdir(descriptor): -> raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST)) from error",
    ): RACE,
    (
        "files/bounds.py",
        "bounded_paths",
        "if not found: -> for name in relative_names(uri):",
    ): "no document of the fuzzer has such a name: tests/files/test_containment.py",
    (
        "files/bounds.py",
        "bounded_path",
        'if name is None: -> raise OutsideError(f"it is not below {root}")',
    ): "no document of the fuzzer has such a name: tests/files/test_containment.py",
    ("files/folders.py", "", 'if sys.platform != "win32": -> MOST_LINKS = 40'): WINDOWS,
    (
        "files/folders.py",
        "check_regular",
        "if stat.S_ISDIR(found.st_mode): -> raise OSError(errno.EISDIR, os.strerror(errno.EISDIR))",
    ): "a folder or a device has the name of a file: tests/files/test_containment.py",
    (
        "files/folders.py",
        "check_regular",
        'if not stat.S_ISREG(found.st_mode) or found.st_dev in _made_up(): -> raise OSError(errno.EINVAL, "it is not a regular file")',
    ): "a folder or a device has the name of a file: tests/files/test_containment.py",
    (
        "files/folders.py",
        "_made_up",
        'if found.st_dev != os.stat("/").st_dev: -> for folder in ("/proc", "/sys") if sys.platform.startswith("linux") else ():',
    ): OTHER_SYSTEM,
    ("files/folders.py", "sync", "if self._descriptor is not None: -> the end"): WINDOWS,
    ("files/folders.py", "flush", "if full is None: -> fcntl.fcntl(descriptor, full)"): OTHER_SYSTEM,
    (
        "files/folders.py",
        "beneath",
        "if not BY_DESCRIPTOR: -> for number in range(1, len(parts) + 1):",
    ): WINDOWS,
    (
        "files/folders.py",
        "beneath",
        "for number in range(1, len(parts) + 1): -> step = os.path.join(root, *parts[:number])",
    ): WINDOWS,
    (
        "files/folders.py",
        "beneath",
        "for number in range(1, len(parts) + 1): -> yield Folder(path, None)",
    ): WINDOWS,
    (
        "files/folders.py",
        "beneath",
        "if not os.path.isdir(step): -> for number in range(1, len(parts) + 1):",
    ): WINDOWS,
    ("files/folders.py", "beneath", "if not os.path.isdir(step): -> if made is None:"): WINDOWS,
    (
        "files/folders.py",
        "beneath",
        "if made is None: -> raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT))",
    ): WINDOWS,
    ("files/folders.py", "beneath", "if made is None: -> os.mkdir(step)"): WINDOWS,
    (
        "files/folders.py",
        "_stepped",
        "if made is None: -> raise",
    ): "only cleaning up after a failure, where another process has removed the folder: tests/files/test_containment.py",
    (
        "files/folders.py",
        "_open",
        'if not BY_DESCRIPTOR: -> path = os.path.join(root, *name.split("/"))',
    ): WINDOWS,
    ("files/folders.py", "_check_real", "if real != base and below(real, base) is None: -> the end"): WINDOWS,
    (
        "files/folders.py",
        "_check_real",
        'if real != base and below(real, base) is None: -> raise OSError(errno.EXDEV, "a link leads out of the folder")',
    ): WINDOWS,
    ("files/folders.py", "_openat2", 'if not sys.platform.startswith("linux"): -> return None'): OTHER_SYSTEM,
    (
        "files/folders.py",
        "call",
        "if code not in {errno.EAGAIN, errno.EINTR}:  # EAGAIN: a name on the way was changed -> while True:",
    ): RACE,
    ("files/folders.py", "_walked", "while parts: -> part = parts.pop()"): NO_OPENAT2,
    ("files/folders.py", "_walked", "while parts: -> return stack.pop()"): NO_OPENAT2,
    ("files/folders.py", "_walked", 'if part in {"", "."}: -> continue'): NO_OPENAT2,
    ("files/folders.py", "_walked", 'if part in {"", "."}: -> if part == "..":'): NO_OPENAT2,
    ("files/folders.py", "_walked", 'if part == "..": -> if len(stack) == 1:'): NO_OPENAT2,
    (
        "files/folders.py",
        "_walked",
        'if part == "..": -> kind = _FOLDER_FLAGS if any(step not in {"", "."} for step in parts) else flags',
    ): NO_OPENAT2,
    (
        "files/folders.py",
        "_walked",
        'if len(stack) == 1: -> raise OSError(errno.EXDEV, "a link leads out of the folder")',
    ): NO_OPENAT2,
    ("files/folders.py", "_walked", "if len(stack) == 1: -> os.close(stack.pop())"): NO_OPENAT2,
    (
        "files/folders.py",
        "_walked",
        "if target is None: -> stack.append(os.open(part, kind | os.O_NOFOLLOW, dir_fd=stack[-1]))",
    ): NO_OPENAT2,
    ("files/folders.py", "_walked", "if target is None: -> links += 1"): NO_OPENAT2,
    (
        "files/folders.py",
        "_walked",
        "if links > MOST_LINKS: -> raise OSError(errno.ELOOP, os.strerror(errno.ELOOP))",
    ): NO_OPENAT2,
    ("files/folders.py", "_walked", 'if links > MOST_LINKS: -> if target.startswith("/"):'): NO_OPENAT2,
    (
        "files/folders.py",
        "_walked",
        'if target.startswith("/"): -> raise OSError(errno.EXDEV, "a link leads out of the folder")',
    ): NO_OPENAT2,
    (
        "files/folders.py",
        "_walked",
        'if target.startswith("/"): -> parts.extend(target.split("/")[::-1])',
    ): NO_OPENAT2,
    ("files/folders.py", "_link", "if error.errno == errno.EINVAL: -> return None"): NO_OPENAT2,
    ("files/folders.py", "_link", "if error.errno == errno.EINVAL: -> raise"): NO_OPENAT2,
    (
        "files/urls.py",
        "on_disk",
        'if not is_url(name): -> scheme, _, rest = name.partition("://")',
    ): "the fuzzer gives no URLs: tests/files/test_urls.py",
    (
        "files/urls.py",
        "named_file",
        'if path is None: -> scheme, _, rest = name.partition("://")',
    ): "the fuzzer gives no URLs: tests/files/test_urls.py",
    (
        "gltf/beside.py",
        "_occupied",
        "if self._is_target(path): -> return True",
    ): "a copied image has the name of the output: tests/gltf/test_container.py",
    (
        "gltf/beside.py",
        "files_of_extensions",
        "if inside and isinstance(uri, str) and not is_data_uri(uri) and is_relative(uri): -> found[uri] = None",
    ): "no document of the fuzzer has extensions that name files: tests/gltf/test_container.py",
    (
        "gltf/codecs/draco_stream.py",
        "_memory_limit",
        "if threading.active_count() > 1: -> yield",
    ): "takes a program with several threads: tests/gltf/test_draco.py",
    (
        "gltf/container.py",
        "_converted",
        'if pack: -> raise OutputError("--pack needs a .glb or .vrm: a .gltf has no binary chunk", Place(target))',
    ): BEFORE + "tests/gltf/test_packing.py",
    (
        "gltf/container.py",
        "_not_copied",
        "if uris: -> files = one_or_many(",
    ): "no document of the fuzzer has extensions that name files: tests/gltf/test_container.py",
    (
        "gltf/document.py",
        "_parsed",
        'if suffix != GLTF_SUFFIX and suffix not in GLB_SUFFIXES: -> raise InputError(not_gltf(path, ""), Place(path))',
    ): BEFORE + "tests/gltf/test_document.py",
    (
        "gltf/images.py",
        "images_unplaced",
        "if not missing: -> message = f\"its material puts an image on {' and '.join(missing)}, which the primitive does not have\"",
    ): "no document of the fuzzer has a material for the other coordinates: tests/render/test_texcoords.py",
    (
        "gltf/json_text.py",
        "not_finite",
        "while left: -> the end",
    ): "only the first number is asked for: tests/gltf/test_json_text.py",
    (
        "gltf/packing.py",
        "_left_buffer",
        'if isinstance(cause, OSError): -> return _Left(uri, "broken", f"is not packed: {error.message}", "buffer")',
    ): "the file of a buffer is there, and broken: tests/gltf/test_packing.py",
    (
        "gltf/primitives.py",
        "_accessor_index",
        'if number is None: -> raise InputError(f"it has no {attribute}", source.place)',
    ): BEFORE + "tests/gltf/test_primitives.py",
    (
        "gltf/codecs/draco.py",
        "holds_the_same",
        "if error is document.budget.refusal: -> raise",
    ): SELDOM + "tests/gltf/test_budget.py",
    (
        "gltf/scenes.py",
        "shown_nodes",
        'if any("mesh" in nodes[number] and "skin" in nodes[number] for number in found): '
        "-> for scene in (*first, *scenes):",
    ): SELDOM + "tests/render/test_render.py",
}
