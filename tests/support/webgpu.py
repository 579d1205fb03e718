"""Compile and run WGSL with two implementations of WebGPU that share no code, each on a software driver.

NAGA is wgpu's compiler, on Mesa's lavapipe (Debian package mesa-vulkan-drivers). TINT is Dawn's, that of
Chromium; it refuses lavapipe and takes SwiftShader, of Debian's chromium-common. A Vulkan loader
reads its choice of drivers once a process: each implementation runs in a process of its own.
"""

from __future__ import annotations

import importlib.util
import os
import pickle
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.support.strictness import missing_tool

TIMEOUT_SECONDS = 300


@dataclass(frozen=True, slots=True)
class Implementation:
    """A package with wgpu's interface, and the description of the driver that it gets."""

    package: str
    drivers: tuple[Path, ...]
    debian_package: str

    def require(self) -> Path:
        """Return the driver's description; else skip, or fail under SKINBAKE_STRICT=1."""
        if importlib.util.find_spec(self.package) is None:
            missing_tool(f"{self.package} is not installed (pip install 'skinbake[dev]')")
        found = [found for path in self.drivers for found in sorted(path.parent.glob(path.name))]
        if not found:
            missing_tool(f"{self.drivers[0]} is not installed (Debian package {self.debian_package})")
        return found[0]


NAGA = Implementation(
    "wgpu",
    (Path("/usr/share/vulkan/icd.d/lvp_icd*.json"), Path("/etc/vulkan/icd.d/lvp_icd*.json")),
    "mesa-vulkan-drivers",
)
TINT = Implementation("wgpudawn", (Path("/usr/lib/chromium/vk_swiftshader_icd.json"),), "chromium-common")


@dataclass(frozen=True, slots=True)
class Job:
    """A compute shader, entry point ``main``: what bindings 0, 1, … of group 0 hold, then the results.

    Bindings behind the results hold ``further``. code is WGSL, or SPIR-V, which NAGA alone takes.
    workgroups 0 compiles only; else the shader is run over that many.
    """

    code: str | bytes
    buffers: tuple[bytes, ...] = ()
    result_bytes: int = 0
    workgroups: int = 0
    further: tuple[bytes, ...] = ()


@dataclass(frozen=True, slots=True)
class Answer:
    """The complaints of the compiler about a shader (empty: none), and the bytes of its results."""

    complaint: str
    results: bytes = b""


def answers(implementation: Implementation, jobs: Mapping[str, Job]) -> dict[str, Answer]:
    """Compile all jobs, and run those that have workgroups, in one process."""
    driver = implementation.require()
    # The second is what loaders before 1.3.207 read; the third is for lavapipe: most of the time it compiles.
    drivers = {"VK_DRIVER_FILES": str(driver), "VK_ICD_FILENAMES": str(driver)}
    environment = {**os.environ, **drivers, "GALLIVM_PERF": "nopt"}
    process = subprocess.run(
        [sys.executable, "-c", f"from {__name__} import serve; serve({implementation.package!r})"],
        input=pickle.dumps(list(jobs.values())),
        capture_output=True,
        env=environment,
        cwd=Path(__file__).parents[2],
        timeout=TIMEOUT_SECONDS,
        check=False,
    )
    if process.returncode != 0:
        raise RuntimeError(process.stderr.decode(errors="replace"))
    return dict(zip(jobs, pickle.loads(process.stdout), strict=True))


def serve(package: str) -> None:
    """Read pickled jobs from stdin and write their answers to stdout."""
    gpu = importlib.import_module(package)
    adapters = [
        adapter
        for adapter in gpu.gpu.enumerate_adapters_sync()
        if adapter.info["backend_type"] == "Vulkan" and adapter.info["adapter_type"] == "CPU"
    ]
    device = adapters[0].request_device_sync()
    found = list(_answers(gpu, device, pickle.loads(sys.stdin.buffer.read())))
    sys.stdout.buffer.write(pickle.dumps(found))


def _answers(gpu: Any, device: Any, jobs: Sequence[Job]) -> Iterator[Answer]:
    for job in jobs:
        try:
            module = device.create_shader_module(code=job.code)
            pipeline = device.create_compute_pipeline(
                layout="auto", compute={"module": module, "entry_point": "main"}
            )
        except gpu.GPUError as error:
            yield Answer(str(error))
            continue
        yield Answer("", _results(gpu, device, pipeline, job) if job.workgroups else b"")


def _results(gpu: Any, device: Any, pipeline: Any, job: Job) -> bytes:
    usage, source = gpu.BufferUsage.STORAGE | gpu.BufferUsage.UNIFORM, gpu.BufferUsage.COPY_SRC
    before, behind = (
        [device.create_buffer_with_data(data=data, usage=usage) for data in given]
        for given in (job.buffers, job.further)
    )
    results = device.create_buffer(size=job.result_bytes, usage=usage | source)
    buffers = [*before, results, *behind]
    entries = [
        {"binding": number, "resource": {"buffer": buffer, "offset": 0, "size": buffer.size}}
        for number, buffer in enumerate(buffers)
    ]
    group = device.create_bind_group(layout=pipeline.get_bind_group_layout(0), entries=entries)
    encoder = device.create_command_encoder()
    run = encoder.begin_compute_pass()
    run.set_pipeline(pipeline)
    run.set_bind_group(0, group)
    run.dispatch_workgroups(job.workgroups)
    run.end()
    device.queue.submit([encoder.finish()])
    return bytes(device.queue.read_buffer(results))
