"""Two poses, as files of any format hold them."""

from math import sqrt
from pathlib import Path

import numpy as np

# 120 degrees about (1, 1, 1): x to y to z to x; its quaternion is 1/2 (1, 1, 1, 1) up to the place of w,
# so a second pose, a quarter turn about z, tells that place.
CYCLE = [[0, 0, 1], [1, 0, 0], [0, 1, 0]]
QUARTER = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
HALF = sqrt(0.5)
POSITIONS = [[0.5, -0.25, 0.125], [0.6, 0.1, 0.3]]
EXPECTED = np.array(
    [
        [[*CYCLE[i], POSITIONS[0][i]] for i in range(3)] + [[0, 0, 0, 1]],
        [[*QUARTER[i], POSITIONS[1][i]] for i in range(3)] + [[0, 0, 0, 1]],
    ]
)
MM = "500,-250,125", "600,100,300"
IMAGES = "a_0.png", "a_1.png"
TIMED = "1700000000.000000000.png", "1700000001.500000000.png"


def flat(matrix):
    return [float(v) for row in matrix for v in row]


THIRD = 2 * np.pi / 3 / sqrt(3)  # of the rotation vector of 120 degrees about (1, 1, 1)


def joined(values, sep=" "):
    return sep.join(map(str, values))


def written(folder: Path, name: str, text: str) -> Path:
    path = folder / name
    path.parent.mkdir(exist_ok=True)
    path.write_text(text, encoding="utf-8")
    return path


def assert_expected(poses, images, atol=1e-15):
    assert poses.names == images
    np.testing.assert_allclose(poses.base_T_gripper, EXPECTED, rtol=0.0, atol=atol)
