import io
import re

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from handeye_fg.looks import copies, flaws, look_at


def textured(seed, shape=(120, 160)):
    """A sharp image of blobs of many sizes."""
    rng = np.random.default_rng(seed)
    levels = sum(
        cv2.resize(rng.normal(0, 22, (shape[0] // n, shape[1] // n)), shape[::-1])
        for n in (2, 4, 8, 16, 40)
    )
    return np.clip(128 + levels, 0, 255).astype(np.uint8)


def compressed(grey, quality):
    file = io.BytesIO()
    Image.fromarray(grey).save(file, "JPEG", quality=quality)
    return np.asarray(Image.open(file))


@pytest.fixture(scope="module")
def sharp():
    return {f"{k}.png": look_at(textured(k)) for k in range(9)}


@pytest.mark.parametrize(
    ("worsened", "words"),
    [
        (lambda grey: cv2.GaussianBlur(grey, (0, 0), 2), "blurred"),
        (lambda grey: cv2.blur(grey, (11, 1)), "blurred"),
        (lambda grey: (0.1 * grey).astype(np.uint8), "dark .mean grey level 1[0-9] of 255, usual"),
        (np.zeros_like, "dark"),
        (lambda grey: np.clip(grey + 240.0, 0, 255).astype(np.uint8), "overexposed"),
        (lambda grey: np.full_like(grey, 120), "without contrast"),
    ],
    ids=["out of focus", "moved", "underexposed", "black", "overexposed", "blank"],
)
def test_what_is_far_worse_than_usual_is_named(sharp, worsened, words):
    found = flaws({**sharp, "bad.png": look_at(worsened(textured(20)))})
    assert flaws(sharp) == {}
    assert list(found) == ["bad.png"]
    assert re.match(words, found["bad.png"])


def test_a_set_that_is_all_dark_or_soft_is_as_usual():
    soft = {str(k): look_at(cv2.GaussianBlur(textured(k) // 5, (0, 0), 3)) for k in range(5)}
    assert flaws(soft) == {}
    assert flaws({}) == copies({}) == {}


def test_copies_are_found_also_when_compressed_again(sharp):
    again = textured(3)
    looks = {
        **sharp,
        "same.png": look_at(again),
        "jpeg.jpg": look_at(compressed(again, 50)),
        "shifted.png": look_at(np.roll(textured(5), 2, axis=1)),
    }
    assert copies(looks) == {"same.png": ("3.png", True), "jpeg.jpg": ("3.png", False)}


def test_blank_images_are_no_copies_of_each_other(sharp):
    blank = look_at(np.full((120, 160), 7, np.uint8))
    assert copies({**sharp, "a": blank, "b": blank}) == {}


@given(st.tuples(st.integers(1, 40), st.integers(1, 40)), st.integers(0, 2**32 - 1))
def test_every_size_has_a_look(shape, seed):
    grey = np.random.default_rng(seed).integers(0, 256, shape, dtype=np.uint8)
    look = look_at(grey)
    assert np.isfinite([look.level, look.contrast, look.sharpness]).all()
    assert set(copies({"a": look, "b": look})) <= {"b"}
