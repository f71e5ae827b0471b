"""X with the intrinsics fixed and free: one linear step against a second refinement."""

import sys
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from handeye_fg import frames
from handeye_fg.graph import refine_views
from handeye_fg.lens import generalised
from handeye_fg.options import GraphOptions, NoiseOptions, Options
from handeye_fg.progress import silent
from handeye_fg.simulate import scenes, simulate_scene
from handeye_fg.solvers import linear_start
from handeye_fg.types import CameraModel

RUNS = 60
CAMERA = CameraModel(
    model="RADIAL", width=1280, height=960, params=np.array([1100.0, 645.0, 475.0, -0.06, 0.03])
)


@pytest.fixture(autouse=True)
def independent_errors(monkeypatch):
    """As they are simulated: that factor is found anew in each refinement."""
    monkeypatch.setattr(sys.modules["handeye_fg.graph.refine"], "_inflation", lambda *_: 1.0)


def view_of(scene, camera, intrinsics, noise=None):
    linear = linear_start(scene.robot_poses.base_T_gripper, scene.model.world_T_camera)
    view = refine_views(
        scene.model,
        scene.robot_poses.base_T_gripper,
        [camera],
        linear,
        Options(graph=GraphOptions(intrinsics=intrinsics), noise=noise or NoiseOptions()),
        "gripper",
        silent,
    )
    return view.refinement, view.intrinsics[0]


def between(one, other):
    return frames.log(frames.inverse(one) @ other)


def known(scene):
    return NoiseOptions(
        pixel_px=scene.noise.pixel,
        robot_rotation_deg=float(np.rad2deg(scene.noise.robot_rotation)),
        robot_translation_mm=1e3 * scene.noise.robot_translation,
    )


@pytest.mark.parametrize("camera", [CAMERA, scenes.default_camera()], ids=["RADIAL", "OPENCV"])
def test_the_other_choice_is_that_of_a_second_refinement(camera):
    """Up to terms of second order, which are a hundredth of a standard deviation here."""
    scene = simulate_scene(np.random.default_rng(0), n_images=10, n_points=150, camera=camera)
    final_fixed, fixed = view_of(scene, camera, "fixed", known(scene))
    final_free, free = view_of(scene, camera, "free", known(scene))
    std = np.sqrt(np.diag(final_free.observability.covariance))
    X_fixed, X_free = (one.state.gripper_T_camera for one in (final_fixed, final_free))
    assert np.abs(between(X_fixed, X_free) / std).max() > 0.1
    assert (fixed.other.kind, free.other.kind) == ("free", "fixed")
    assert np.abs(between(X_free, fixed.other.gripper_T_camera) / std).max() < 0.01
    assert np.abs(between(X_fixed, free.other.gripper_T_camera) / std).max() < 0.01
    for one, final in ((fixed, final_free), (free, final_fixed)):
        covariance = final.observability.covariance
        np.testing.assert_allclose(
            one.other.covariance / np.outer(std, std), covariance / np.outer(std, std), atol=0.02
        )
        shift = between(X_fixed, X_free)
        assert one.other.shift_translation == pytest.approx(np.linalg.norm(shift[3:]), rel=0.05)
        assert one.other.shift_rotation == pytest.approx(np.linalg.norm(shift[:3]), rel=0.05)
    assert fixed.other.shift_sigma == pytest.approx(free.other.shift_sigma, rel=0.02)
    assert fixed.focal_offset.correlation == pytest.approx(free.focal_offset.correlation, abs=0.01)


@pytest.mark.slow
@pytest.mark.simulation
def test_the_change_has_the_stated_deviations_where_the_given_intrinsics_are_right():
    """Its square is chi-square by direction: a RADIAL camera's 5 parameters change X in 5 of 6."""
    squares = []
    for seed in range(RUNS):
        scene = simulate_scene(
            np.random.default_rng(seed), n_images=10, n_points=80, camera=CAMERA, start_sigma=1e-4
        )
        squares.append(view_of(scene, CAMERA, "fixed")[1].other.shift_sigma ** 2)
    low, high = (stats.chi2.ppf(p, 5 * RUNS) / (5 * RUNS) for p in (0.0005, 0.9995))
    assert low < np.mean(squares) < high


def flat_scene(tilt_deg, *, flat, monkeypatch):
    """A narrow camera above a plane at one distance, or above a scene with depth."""
    monkeypatch.setattr(scenes, "DOME_TILT", np.deg2rad(tilt_deg))
    if flat:
        monkeypatch.setattr(scenes, "CAMERA_DISTANCE", (0.45, 0.4501))
        monkeypatch.setattr(scenes, "SCENE_HALF_SIZE", scenes.SCENE_HALF_SIZE * [1.0, 1.0, 0.0])
    camera = scenes.default_camera()
    focal = 4400.0 if flat else 1100.0
    camera = replace(camera, params=np.append([focal, focal], camera.params[2:]))
    return simulate_scene(
        np.random.default_rng(3),
        n_images=12,
        n_points=600,
        camera=camera,
        pixel_sigma=1.0,
        robot_rotation_sigma=2e-5,
        robot_translation_sigma=5e-6,
    )


@pytest.mark.parametrize("intrinsics", ["fixed", "free"])
def test_focal_length_and_position_are_confounded_above_a_plane(intrinsics, monkeypatch):
    scene = flat_scene(15.0, flat=True, monkeypatch=monkeypatch)
    offset = view_of(scene, scene.camera, intrinsics)[1].focal_offset
    assert offset.confounded
    assert offset.std_factor == pytest.approx(1.0 / np.sqrt(1.0 - offset.correlation**2))
    # Camera positions scale with the focal length: 1 % of 0.45 m at most.
    assert -0.0045 < offset.metres_per_percent < -0.002


def test_focal_length_and_position_are_told_apart_with_depth_and_tilts(monkeypatch):
    scene = flat_scene(40.0, flat=False, monkeypatch=monkeypatch)
    final, found = view_of(scene, scene.camera, "fixed", known(scene))
    assert not found.focal_offset.confounded
    assert abs(found.focal_offset.correlation) < 0.6
    # What a focal length that is a little off does is what the figure says.
    off = replace(scene.camera, params=scene.camera.params * np.repeat([1.0005, 1.0], [2, 6]))
    moved = view_of(scene, off, "fixed", known(scene))[0].state.gripper_T_camera
    shift = between(final.state.gripper_T_camera, moved)[5]
    assert shift == pytest.approx(0.05 * found.focal_offset.metres_per_percent, rel=0.05)


def test_a_distortion_that_the_model_lacks_is_refined_in_the_general_model():
    camera = scenes.default_camera()
    scene = simulate_scene(np.random.default_rng(5), n_images=10, n_points=150, camera=camera)
    pinhole = replace(camera, model="PINHOLE", params=camera.params[:4])
    _, view = view_of(scene, pinhole, "auto")
    assert view.camera.model == "OPENCV"
    assert "more distortion than PINHOLE has" in view.note
    assert np.abs((view.camera.params - camera.params) / view.std).max() < 5.0
    # A wrong focal length is another matter: the model stays.
    exact = simulate_scene(np.random.default_rng(5), n_images=10, n_points=150, camera=pinhole)
    wrong = replace(pinhole, params=pinhole.params * [1.02, 1.02, 1.0, 1.0])
    _, view = view_of(exact, wrong, "auto")
    assert view.refined
    assert view.camera.model == "PINHOLE"
    assert generalised(wrong).params.tolist() == [*wrong.params, 0.0, 0.0, 0.0, 0.0]
