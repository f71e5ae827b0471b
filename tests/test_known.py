"""What users know beforehand: its residuals, and that it completes or strengthens a calibration."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from scipy.spatial.transform import Rotation

import handeye_fg as hf
from handeye_fg import frames
from handeye_fg.graph import refine_views
from handeye_fg.graph.known import KnownDistance, KnownSpread, of_model, with_cameras
from handeye_fg.graph.measurements import known_graph
from handeye_fg.graph.variables import State, to_values
from handeye_fg.io.config import read_config, write_config
from handeye_fg.known import in_world_units, rows, whitened
from handeye_fg.options import NoiseOptions, Options
from handeye_fg.progress import silent
from handeye_fg.simulate import simulate_poses, simulate_scene
from handeye_fg.solvers import linear_start
from handeye_fg.types import Rig

RUNS = 40
QUATERNION = (0.1, -0.2, 0.3, 0.9)
PRIORS = (
    hf.Prior("translation-along", (0.0, 0.6, 0.8), 0.08, 1e-3),
    hf.PosePrior((0.03, -0.05, 0.09), QUATERNION, 0.5, 2.0),
    hf.PosePrior((0.03, -0.05, 0.09), QUATERNION, std_rotation_deg=0.5),
    hf.PosePrior((0.03, -0.05, 0.09), QUATERNION, std_translation_mm=2.0),
    hf.ScalePrior(0.25, 0.01),
)
NAMES = ("along", "pose", "rotation", "position", "scale")
DISTANCE = hf.DistancePrior(("a.jpg", "b.jpg"), 0.25, 1e-4)


@pytest.mark.parametrize("prior", PRIORS, ids=NAMES)
def test_derivatives_are_those_of_the_residuals(prior):
    X = frames.pose(Rotation.from_quat(QUATERNION).as_matrix(), np.array([0.02, -0.04, 0.1]))
    values, derivatives = rows(prior, X, -1.3)
    np.testing.assert_allclose(values, whitened(prior, X[None], np.array([-1.3]))[0])
    for column, step in enumerate(1e-6 * np.eye(7)):
        ahead, behind = (
            whitened(prior, (X @ frames.exp(s * step[:6]))[None], np.array([-1.3 + s * step[6]]))[0]
            for s in (1.0, -1.0)
        )
        found = (ahead - behind) / 2e-6
        scale = np.abs(derivatives).max()
        np.testing.assert_allclose(derivatives[:, column], found, atol=1e-6 * scale)


def state_of(scene):
    return State(
        world_T_camera=scene.world_T_camera,
        points_world=scene.points_world,
        gripper_T_cameras=scene.gripper_T_camera[None],
        base_T_world=scene.base_T_world,
        log_scale=float(np.log(scene.metres_per_world_unit)),
        cameras=(scene.camera,),
        rig=Rig.of_one_camera(len(scene.world_T_camera)),
    )


@pytest.mark.parametrize("prior", [*PRIORS, DISTANCE], ids=[*NAMES, "distance"])
def test_factors_have_the_residuals_that_closed_forms_have(prior):
    """GTSAM's whitened errors against the numpy ones, at the truth of a scene, whose unit is known."""
    scene = simulate_scene(np.random.default_rng(0), n_images=5, n_points=40, start_sigma=0.0)
    scene = replace(scene, model=replace(scene.model, names=("a.jpg", "b.jpg", "c", "d", "e")))
    state, X = state_of(scene), scene.gripper_T_camera
    (known,) = of_model([prior], scene.model, None)
    graph = known_graph([known])
    errors = np.concatenate(
        [graph.at(k).whitenedError(to_values(state)) for k in range(graph.size())]
    )
    plain = with_cameras(known, state.world_T_camera)
    expected = whitened(plain, X[None], np.array([state.log_scale]))[0]
    if prior.kind == "distance":
        assert isinstance(known, KnownDistance)
        metres = np.exp(state.log_scale) * np.linalg.norm(
            state.world_T_camera[0, :3, 3] - state.world_T_camera[1, :3, 3]
        )
        assert errors == pytest.approx([(metres - prior.value) / prior.std])
    elif prior.kind == "translation-along":
        assert errors[0] == pytest.approx(expected[0])
    elif prior.kind == "pose":
        # Of the rotation and of the position, in one frame or another.
        norms = [np.linalg.norm(part) for part in np.reshape(errors, (-1, 3))]
        assert norms == pytest.approx([np.linalg.norm(p) for p in np.reshape(expected, (-1, 3))])
    else:
        assert isinstance(known, KnownSpread)
        assert errors == pytest.approx(expected)
        assert expected[0] == pytest.approx(
            (state.log_scale - np.log(0.25)) / (prior.std / prior.value)
        )
    assert graph.linearize(to_values(state)).size() == graph.size()


def refined(scene, priors, noise=None):
    reported, model = scene.robot_poses.base_T_gripper, scene.model
    known = in_world_units(priors, model.names, model.world_T_camera)
    linear = linear_start(reported, model.world_T_camera, priors=known)
    options = Options(priors=tuple(priors), noise=noise or NoiseOptions())
    return refine_views(
        model, reported, [scene.camera], linear, options, "gripper", silent
    ).refinement


def length(scene, one, other):
    """True distance of two cameras, metres."""
    offset = scene.world_T_camera[one, :3, 3] - scene.world_T_camera[other, :3, 3]
    return float(scene.metres_per_world_unit * np.linalg.norm(offset))


@pytest.mark.parametrize("kind", ["scale", "distance"])
def test_a_known_length_completes_pure_rotations(kind):
    scene = simulate_scene(
        np.random.default_rng(0), n_images=10, n_points=150, motion="pure_rotation"
    )
    without = refined(scene, [])
    assert [free.kind for free in without.observability.free_directions] == ["scale"]
    names = scene.model.names
    if kind == "distance":
        true = length(scene, 0, 1)
        prior = hf.DistancePrior(names[:2], true, 0.01 * true)
    else:
        prior = hf.ScalePrior(scene.metres_per_world_unit, 0.01 * scene.metres_per_world_unit)
    final = refined(scene, [prior])
    assert not final.observability.free_directions
    ratio = final.metres_per_world_unit / scene.metres_per_world_unit
    assert ratio == pytest.approx(1.0, abs=0.02)
    assert final.metres_per_world_unit_std / final.metres_per_world_unit == pytest.approx(
        0.01, rel=0.25
    )


def test_a_wrong_length_that_is_sure_of_itself_wins_over_the_robot():
    scene = simulate_scene(np.random.default_rng(1), n_images=10, n_points=150)
    noise = NoiseOptions(robot_rotation_deg=0.1, robot_translation_mm=5.0, pixel_px=0.3)
    true = length(scene, 2, 5)
    names = scene.model.names
    free, held = (
        refined(scene, priors, noise)
        for priors in ([], [hf.DistancePrior((names[2], names[5]), 1.05 * true, 1e-5)])
    )
    where = held.base_T_camera[[2, 5], :3, 3]
    assert np.linalg.norm(where[0] - where[1]) == pytest.approx(1.05 * true, rel=1e-3)
    assert held.metres_per_world_unit_std < 0.5 * free.metres_per_world_unit_std


@pytest.mark.slow
@pytest.mark.simulation
@pytest.mark.parametrize("kind", ["pose", "scale", "distance"])
def test_the_covariance_stays_that_of_the_errors(kind):
    """With priors drawn around the truth, as their standard deviations say."""
    noise = NoiseOptions(robot_rotation_deg=0.1, robot_translation_mm=1.0, pixel_px=0.3)
    squares = []
    for seed in range(RUNS):
        rng = np.random.default_rng(seed)
        scene = simulate_scene(
            rng,
            n_images=8,
            n_points=60,
            robot_rotation_sigma=np.deg2rad(0.1),
            robot_translation_sigma=1e-3,
            start_sigma=1e-4,
        )
        X, true = scene.gripper_T_camera, length(scene, 0, 7)
        if kind == "pose":
            turn = np.deg2rad(0.05) * rng.standard_normal(3)
            R = X[:3, :3] @ Rotation.from_rotvec(turn).as_matrix()
            place = X[:3, 3] + 5e-4 * rng.standard_normal(3)
            prior = hf.PosePrior.of(frames.pose(R, place), 0.05, 0.5)
        elif kind == "scale":
            ratio = 1.0 + 1e-3 * rng.standard_normal()
            # The model's cameras are off the truth: its unit is that of their extent.
            unit = true_unit(scene)
            prior = hf.ScalePrior(ratio * unit, 1e-3 * unit)
        else:
            names = scene.model.names
            found = true + 2e-4 * rng.standard_normal()
            prior = hf.DistancePrior((names[0], names[7]), found, 2e-4)
        final = refined(scene, [prior], noise)
        error = frames.log(frames.inverse(final.state.gripper_T_camera) @ X)
        squares.append(error @ np.linalg.solve(final.observability.covariance, error))
    low, high = (stats.chi2.ppf(p, 6 * RUNS) for p in (0.0005, 0.9995))
    assert low < np.sum(squares) < high


def true_unit(scene):
    """Metres per unit of the model whose cameras were disturbed."""

    def spread(poses):
        return np.sqrt(np.var(poses[:, :3, 3], axis=0).sum())

    extent = spread(scene.world_T_camera) / spread(scene.model.world_T_camera)
    return float(scene.metres_per_world_unit * extent)


@pytest.mark.parametrize("method", ["andreff_scale", "pose_graph"])
def test_pose_pairs_take_a_known_length(method):
    robot, camera, truth = simulate_poses(
        np.random.default_rng(2),
        n_poses=12,
        motion="pure_rotation",
        robot_rotation_sigma=1e-4,
        robot_translation_sigma=5e-5,
        camera_rotation_sigma=1e-4,
        camera_translation_sigma=5e-5,
    )
    names = [f"row {i}" for i in range(12)]
    lengths = np.linalg.norm(camera[:, :3, 3] - camera[0, :3, 3], axis=1)
    far = int(lengths.argmax())
    metres = truth.metres_per_world_unit * float(lengths[far])
    assert hf.solve(robot, camera, method, names=names).status == "partial"
    for prior in (
        hf.DistancePrior((names[0], names[far]), metres, 1e-4),
        hf.ScalePrior(truth.metres_per_world_unit, 1e-3 * truth.metres_per_world_unit),
    ):
        result = hf.solve(robot, camera, method, names=names, priors=[prior])
        assert result.status == "ok"
        ratio = result.metres_per_world_unit / truth.metres_per_world_unit
        assert ratio == pytest.approx(1.0, abs=5e-3)


def test_priors_that_cannot_be_used_are_refused(tmp_path):
    robot, camera, _ = simulate_poses(np.random.default_rng(3), n_poses=6)
    names = list("abcdef")
    distance, scale = hf.DistancePrior(("a", "b"), 0.1, 1e-3), hf.ScalePrior(1.0, 0.1)
    strange = hf.DistancePrior(("a", "z"), 0.1, 1e-3)
    for prior in (distance, scale):
        with pytest.raises(hf.InputDataError, match="method takes them as metres"):
            hf.solve(robot, camera, "park_martin", names=names, priors=[prior])
    with pytest.raises(hf.InputDataError, match="z has no camera pose"):
        hf.solve(robot, camera, names=names, priors=[strange])
    with pytest.raises(hf.InputDataError, match="pose pairs come without images"):
        hf.solve(robot, camera, names=names, priors=[hf.CameraPrior(0.2, 3.0)])
    with pytest.raises(hf.InputDataError, match="the rows are motions"):
        hf.solve(robot[1:], camera[1:], motions=True, priors=[distance])
    still = np.stack([camera[0], camera[0], *camera[2:]])
    with pytest.raises(hf.InputDataError, match="did not move between them"):
        hf.solve(robot, still, names=names, robust=False, priors=[distance])
    with pytest.raises(hf.InputDataError, match="give a prior of kind distance"):
        hf.calibrate(tmp_path, {}, options=Options(priors=(scale,)))
    scene = simulate_scene(np.random.default_rng(0), n_images=4, n_points=40)
    two = Rig(n_cameras=2, camera=np.array([0, 1, 0, 1]), pose=np.array([0, 0, 1, 1]))
    with pytest.raises(hf.InputDataError, match="is for one camera"):
        of_model([scale], scene.model, two)
    pair = hf.DistancePrior(scene.model.names[:2], 0.1, 1e-3)
    with pytest.raises(hf.InputDataError, match="of the first camera"):
        of_model([pair], scene.model, two)
    other = hf.DistancePrior(scene.model.names[0:3:2], 0.1, 1e-3)
    (known,) = of_model([other], scene.model, two)
    assert known == KnownDistance(one=0, other=1, metres=0.1, std=1e-3)


def test_options_refuse_priors_that_say_nothing():
    for make, words in (
        (lambda: hf.PosePrior((0.0, 0.0), QUATERNION, 1.0), "three numbers"),
        (lambda: hf.PosePrior((0.0, 0.0, 0.0), (0.0,) * 4, 1.0), "not all zero"),
        (lambda: hf.PosePrior((0.0, 0.0, 0.0), QUATERNION), "no standard deviation"),
        (lambda: hf.PosePrior((0.0, 0.0, 0.0), QUATERNION, -1.0), "positive"),
        (lambda: hf.ScalePrior(0.0, 0.1), "value is 0.0"),
        (lambda: hf.ScalePrior(1.0, np.inf), "standard deviation is inf"),
        (lambda: hf.DistancePrior(("a", "a"), 1.0, 0.1), "two different names"),
        (lambda: hf.CameraPrior(0.0, 1.0), "positive number of per cent"),
        (lambda: hf.DistancePrior(("a", "b"), -1.0, 0.1), "value is -1.0"),
    ):
        with pytest.raises(ValueError, match=words):
            make()


def test_priors_survive_the_options_file(tmp_path):
    options = Options(priors=(*PRIORS, DISTANCE, hf.CameraPrior(0.2, 3.0)))
    assert read_config(write_config(options, tmp_path / "config.toml")) == options
    (tmp_path / "bad.toml").write_text('[[priors]]\nkind = "mass"\nvalue = 0.1\n', encoding="utf-8")
    with pytest.raises(
        hf.InputDataError, match="a table with a kind: one of translation-along, pose"
    ):
        read_config(tmp_path / "bad.toml")


def test_a_pose_prior_of_a_matrix_is_that_matrix():
    X = frames.exp(np.array([0.3, -0.2, 1.4, 0.03, -0.05, 0.09]))
    prior = hf.PosePrior.of(X, 0.5, 2.0)
    assert whitened(prior, X[None], np.zeros(1))[0] == pytest.approx(np.zeros(6), abs=1e-9)
