"""The words and the scale in a picture."""

from __future__ import annotations

import numpy as np
import pytest

from skinbake.geometry.skinned import IntArray
from skinbake.render.pictures import INK, captioned
from skinbake.render.studio import STOPS, Look, Picture

BOTH = ("standard", "accurate")


def blank(width: int, height: int) -> Picture:
    return np.full((height, width, 3), 240, np.uint8)


def changed(picture: Picture) -> IntArray:
    """Return the columns in which something is drawn."""
    return np.flatnonzero((picture != 240).any(axis=(0, 2)))


def test_each_half_of_a_split_picture_has_its_own_word() -> None:
    look = Look(600, 300)
    columns = changed(captioned(blank(600, 300), BOTH, look))
    halves = [columns[columns < 300], columns[columns >= 300] - 300]
    assert all(len(half) > 20 for half in halves)
    assert halves[0].min() == pytest.approx(halves[1].min(), abs=2)
    found = captioned(blank(600, 300), BOTH, look)
    assert not np.array_equal(found[:, :300], found[:, 300:])


def test_words_stand_out_on_parts_of_their_own_colour() -> None:
    dark = np.broadcast_to(np.array(INK, np.uint8), (300, 600, 3)).copy()
    found = captioned(dark, BOTH, Look(600, 300))
    for half in (found[:, :300], found[:, 300:]):
        assert half.max() > 230


def test_the_scale_has_the_colours_of_the_errors_and_its_largest_angle() -> None:
    look = Look(600, 300, mode="error")
    found = captioned(blank(600, 300), BOTH, look)
    places = [np.argwhere((found == stop).all(axis=2)) for stop in STOPS]
    assert all(len(place) for place in places[:1] + places[-1:])
    assert places[0][:, 1].max() < places[-1][:, 1].min()
    assert min(place[:, 1].min() for place in (places[0], places[-1])) > 300
    assert not np.array_equal(found, captioned(blank(600, 300), BOTH, Look(600, 300, "error", legend=30.0)))
    alone = captioned(blank(600, 300), ("accurate",), look)
    assert (alone[:, :300] == 240).all()
    assert (alone[:, 300:] != 240).any()


@pytest.mark.parametrize(
    ("size", "sides", "mode"),
    [((600, 300), ("accurate",), "shaded"), ((64, 48), BOTH, "error"), ((300, 300), BOTH, "shaded")],
)
def test_pictures_that_need_no_words_stay_as_they_are(
    size: tuple[int, int], sides: tuple[str, ...], mode: str
) -> None:
    picture = blank(*size)
    assert captioned(picture, sides, Look(*size, mode)) is picture
