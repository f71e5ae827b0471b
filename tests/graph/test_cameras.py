"""What is done with the intrinsics, on simulated scenes."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from handeye_fg import frames
from handeye_fg.errors import InputDataError
from handeye_fg.graph import refine_views
from handeye_fg.lens import refinable
from handeye_fg.options import GraphOptions, Options
from handeye_fg.priors import CameraPrior
from handeye_fg.progress import silent
from handeye_fg.simulate import simulate_scene
from handeye_fg.solvers import linear_start
from handeye_fg.types import CameraModel

FULL = CameraModel(
    model="FULL_OPENCV",
    width=1280,
    height=960,
    params=np.array([900, 901, 642, 477, -0.1, 0.05, 1e-3, -8e-4, 0.12, 0.0, 0.0, 0.0]),
)
FISHEYE = CameraModel(
    model="OPENCV_FISHEYE",
    width=1280,
    height=960,
    params=np.array([700.0, 701.0, 640.0, 480.0, 0.01, -0.004, 0.001, 0.0]),
)


CAMERAS = [
    *(
        CameraModel(model=model, width=1280, height=960, params=np.array(params))
        for model, params in (
            ("SIMPLE_PINHOLE", [1100.0, 645.0, 475.0]),
            ("PINHOLE", [1100.0, 1090.0, 645.0, 475.0]),
            ("SIMPLE_RADIAL", [1100.0, 645.0, 475.0, -0.1]),
            ("RADIAL", [1100.0, 645.0, 475.0, -0.1, 0.05]),
            ("OPENCV", [1100.0, 1090.0, 645.0, 475.0, -0.1, 0.05, 1e-3, -8e-4]),
        )
    ),
    replace(FULL, params=np.concatenate([FULL.params[:9], [0.1, 0.05, -0.02]])),
    FISHEYE,
]


def view_of(scene, camera, intrinsics="auto", options=None):
    linear = linear_start(scene.robot_poses.base_T_gripper, scene.model.world_T_camera)
    return refine_views(
        scene.model,
        scene.robot_poses.base_T_gripper,
        None if camera is None else [camera],
        linear,
        options or Options(graph=GraphOptions(intrinsics=intrinsics)),
        "gripper",
        silent,
    )


def scene_of(seed, **arguments):
    return simulate_scene(np.random.default_rng(seed), n_images=10, n_points=150, **arguments)


def nees(view, scene):
    final = view.refinement
    e = frames.log(frames.inverse(final.state.gripper_T_camera) @ scene.gripper_T_camera)
    return float(e @ np.linalg.solve(final.observability.covariance, e))


LIMIT = stats.chi2.isf(1e-3, 6)


def test_a_right_camera_file_is_kept():
    scene = scene_of(0)
    view = view_of(scene, scene.camera)
    assert not view.intrinsics[0].refined
    assert view.intrinsics[0].camera is scene.camera
    assert view.intrinsics[0].std.tolist() == [0.0] * 8
    assert "were kept" in view.intrinsics[0].note
    assert nees(view, scene) < LIMIT


def test_a_wrong_camera_file_is_contradicted_and_refined():
    scene = scene_of(1)
    wrong = replace(scene.camera, params=scene.camera.params * [1.02, 1.02, 1, 1, 1, 1, 1, 1])
    kept, refined = view_of(scene, wrong, "fixed"), view_of(scene, wrong)
    assert not kept.intrinsics[0].refined
    # The error shows as robot noise that is not there.
    assert kept.refinement.noise.robot_translation > 3 * scene.noise.robot_translation
    assert refined.intrinsics[0].refined
    assert refined.intrinsics[0].other.kind == "fixed"
    assert refined.intrinsics[0].other.shift_sigma > 5.0
    assert "contradict" in refined.intrinsics[0].note
    assert nees(refined, scene) < LIMIT
    error = refined.intrinsics[0].camera.params - scene.camera.params
    assert (np.abs(error) < 5 * refined.intrinsics[0].std).all()


@pytest.mark.parametrize("wish", ["prior", "free"])
def test_intrinsics_are_refined_on_request(wish):
    scene = scene_of(2)
    view = view_of(scene, scene.camera, wish)
    assert view.intrinsics[0].refined
    assert wish in view.intrinsics[0].note
    assert (view.intrinsics[0].std > 0).all()


def test_without_a_camera_file_the_intrinsics_are_found():
    scene = scene_of(3)
    start = replace(scene.camera, params=scene.camera.params * [1.02, 1.02, 1, 1, 0, 0, 0, 0])
    view = view_of(replace(scene, model=replace(scene.model, cameras=(start,))), None)
    assert view.intrinsics[0].refined
    assert view.intrinsics[0].camera.model == "OPENCV"
    assert nees(view, scene) < LIMIT


@pytest.mark.parametrize("camera", [FULL, FISHEYE], ids=["k3", "fisheye"])
def test_other_models_are_kept_exactly(camera):
    scene = scene_of(4, camera=camera)
    view = view_of(scene, camera)
    assert not view.intrinsics[0].refined
    assert view.intrinsics[0].camera is camera
    assert nees(view, scene) < LIMIT
    if camera is FULL:
        without_k3 = replace(camera, params=np.where(np.arange(12) == 8, 0.0, camera.params))
        wrong = view_of(scene, without_k3, "fixed")
        assert wrong.refinement.noise.pixel > 1.2 * view.refinement.noise.pixel


@pytest.mark.parametrize("camera", CAMERAS, ids=lambda camera: camera.model)
def test_a_model_is_refined_in_its_own_parameters(camera):
    """With the denominator of the rational model as the file has it."""
    scene = scene_of(6, camera=camera)
    wrong = camera.params.copy()
    wrong[refinable(camera.model)] *= 1.01
    view = view_of(scene, replace(camera, params=wrong), "prior")
    assert view.intrinsics[0].refined
    assert view.intrinsics[0].camera.model == camera.model
    unknown = refinable(camera.model)
    kept = np.setdiff1d(np.arange(len(wrong)), unknown)
    np.testing.assert_array_equal(view.intrinsics[0].camera.params[kept], wrong[kept])
    assert (view.intrinsics[0].std[kept] == 0.0).all()
    error = (view.intrinsics[0].camera.params - camera.params)[unknown]
    covariance = view.refinement.intrinsics_covariances[0][np.ix_(unknown, unknown)]
    assert error @ np.linalg.solve(covariance, error) < stats.chi2.isf(1e-3, len(unknown))
    assert nees(view, scene) < LIMIT


def test_a_distortion_that_folds_the_image_is_refined_or_refused():
    scene = scene_of(5)
    params = np.zeros(12)
    params[:8] = scene.camera.params
    params[8] = -2.5
    folded = replace(scene.camera, model="FULL_OPENCV", params=params)
    with pytest.raises(InputDataError, match="folds"):
        view_of(scene, folded, "fixed")
    view = view_of(scene, folded)
    assert view.intrinsics[0].refined
    assert "folds" in view.intrinsics[0].note
    assert view.intrinsics[0].camera.model == "FULL_OPENCV"
    assert view.intrinsics[0].other is None  # there is no X with such a file
    assert nees(view, scene) < LIMIT


def test_a_prior_on_the_intrinsics_says_how_right_the_file_is():
    """Narrower than what the images say, it decides; it asks for a file that is refined."""
    scene = scene_of(2)
    wrong = replace(scene.camera, params=scene.camera.params * [1.01, 1.01, 1, 1, 1, 1, 1, 1])
    focal = wrong.params[0]
    views = {}
    for percent in (1.0, 1e-4):
        options = Options(priors=(CameraPrior(percent, 0.5),))
        views[percent] = view_of(scene, wrong, options=options).intrinsics[0]
    wide, narrow = views[1.0], views[1e-4]
    assert wide.refined
    assert "(prior)" in wide.note
    assert abs(wide.camera.params[0] - scene.camera.params[0]) < 5 * wide.std[0]
    assert narrow.camera.params[0] == pytest.approx(focal, rel=1e-5)
    assert narrow.std[0] == pytest.approx(1e-6 * focal, rel=0.3)
    for camera, wish in ((None, "auto"), (wrong, "fixed"), (wrong, "free")):
        options = Options(priors=(CameraPrior(1.0, 5.0),), graph=GraphOptions(intrinsics=wish))
        with pytest.raises(InputDataError, match="says how right a camera file is"):
            view_of(scene, camera, options=options)
