"""M1 to M5 as published: exact without noise, and two of them against OpenCV's with noise.

The latter is skipped where OpenCV's Python module lacks the function, as that of 5.0.0 does.
"""

from collections.abc import Callable
from functools import partial

import cv2
import numpy as np
import pytest

from handeye_fg.frames import Array, inverse, pose
from handeye_fg.simulate import disturbed
from handeye_fg.simulate.published import (
    andreff,
    andreff_scale,
    daniilidis,
    horaud_dornaika,
    tsai_lenz,
)
from handeye_fg.simulate.series import LARGE, SMALL, Amplitude, errors, simulate_draws

Method = Callable[[Array, Array], Array]

METHODS: dict[str, Method] = {
    "M1": tsai_lenz,
    "M2": daniilidis,
    "M2, millimetres": partial(daniilidis, unit=1e-3),
    "M3": horaud_dornaika,
    "M3, millimetres": partial(horaud_dornaika, unit=1e-3),
    "M4": andreff,
    "M5": andreff_scale,
}


@pytest.mark.parametrize("amplitude", [LARGE, SMALL])
@pytest.mark.parametrize("name", METHODS)
def test_exact_without_noise(name: str, amplitude: Amplitude) -> None:
    rng = np.random.default_rng(0)
    drawn = simulate_draws(rng, n_draws=50, n_motions=3, amplitude=amplitude, sigma=0.0)
    found = errors(drawn, METHODS[name], scale_known=name != "M5")
    # Rounding (1e-16) over small angles (0.1 rad or less), squared where normal equations or square
    # roots of differences that vanish take part, over lengths in millimetres: 1e-6 in the worst draws.
    assert np.quantile(found.rotation, 0.9) < 1e-6
    assert np.quantile(found.translation, 0.9) < 1e-6


@pytest.mark.skipif(
    not hasattr(cv2, "calibrateHandEye"), reason="this OpenCV has no calibrateHandEye in Python"
)
@pytest.mark.parametrize(
    ("solve", "flag"), [(tsai_lenz, "HAND_EYE_TSAI"), (daniilidis, "HAND_EYE_DANIILIDIS")]
)
def test_agrees_with_opencv(solve: Method, flag: str) -> None:
    """OpenCV takes poses, and forms all motions between them, from the later to the earlier.

    Motions below 120 degrees: there OpenCV's quaternions have a positive scalar part, too.
    """
    rng = np.random.default_rng(1)
    amplitude = Amplitude(translation=1.0, rotation=1.0)
    drawn = simulate_draws(rng, n_draws=1, n_motions=5, amplitude=amplitude, sigma=0.0)
    base_T_gripper = drawn.gi_T_gj[0]
    world_T_camera = disturbed(rng, base_T_gripper @ drawn.gripper_T_camera[0], 0.02, 0.01)
    j, i = np.triu_indices(len(base_T_gripper), k=1)
    A = inverse(base_T_gripper)[i] @ base_T_gripper[j]
    B = inverse(world_T_camera)[i] @ world_T_camera[j]
    camera_T_world = inverse(world_T_camera)
    rotation, translation = cv2.calibrateHandEye(
        list(base_T_gripper[:, :3, :3]),
        list(base_T_gripper[:, :3, 3]),
        list(camera_T_world[:, :3, :3]),
        list(camera_T_world[:, :3, 3]),
        method=getattr(cv2, f"CALIB_{flag}"),
    )
    np.testing.assert_allclose(solve(A, B), pose(rotation, translation[:, 0]), atol=1e-9)
