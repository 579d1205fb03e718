"""What the package of every engine says of a file when it loads it: the same tests for each."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from fixtures.make_fixtures import FOLDER
from skinbake.skinning.rest import Algorithm
from tests.support import after_bake
from tests.support.baked_files import Editable
from tests.support.baking import bake_file
from tests.support.characters import Character, Placement, Pose, baked
from tests.support.stage import Stage

TUBE = FOLDER / "bent_tube.glb"


@dataclass(frozen=True)
class Drawn:
    """A character, what a page was told of it, what it has found, and the lighting that it should have."""

    stage: Stage
    told: dict[str, Any]
    found: dict[str, Any]
    character: Character
    lit: Algorithm


class FilesToldOf:
    """Tests for a class that names the engine, and the function of its page that reports of a file."""

    engine: str
    function: str = "reports"
    drawing: str = "normals"
    pose = Pose(clip=0, time=0.45)
    part = 'a part of "cut"'
    names_files = True

    def check(self, drawn: Drawn) -> None:
        """Hold what was drawn against its lighting."""
        raise NotImplementedError

    def reasons(self, stage: Stage) -> list[str]:
        """Return the reasons that the console has, sorted."""
        said = [line for line in stage.messages() if line.startswith("skinbake")]
        assert all(f"has {self.engine}'s standard lighting: " in line for line in said)
        return sorted(line.partition("lighting: ")[2] for line in said)

    def told(self, stage: Stage, path: Path) -> tuple[Any, list[str]]:
        """Return the report of a file, and the reasons that the console has, sorted."""
        found = stage.page.call(self.function, {"url": f"/models/{path.name}"})
        return found["report"] if isinstance(found, dict) else found, self.reasons(stage)

    @after_bake.each
    def test_a_file_that_a_tool_has_changed_since_its_bake_is_lit_standard(
        self, stage: Stage, kind: str
    ) -> None:
        """But for a tool that only merges equal vertices."""
        character = Character(after_bake.changed(TUBE, stage.models, kind), self.pose)
        told = character.told(Placement())
        found = stage.page.call(self.drawing, told)
        ((lighting, reason),) = found["report"]
        assert after_bake.REASONS[kind] in reason
        assert bool(reason) == bool(after_bake.REASONS[kind])
        assert lighting == ("standard" if reason else "accurate")
        assert self.reasons(stage) == ([reason] if reason else [])
        lit = Algorithm.LBS_STANDARD if reason else Algorithm.LBS_ACCURATE
        self.check(Drawn(stage, told, found, character, lit))

    def test_a_file_that_lost_its_metadata_is_lit_standard(self, stage: Stage) -> None:
        character = Character(baked(TUBE, stage.models), self.pose)
        file = Editable(character.path)
        del file.primitive()["extras"]
        path = file.write(stage.models / "lost.glb")
        told = {**character.told(Placement()), "url": f"/models/{path.name}"}
        found = stage.page.call(self.drawing, told)
        reason = "it has lost the metadata of its bake: keep the extras of primitives, or bake last"
        assert (found["report"], self.reasons(stage)) == ([["standard", reason]], [reason])
        self.check(Drawn(stage, told, found, character, Algorithm.LBS_STANDARD))

    def test_all_parts_of_a_skin_are_lit_as_the_one_that_does_not_fit_its_bake(self, stage: Stage) -> None:
        path = after_bake.simplified_in_part(FOLDER / "two_primitives.glb", stage.models)
        changed = "a tool has changed its triangles since its bake: bake last"
        alike = f"{self.part}, of the same skin, does not fit its bake: bake last"
        report, said = self.told(stage, path)
        assert report == [["standard", alike], ["standard", changed]]
        assert said == sorted([alike, changed])

    @after_bake.each_damage
    def test_damaged_metadata_are_told_of(self, stage: Stage, kind: str) -> None:
        ((lighting, reason),), said = self.told(stage, after_bake.damaged(TUBE, stage.models, kind))
        assert lighting == "standard"
        assert after_bake.DAMAGES[kind][1] in reason
        assert said == [reason]

    def test_a_file_without_a_bake_is_told_of_once(self, stage: Stage) -> None:
        """As information, not as a warning."""
        path = stage.models / "unbaked-for-information.glb"
        path.write_bytes(TUBE.read_bytes())
        (said,) = stage.call("information", {"url": f"/models/{path.name}"})
        assert said.startswith('skinbake: "')
        assert (path.name in said) == self.names_files
        before, _, remedy = said.partition(f"\" has no bake, and {self.engine}'s standard lighting: ")
        assert before
        assert remedy in ("run skinbake bake on it", "run skinbake bake on its file")
        url = f"/models/{baked(TUBE, stage.models).name}"
        assert stage.call("information", {"url": url}) == []

    @pytest.mark.parametrize("options", [{"correctives": 1}, {"leave_under": 999.0}])
    def test_a_file_with_correctives_or_left_unbaked_is_not_told_to_be_baked(
        self, stage: Stage, options: dict[str, Any]
    ) -> None:
        path = stage.models / f"{next(iter(options))}.glb"
        bake_file(TUBE, path, **options)
        assert stage.call("information", {"url": f"/models/{path.name}"}) == []
