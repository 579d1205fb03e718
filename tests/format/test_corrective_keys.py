"""The keys of morph weights that are there and of correctives, in one sampler."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from skinbake.format.correctives import Keys, with_correctives
from tests.correctives.models import SHEET, rewritten
from tests.support.baked_files import Editable
from tests.support.command_line import invoke
from tests.support.gltf_reading import read

TIMES = np.array([0.0, 0.3, 0.35, 1.1], dtype=np.float32)
OURS = np.array([0.1, 0.32, 0.9, 1.4], dtype=np.float32), np.array([[1.0], [3.0], [-2.0], [0.5]], np.float32)


def at(keys: Keys, time: float) -> Any:
    """Return the values of a sampler at a time (glTF 2.0, appendix C), written out anew."""
    times = keys.times.astype(np.float64)
    time = min(max(time, times[0]), times[-1])
    before = max(int(np.searchsorted(times, time, side="right")) - 1, 0)
    after = min(before + 1, len(times) - 1)
    span = times[after] - times[before]
    s = (time - times[before]) / span if span else 0.0
    values = keys.values.astype(np.float64)
    if keys.method == "STEP":
        return values[before]
    if keys.method == "LINEAR":
        return values[before] + s * (values[after] - values[before])
    (_, p0, m0), (m1, p1, _) = values[before], values[after]
    return (
        (2 * s**3 - 3 * s**2 + 1) * p0
        + span * (s**3 - 2 * s**2 + s) * m0
        + (3 * s**2 - 2 * s**3) * p1
        + span * (s**3 - s**2) * m1
    )


@pytest.mark.parametrize("method", ["LINEAR", "STEP", "CUBICSPLINE"])
def test_merged_keys_play_as_each_would_alone(method: str) -> None:
    shape = (4, 3, 2) if method == "CUBICSPLINE" else (4, 2)
    there = Keys(TIMES, np.random.default_rng(5).normal(size=shape).astype(np.float32), method)
    ours = Keys(*OURS, "LINEAR")
    merged = with_correctives(there, *OURS)
    assert (np.diff(merged.times) > 0).all()
    # A step takes one float of time.
    between = [time for time in np.linspace(-0.1, 1.5, 161) if np.abs(TIMES - time).min() > 1e-6]
    for time in [*between, *TIMES.astype(float), *OURS[0].astype(float)]:
        found = at(merged, time)
        assert found[:2] == pytest.approx(at(there, time), abs=2e-5)
        assert found[2:] == pytest.approx(at(ours, time), abs=2e-5)


def test_keys_that_are_there_keep_their_bits() -> None:
    values = np.array([[0.1], [0.2], [0.7], [0.3]], dtype=np.float32)
    merged = with_correctives(Keys(TIMES, values, "LINEAR"), *OURS)
    rows = np.searchsorted(merged.times, TIMES)
    assert merged.times[rows].tobytes() == TIMES.tobytes()
    assert merged.values[rows, :1].tobytes() == values.tobytes()


def test_two_keys_at_one_time_become_the_last_one() -> None:
    times = np.array([0.0, 0.5, 0.5, 1.0], dtype=np.float32)
    values = np.array([[0.0], [1.0], [4.0], [5.0]], dtype=np.float32)
    merged = with_correctives(Keys(times, values, "LINEAR"), *OURS)
    assert (np.diff(merged.times) > 0).all()
    assert at(merged, 0.75)[0] == pytest.approx(4.5)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["LINEAR", "STEP", "CUBICSPLINE"])
@pytest.mark.parametrize("owner", ["nodes", "meshes"])
def test_what_a_pointer_to_one_weight_plays_stands_in_the_channel_too(
    owner: str, method: str, tmp_path: Path
) -> None:
    """Players that read no pointers play the channel of all weights; others find the same value twice."""
    file = Editable(SHEET)
    (animation,) = file.content["animations"]
    times = np.array([0.0, 0.4, 1.0], dtype=np.float32)
    values = np.array([0.1, 0.9, 0.3], dtype=np.float32)
    stored = np.stack([values * 0, values, values * 0], axis=1) if method == "CUBICSPLINE" else values
    channel = animation["channels"][-1]
    channel["sampler"] = len(animation["samplers"])
    sampler = {"input": file.add(times[:, None]), "output": file.add(stored.reshape(-1, 1))}
    animation["samplers"].append({**sampler, "interpolation": method})
    pointer = {"pointer": f"/{owner}/0/weights/1"}
    channel["target"] = {"path": "pointer", "extensions": {"KHR_animation_pointer": pointer}}
    file.content["extensionsUsed"] = ["KHR_animation_pointer"]
    path, out, back = file.write(tmp_path / "in.glb"), tmp_path / "out.glb", tmp_path / "back.glb"
    assert invoke("bake", path, "-o", out, "--correctives", "auto").exit_code == 0
    result = invoke("verify", out)
    assert result.exit_code == 0, result.output
    baked = read(out)
    (made,) = baked.content["animations"]
    [added] = [one for one in made["channels"] if one["target"]["path"] == "weights"]
    keys = made["samplers"][added["sampler"]]
    at_keys = baked.values(keys["input"])[:, 0].astype(np.float32)
    all_weights = baked.values(keys["output"]).reshape(len(at_keys), -1).astype(np.float32)
    played = Keys(at_keys, all_weights, keys["interpolation"])
    own = Keys(times, stored.reshape(3, -1, 1) if method == "CUBICSPLINE" else stored[:, None], method)
    for time in np.linspace(0.0, 1.0, 41):
        if method != "STEP" or np.abs(time - times[1:]).min() > 1e-3:
            assert at(played, time)[1] == pytest.approx(at(own, time)[0], abs=0.01)
            assert at(played, time)[0] == 0.0
    assert invoke("strip", out, "-o", back).exit_code == 0
    assert back.read_bytes() == path.read_bytes()


def test_a_pointer_to_all_morph_weights_is_refused(tmp_path: Path) -> None:
    def change(content: Any) -> None:
        for channel in content["animations"][0]["channels"]:
            if channel["target"]["path"] == "weights":
                node = channel["target"].pop("node")
                channel["target"]["path"] = "pointer"
                pointer = {"pointer": f"/nodes/{node}/weights"}
                channel["target"]["extensions"] = {"KHR_animation_pointer": pointer}

    path = rewritten(SHEET, tmp_path / "pointer.glb", change)
    result = invoke("bake", path, "-o", tmp_path / "out.glb", "--correctives", "auto")
    assert result.exit_code == 3 and "KHR_animation_pointer" in result.output
    assert not (tmp_path / "out.glb").exists()


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["i1", "u1", "i2", "u2"])
def test_weights_stored_as_integers_come_back_byte_for_byte(kind: str, tmp_path: Path) -> None:
    file = Editable(SHEET)
    (animation,) = file.content["animations"]
    sampler = animation["samplers"][animation["channels"][-1]["sampler"]]
    stored = np.clip(file.stored(sampler["output"]), 0.0, 1.0) * np.iinfo(kind).max
    sampler["output"] = file.add(np.round(stored).astype(kind).reshape(-1, 1))
    types = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123}
    file.content["accessors"][sampler["output"]] |= {"componentType": types[kind], "normalized": True}
    path, out, back = file.write(tmp_path / "in.glb"), tmp_path / "out.glb", tmp_path / "back.glb"
    result = invoke("bake", path, "-o", out, "--correctives", "auto")
    assert result.exit_code == 0, result.output
    assert invoke("strip", out, "-o", back).exit_code == 0
    assert back.read_bytes() == path.read_bytes()
