"""Compare the place on which the page opens with the best of all places, found by trying every one.

Usage: python -m benchmarks.where_it_shows [MODEL...]

A place is a patch around any vertex, at any of 49 moments of any clip that moves. All are bounded by what
they improve, seen or not. From the largest bound on, each is looked at: rays from its vertices to the camera
are cut with all triangles, until no bound is larger than what was seen. The search of skinbake is judged by
the same rays. Poses are measured one after the other, so that no table of all of them is held.

Without a model, ten characters are compared, nine of them of the corpus (SKINBAKE_CORPUS, or
../shared/corpus).
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
from scipy.sparse import coo_array, csc_array, hstack
from scipy.sparse.csgraph import dijkstra

from benchmarks.corpus_table import REPOSITORY, corpus_folders
from skinbake.choices import Truth
from skinbake.commands import where_it_shows as search
from skinbake.commands.shown import baked_in_memory
from skinbake.freshness.baked_views import sound_views
from skinbake.geometry.skinned import IntArray
from skinbake.gltf.document import Document, read_document
from skinbake.gltf.reading.clips import Clip, read_clips
from skinbake.measure.draws import Draw
from skinbake.measure.scene import Scene, errors_of
from tests.support.characters import Array

MOMENTS = 49
CHARACTERS = (
    "TRex/trex.gltf",
    "CesiumMan/CesiumMan.glb",
    "Fox/fox.glb",
    "RiggedFigure/RiggedFigure.gltf",
    "RiggedSimple/RiggedSimple.gltf",
    "Alien/Alien_Scolitex.gltf",
    "RobotMantis/animated_robot_mantis.glb",
    "RiggedElf/RiggedElf.gltf",
    "Mannequiny/mannequiny-0.3.0.glb",
    REPOSITORY / "fixtures/characters/butterfly_wings.glb",
)


class Model:
    """All draws as one mesh: rest (V, 3), areas (V,), triangles (T, 3), and each vertex's patch, a column."""

    def __init__(self, document: Document) -> None:
        self.document = document
        self.draws = Scene(document, sound_views(document)).shown()
        self.rest, self.starts = self._positions(self.draws)
        views = [view for draw in self.draws for view in draw.surface.views]
        firsts = np.cumsum([0, *(len(view.now.positions) for view in views)])
        self.triangles = np.concatenate(
            [view.now.triangles.astype(np.int64) + first for view, first in zip(views, firsts, strict=False)]
        )
        corners = self.rest[self.triangles]
        sizes = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        self.areas = np.bincount(self.triangles.ravel(), np.repeat(sizes / 6, 3), len(self.rest))
        used = self.rest[np.unique(self.triangles)]
        self.radius = search.RADIUS * np.linalg.norm(np.ptp(used, axis=0))
        # Copies of a vertex in one draw are one place.
        owner = np.repeat(np.arange(len(self.draws)), np.diff(self.starts))
        _, self.first, self.place = np.unique(
            np.column_stack([owner, self.rest]), axis=0, return_index=True, return_inverse=True
        )
        ends = np.concatenate([self.place[self.triangles[:, pair]] for pair in ([0, 1], [1, 2], [2, 0])])
        ends = np.unique(np.sort(ends, axis=1), axis=0)
        ends = ends[ends[:, 0] != ends[:, 1]]
        lengths = np.linalg.norm(np.diff(self.rest[self.first[ends]], axis=1)[:, 0], axis=1)
        graph = coo_array((np.maximum(lengths, 1e-300), ends.T), shape=(len(self.first),) * 2).tocsr()
        parts = []
        for start in range(0, len(self.first), 500):
            chosen = np.arange(start, min(start + 500, len(self.first)))
            near = dijkstra(graph, directed=False, indices=chosen, limit=self.radius)
            parts.append(csc_array(np.isfinite(near).T[self.place].astype(np.float32)))
        self.patches = csc_array(hstack(parts, format="csc"))

    def _positions(self, posed: list[Draw]) -> tuple[Array, IntArray]:
        parts = [np.concatenate([part[0] for part in draw.positions()]) for draw in posed]
        return np.concatenate(parts), np.cumsum([0, *map(len, parts)])

    def at(self, clip: Clip, moment: float) -> tuple[Array, Array]:
        """Return positions (V, 3) and improvements (V,), 0 where nothing is known."""
        posed = [draw.at(clip, np.array([moment])) for draw in self.draws]
        errors = [one for draw in posed for one in errors_of(draw, draw.truths((Truth.TANGENTS,)))]
        standard, accurate = (
            np.concatenate([one[name][0, 0] for one in errors]).astype(np.float64)
            for name in ("standard", "accurate")
        )
        known = np.concatenate([one["standard"][1, 0] > 0 for one in errors])
        known &= (standard < search.INSIDE_OUT) & (accurate < search.INSIDE_OUT)
        return self._positions(posed)[0], np.where(known, self.areas * (standard - accurate), 0.0)

    def seen(self, positions: Array, gains: Array, members: IntArray) -> float:
        """Return what a patch improves where a camera before it sees it, by rays."""
        pulls = np.maximum(gains[members], 0.0)
        if not pulls.sum() > 0:
            return 0.0
        corners = positions[self.triangles]
        edges = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        crossed = np.cross(*edges)
        owners = self.place[self.triangles].ravel()
        of_place = np.stack(
            [np.bincount(owners, np.repeat(axis, 3), len(self.first)) for axis in crossed.T], axis=1
        )
        normals = of_place[self.place[members]]
        normals = normals / np.maximum(np.linalg.norm(normals, axis=1), 1e-300)[:, None]
        middle, mean = pulls @ positions[members] / pulls.sum(), pulls @ normals
        pitch = np.clip(np.arctan2(mean[1], np.hypot(mean[0], mean[2])), *search.PITCHES)
        yaw = np.arctan2(mean[0], mean[2])
        towards = np.array([np.cos(pitch) * np.sin(yaw), np.sin(pitch), np.cos(pitch) * np.cos(yaw)])
        eye = middle + search.AWAY * self.radius * towards
        total = 0.0
        for vertex, normal in zip(members, normals, strict=True):
            ray = eye - positions[vertex]
            length = np.linalg.norm(ray)
            if ray @ normal <= search.FACING * length:
                continue
            # Where the ray meets the plane of each triangle (Möller and Trumbore 1997).
            p = np.cross(ray, edges[1])
            determinant = (edges[0] * p).sum(axis=1)
            offset = positions[vertex] - corners[:, 0]
            u = (offset * p).sum(axis=1) / determinant
            q = np.cross(offset, edges[0])
            v, t = q @ ray / determinant, (edges[1] * q).sum(axis=1) / determinant
            deep = t * length > search.BEFORE * self.radius
            if not (deep & (t < 1) & (u > 0) & (v > 0) & (u + v < 1)).any():
                total += gains[vertex]
        return float(total)

    def members(self, place: int) -> IntArray:
        """Return the vertices of the patch around a place."""
        found: IntArray = self.patches.indices[self.patches.indptr[place] : self.patches.indptr[place + 1]]
        return found


def compare(path: Path) -> str:
    """Return the line of one model."""
    document = baked_in_memory(read_document(str(path)))
    model, clips = Model(document), read_clips(document)
    begun = time.perf_counter()
    spots = search.where_it_shows(document, model.draws)
    seconds = time.perf_counter() - begun
    if not spots:
        return f"| {path.stem} | no place |"
    spot = spots[0]
    positions, gains = model.at(spot.clip, spot.time)
    found = model.seen(positions, gains, spot.members + model.starts[spot.draw])
    # The bounds of all places, by pose: only the largest is kept until a pose is looked at.
    moments = [
        (clip, moment)
        for clip in clips
        for moment in np.linspace(clip.start, clip.duration, MOMENTS)
        if clip.duration > clip.start
    ]
    bounds = np.array([(np.maximum(model.at(*moment)[1], 0.0) @ model.patches).max() for moment in moments])
    best, looks = 0.0, 0
    for number in np.argsort(-bounds):
        if bounds[number] <= best:
            break
        positions, gains = model.at(*moments[number])
        each = np.maximum(gains, 0.0) @ model.patches
        for place in np.argsort(-each):
            if each[place] <= best:
                break
            looks += 1
            best = max(best, model.seen(positions, gains, model.members(int(place))))
    share = f"{100 * found / max(best, found):.0f} %"
    words = search.in_words(spot)
    cells = [
        path.stem,
        f"{len(model.rest):,}",
        f"{len(clips)}",
        words,
        share,
        f"{seconds:.1f} s",
        f"{looks:,}",
    ]
    return f"| {' | '.join(cells)} |"


def main() -> None:
    """Compare the models."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", maxsplit=1)[0])
    parser.add_argument("models", nargs="*", type=Path)
    models = parser.parse_args().models
    models = models or [corpus_folders()[0] / name for name in CHARACTERS]
    print("| model | vertices | clips | here | of the largest | search | places looked at |")
    print("|---|--:|--:|--:|--:|--:|--:|")
    for path in models:
        with np.errstate(all="ignore"):
            print(compare(path), flush=True)


if __name__ == "__main__":
    main()
